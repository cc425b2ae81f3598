"""Joint estimation of vehicle pose and sheet offsets from marker images.

A pose from markers has the error of the sheets it was computed from: z = truth + C (offsets - assumed ones) + noise.
The offsets are filter states, so that an error common to all images of a sheet is not treated as white noise. The
relative positions of several sheets in one image are independent of the pose, and are a separate measurement
(:class:`SheetTies`).
"""

from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.map_errors import STATES
from autopilot.estimator.measure_pose import PoseFix, SheetDependence
from autopilot.estimator.measurement import Measurement, Moment
from autopilot.estimator.states import NX, SheetStates


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SheetTies(Measurement):
    """Measurement of the relative sheet offsets in one image: rows of at least unit variance, functions of offsets
    alone.
    """

    ground: SheetDependence

    def predicted(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """Nothing: the sheets' part comes on top."""
        return np.zeros(len(self.z))

    def jacobian(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        return np.zeros((len(self.z), NX))


_GROUNDED = (PoseFix, SheetTies)


def ground_of(measurement: Measurement) -> SheetDependence | None:
    """Dependence of a measurement on sheets, None = independent."""
    return measurement.ground if isinstance(measurement, _GROUNDED) else None


def columns_of(which: tuple[int, ...], sheets: tuple[int, ...]) -> list[int]:
    """Indices of the states of ``sheets`` among those of ``which``."""
    places = {number: k for k, number in enumerate(which)}
    return [STATES * places[number] + i for number in sheets for i in range(STATES)]


def entered(states: SheetStates | None, sheets: tuple[int, ...], sigma: FloatArray, most: int) -> SheetStates:
    """The states with those of ``sheets`` among them; new ones as they were laid, correlated with nothing.

    When there are more than ``most`` the ones that came first are forgotten."""
    if states is None:
        states = SheetStates((), np.empty(0), np.empty((NX, 0)), np.empty((0, 0)))
    new = [k for k, number in enumerate(sheets) if number not in states.which]
    if not new:
        return states
    which = [*states.which, *(sheets[k] for k in new)]
    old, more = len(states.offset), STATES * len(new)
    offset = np.concatenate((states.offset, np.zeros(more)))
    cross = np.hstack((states.cross, np.zeros((NX, more))))
    cov = np.zeros((old + more, old + more))
    cov[:old, :old] = states.cov
    cov[range(old, old + more), range(old, old + more)] = sigma[new].reshape(-1) ** 2
    drop = {k for k in range(max(0, len(which) - most)) if which[k] not in sheets}
    if drop:
        keep = [k for k in range(len(which)) if k not in drop]
        columns = [STATES * k + i for k in keep for i in range(STATES)]
        which = [which[k] for k in keep]
        offset, cross, cov = offset[columns], cross[:, columns], cov[np.ix_(columns, columns)]
    return SheetStates(tuple(which), offset, cross, cov)


def estimated_offsets(
    states: SheetStates | None, sheets: tuple[int, ...], sigma: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Offsets (4n,) and their covariance (4n, 4n)."""
    full = entered(states, sheets, sigma, len(sheets) + (0 if states is None else len(states.which)))
    columns = columns_of(full.which, sheets)
    return full.offset[columns], full.cov[columns][:, columns]
