"""Ground stations blame the item that was asked for last: it is the guilty one, whatever a plan is refused for."""

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import development as mav
from system_harness import OpenSession
from wire_client import REMEDIES, Harbour, WireClient

from autopilot.core.plan import MissionResult, PlanItem, PlanKind
from autopilot.core.plan_wire import item_message
from autopilot.mission.items import Command, MavFrame
from autopilot.mission.paper import paper_plan

PLAN = paper_plan(1)
KIND, R = PlanKind, MissionResult
Case = tuple[PlanKind, list[PlanItem], int]
"""A plan, and the item that is wrong with it."""


def at(command: int, north: float, east: float, down: float, *params: float) -> PlanItem:
    """An item in local metres; its number comes later."""
    p1, p2, p3, p4 = (*params, *(0.0,) * (4 - len(params)))
    return PlanItem(
        seq=0,
        frame=MavFrame.LOCAL_NED,
        command=command,
        param1=p1,
        param2=p2,
        param3=p3,
        param4=p4,
        x=round(north * 1e4),
        y=round(east * 1e4),
        z=down,
    )


def order(command: int, *params: float) -> PlanItem:
    return replace(at(command, 0.0, 0.0, 0.0, *params), frame=MavFrame.MISSION)


def numbered(items: Sequence[PlanItem]) -> list[PlanItem]:
    return [replace(item, seq=seq) for seq, item in enumerate(items)]


def place(draw: random.Random, down: float = 0.5) -> PlanItem:
    return at(Command.NAV_WAYPOINT, draw.uniform(-2, 2), draw.uniform(-1, 1), down, 0, 0, 0, math.nan)


def mission(draw: random.Random, guilty: PlanItem, *behind: PlanItem, last: bool = False) -> tuple[list[PlanItem], int]:
    """A mission in which one item is wrong, at a place that is drawn (``last``: only ``behind`` comes after it)."""
    before = [place(draw) for _ in range(draw.randint(1, 6))]
    after = [] if last else [place(draw) for _ in range(draw.randint(0, 6))]
    return numbered([*before, guilty, *after, *behind]), len(before)


def polygon(points: Sequence[tuple[float, float]], *, inside: bool = False) -> list[PlanItem]:
    command = Command.FENCE_POLYGON_VERTEX_INCLUSION if inside else Command.FENCE_POLYGON_VERTEX_EXCLUSION
    return [at(command, north, east, 0.0, len(points)) for north, east in points]


def cylinder(north: float, east: float, radius: float) -> PlanItem:
    """An obstacle of a fence."""
    return at(Command.FENCE_CIRCLE_EXCLUSION, north, east, 0.0, radius)


def fence(draw: random.Random, guilty: Sequence[PlanItem]) -> tuple[list[PlanItem], int]:
    """Obstacles far from each other, and among them what is wrong."""
    before = [cylinder(20.0 + 5.0 * k, 0.0, 0.5) for k in range(draw.randint(0, 4))]
    after = [cylinder(-20.0 - 5.0 * k, 0.0, 0.5) for k in range(draw.randint(1, 4))]
    return numbered([*before, *guilty, *after]), len(before)


def above_water(draw: random.Random) -> Case:
    """A ground station's first waypoint at its default height: it could have been home until the others came."""
    items = [replace(item, frame=MavFrame.GLOBAL_INT, z=-0.5) for item in PLAN.mission[:3]]
    first = replace(items[0], z=50.0, param1=0.0, param2=0.0, param3=0.0, param4=math.nan)
    return KIND.MISSION, numbered([first, *items[1:]]), 0


def the_far_end(draw: random.Random) -> Case:
    items, guilty = mission(draw, order(Command.DO_JUMP, 0, 1))
    items[guilty] = replace(items[guilty], param1=float(len(items) + draw.randint(0, 5)))
    return KIND.MISSION, items, guilty


def for_ever(draw: random.Random) -> Case:
    items, guilty = mission(draw, order(Command.DO_JUMP, 0, -1))
    items[guilty] = replace(items[guilty], param1=float(guilty - 1))
    items[guilty - 1] = replace(order(Command.DO_CHANGE_SPEED, 1, 0.2), seq=guilty - 1)
    return KIND.MISSION, items, guilty


