"""Mission items beyond waypoints, sent by the bytes of a ground station and flown through Autopilot.step."""

import re

import numpy as np
import pytest
from mission_world import MissionWorld, placed

from autopilot.core.frames import wrap_pi
from autopilot.mavlink.dialect import mav
from tests.plan_items import NAN, plain, waypoint

HOLD = (4 << 16) | (3 << 24)


def afloat(start: tuple[float, float, float, float] = (-1.2, 0.6, 0.5, 0.0)) -> MissionWorld:
    world = MissionWorld(start)
    world.run(1.5)
    return world


@pytest.fixture(name="world")
def world_fixture() -> MissionWorld:
    return afloat()


def test_loiter_turns_are_flown_round_the_centre_and_left(world: MissionWorld) -> None:
    world.fly([placed(0, 18, -1.4, 0.6, 0.6, 0.75, 0.0, -0.5), waypoint(1, -0.8, 0.8)], 30.0)
    assert world.reached == [0, 1]
    assert "Mission complete" in world.texts()
    track = np.array(world.track)[300:]
    away = track[:, :2] - (-1.4, 0.6)
    off = np.abs(np.hypot(*away.T) - 0.5)
    ring = slice(int(np.flatnonzero(off < 0.03)[0]), None)
    ring = slice(ring.start, ring.start + 1000)
    bearing = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
    assert off[ring].max() < 0.08
    assert bearing[ring][-1] - bearing[ring][0] < -2.0
    settled = slice(ring.start + 300, ring.stop)
    look = np.arctan2(-away[settled, 1], -away[settled, 0])
    assert np.abs(np.angle(np.exp(1j * (look - track[settled, 3])))).max() < 0.3
    assert world.clearance_m() > 0.0


def test_a_vehicle_stays_behind_its_last_turn(world: MissionWorld) -> None:
    world.fly([placed(0, 18, -1.4, 0.6, 0.5, 0.25, 0.0, 0.5)], 16.0)
    assert world.reached == [0] and world.custom_mode == HOLD
    assert np.hypot(*world.x[4:6]) < 0.03
    assert abs(np.hypot(world.x[0] + 1.4, world.x[1] - 0.6) - 0.5) < 0.1


REFUSED = (
    (placed(0, 18, -1.4, 0.6, 0.5, 0.0, 0.0, 0.5), 6, "turns (param1) is 0"),
    (placed(0, 18, -1.4, 0.6, 0.5, 1.0, 0.0, 0.01), 8, "radius (param3) is 0.01 m"),
    (placed(0, 18, -1.4, 0.6, 3.5, 1.0, 0.0, 0.5), 12, "depth 3.50 m"),
    (plain(0, 114, -1.0), 6, "distance (param1)"),
    (plain(0, 114, 1.0), 5, "no place comes after"),
    (placed(0, 4501, -1.0, 0.5, 0.5, 2.0), 6, "geometry (param1)"),
    (placed(0, 201, -1.0, 0.5, 0.5, 2.0), 6, "ROI mode (param1)"),
    (plain(0, 195), 2, "has no position"),
    (plain(0, 207, 0.0), 6, "cannot be switched off"),
    (plain(0, 93, -1.0), 6, "delay (param1)"),
    (placed(0, 16, -1.4, 0.6, 0.5, 0.0, 0.0199), 7, "acceptance radius (param2) is 0.0199"),
)


def test_what_cannot_be_flown_is_refused_by_name(world: MissionWorld) -> None:
    for item, field, text in REFUSED:
        assert world.upload([item]).type == field
        assert "item 0" in world.texts() and text in world.texts()
    assert world.upload([placed(0, 16, -1.4, 0.6, 0.5, 0.0, 0.02)]).type == 0, "as in a file"


