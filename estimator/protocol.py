"""The interface between an estimator and the service, and how an estimator is made (docs/extend.md).

Two estimators implement it: an extended Kalman filter (the default) and a complementary filter. Both accept samples
late and out of order, and estimate the state at the present tick. A class that inherits from :class:`Estimator` has to
define ``step`` and ``ahrs_us`` only.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from autopilot.core.frames import FloatArray
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import AidStatus, NavDoubt, NavState, ShadowStatus
from autopilot.core.model4 import Model4
from autopilot.core.samples import LaserSample, PoseSample, Sample
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.options import DEFAULT_OPTIONS, EstimatorOptions


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EstimatorContext:
    """Everything that an estimator is constructed from."""

    vehicle: Vehicle
    """The vehicle file: positions and latencies of the sensors."""
    model: Model4
    """4-DoF model of the vehicle: masses, drag, thruster allocation (4, N)."""
    markers: MarkerMap | None
    """Surveyed marker map; None: marker sightings cannot be used, poses can."""
    floor_depth_m: float | None
    """Depth of the floor that laser and altimeter measure to [m]; None = not known."""
    options: EstimatorOptions = DEFAULT_OPTIONS
    """Options set by parameters."""


class Estimator(Protocol):
    """Samples in, navigation state out. World frame NED, body frame FRD, SI units, radians.

    Deterministic: the same calls give the same states bit for bit, so that a log can be replayed. All calls come from
    one thread. An exception is a fault: the last estimate is used for 0.2 s, after which the estimate is invalid; the
    vehicle holds until it recovers, and the same fault a second time within one arming disarms.
    """

    @abstractmethod
    def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray) -> NavState | None:
        """Advance the estimate to the present tick.

        Parameters
        ----------
        t_us
            Time of the tick [us], every 10 ms and growing.
        samples
            Samples that arrived since the last call, in any order, each stamped with its time of measurement. Bad ones
            (not finite, from the future, duplicate, too old) are counted and dropped, never raised.
        thrust_n
            (N,) commanded thrust of the last tick [N], in the order of the vehicle file.

        Returns
        -------
        NavState or None
            The state at ``t_us``; None until the position is known. Its ``variance`` sets margins and failsafes;
            ``reset_count`` grows by one when position or yaw jump.
        """
        ...

    @property
    @abstractmethod
    def ahrs_us(self) -> int | None:
        """Time of the tick that last had a valid AHRS sample (well-formed, new, not stuck) [us]; None before the first.
        When it stops, the vehicle surfaces."""
        ...

    @property
    def doubts(self) -> frozenset[NavDoubt]:
        """Findings of the monitors against the estimate or its sensors, as of the last step."""
        return frozenset()

    @property
    def shadow(self) -> ShadowStatus | None:
        """Difference to a redundant estimator, as of the last step; None without one."""
        return None

    @property
    def refined_map(self) -> MarkerMap | None:
        """The marker map with the sheets' estimated poses; None without a map."""
        return None

    def take_aids(self) -> tuple[AidStatus, ...]:
        """Result of every measurement (innovation, test ratio, fused or rejected) since the last call."""
        return ()

    def take_made(self) -> tuple[PoseSample | LaserSample, ...]:
        """Poses and ranges made of images since the last call, with the images' stamps: inputs of a redundant
        estimator."""
        return ()

    def take_remarks(self) -> tuple[str, ...]:
        """Messages to the operator about map and calibration since the last call."""
        return ()

    def counters(self) -> Mapping[str, int]:
        """Running counts by name, e.g. ``markers.fused``, ``ahrs.malformed``, ``resets``."""
        return {}
