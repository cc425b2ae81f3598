"""What an estimator is to the rest of the vehicle, and how one is made.

Two estimators stand behind the same interface: an extended Kalman filter (the default) and an observer of the
complementary type. Both take samples as they arrive, late and out of order as they may be, and say where the vehicle is
*now*.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol

from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import AidStatus, NavDoubt, NavState, ShadowStatus
from autopilot.core.samples import Sample
from autopilot.core.vehicle import Vehicle
from estimator.options import DEFAULT_OPTIONS, EstimatorOptions

ESTIMATOR_NAMES = ("ekf", "complementary")
"""Names that :func:`create_estimator` knows."""


class Estimator(Protocol):
    """Samples in, navigation state out. Deterministic: the same calls give the same states bit for bit."""

    def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray) -> NavState | None:
        """The state at ``t_us``, None until the first images have told where the vehicle is.

        To be called at the base tick with growing times. ``samples`` is what arrived since the last call, in any order.
        ``thrust_n`` (n,) is what was commanded during the last tick [N], in the order of the vehicle file.
        Bad samples (not finite, from the future, twice, too old) are counted and dropped, never raised.
        """
        ...

    @property
    def ahrs_us(self) -> int | None:
        """Time of the tick at which an AHRS sample was last good (well-formed, new, not stuck), None before."""
        ...

    @property
    def doubts(self) -> frozenset[NavDoubt]:
        """What speaks against the estimate or its sensors, as of the last step."""
        ...

    @property
    def shadow(self) -> ShadowStatus | None:
        """How far another estimator in this one's shadow is from it, as of the last step; None without one."""
        ...

    @property
    def refined_map(self) -> MarkerMap | None:
        """The marker map with its sheets where they have been found so far; None without a map."""
        ...

    def take_aids(self) -> tuple[AidStatus, ...]:
        """What became of every measurement since the last call of this method."""
        ...

    def take_remarks(self) -> tuple[str, ...]:
        """What the operator is to be told of map and calibration, since the last call of this method."""
        ...

    def counters(self) -> Mapping[str, int]:
        """Running counts by name, e.g. ``markers.fused``, ``ahrs.malformed``, ``resets``."""
        ...


def create_estimator(
    name: str,
    vehicle: Vehicle,
    markers: MarkerMap | None,
    *,
    floor_depth_m: float | None = None,
    options: EstimatorOptions = DEFAULT_OPTIONS,
    shadow: bool = False,
) -> Estimator:
    """The estimator of that name for that vehicle.

    ``markers`` is the surveyed floor (None: marker sightings cannot be used, poses can). ``floor_depth_m`` is what the
    laser points at; None = the depth of the markers, and without markers no laser. ``shadow``: the other estimator runs
    beside it and is compared with it. ConfigError if the name is unknown.
    """
    if name not in ESTIMATOR_NAMES:
        raise ConfigError(f"estimator {name!r} is not known; use one of {', '.join(ESTIMATOR_NAMES)}")
    if floor_depth_m is None and markers is not None:
        floor_depth_m = float(markers.corners_ned_m[..., 2].mean())
    from estimator.complementary import create_complementary
    from estimator.ekf import create_ekf

    create, create_other = create_ekf, create_complementary
    if name == "complementary":
        create, create_other = create_other, create
    flown = create(vehicle, markers, floor_depth_m, options)
    if not shadow:
        return flown
    from estimator.shadow import Shadowed

    return Shadowed(flown, create_other(vehicle, None, floor_depth_m, options))
