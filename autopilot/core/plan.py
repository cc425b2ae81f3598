"""Plans as in the MAVLink mission protocol: items, kinds, and the result of an upload."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol


class PlanKind(IntEnum):
    """MAV_MISSION_TYPE."""

    MISSION = 0
    FENCE = 1
    RALLY = 2


class MissionResult(IntEnum):
    """MAV_MISSION_RESULT (common.xml)."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID = 5
    INVALID_PARAM1 = 6
    INVALID_PARAM2 = 7
    INVALID_PARAM3 = 8
    INVALID_PARAM4 = 9
    INVALID_PARAM5_X = 10
    INVALID_PARAM6_Y = 11
    INVALID_PARAM7 = 12
    INVALID_SEQUENCE = 13
    DENIED = 14
    OPERATION_CANCELLED = 15


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanItem:
    """One MISSION_ITEM_INT, stored unchanged so that a download returns what was uploaded."""

    seq: int
    frame: int
    """MAV_FRAME."""
    command: int
    """MAV_CMD."""
    param1: float = 0.0
    param2: float = 0.0
    param3: float = 0.0
    param4: float = float("nan")
    x: int = 0
    """Latitude 1e-7 deg, or metres * 1e4 in local frames."""
    y: int = 0
    """Longitude 1e-7 deg, or metres * 1e4 in local frames."""
    z: float = 0.0
    """Altitude [m, up] in global frames, metres down in LOCAL_NED."""
    autocontinue: int = 1
    is_home: bool = False
    """The row that ground stations of the ArduPilot family put before a mission: not flown, but numbered."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanRejection:
    """Reason for refusing a plan. ``reason`` names the item, the problem and the remedy, in one line."""

    seq: int | None
    """The item that is to be changed; None when it is no item's fault."""
    result: MissionResult
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanProblem(PlanRejection):
    """Something wrong with the plans in force, or between them: nothing may be flown until it is mended."""

    kind: PlanKind
    """The plan whose item ``seq`` is."""


MAX_ITEMS = {PlanKind.MISSION: 2000, PlanKind.FENCE: 1000, PlanKind.RALLY: 1000}
"""Items that a plan may hold; a mission one more when it begins with home."""

_FENCE_RETURN_POINT = 5000
_NAV_WAYPOINT = 16
_AMSL = (0, 5)
"""MAV_FRAME_GLOBAL and _GLOBAL_INT."""


def may_be_home(item: PlanItem) -> bool:
    """Whether an item may be the home position before a mission: a plain waypoint with an altitude above the sea."""
    bare = not (item.param1 or item.param2 or item.param3) and (item.param4 == 0.0 or item.param4 != item.param4)
    return item.seq == 0 and item.command == _NAV_WAYPOINT and item.frame in _AMSL and bare


def begins_with_home(items: Sequence[PlanItem]) -> bool:
    """Whether the first item of a mission is home (as in files "QGC WPL 110"): it is the only place in its frame."""
    if not items or not may_be_home(items[0]):
        return False
    frames = {item.frame in _AMSL for item in items[1:] if item.x or item.y}
    return frames == {False}


def in_water(item: PlanItem, surface_alt_m: float, params: Mapping[str, float]) -> bool:
    """Whether an item that may be home is within the vehicle's range of depths, which makes it a waypoint."""
    return params["DEPTH_MIN"] <= surface_alt_m - item.z <= params["DEPTH_MAX"]


def has_shapes(fence: Sequence[PlanItem]) -> bool:
    """Whether a fence plan keeps the vehicle in or out of anything."""
    return any(item.command != _FENCE_RETURN_POINT for item in fence)


class PlanChange(Protocol):
    """A change of plans that has been asked for; it is judged beside the loop."""

    @property
    def done(self) -> bool:
        """Whether it has been taken or refused."""
        ...

    @property
    def rejection(self) -> PlanRejection | None:
        """Why it was refused; None when it was taken, or is not done."""
        ...

    def cancel(self) -> None:
        """It is not wanted any more: the plans in force stay, unless it was done before."""
        ...


class PlanStore(Protocol):
    """Storage of plans for the MAVLink mission protocol (implemented in mission/store.py)."""

    def items(self, kind: PlanKind) -> tuple[PlanItem, ...]: ...

    def size_text(self) -> str:
        """Size of a mission that is far, for texts; "" for others."""
        ...

    def checksum(self, kind: PlanKind) -> int:
        """Opaque id of the plan in force (MAVLink mission protocol): another one whenever it changes, 0 = empty."""
        ...

    def check_item(self, kind: PlanKind, item: PlanItem) -> PlanRejection | None:
        """The cheap check of one item as it arrives (frame, command, ranges, NaN)."""
        ...

    def propose(self, plans: Mapping[PlanKind, tuple[PlanItem, ...]]) -> PlanChange:
        """Validate plans and accept all of them, or refuse and keep the active ones. Replaces a pending change."""
        ...

    @property
    def kept(self) -> bool:
        """Whether the active plans are stored on disk, or have failed to be; always true without storage."""
        ...
