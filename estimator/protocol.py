"""What an estimator is to the rest of the vehicle, and what it is made of (docs/extend.md).

Two estimators stand behind the same interface: an extended Kalman filter (the default) and an observer of the
complementary type. Both take samples as they arrive, late and out of order as they may be, and say where the vehicle is
*now*. Whoever inherits from :class:`Estimator` writes ``step`` and ``ahrs_us`` and nothing more.
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
    """What an estimator is made of."""

    vehicle: Vehicle
    """The vehicle file: where sensors sit, how late they are."""
    model: Model4
    """Its 4-DoF model: masses, drags, and the allocation (4 x N)."""
    markers: MarkerMap | None
    """The surveyed floor; None: marker sightings cannot be used, poses can."""
    floor_depth_m: float | None
    """What the laser points at; None = not known."""
    options: EstimatorOptions = DEFAULT_OPTIONS
    """What parameters say of estimators."""


class Estimator(Protocol):
    """Samples in, navigation state out. World NED, body FRD, SI, radians.

    Deterministic: the same calls give the same states bit for bit; a log is replayed by that. All calls come from one
    thread. What raises is a fault: the last estimate stands in for 0.2 s, then there is none that is valid; the vehicle
    holds as long as that lasts, and the same fault a second time within one arming disarms.
    """

    @abstractmethod
    def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray) -> NavState | None:
        """The state at ``t_us``, None until it is known where the vehicle is.

        Called every 10 ms with growing times. ``samples`` is what arrived since the last call, in any order, stamped
        with the time of measurement. ``thrust_n`` (N,) is what the thrusters were to give during the last tick [N], in
        the order of the vehicle file. Bad samples (not finite, from the future, twice, too old) are to be counted and
        dropped, never raised. ``variance`` of the state is what margins and failsafes go by; ``reset_count`` grows by
        one when position or yaw jump.
        """
        ...

    @property
    @abstractmethod
    def ahrs_us(self) -> int | None:
        """Time of the tick at which an AHRS sample was last good (well-formed, new, not stuck), None before: when it
        stops, the vehicle surfaces."""
        ...

    @property
    def doubts(self) -> frozenset[NavDoubt]:
        """What speaks against the estimate or its sensors, as of the last step."""
        return frozenset()

    @property
    def shadow(self) -> ShadowStatus | None:
        """How far another estimator in this one's shadow is from it, as of the last step; None without one."""
        return None

    @property
    def refined_map(self) -> MarkerMap | None:
        """The marker map with its sheets where they have been found so far; None without a map."""
        return None

    def take_aids(self) -> tuple[AidStatus, ...]:
        """What became of every measurement since the last call of this method."""
        return ()

    def take_made(self) -> tuple[PoseSample | LaserSample, ...]:
        """Poses and ranges from pictures since the last call, stamped as the pictures were: what a shadow gets."""
        return ()

    def take_remarks(self) -> tuple[str, ...]:
        """What the operator is to be told of map and calibration, since the last call of this method."""
        return ()

    def counters(self) -> Mapping[str, int]:
        """Running counts by name, e.g. ``markers.fused``, ``ahrs.malformed``, ``resets``."""
        return {}
