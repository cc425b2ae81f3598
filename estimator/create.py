"""Construction of estimators by name, alone or with a redundant one."""

from dataclasses import replace

from autopilot.core.markers import MarkerMap
from autopilot.core.plugins import find_plugin
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.options import DEFAULT_OPTIONS, EstimatorOptions
from autopilot.estimator.protocol import Estimator, EstimatorContext
from autopilot.estimator.shadow import Shadowed

SHADOW_OF = {"ekf": "complementary"}
"""Who flies in whose shadow; in that of all others the EKF."""

SHADOW_STAMPS_S = 4.0
"""A window of the stamps' watch is two seconds long: the shadow looks at every second one."""


def create_estimator(
    name: str,
    vehicle: Vehicle,
    markers: MarkerMap | None,
    *,
    floor_depth_m: float | None = None,
    options: EstimatorOptions = DEFAULT_OPTIONS,
    shadow: bool = False,
    asked_by: str | None = None,
) -> Estimator:
    """Construct the estimator of that name for a vehicle.

    Parameters
    ----------
    name
        A shipped estimator, one of an installed package, or ``package:Class``.
    vehicle
        The vehicle file.
    markers
        Surveyed marker map; None: marker sightings cannot be used, poses can.
    floor_depth_m
        Depth of the floor under the laser [m]; None = the depth of the markers, and without markers no laser.
    options
        Options set by parameters.
    shadow
        Whether a redundant estimator runs beside it and is compared with it.
    asked_by
        Origin of the name in error messages; default ``--estimator``.

    Raises
    ------
    ConfigError
        There is none of that name, or it does not implement :class:`Estimator`; names origin, value and remedy.
    """
    if floor_depth_m is None and markers is not None:
        floor_depth_m = float(markers.corners_ned_m[..., 2].mean())
    context = EstimatorContext(
        vehicle=vehicle,
        model=vehicle.to_model(),
        markers=markers,
        floor_depth_m=floor_depth_m,
        options=options,
    )
    flown: Estimator = find_plugin("estimator", name, asked_by).make(context, Estimator)
    if not shadow:
        return flown
    options = replace(context.options, watch_tilt=False, stamps_every_s=SHADOW_STAMPS_S)
    unwatched = replace(context, markers=None, options=options)
    return Shadowed(flown, find_plugin("estimator", SHADOW_OF.get(name, "ekf")).make(unwatched, Estimator))
