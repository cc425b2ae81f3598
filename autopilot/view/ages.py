"""Age limits beyond which a displayed value is stale (grey).

A limit is :data:`MISSED` nominal periods of the value, and no less than :data:`LEAST_S`: the page gets ten frames
per second. Rates are in the vehicle file; a value without one gets :data:`UNKNOWN_S`.
"""

from autopilot.core.sensors import SENSOR_ROWS
from autopilot.core.vehicle import Vehicle
from autopilot.view.feed import CAMERA, FRAME_S, PICTURE_S
from autopilot.view.page_state import AgeLimits

MISSED = 5
"""Missed periods in a row before a value is stale."""
LEAST_S = 5 * FRAME_S
UNKNOWN_S = 2.0
SLOW_S = 1.0
"""Period of battery monitors, leak probes and the loop's account."""
LINK_S = 2.0
"""Four times the longest pause between two frames (:data:`autopilot.view.hub.IDLE_S`)."""
CONTROL_S = 0.05
"""Time between two control steps."""
FLOW_S = 1.0
"""Time between two fields of the current."""


def limit_s(period_s: float) -> float:
    """Age above which a value of this period is stale."""
    return max(LEAST_S, MISSED * period_s)


def sensor_limits_s(vehicle: Vehicle) -> dict[str, float]:
    """Of devices and aiding sensors, by name; others have :data:`UNKNOWN_S`."""
    periods: dict[str, float] = {}
    for row in SENSOR_ROWS:
        if row.table:
            periods |= dict.fromkeys((row.device, *row.aids), 1.0 / getattr(vehicle, row.table).rate_hz)
    periods |= dict.fromkeys(("battery", "leak", "hull"), SLOW_S)
    if vehicle.camera is not None:
        periods |= dict.fromkeys((CAMERA, "markers", "laser"), 1.0 / vehicle.camera.rate_hz)
    return {name: limit_s(period_s) for name, period_s in periods.items()}


def age_limits(vehicle: Vehicle) -> AgeLimits:
    """Of the parts of the page."""
    camera = vehicle.camera
    late_s, period_s = (0.0, PICTURE_S) if camera is None else (camera.latency_s, 1.0 / camera.rate_hz)
    return AgeLimits(
        link_s=LINK_S,
        estimate_s=limit_s(1.0 / vehicle.ahrs.rate_hz),
        control_s=limit_s(CONTROL_S),
        picture_s=late_s + limit_s(max(period_s, PICTURE_S)),
        battery_s=limit_s(SLOW_S),
        loop_s=limit_s(SLOW_S),
        flow_s=limit_s(FLOW_S),
        track_s=UNKNOWN_S,
    )