def in_mission(*made: PlanItem, last: bool = False) -> Callable[[random.Random], Case]:
    def make(draw: random.Random) -> Case:
        return KIND.MISSION, *mission(draw, *made, last=last)

    return make


def in_fence(*made: PlanItem) -> Callable[[random.Random], Case]:
    def make(draw: random.Random) -> Case:
        return KIND.FENCE, *fence(draw, made)

    return make


def in_rally(made: PlanItem) -> Callable[[random.Random], Case]:
    def make(draw: random.Random) -> Case:
        points = [at(Command.RALLY_POINT, 0.1 * k, 0.0, 0.5) for k in range(draw.randint(2, 6))]
        guilty = draw.randrange(len(points))
        points[guilty] = made
        return KIND.RALLY, numbered(points), guilty

    return make


WAYPOINT = at(Command.NAV_WAYPOINT, 0.0, 0.9, 0.5, 0, 0, 0, math.nan)
GLOBAL = replace(PLAN.mission[0], seq=0)
SQUARE = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)]
CASES = {
    "too deep": (R.INVALID_PARAM7, "DEPTH_MAX 1.2 m: use 0.05 to 1.2 m", in_mission(replace(WAYPOINT, z=1.4))),
    "too shallow": (R.INVALID_PARAM7, "DEPTH_MIN", in_mission(replace(WAYPOINT, z=0.0))),
    "too deep, taking off": (
        R.INVALID_PARAM7,
        "DEPTH_MAX",
        in_mission(at(Command.NAV_TAKEOFF, 0.0, 0.0, 3.0, 0, 0, 0, math.nan)),
    ),
    "above the surface": (R.INVALID_PARAM7, "altitude must be <= 0", in_mission(replace(GLOBAL, z=0.5))),
    "above the surface, local": (R.INVALID_PARAM7, "above", in_mission(replace(WAYPOINT, z=-0.2))),
    "first item in the air": (R.INVALID_PARAM7, "above the surface", above_water),
    "NaN altitude": (R.INVALID_PARAM7, "altitude", in_mission(replace(WAYPOINT, z=math.nan))),
    "infinite altitude": (R.INVALID_PARAM7, "altitude", in_mission(replace(WAYPOINT, z=math.inf))),
    "NaN latitude": (R.INVALID_PARAM5_X, "latitude", in_mission(replace(GLOBAL, x=-(2**31)))),
    "no longitude": (R.INVALID_PARAM6_Y, "longit", in_mission(replace(GLOBAL, y=2**31 - 1))),
    "latitude and longitude 0": (R.INVALID_PARAM5_X, "both 0", in_mission(replace(GLOBAL, x=0, y=0))),
    "too far away": (R.INVALID_PARAM5_X, "km from the local origin", in_mission(replace(GLOBAL, x=GLOBAL.x + 10**7))),
    "altitude above terrain": (
        R.UNSUPPORTED_FRAME,
        "frame 10",
        in_mission(replace(GLOBAL, frame=mav.MAV_FRAME_GLOBAL_TERRAIN_ALT)),
    ),
    "body frame": (R.UNSUPPORTED_FRAME, "frame 12", in_mission(replace(WAYPOINT, frame=mav.MAV_FRAME_BODY_FRD))),
    "too fast": (
        R.INVALID_PARAM2,
        "0.9 m/s is above SPD_PLANAR_MAX",
        in_mission(order(Command.DO_CHANGE_SPEED, 1, 0.9)),
    ),
    "negative hold": (R.INVALID_PARAM1, "hold time", in_mission(replace(WAYPOINT, param1=-3.0))),
    "infinite hold": (R.INVALID_PARAM1, "infinite", in_mission(replace(WAYPOINT, param1=math.inf))),
    "infinite yaw": (R.INVALID_PARAM4, "yaw", in_mission(replace(WAYPOINT, param4=math.inf))),
    "jump out": (R.INVALID_PARAM1, "does not exist", the_far_end),
    "endless jump": (R.INVALID, "for ever", for_ever),
    "condition without a place": (
        R.INVALID,
        "no place comes",
        in_mission(order(Command.CONDITION_DISTANCE, 1.0), order(Command.DO_CHANGE_SPEED, 1, 0.2), last=True),
    ),
    "local landing": (R.UNSUPPORTED, "command 23", in_mission(replace(WAYPOINT, command=23))),
    "unknown command": (R.UNSUPPORTED, "command 65535", in_mission(order(65535))),
    "polygon of two vertices": (R.INVALID_PARAM1, "has 3 or more", in_fence(*polygon(SQUARE[:2]))),
    "polygon of other vertices": (R.INVALID_PARAM1, "of 4 vertices", in_fence(*polygon(SQUARE)[:3])),
    "polygon that crosses itself": (R.INVALID, "intersects", in_fence(*polygon([(0, 0), (2, 2), (2, 0), (0, 2)]))),
    "polygon without area": (R.INVALID, "no area", in_fence(*polygon([(0, 0), (1, 1), (1, 1.0005)]))),
    "workspace without room": (
        R.INVALID,
        "no room",
        in_fence(*polygon([(-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)], inside=True)),
    ),
    "circle without radius": (R.INVALID_PARAM1, "radius", in_fence(cylinder(0.0, 0.0, 0.0))),
    "NaN radius": (R.INVALID_PARAM1, "radius", in_fence(cylinder(0.0, 0.0, math.nan))),
    "NaN centre": (
        R.INVALID_PARAM5_X,
        "latitude",
        in_fence(replace(cylinder(0.0, 0.0, 0.2), frame=MavFrame.GLOBAL_INT, x=-(2**31))),
    ),
    "a waypoint among fences": (R.UNSUPPORTED, "command 16", in_fence(WAYPOINT)),
    "unknown shape": (R.UNSUPPORTED, "command 5999", in_fence(order(5999))),
    "no rally point": (R.UNSUPPORTED, "not supported", in_rally(WAYPOINT)),
    "rally point in the air": (
        R.INVALID_PARAM7,
        "above the surface",
        in_rally(at(Command.RALLY_POINT, 0.0, 0.0, -3.0)),
    ),
}
"""Name -> result, words of the reason, and what makes the plan."""


