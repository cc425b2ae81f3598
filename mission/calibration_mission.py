"""The manoeuvre that a calibration from a flight needs (docs/calibration.md), made for a fence and its depth band.

At two heights over the floor: legs along both axes with a quarter turn on each, then a full circle in the middle.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import Origin
from autopilot.core.geometry import Fence
from autopilot.core.plan import PlanItem
from autopilot.core.shapes import bounding_box
from autopilot.mission.clearance import Clearance
from autopilot.mission.fence import build_fence, read_fence
from autopilot.mission.local_plan import EndTable, LocalPlan, OriginTable, RepeatTable, WaypointTable, plan_of_local
from autopilot.mission.mission_tuning import CALIBRATION

CALIBRATION_PARAMETERS = ("DEPTH_MAX", "DEPTH_MIN", "MPC_MARGIN")
"""Parameters that the manoeuvre depends on."""


def calibration_mission(
    fence_items: Sequence[PlanItem],
    origin: Origin,
    params: Mapping[str, float],
    *,
    radius_m: float,
    floor_m: float,
    near_ned_m: FloatArray,
    laps: int,
) -> tuple[PlanItem, ...]:
    """The mission, which ends at the surface.

    Parameters
    ----------
    fence_items
        Fence in force.
    origin
        Of the vehicle's local frame.
    params
        Those of :data:`CALIBRATION_PARAMETERS`.
    radius_m
        Of the vehicle.
    floor_m
        Depth of the floor.
    near_ned_m
        (2,) where the markers are: of several places with room the nearest one to it is taken.
    laps
        How often both heights are flown.

    Raises
    ------
    ConfigError
        Names what is missing: a fence, room in it, or depth.
    """
    shapes, problems = read_fence(fence_items, origin)
    if problems:
        raise ConfigError(f"{problems[0].reason}; upload a fence that can be read")
    fence = build_fence(shapes, params)
    if not fence.inclusions:
        raise ConfigError("the vehicle has no fence to stay inside; upload one (autopilot mission upload)")
    depths = _depths_m(fence, floor_m, radius_m + params["MPC_MARGIN"])
    keep_m = radius_m + params["MPC_MARGIN"] + CALIBRATION.margin_m
    place, reach_m = _room(fence, keep_m, near_ned_m)
    return plan_of_local(
        LocalPlan(
            origin=OriginTable(lat_deg=origin.lat_deg, lon_deg=origin.lon_deg, alt_m=origin.alt_m),
            waypoint=[
                WaypointTable(
                    x_m=place[0] + reach_m * north,
                    y_m=place[1] + reach_m * east,
                    depth_m=depth_m,
                    yaw_rad=math.remainder(turn_rad, 2.0 * math.pi),
                    accept_m=CALIBRATION.accept_fraction * reach_m,
                )
                for depth_m, sign in zip(depths, (1.0, -1.0), strict=True)
                for north, east, turn_rad in _level(sign)
            ],
            repeat=RepeatTable(laps=laps) if laps > 1 else None,
            end=EndTable(action="surface"),
        )
    ).mission


def _level(sign: float) -> list[tuple[float, float, float]]:
    """North and east in units of the reach, and heading [rad], of the waypoints at one height."""
    quarter, third = 0.5 * math.pi * sign, 2.0 * math.pi / 3.0 * sign
    legs = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]
    return [
        *((north, east, n * quarter) for n, (north, east) in enumerate(legs)),
        *((0.0, 0.0, -quarter + n * third) for n in (1, 2, 3)),
    ]


def _depths_m(fence: Fence, floor_m: float, keep_m: float) -> tuple[float, float]:
    """Greatest and least depth: heights over the floor that differ by a factor of two, if the band has it."""
    top_m = fence.depth_min_m + CALIBRATION.margin_m
    bottom_m = min(fence.depth_max_m, floor_m - keep_m) - CALIBRATION.margin_m
    low_m = max(floor_m - bottom_m, CALIBRATION.least_height_m)
    high_m = min(CALIBRATION.height_factor * low_m, floor_m - top_m)
    if not high_m >= CALIBRATION.least_factor * low_m:
        raise ConfigError(
            f"between DEPTH_MIN {fence.depth_min_m:g} and DEPTH_MAX {fence.depth_max_m:g} m, over a floor"
            f" at {floor_m:.2f} m, heights from {low_m:.2f} m do not differ by a factor of"
            f" {CALIBRATION.least_factor:g};"
            " change these parameters, or calibrate where the water is deeper"
        )
    return floor_m - low_m, floor_m - high_m


def _room(fence: Fence, keep_m: float, near_ned_m: FloatArray) -> tuple[tuple[float, float], float]:
    """Centre and radius of a circle that keeps ``keep_m`` from all boundaries, as large as is of use."""
    clearance = Clearance.of(fence)
    boxes = [bounding_box(shape) for shape in fence.inclusions]
    low, high = np.max([b[0] for b in boxes], axis=0), np.min([b[1] for b in boxes], axis=0)
    place, reach_m = 0.5 * (low + high), -math.inf
    for _ in range(CALIBRATION.refinements):
        axes = [np.linspace(low[i], high[i], CALIBRATION.grid) for i in range(2)]
        grid = np.concatenate((np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2), [place]))
        room_m = np.minimum(clearance.clearance_m(grid) - keep_m, CALIBRATION.most_reach_m)
        best = np.lexsort((np.hypot(*(grid - near_ned_m).T), -room_m))[0]
        place, reach_m = grid[best], float(room_m[best])
        cell = (high - low) / (CALIBRATION.grid - 1)
        low, high = place - cell, place + cell
    if not reach_m >= CALIBRATION.least_reach_m:
        raise ConfigError(
            f"the fence leaves a circle of {max(reach_m + keep_m, 0.0):.2f} m free; the calibration needs"
            f" {CALIBRATION.least_reach_m + keep_m:.2f} m: enlarge it, or remove obstacles"
        )
    return (float(place[0]), float(place[1])), reach_m
