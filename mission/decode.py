"""Decodes the fields of an item from the wire: parameters, frames, degrees.

An invalid item is refused with the MAV_MISSION_RESULT of the wrong field and a message to the operator (MAVLink
mission protocol, common.xml). Commands are defined in :mod:`autopilot.mission.item_types`.
"""

import math

import numpy as np

from autopilot.core.errors import PlanError
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.geodesy import (
    MAX_RANGE_M,
    Origin,
    deg_from_e7,
    m_from_local_e4,
    ned_from_geodetic,
    surface_distance_m,
)
from autopilot.core.plan import MissionResult, PlanItem, PlanRejection
from autopilot.mission.items import AMSL_FRAMES, GLOBAL_FRAMES, TERRAIN_FRAMES, MavFrame

INVALID_INT32 = 2147483647
"""MAVLink's "not a number" of an integer coordinate."""

SURFACE_TOLERANCE_M = 1e-3
"""Altitudes arrive as 32-bit floats: a millimetre above the surface still is the surface."""
_PARAM_RESULT = (
    MissionResult.INVALID_PARAM1,
    MissionResult.INVALID_PARAM2,
    MissionResult.INVALID_PARAM3,
    MissionResult.INVALID_PARAM4,
)


class ItemRefusedError(PlanError):
    """An item that cannot be taken; carries the answer for the uploader."""

    def __init__(self, rejection: PlanRejection) -> None:
        super().__init__(rejection.reason)
        self.rejection = rejection


def refuse(item: PlanItem, result: MissionResult, text: str, label: str = "item") -> ItemRefusedError:
    """The error for ``item``: ``label seq: text``."""
    return ItemRefusedError(PlanRejection(seq=item.seq, result=result, reason=f"{label} {item.seq}: {text}"))


def wrong(item: PlanItem, index: int, name: str, advice: str, unit: str = "") -> ItemRefusedError:
    """The error for parameter 1..4: ``name (param1) is 7 unit; advice``."""
    value = item_params(item)[index - 1]
    shown = "not given" if math.isnan(value) else f"{value:g}{unit}"
    return refuse(item, _PARAM_RESULT[index - 1], f"{name} (param{index}) is {shown}; {advice}")


def item_params(item: PlanItem) -> tuple[float, float, float, float]:
    return item.param1, item.param2, item.param3, item.param4


def number(item: PlanItem, index: int, name: str, label: str = "item") -> float | None:
    """Parameter 1..4, None when it is NaN ("not given"); infinity is refused."""
    value = item_params(item)[index - 1]
    if math.isinf(value):
        raise refuse(item, _PARAM_RESULT[index - 1], f"{name} (param{index}) is infinite; give a number", label)
    return None if math.isnan(value) else value


def whole(item: PlanItem, index: int, name: str) -> int:
    """Parameter 1..4 as a whole number."""
    value = number(item, index, name)
    if value is None or value != int(value):
        raise wrong(item, index, name, "give a whole number")
    return int(value)


def seconds(item: PlanItem, name: str) -> float:
    """Parameter 1 as a time [s], 0 when it is not given."""
    value = number(item, 1, name) or 0.0
    if value < 0.0:
        raise wrong(item, 1, name, "give 0 s or more", " s")
    return value


def heading_rad(item: PlanItem) -> float | None:
    """Heading from p4 [deg], None = free."""
    value = number(item, 4, "yaw")
    if value is None:
        return None
    if abs(value) > 360.0:
        raise wrong(item, 4, "yaw", "use -360 to 360 deg, or NaN for a free heading", " deg")
    return wrap_pi(math.radians(value))


def check_frame(item: PlanItem, label: str = "item") -> None:
    """Refuse frames in which a position cannot be given."""
    if item.frame in GLOBAL_FRAMES or item.frame == MavFrame.LOCAL_NED:
        return
    if item.frame in TERRAIN_FRAMES:
        text = f"frame {item.frame} (altitude above terrain) is not supported; use relative altitude (frame 3)"
    elif item.frame == MavFrame.MISSION:
        text = f"frame 2 (MISSION) has no position but command {item.command} needs one; use frame 3, 0 or 1"
    else:
        text = f"frame {item.frame} is not supported; use 3 (relative altitude), 0 (AMSL) or 1 (LOCAL_NED)"
    raise refuse(item, MissionResult.UNSUPPORTED_FRAME, text, label)


