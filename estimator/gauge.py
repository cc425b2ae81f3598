"""Common error of all sheets of a map, unobservable from images, and the accuracy of the laying of sheets.

Images determine the positions of sheets relative to each other, not their mean in the tank (gauge freedom). The
uncertainty of the mean follows from the laying accuracy, for which the map has a stated or default value. The scatter
of the estimated offsets about their common part gives a measured value.
"""

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.map_errors import STATES, MapErrors
from autopilot.estimator.states import EAST, NORTH, SheetStates

KNOWN_FRACTION = 0.25
"""An offset is known when its variance is this share of its prior."""
STATED_COUNT = 4.0
"""The map's word on how well its sheets were laid counts as so many offsets."""
KINDS = ((0, 1), (2,), (3,))
"""Components of an offset that are laid equally well: place, depth, heading."""
LEAST_SIGMA = 1e-6
"""m, rad: keeps weights finite."""
_ENTRIES = ((0, 0), (1, 1), (2, 2), (3, 3), (0, 3), (1, 3))


def known_sheets(errors: MapErrors, states: SheetStates) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of sheets with estimated offsets: position (k, 3), offsets (k, 4), and stated laying accuracy (k, 4)."""
    which = list(states.which)
    sigma = np.maximum(errors.sigma[which], LEAST_SIGMA)
    variance = states.cov.diagonal().reshape(-1, STATES)
    known = (variance[:, 3] < KNOWN_FRACTION * sigma[:, 3] ** 2) & (variance[:, 0] < sigma[:, 0] ** 2)
    return errors.pivot_ned_m[which][known], states.offset.reshape(-1, STATES)[known], sigma[known]


def common_columns(pivots: FloatArray) -> FloatArray:
    """(4k, 4) offsets of the sheets for a common translation north, east, down or rotation about their mean."""
    arm = pivots - pivots.mean(axis=0)
    common = np.zeros((STATES * len(pivots), STATES))
    common[0::STATES, 0] = common[1::STATES, 1] = common[2::STATES, 2] = common[3::STATES, 3] = 1.0
    common[0::STATES, 3], common[1::STATES, 3] = -arm[:, 1], arm[:, 0]
    return common


def laid_scales(pivots: FloatArray, offsets: FloatArray, sigma: FloatArray) -> FloatArray:
    """(4,) measured over stated laying accuracy: north, east, down, heading; 1 without data."""
    scales = np.ones(STATES)
    if len(pivots) < 2:
        return scales
    common = common_columns(pivots)
    weight = 1.0 / sigma.reshape(-1) ** 2
    shared = np.linalg.solve((common.T * weight) @ common, common.T @ (weight * offsets.reshape(-1)))
    own = (offsets.reshape(-1) - common @ shared).reshape(-1, STATES) / sigma
    for kind in KINDS:
        part = list(kind)
        freedom = len(kind) * (len(pivots) - 1)
        squares = float((own[:, part] ** 2).sum())
        scales[part] = np.sqrt((STATED_COUNT + squares) / (STATED_COUNT + freedom))
    return scales


def common_covariance(pivots: FloatArray, sigma: FloatArray) -> FloatArray:
    """(4, 4) covariance of the sheets' common error about their mean, each laid with the accuracy (k, 4)."""
    common = common_columns(pivots)
    return np.asarray(np.linalg.inv((common.T / sigma.reshape(-1) ** 2) @ common), dtype=np.float64)


class Gauge:
    """Variance of the mean of all sheets by the offsets estimated so far, compared with the filter's from the map."""

    def __init__(self, errors: MapErrors) -> None:
        self._errors = errors
        self._middle = [0.0, 0.0, 0.0]
        self._more = [0.0] * len(_ENTRIES)
        """Entries of the difference of the two covariances (4, 4)."""

    def update(self, states: SheetStates) -> None:
        """Update after new or more accurate offsets."""
        pivots, offsets, sigma = known_sheets(self._errors, states)
        if len(pivots) < 2:
            return
        scales = laid_scales(pivots, offsets, sigma)
        self._middle = pivots.mean(axis=0).tolist()
        more = common_covariance(pivots, sigma * scales) - common_covariance(pivots, sigma)
        self._more = [more.item(entry) for entry in _ENTRIES]

    def more_variance(self, x: FloatArray) -> list[float]:
        """(4,) variance of north, east, down, yaw at the state's position in addition to the filter's; negative where
        sheets were laid better than stated.
        """
        north, east = x.item(NORTH) - self._middle[0], x.item(EAST) - self._middle[1]
        across, along, down, turn, across_turn, along_turn = self._more
        return [
            across - 2.0 * east * across_turn + east * east * turn,
            along + 2.0 * north * along_turn + north * north * turn,
            down,
            turn,
        ]