def test_a_circle_that_leaves_the_fence_is_not_started(world: MissionWorld) -> None:
    """Wrong between two plans: stored, named, and not flown."""
    assert world.upload([placed(0, 18, -1.4, 0.6, 0.5, 1.0, 0.0, 0.9)]).type == 0
    world.run(0.2)
    assert "circle of item 0" in world.texts()
    assert world.command(400, 1.0) != 0
    assert world.upload([waypoint(0, -1.4, 0.6), plain(1, 18, 1.0, 0.0, 0.9)]).type == 0
    world.run(0.2)
    assert "circle of item 1" in world.texts()
    assert world.upload([placed(0, 18, -1.4, 0.6, 0.5, 1.0, 0.0, 0.5)]).type == 0
    world.run(0.2)
    assert world.command(400, 1.0) == 0


def test_conditions_wait_on_the_way_and_not_at_a_stop() -> None:
    world = afloat((-1.8, 0.9, 0.5, 0.0))
    items = [
        waypoint(0, -1.5, 0.9),
        plain(1, 114, 1.5),
        plain(2, 178, 1.0, 0.15),
        placed(3, 4501, 0.4, 0.4, 0.5),
        plain(4, 178, 1.0, 0.3),
        waypoint(5, 1.3, 0.9),
    ]
    world.fly(items, 24.0)
    assert world.reached == [0, 5]
    track = np.array(world.track)
    along, speed = track[:, 0], np.hypot(track[:, 4], track[:, 5])

    def at(x: float) -> float:
        return float(speed[int(np.argmax(along > x))])

    assert at(-0.4) > 0.22
    assert at(0.35) == pytest.approx(0.15, abs=0.05)
    assert at(0.8) > 0.2
    between = speed[int(np.argmax(along > -1.2)) : int(np.argmax(along > 0.9))]
    assert between.min() > 0.1


def test_a_mission_that_ends_with_a_gate_reaches_its_last_item(world: MissionWorld) -> None:
    world.fly([waypoint(0, -0.8, 0.6), placed(1, 4501, -0.5, 0.6, 0.5)], 10.0)
    assert "Mission complete" in world.texts() and world.reached == [0, 1]


def test_the_vehicle_looks_at_a_place_wherever_it_goes() -> None:
    world = afloat((-1.8, 0.9, 0.5, 0.0))
    items = [
        placed(0, 195, -0.625, -0.625, 0.0),
        waypoint(1, -0.2, 0.9, yaw_deg=90.0),
        plain(2, 93, 3.0),
        plain(3, 197),
        waypoint(4, 1.2, 0.9, yaw_deg=0.0),
    ]
    world.fly(items, 3.0)
    begun = len(world.track)
    while 2 not in world.reached:
        world.run(0.1)
    track = np.array(world.track[begun:-20])
    look = np.arctan2(-0.625 - track[:, 1], -0.625 - track[:, 0])
    assert np.abs(np.angle(np.exp(1j * (look - track[:, 3])))).max() < 0.3
    world.run(14.0)
    assert world.reached == [1, 2, 4]
    assert abs(wrap_pi(float(world.x[3]))) < 0.2


def test_delays_and_takeoff_are_flown() -> None:
    world = MissionWorld((-1.0, 0.6, 0.1, 0.0))
    world.run(1.5)
    items = [
        placed(0, 22, 0.0, 0.0, -2.0, 0.0, 0.0, 0.0, NAN),
        plain(1, 112, 2.0),
        plain(2, 93, 2.0),
        plain(3, 207, 1.0),
    ]
    world.fly(items, 12.0)
    assert world.reached == [0, 2, 3]
    assert world.x[2] == pytest.approx(0.5, abs=0.06)


def test_waypoints_close_together_do_not_flood_the_operator(world: MissionWorld) -> None:
    items = [waypoint(k, -1.2 + 1e-4 * k, 0.6) for k in range(60)]
    world.fly([*items, plain(60, 177, 0.0, -1.0)], 10.0)
    assert 90 < len(world.reached) <= 121, "20 at once, and ten a second"
    said = [m.text for m in world.inbox if m.get_type() == "STATUSTEXT"]
    assert len(said) <= 13 and any(re.match(r"Reached \d+ items, the last is item", text) for text in said)
    assert len([m for m in world.inbox if m.get_type() == "MISSION_CURRENT"]) <= 115


