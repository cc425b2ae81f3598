"""The marker map with the estimated sheet offsets and their uncertainty."""

from dataclasses import replace

import numpy as np

from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.map_errors import STATES
from autopilot.core.markers import MarkerMap
from autopilot.estimator.gauge import common_columns, known_sheets, laid_scales
from autopilot.estimator.states import SheetStates

LEAST_SIGMA_M, LEAST_SIGMA_RAD = 1e-4, 1e-4
"""Of a sheet in a refined map: its paper and its markers' print."""


def refined_map(markers: MarkerMap, states: SheetStates | None) -> MarkerMap:
    """The map with the sheet offsets of ``states``; sheets never seen are unchanged.

    The common error of all sheets is that of the frame and no longer of any sheet. Depths stay on a level floor.
    """
    errors = markers.errors
    if errors is None or states is None or not states.which:
        return markers
    corners, pivots, sigma = markers.corners_ned_m.copy(), errors.pivot_ned_m.copy(), errors.sigma.copy()
    frame, own = _frame_and_own(pivots[list(states.which)], sigma[list(states.which)], states)
    scales = laid_scales(*known_sheets(errors, states))
    frame = frame * scales[[0, 2, 3]]
    if markers.level:  # depths and their accuracies stay unchanged
        frame[1], own[:, 2] = 0.0, sigma[list(states.which), 2]
    for k, sheet in enumerate(states.which):
        north, east, down, turn_rad = states.offset[STATES * k : STATES * (k + 1)].tolist()
        shift = np.array([north, east, 0.0 if markers.level else down])
        turn = r_ned_from_frd(np.array([0.0, 0.0, turn_rad]))
        mine = errors.sheet == sheet
        corners[mine] = pivots[sheet] + (corners[mine] - pivots[sheet]) @ turn.T + shift
        pivots[sheet] = pivots[sheet] + shift
        least = np.array([LEAST_SIGMA_M, LEAST_SIGMA_M, LEAST_SIGMA_M, LEAST_SIGMA_RAD])
        sigma[sheet] = np.minimum(np.maximum(own[k], least), sigma[sheet])
    across, depth, heading = np.hypot(frame, errors.frame_sigma).tolist()
    return replace(
        markers,
        corners_ned_m=corners,
        errors=replace(errors, pivot_ned_m=pivots, sigma=sigma, frame_sigma=(across, depth, heading)),
    )


def _frame_and_own(pivots: FloatArray, laid: FloatArray, states: SheetStates) -> tuple[FloatArray, FloatArray]:
    """Standard deviations of the sheets' common error (horizontal, down, heading), and of each from it (k, 4)."""
    count = len(pivots)
    common = common_columns(pivots)
    weight = 1.0 / np.maximum(laid.reshape(-1), 1e-6) ** 2
    of_frame = np.linalg.solve((common.T * weight) @ common, common.T * weight)
    frame = of_frame @ states.cov @ of_frame.T
    rest = np.eye(STATES * count) - common @ of_frame
    own = np.sqrt(np.maximum((rest @ states.cov @ rest.T).diagonal(), 0.0)).reshape(-1, STATES)
    across, down, heading = 0.5 * (frame[0, 0] + frame[1, 1]), frame[2, 2], frame[3, 3]
    return np.sqrt(np.maximum([across, down, heading], 0.0)), own