@pytest.fixture(scope="module", name="vehicle")
def vehicle_fixture(module_session: OpenSession) -> tuple[Harbour, WireClient]:
    """A vehicle in the tank, and a client."""
    client = WireClient()
    made = Harbour(module_session(sensors="pose", peers=(client,)))
    made.run(0.5)
    assert made.offer(client, KIND.FENCE, PLAN.fence) == MissionResult.ACCEPTED
    assert made.offer(client, KIND.MISSION, PLAN.mission) == MissionResult.ACCEPTED
    return made, client


@pytest.mark.parametrize("name", CASES)
def test_the_guilty_item_is_asked_for_last(vehicle: tuple[Harbour, WireClient], name: str) -> None:
    made, client = vehicle
    result, words, make = CASES[name]
    for seed in range(4):
        kind, items, guilty = make(random.Random(f"{name} {seed}"))
        before = made.session.parts.plans.items(kind)
        assert made.offer(client, kind, items) == result
        (text,) = client.texts()
        shown = f"{guilty} (QGC {guilty + 1})" if kind is KIND.MISSION else f"{guilty}"
        assert text.startswith(f"{kind.name.capitalize()} refused: ") and f" {shown}: " in text and words in text
        assert any(remedy in text for remedy in REMEDIES) and "\n" not in text
        said = [m for m in client.inbox if m.get_type() in ("MISSION_REQUEST_INT", "MISSION_ACK")]
        assert (said[-1].get_type(), said[-2].get_type()) == ("MISSION_ACK", "MISSION_REQUEST_INT")
        assert said[-2].seq == guilty, text
        assert made.session.parts.plans.items(kind) is before
        # The answer was lost, and the client sends its last item again: the same is blamed.
        client.inbox.clear()
        made.run(0.3)
        client.send(item_message(items[-1], kind))
        made.run(0.1)
        asked = [m.seq for m in client.received("MISSION_REQUEST_INT")]
        if client.received("MISSION_ACK")[0].type != mav.MAV_MISSION_ERROR and guilty != len(items) - 1:
            assert asked == [guilty]


def test_a_plan_that_is_taken_asks_for_every_item_once(vehicle: tuple[Harbour, WireClient]) -> None:
    made, client = vehicle
    for kind, items in ((KIND.MISSION, PLAN.mission), (KIND.FENCE, PLAN.fence)):
        assert made.offer(client, kind, items) == MissionResult.ACCEPTED
        assert [m.seq for m in client.received("MISSION_REQUEST_INT")] == list(range(len(items)))