def horizontal_ned_m(item: PlanItem, origin: Origin, label: str = "item") -> tuple[float, float]:
    """North and east [m] of an item with a position; refuses bad frames, coordinates and far-away points."""
    check_frame(item, label)
    for value, result, name in (
        (item.x, MissionResult.INVALID_PARAM5_X, "latitude or x (param5)"),
        (item.y, MissionResult.INVALID_PARAM6_Y, "longitude or y (param6)"),
    ):
        if abs(value) >= INVALID_INT32:
            raise refuse(item, result, f"{name} is not a number; give a position", label)
    if item.frame == MavFrame.LOCAL_NED:
        north, east = m_from_local_e4(item.x), m_from_local_e4(item.y)
    else:
        lat, lon = deg_from_e7(item.x), deg_from_e7(item.y)
        if abs(lat) > 90.0:
            text = f"latitude {lat:.7f} deg is out of range; use -90 to 90"
            raise refuse(item, MissionResult.INVALID_PARAM5_X, text, label)
        if abs(lon) > 180.0:
            text = f"longitude {lon:.7f} deg is out of range; use -180 to 180"
            raise refuse(item, MissionResult.INVALID_PARAM6_Y, text, label)
        if item.x == 0 and item.y == 0:
            text = "latitude and longitude are both 0, the position is not set; give a position"
            raise refuse(item, MissionResult.INVALID_PARAM5_X, text, label)
        if surface_distance_m(origin, lat, lon) > 2.0 * MAX_RANGE_M:
            north, east = math.radians(lat - origin.lat_deg) * 6.4e6, math.inf
        else:
            pos = ned_from_geodetic(origin, lat, lon, origin.alt_m)
            north, east = float(pos[0]), float(pos[1])
    if math.hypot(north, east) > MAX_RANGE_M:
        result = MissionResult.INVALID_PARAM5_X if abs(north) > MAX_RANGE_M else MissionResult.INVALID_PARAM6_Y
        text = (
            f"position is more than {MAX_RANGE_M / 1e3:.0f} km from the local origin "
            f"({origin.lat_deg:.6f}, {origin.lon_deg:.6f}); move the item, or set the origin near the plan"
        )
        raise refuse(item, result, text, label)
    return north, east


def depth_m(item: PlanItem, origin: Origin, label: str = "item") -> float:
    """Depth [m] of an item, positive down; refuses non-finite values and those above the surface."""
    if not math.isfinite(item.z):
        raise refuse(item, MissionResult.INVALID_PARAM7, f"altitude (param7) is {item.z}; give a number <= 0", label)
    if item.frame == MavFrame.LOCAL_NED:
        depth, rule = item.z, "z in LOCAL_NED is depth: 0.4 m under the surface is z = 0.4"
    elif item.frame in AMSL_FRAMES:
        depth = origin.alt_m - item.z
        rule = f"altitude must be <= {origin.alt_m:g} AMSL: depth 0.4 m is {origin.alt_m - 0.4:g}"
    else:
        depth, rule = -item.z, "altitude must be <= 0, -0.4 at 0.4 m"
    if depth < -SURFACE_TOLERANCE_M:
        raise refuse(item, MissionResult.INVALID_PARAM7, f"{-depth:.2f} m above the surface; {rule}", label)
    return max(0.0, depth)


def pos_ned_m(item: PlanItem, origin: Origin) -> FloatArray:
    """(3,) local NED position [m] of an item; refuses as :func:`horizontal_ned_m` and :func:`depth_m`."""
    return np.array([*horizontal_ned_m(item, origin), depth_m(item, origin)])


def is_here(item: PlanItem) -> bool:
    """Whether the item means "where the vehicle is then": no position frame, or latitude and longitude 0."""
    return item.frame == MavFrame.MISSION or (item.frame in GLOBAL_FRAMES and item.x == 0 and item.y == 0)
