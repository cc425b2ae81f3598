"""Survey and corridor scan, as QGroundControl emits them, and the longest plan, flown through Autopilot.step."""

import numpy as np
from mission_world import MissionWorld
from survey_patterns import corridor, survey

from autopilot.core.plan import MAX_ITEMS, PlanKind


def afloat(start: tuple[float, float, float, float]) -> MissionWorld:
    world = MissionWorld(start)
    world.run(1.5)
    return world


def test_a_survey_with_gates_is_flown_along_its_legs() -> None:
    world = afloat((-1.9, 0.5, 0.5, 0.0))
    origin = world.parts.plans.origin
    items = survey(origin, -1.7 + 0.5j, 0.8 + 0.4j, 0.4, depth=0.5, turn_m=0.2, gates=1.0)
    assert [item.command for item in items] == [16, 4501, 4501, 16] * 2
    world.fly(items, 30.0)
    assert world.reached[-3:] == [3, 4, 7] and "Mission complete" in world.texts()
    track = np.array(world.track)[200:]
    inside = track[(track[:, 0] > -1.6) & (track[:, 0] < -1.0)]
    off = np.minimum(np.abs(inside[:, 1] - 0.5), np.abs(inside[:, 1] - 0.9))
    assert off.max() < 0.2, "a turnaround is left at its acceptance radius, 0.3 m"
    assert np.abs(track[:, 2] - 0.5).max() < 0.06
    assert world.clearance_m() > 0.0


def test_a_corridor_is_flown_to_and_fro() -> None:
    world = afloat((-1.9, 0.5, 0.5, 0.0))
    path = [-1.8 + 0.6j, -1.0 + 0.6j, -0.4 + 0.9j]
    items = corridor(world.parts.plans.origin, path, (0.0, 0.2), depth=0.5, trigger_m=0.0)
    assert world.upload(items).type == 0
    world.run(0.2)
    assert world.command(400, 1.0) == 0, world.texts()
    assert world.command(300, 0.0, 0.0) == 0
    world.inbox.clear()
    world.run(22.0)
    assert world.reached[-5:] == [1, 2, 3, 4, 5]
    assert world.clearance_m() > 0.0


def test_the_longest_mission_is_taken_read_back_and_flown_from_its_middle() -> None:
    world = afloat((-1.7, 0.5, 0.5, 0.0))
    most = MAX_ITEMS[PlanKind.MISSION]
    items = survey(world.parts.plans.origin, -1.7 + 0.4j, 0.6 + 0.5j, 0.0005, depth=0.5)[:most]
    assert len(items) == most
    ack = world.upload(items)
    assert ack.type == 0 and ack.opaque_id != 0
    assert len(world.parts.plans.items(PlanKind.MISSION)) == most
    world.arm()
    assert world.command(224, 1990.0) == 0
    assert world.command(300, 1990.0, 0.0) == 0
    world.inbox.clear()
    world.run(12.0)
    assert world.reached[:3] == [1990, 1991, 1992]


def test_one_item_too_many_is_refused_with_the_limit() -> None:
    world = afloat((-1.7, 0.5, 0.5, 0.0))
    items = survey(world.parts.plans.origin, -1.7 + 0.4j, 0.6 + 0.6j, 0.0005, depth=0.5)[:2002]
    assert world.upload(items).type == 4
    assert "2002 items, at most 2000 fit" in world.texts()