def test_of_many_that_are_reached_at_once_the_last_is_told(world: MissionWorld) -> None:
    world.fly([waypoint(k, -1.2 + 1e-4 * k, 0.6) for k in range(400)], 22.0)
    reached = world.reached
    assert reached[:15] == list(range(reached[0], reached[0] + 15)), "one by one at first"
    assert reached[-1] == 399 and reached == sorted(set(reached)) and len(reached) <= 20 + 10 * 22
    said = [m.text for m in world.inbox if m.get_type() == "STATUSTEXT"]
    assert "the last is item 399 (QGC 400)" in said[-2] and "Mission complete" in said[-1]


def test_what_was_reached_is_told_although_the_mission_is_paused_meanwhile(world: MissionWorld) -> None:
    world.fly([waypoint(0, -1.2, 0.6), waypoint(1, -1.2, 0.6), waypoint(2, 1.5, 0.6)], 0.5)
    assert world.command(193, 0.0) == 0
    texts = world.texts()
    world.inbox.clear()
    world.run(2.0)
    assert "Reached item 1" in texts + world.texts()


def test_jumps_with_nothing_between_end(world: MissionWorld) -> None:
    """Three loops of 30,000 turns, one in the other, and nothing that is flown."""
    empty = [plain(k, 177, 1.0, 30_000.0) for k in range(2, 5)]
    world.fly([waypoint(0, -1.2, 0.6), plain(1, 178, 1.0, 0.2), *empty, waypoint(5, -0.9, 0.6)], 6.0)
    assert 5 in world.reached and "Mission complete" in world.texts()


def test_plan_ids_tell_what_is_in_force(world: MissionWorld) -> None:

    def ids() -> tuple[int, int, int]:
        (m,) = [
            m for m in world.ask(mav.MAVLink_command_long_message(1, 1, 512, 0, 42, 0, 0, 0, 0, 0, 0)) if m.id == 42
        ]
        return m.mission_id, m.fence_id, m.rally_points_id

    none, fence, rally = ids()
    assert (none, rally) == (0, 0) and fence != 0
    ack = world.upload([waypoint(0, -1.2, 0.6), waypoint(1, -1.0, 0.6)])
    assert ack.opaque_id != 0 and ids() == (ack.opaque_id, fence, 0)
    (count,) = [m for m in world.ask(mav.MAVLink_mission_request_list_message(1, 1, 0)) if m.id == 44]
    assert count.opaque_id == ack.opaque_id
    assert world.upload([waypoint(0, 9.0, 0.6, depth=9.0)]).opaque_id == 0
    assert ids() == (ack.opaque_id, fence, 0), "a refused plan changes nothing"
    point = world.upload([placed(0, 5100, -1.0, 0.6, 0.5)], 2)
    assert ids() == (ack.opaque_id, fence, point.opaque_id)
    again = world.upload([waypoint(0, -1.2, 0.6), waypoint(1, -1.0, 0.7)])
    assert again.opaque_id not in (0, ack.opaque_id)
    assert world.upload([], 0).opaque_id == 0
    assert ids() == (0, fence, point.opaque_id)
    world.inbox.clear()
    world.tick([world.pack(mav.MAVLink_mission_clear_all_message(1, 1, 255))])
    world.run(0.2)
    assert ids() == (0, 0, 0)
    assert [m for m in world.inbox if m.id == 42]


def test_a_fence_is_not_switched_off_by_command(world: MissionWorld) -> None:
    assert world.command(207, 1.0) == 0
    assert world.command(207, 0.0) == 2 and "fence cannot be switched off" in world.texts()
