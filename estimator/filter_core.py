"""Interface of the filter cores: prediction and update of the state. Everything else is in the engine."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from autopilot.core.frames import FloatArray
from autopilot.estimator.carry import PastUpdate
from autopilot.estimator.inertial import InertialStep
from autopilot.estimator.measurement import Measurement, Moment
from autopilot.estimator.states import FilterState


class Innovation(NamedTuple):
    """Innovation of a measurement, before the update."""

    y: FloatArray
    """(m,) residual."""
    variance: FloatArray
    """(m,) expected variance of each residual."""
    test_ratio: float
    """Squared distance over its gate, > 1 = to be rejected."""
    gain: FloatArray
    """(21, m) Kalman gain."""
    spread: FloatArray | None
    """(21, m) covariance between state and residual; None where :attr:`after` is known."""
    after: FilterState | None = None
    """The state if it is used, when that is known already."""
    update: PastUpdate | None = None
    """The update for :mod:`autopilot.estimator.carry`; None where its effect cannot be carried on."""

    @property
    def passes(self) -> bool:
        return self.test_ratio <= 1.0


class FilterCore(Protocol):
    """Pure functions of a filter state: nothing is remembered between calls, so that history can be replayed."""

    def start(self, x: FloatArray) -> FilterState:
        """First state around ``x`` (21,)."""
        ...

    def predict(self, state: FilterState, step: InertialStep) -> FilterState: ...

    def transition(self) -> FloatArray | None:
        """Jacobian (21, 21) of the last prediction, a new array; None: corrections of this filter cannot be carried
        forward.
        """
        ...

    def innovation(
        self, state: FilterState, measurement: Measurement, moment: Moment, after_s: float
    ) -> Innovation: ...

    def correct(self, state: FilterState, innovation: Innovation) -> FilterState:
        """State after the measurement that ``innovation`` was made of."""
        ...

    def relocate(self, state: FilterState, pose: FloatArray, noise: FloatArray, vel_ned_m_s: FloatArray) -> FilterState:
        """State moved to a pose (4,) north, east, down, yaw with covariance (4, 4) and a velocity over ground (3,).

        The heading offset moves along with the yaw."""
        ...

    def reopen(
        self, state: FilterState, part: slice, variance: float, value: Sequence[float] | None = None
    ) -> FilterState:
        """State with the variance of the components ``part`` reset, and their correlations set to zero.

        ``value``: their new mean, None = unchanged.
        """
        ...

    def loosen(self, state: FilterState, sheet: int, sigma: Sequence[float], variance: Sequence[float]) -> FilterState:
        """State in which a sheet of the map may have moved by any amount of that variance (4,) beyond the
        ``sigma`` (4,) that it was laid with."""
        ...

    def variance(self, state: FilterState, cos_yaw: float, sin_yaw: float) -> list[float]:
        """(10,) variances: position NED, yaw, velocity relative to the water FRD, current NED."""
        ...

    def planar_variance(self, state: FilterState) -> float:
        """The larger one of the variances of north and east [m^2]."""
        ...
