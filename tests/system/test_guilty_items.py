"""Ground stations blame the item that was asked for last: it is the guilty one, whatever a plan is refused for."""

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import development as mav
from system_harness import OpenSession
from wire_client import Harbour, WireClient

from autopilot.core.plan import MissionResult, PlanItem, PlanKind
from autopilot.core.plan_wire import item_message
from autopilot.mission.items import Command, MavFrame
from autopilot.mission.paper import paper_plan

PLAN = paper_plan(1)
KIND = PlanKind
Case = tuple[PlanKind, list[PlanItem], int, str]
"""A plan, the item that is wrong with it, and a word of the reason."""


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
    return KIND.MISSION, numbered([first, *items[1:]]), 0, "above the surface"


def the_far_end(draw: random.Random) -> Case:
    items, guilty = mission(draw, order(Command.DO_JUMP, 0, 1))
    items[guilty] = replace(items[guilty], param1=float(len(items) + draw.randint(0, 5)))
    return KIND.MISSION, items, guilty, "does not exist"


def for_ever(draw: random.Random) -> Case:
    items, guilty = mission(draw, order(Command.DO_JUMP, 0, -1))
    items[guilty] = replace(items[guilty], param1=float(guilty - 1))
    items[guilty - 1] = replace(order(Command.DO_CHANGE_SPEED, 1, 0.2), seq=guilty - 1)
    return KIND.MISSION, items, guilty, "for ever"


def two_obstacles(draw: random.Random) -> Case:
    """The second of the two that are too near to each other."""
    items, first = fence(draw, [cylinder(0.0, 0.0, 0.5), cylinder(1.4, 0.0, 0.5)])
    return KIND.FENCE, items, first + 1, "gap of"


def in_mission(word: str, *made: PlanItem, last: bool = False) -> Callable[[random.Random], Case]:
    def make(draw: random.Random) -> Case:
        return KIND.MISSION, *mission(draw, *made, last=last), word

    return make


def in_fence(word: str, *made: PlanItem) -> Callable[[random.Random], Case]:
    def make(draw: random.Random) -> Case:
        return KIND.FENCE, *fence(draw, made), word

    return make


def in_rally(word: str, made: PlanItem) -> Callable[[random.Random], Case]:
    def make(draw: random.Random) -> Case:
        points = [at(Command.RALLY_POINT, 0.1 * k, 0.0, 0.5) for k in range(draw.randint(2, 6))]
        guilty = draw.randrange(len(points))
        points[guilty] = made
        return KIND.RALLY, numbered(points), guilty, word

    return make


WAYPOINT = at(Command.NAV_WAYPOINT, 0.0, 0.9, 0.5, 0, 0, 0, math.nan)
SQUARE = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)]
CASES = {
    "too deep": in_mission("DEPTH_MAX", replace(WAYPOINT, z=1.4)),
    "too shallow": in_mission("DEPTH_MIN", replace(WAYPOINT, z=0.0)),
    "too deep, taking off": in_mission("DEPTH_MAX", at(Command.NAV_TAKEOFF, 0.0, 0.0, 3.0, 0, 0, 0, math.nan)),
    "no depth": in_mission("", replace(WAYPOINT, z=math.nan)),
    "too fast": in_mission("SPD_PLANAR_MAX", order(Command.DO_CHANGE_SPEED, 1, 0.9)),
    "jump out": the_far_end,
    "endless jump": for_ever,
    "condition without a place": in_mission(
        "no place comes", order(Command.CONDITION_DISTANCE, 1.0), order(Command.DO_CHANGE_SPEED, 1, 0.2), last=True
    ),
    "first item in the air": above_water,
    "unknown command": in_mission("", order(31999)),
    "unknown frame": in_mission("", replace(WAYPOINT, frame=21)),
    "too far away": in_mission("", replace(WAYPOINT, frame=MavFrame.GLOBAL_INT, x=10_000_000, z=-0.5)),
    "infinite hold": in_mission("infinite", replace(WAYPOINT, param1=math.inf)),
    "polygon of other vertices": in_fence("of 4 vertices", *polygon(SQUARE)[:3]),
    "polygon that crosses itself": in_fence("intersects", *polygon([(0, 0), (2, 2), (2, 0), (0, 2)])),
    "polygon without area": in_fence("no area", *polygon([(0, 0), (1, 1), (1, 1.0005)])),
    "two near obstacles": two_obstacles,
    "workspace without room": in_fence(
        "no room", *polygon([(-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)], inside=True)
    ),
    "circle without radius": in_fence("radius", cylinder(0.0, 0.0, 0.0)),
    "unknown shape": in_fence("", order(5999)),
    "no rally point": in_rally("not supported", WAYPOINT),
    "rally point in the air": in_rally("", at(Command.RALLY_POINT, 0.0, 0.0, -3.0)),
}


@pytest.fixture(scope="module", name="vehicle")
def vehicle_fixture(module_session: OpenSession) -> tuple[Harbour, WireClient]:
    """A vehicle in the tank, and a client."""
    client = WireClient()
    made = Harbour(module_session(sensors="pose", peers=(client,)))
    made.run(1.5)
    return made, client


@pytest.mark.parametrize("name", CASES)
def test_the_guilty_item_is_asked_for_last(vehicle: tuple[Harbour, WireClient], name: str) -> None:
    made, client = vehicle
    for seed in range(4):
        kind, items, guilty, word = CASES[name](random.Random(f"{name} {seed}"))
        before = made.session.parts.plans.items(kind)
        assert made.offer(client, kind, items) != MissionResult.ACCEPTED
        (text,) = client.texts()
        assert f" {guilty}: " in text and word in text
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
