"""Pilots, set points, circles and dives, by the bytes that ground stations and clients send, through Autopilot.step."""

import math
import re
from typing import Any

import numpy as np
import pytest
from piloted_world import (
    ALTITUDE,
    HOLD,
    MANUAL,
    MISSION,
    OFFBOARD,
    ORBIT,
    POSITION,
    RETURN,
    STABILIZED,
    SURFACE,
    TAKEOFF,
    PilotedWorld,
    mav,
    position,
    velocity,
)

from autopilot.core.messages import Failsafe
from autopilot.mavlink.api import FlightMode

ACCEPTED, DENIED = 0, 2


def afloat(*args: object, **kwargs: object) -> PilotedWorld:
    """Armed and settled in Hold."""
    world = PilotedWorld(*args, **kwargs)  # type: ignore[arg-type]
    world.run(1.5)
    world.arm()
    world.run(1.0)
    return world


@pytest.fixture(name="world")
def world_fixture() -> PilotedWorld:
    return afloat()


# A pilot


@pytest.mark.parametrize(
    ("mode", "start", "sticks"),
    [(POSITION, (0.0, 0.3, 0.5, 0.0), {"y": 1000}), (MANUAL, (-0.3, 0.02, 0.5, 0.0), {"x": 1000})],
    ids=["wall", "pillar"],
)
def test_a_pilot_at_full_stick_is_slowed_down_and_touches_nothing(
    mode: int, start: tuple[float, ...], sticks: dict[str, int]
) -> None:
    world = afloat(start)
    assert world.mode(mode) == ACCEPTED
    world.steer(12.0, **sticks)
    assert world.clearance_m() > 0.0
    assert world.clearance_m() < 0.25, "kept away instead of slowed down"
    assert np.hypot(*np.array(world.track)[:, 4:6].T).max() > 0.15
    assert np.hypot(*world.x[4:6]) < 0.03


def test_switching_modes_is_no_jolt(world: PilotedWorld) -> None:
    """Depth changes by less than 0.1 m and no thruster by more than 3 N at once, moving or at rest."""
    order = (MANUAL, POSITION, STABILIZED, ALTITUDE, MANUAL, HOLD, POSITION)
    for n, mode in enumerate(order):
        depth, since = world.x[2], len(world.thrust)
        assert world.mode(mode) == ACCEPTED
        world.steer(1.5, x=(0, 800, -800)[n % 3])
        assert abs(world.x[2] - depth) < 0.1
        assert np.abs(np.diff(np.array(world.thrust[since - 1 :]), axis=0)).max() <= 3.0


def test_released_sticks_hold_the_place_and_sticks_move_as_asked() -> None:
    world = afloat(params={"PILOT_GAIN": 1.0, "PILOT_SPD": 0.2})
    world.mode(POSITION)
    world.steer(0.5)
    world.steer(4.0, x=1000, z=0, r=500)
    assert np.hypot(*world.x[4:6]) == pytest.approx(0.2, abs=0.03)
    assert world.x[7] == pytest.approx(0.4, abs=0.06)
    world.steer(4.0)
    rest = world.x.copy()
    world.steer(5.0)
    assert np.linalg.norm(world.x[:3] - rest[:3]) < 0.03
    assert abs(world.x[3] - rest[3]) < 0.03


def test_manual_drifts_with_the_current_and_position_does_not() -> None:
    world = afloat((-1.6, 0.0, 0.5, 0.0), current=(0.1, 0.0))
    world.run(8.0)
    world.mode(POSITION)
    world.steer(4.0)
    place = world.x[0]
    world.mode(MANUAL)
    world.steer(4.0)
    assert world.x[0] - place > 0.15
    world.mode(POSITION)
    world.steer(5.0)
    place = world.x[0]
    world.steer(3.0)
    assert abs(world.x[0] - place) < 0.05


def test_a_joystick_that_falls_silent_is_released() -> None:
    world = afloat((-1.6, 0.0, 0.5, 0.0))
    world.mode(POSITION)
    world.steer(0.5)
    world.steer(2.0, x=1000)
    world.inbox.clear()
    world.run(4.5)
    assert np.hypot(*world.x[4:6]) < 0.02
    assert "pilot input lost" in world.texts()


def test_both_conventions_of_the_vertical_stick(world: PilotedWorld) -> None:
    """0 to 1000 with 500 neutral; below zero says the other one; a stick that rests at an end is not believed."""
    world.mode(ALTITUDE)
    depth = world.x[2]
    world.inbox.clear()
    world.steer(2.0, z=0)
    assert abs(world.x[2] - depth) < 0.05
    assert "rests at 500" in world.texts()
    world.steer(0.5, z=500)
    world.steer(2.5, z=0)
    assert world.x[2] > depth + 0.1
    world = afloat(params={"PILOT_Z": 1.0})
    world.mode(ALTITUDE)
    depth = world.x[2]
    world.steer(2.0, z=0)
    assert abs(world.x[2] - depth) < 0.05
    world.steer(2.5, z=-1000)
    assert world.x[2] > depth + 0.1


def test_a_negative_vertical_stick_tells_its_convention(world: PilotedWorld) -> None:
    world.mode(ALTITUDE)
    depth = world.x[2]
    world.inbox.clear()
    world.steer(0.3, z=-300)
    world.steer(1.0, z=0)
    assert "PILOT_Z 1" in world.texts() and abs(world.x[2] - depth) < 0.05
    world.steer(2.5, z=-1000)
    assert world.x[2] > depth + 0.1


def test_channels_are_sticks_and_one_pilot_steers_at_a_time(world: PilotedWorld) -> None:
    world.mode(POSITION)
    north = world.x[0]
    none = 65535
    ahead = mav.MAVLink_rc_channels_override_message(1, 1, none, none, 1500, 1500, 1900, 1500, none, none)
    world.stream(2.5, ahead)
    assert world.x[0] > north + 0.2
    other = mav.MAVLink(None, srcSystem=200, srcComponent=190)
    back = mav.MAVLink_manual_control_message(1, -1000, 0, 500, 0, 0)
    world.inbox.clear()
    north = world.x[0]
    for _ in range(60):
        world.tick([world.pack(ahead), bytes(back.pack(other))])
    assert world.x[0] > north and "255/190 steers" in world.texts()


def test_released_channels_are_released_at_once(world: PilotedWorld) -> None:
    """They acted on for half a second, and kept another pilot out for as long."""
    world.mode(POSITION)
    none = 65535
    ahead = mav.MAVLink_rc_channels_override_message(1, 1, none, none, 1500, 1500, 1900, 1500, none, none)
    world.stream(1.0, ahead)
    assert world.parts.server.pilot.sticks is not None
    unused = mav.MAVLink_rc_channels_override_message(1, 1, none, none, none, none, none, none, 1500, 1500)
    world.tick([world.pack(unused)])
    assert world.parts.server.pilot.sticks is not None, "other channels are no release"
    release = mav.MAVLink_rc_channels_override_message(1, 1, none, none, 0, 0, 0, 0, none, none)
    stranger = mav.MAVLink(None, srcSystem=200, srcComponent=190)
    world.tick([bytes(release.pack(stranger))])
    assert world.parts.server.pilot.sticks is not None, "nobody else releases them"
    world.tick([world.pack(release)])
    assert world.parts.server.pilot.sticks is None
    back = mav.MAVLink_manual_control_message(1, -1000, 0, 500, 0, 0)
    world.tick([bytes(back.pack(stranger))])
    assert world.parts.server.pilot.sticks is not None and world.parts.server.pilot.sticks.ahead < 0.0


def test_buttons_do_what_their_parameters_say() -> None:
    world = PilotedWorld(
        params={
            "BTN0_FUNCTION": 2,
            "BTN1_FUNCTION": 8,
            "BTN2_FUNCTION": 42,
            "BTN3_FUNCTION": 26,
            "BTN4_FUNCTION": 4,
            "BTN5_FUNCTION": 31,
            "BTN6_FUNCTION": 33,
            "BTN7_FUNCTION": 53,
            "BTN8_FUNCTION": 24,
        }
    )
    world.run(1.5)
    world.inbox.clear()
    world.steer(0.4, buttons=1)
    assert world.parts.commander.armed, world.texts()
    world.steer(0.4, buttons=2)
    world.steer(0.2, buttons=4)
    world.steer(0.2, buttons=8)
    text = world.texts()
    assert "Mode POSHOLD" in text and "gain 60 %" in text and "26 is not offered" in text
    world.steer(0.2, buttons=32)
    world.steer(0.2, buttons=64)
    carried = world.steer(0.2, buttons=128).payload
    assert carried is not None and carried.pulses_us == (1800, 1900, 1900), "lights less an eighth, relay on"
    world.steer(0.2, buttons=256)
    assert "24 is not offered" in world.texts(), "there is no camera here"
    world.steer(0.2, buttons=16)
    assert not world.parts.commander.armed


# Without a position


def blind(mode: int, **kwargs: object) -> PilotedWorld:
    """Armed in a mode that needs no position, with AHRS and pressure sensor alone."""
    world = PilotedWorld(fixes=False, depth=True, **kwargs)  # type: ignore[arg-type]
    world.run(1.0)
    assert world.mode(mode) == ACCEPTED
    world.arm()
    return world


@pytest.mark.parametrize("extra_n", [-5.0, 5.0])
def test_depth_is_held_without_a_position_whatever_the_buoyancy(extra_n: float) -> None:
    world = blind(ALTITUDE, extra_buoyancy_n=extra_n, start=(0.0, 0.0, 0.6, 0.3))
    world.steer(1.0)
    depth, heading = world.x[2], world.x[3]
    lowest = highest = depth
    for _ in range(12):
        world.steer(1.0)
        lowest, highest = min(lowest, world.x[2]), max(highest, world.x[2])
    assert highest - lowest < 0.3
    settled = world.x[2]
    world.steer(3.0)
    assert abs(world.x[2] - settled) < 0.03
    assert abs(world.x[3] - heading) < 0.1
    world.steer(2.0, z=1000)
    assert world.x[2] < settled - 0.1


def test_manual_is_thrust_and_stabilize_holds_the_heading_without_a_position() -> None:
    world = blind(MANUAL)
    world.steer(1.0)
    world.steer(2.0, x=500)
    assert world.thrust[-1][:2] == pytest.approx([3.0, 3.0], abs=0.1)
    assert world.mode(STABILIZED) == ACCEPTED
    world.steer(0.5)
    heading = world.x[3]
    for _ in range(3):
        world.x[3] += 0.3
        world.steer(3.0)
    assert abs(world.x[3] - heading) < 0.06
    world.steer(2.0, r=1000)
    assert world.x[3] - heading > 0.4
    assert world.mode(POSITION) == DENIED
    assert world.step_n() <= 3.0


def test_a_pilot_without_a_position_is_not_let_go_of() -> None:
    world = blind(ALTITUDE)
    world.steer(1.0)
    for mode in (HOLD, MISSION, RETURN, TAKEOFF, ORBIT, POSITION):
        world.inbox.clear()
        assert world.mode(mode) == DENIED
        assert "denied: no position, use STABILIZE" in world.texts()
    assert world.command(300) == DENIED  # mission start
    assert world.custom_mode == ALTITUDE
    assert world.mode(SURFACE) == ACCEPTED
    world.fixes = True
    world.run(5.0)
    assert world.mode(ALTITUDE) == world.mode(HOLD) == ACCEPTED


def test_a_vehicle_that_never_had_a_position_is_not_left_to_drift() -> None:
    world = PilotedWorld(fixes=False, depth=True)
    world.run(1.0)
    assert world.parts.commander.arm(force=True).result == ACCEPTED
    assert world.run(4.5).mode.custom_mode == HOLD
    outputs = world.run(1.0)
    assert outputs.mode.custom_mode == SURFACE and outputs.mode.failsafes == 1 << Failsafe.NAV_LOST
    assert outputs.command.thrust_n.any()


def test_a_position_that_is_lost_does_not_take_the_sticks_away_and_one_that_comes_back_is_no_jolt() -> None:
    world = afloat(depth=True)
    world.mode(ALTITUDE)
    world.steer(1.0)
    nav = world.parts.estimator
    world.fixes = False
    depth, since = world.x[2], len(world.thrust)
    lost = False
    for _ in range(80):
        world.inbox.clear()
        outputs = world.steer(1.0, x=200 if lost else 0)
        lost = lost or "Position lost" in world.texts()
        if lost and outputs.goal is None:
            break
    assert lost, nav
    world.steer(6.0)
    assert world.parts.commander.armed and world.parts.commander.mode.name == "ALT_HOLD"
    assert abs(world.x[2] - depth) < 0.1
    world.fixes = True
    world.inbox.clear()
    world.steer(4.0)
    assert "Position is back" in world.texts()
    assert abs(world.x[2] - depth) < 0.15
    assert np.abs(np.diff(np.array(world.thrust[since:]), axis=0)).max() <= 3.0


# Set points


def test_set_points_are_flown_and_their_end_is_told(world: PilotedWorld) -> None:
    assert world.mode(OFFBOARD) == DENIED and "send set points first" in world.texts()
    place = position(-0.6, 0.5, 0.6, 0.5)
    world.stream(0.3, place)
    assert world.mode(OFFBOARD) == ACCEPTED
    world.stream(8.0, place)
    assert np.linalg.norm(world.x[:3] - (-0.6, 0.5, 0.6)) < 0.1
    assert world.x[3] == pytest.approx(0.5, abs=0.1)
    world.stream(4.0, velocity(0.0, -0.15, 0.0))
    assert world.x[5] == pytest.approx(-0.15 * math.cos(world.x[3]), abs=0.05)
    world.inbox.clear()
    world.run(1.5)
    assert "Set points stopped" in world.texts()
    assert world.custom_mode == HOLD


def test_body_velocity_with_a_yaw_rate_and_heading_with_vertical_thrust(world: PilotedWorld) -> None:
    around = position(0, 0, 0, mask=1479, frame=8, vx=0.1, yaw_rate=0.4)
    world.stream(0.3, around)
    world.mode(OFFBOARD)
    world.stream(6.0, around)
    assert world.x[7] == pytest.approx(0.4, abs=0.05)
    assert world.x[4] == pytest.approx(0.1, abs=0.04)
    depth = world.x[2]
    world.stream(4.0, attitude(yaw=0.5 * math.pi, thrust=0.2))
    assert world.x[2] > depth + 0.1
    assert abs(math.remainder(world.x[3] - 0.5 * math.pi, 2 * math.pi)) < 0.15


def attitude(*, roll: float = 0.0, yaw: float = 0.0, thrust: float = 0.5, mask: int = 7, roll_rate: float = 0.0) -> Any:
    """SET_ATTITUDE_TARGET: a heading or a roll."""
    turn, axis = 0.5 * (roll or yaw), (1.0, 0.0) if roll else (0.0, 1.0)
    quat = [math.cos(turn), axis[0] * math.sin(turn), 0.0, axis[1] * math.sin(turn)]
    return mav.MAVLink_set_attitude_target_message(0, 1, 1, mask, quat, roll_rate, 0.0, 0.0, thrust)


REFUSED = (
    (position(9.0, 0.0, 0.5), "fence"),
    (position(0.0, 0.9, 3.0), "depth"),
    (position(0, 0, 0, mask=0b111000111111), "accelerations"),
    (position(0, 0, 0, mask=0b111111111110), "needs x and y"),
    (position(0, 0, 0, mask=0xFFF), "nothing to do"),
    (position(0, 0, 0.5, frame=2), "frame 2"),
    (velocity(math.nan, 0, 0), "no usable number"),
    (velocity(80.0, 0, 0), "no usable number"),
    (mav.MAVLink_set_actuator_control_target_message(0, 0, 1, 1, [0.0] * 8), "no actuator control"),
    (attitude(roll=0.3), "roll and pitch cannot be set"),
    (attitude(mask=128, roll_rate=0.3), "roll and pitch rates cannot be set"),
    (attitude(mask=0xFF), "nothing to do"),
)


def test_a_set_point_that_is_not_followed_is_refused_by_a_text_and_ends_the_mode(world: PilotedWorld) -> None:
    for message, text in REFUSED:
        world.stream(0.3, velocity(0.0, 0.0, 0.0))
        assert world.mode(OFFBOARD) == ACCEPTED
        world.inbox.clear()
        world.stream(0.2, message)
        assert "Set point refused" in world.texts() and text in world.texts()
        assert world.parts.commander.mode is FlightMode.HOLD
        world.run(0.3)
        assert world.mode(OFFBOARD) == DENIED


def test_a_stream_that_is_refused_is_told_once_and_counted(world: PilotedWorld) -> None:
    actuators = mav.MAVLink_set_actuator_control_target_message(0, 0, 1, 1, [0.0] * 8)
    world.inbox.clear()
    world.stream(8.0, actuators)
    assert world.texts().count("no actuator control") == 1 and "so far" not in world.texts()
    world.inbox.clear()
    world.stream(8.0, actuators)
    assert world.texts().count("no actuator control") == 1 and re.search(r"\(\d{2,} so far\)", world.texts())


def test_a_client_that_steers_at_a_pillar_by_velocities_is_slowed_down() -> None:
    world = afloat((-0.4, 0.05, 0.5, 0.0))
    world.stream(0.3, velocity(0.4, 0.0, 0.0))
    world.mode(OFFBOARD)
    world.stream(8.0, velocity(0.4, 0.0, 0.0))
    assert 0.0 < world.clearance_m() < 0.2
    place = mav.MAVLink_set_position_target_global_int_message(
        0, 1, 1, 6, 0b110111111000, round(37.9755e7), round(23.7790e7), -0.4, 0, 0, 0, 0, 0, 0, 0, 0
    )
    world.stream(6.0, place)
    assert np.linalg.norm(world.x[:3] - (0.0, 0.0, 0.4)) < 0.1
    assert world.clearance_m() > 0.0


# Circles, depths, dives


def test_an_orbit_is_flown_looked_at_and_cancelled() -> None:
    world = afloat((-0.8, 0.6, 0.5, 0.0))
    assert world.command_int(34, -1.4, 0.6, 0.6, param1=0.5, frame=1) == ACCEPTED
    world.run(25.0)
    track = np.array(world.track[-1200:])
    away = track[:, :2] - (-1.4, 0.6)
    assert np.abs(np.hypot(*away.T) - 0.5).max() < 0.08
    assert np.abs(track[:, 2] - 0.6).max() < 0.05
    look = np.arctan2(-away[:, 1], -away[:, 0])
    assert np.abs(np.angle(np.exp(1j * (look - track[:, 3])))).max() < 0.25
    assert np.diff(np.unwrap(look)).sum() > 1.0
    assert world.custom_mode == ORBIT
    assert world.command(193, 0.0) == ACCEPTED
    world.run(3.0)
    assert world.custom_mode == HOLD and np.hypot(*world.x[4:6]) < 0.03
    here = mav.MAVLink_command_int_message(1, 1, 3, 34, 0, 0, 0.4, 0.0, 0.0, 0.0, 0x7FFF_FFFF, 0x7FFF_FFFF, -9.0)
    assert [m.result for m in world.ask(here) if m.get_type() == "COMMAND_ACK"] == [DENIED]
    assert "depth 9.00 m is outside" in world.texts(), "of a circle here too"
    assert world.command_int(34, 0.0, 0.9, 0.6, param1=0.5, frame=1) == DENIED
    assert "circle comes within" in world.texts()


def test_depth_changes_by_command(world: PilotedWorld) -> None:
    assert world.command(186, -0.8, 3.0) == ACCEPTED
    world.run(8.0)
    assert world.x[2] == pytest.approx(0.8, abs=0.05)
    assert world.command(186, -4.0, 3.0) == DENIED and "outside" in world.texts()


def test_taking_off_is_a_dive_from_the_surface_that_can_be_cancelled() -> None:
    """QGroundControl sends the takeoff before it arms, with an altitude above the water."""
    world = PilotedWorld((-1.0, 0.5, 0.0, 0.0))
    world.run(1.5)
    assert world.command(22, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.5) == ACCEPTED
    world.arm()
    world.inbox.clear()
    world.run(8.0)
    assert "Dived to 0.50 m" in world.texts()
    assert world.x[2] == pytest.approx(0.5, abs=0.06)
    assert world.command(22, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.1) == ACCEPTED
    world.run(1.0)
    assert world.custom_mode == TAKEOFF
    assert world.mode(HOLD) == ACCEPTED
    world.run(4.0)
    assert world.x[2] < 0.95


@pytest.mark.parametrize("seed", range(1))
def test_random_sticks_modes_and_set_points_touch_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = afloat(current=(-0.08, 0.05))
    for _ in range(10):
        mode = int(rng.choice([MANUAL, STABILIZED, ALTITUDE, POSITION]))
        assert world.mode(mode) == ACCEPTED
        x, y, r = rng.integers(-1000, 1001, 3).tolist()
        world.steer(0.2)
        world.steer(1.5, x=x, y=y, z=int(rng.integers(0, 1001)), r=r)
    assert world.clearance_m() > 0.0
    depths = np.array(world.track)[:, 2]
    assert depths.max() < 1.25
    assert world.step_n() <= 3.0


@pytest.mark.parametrize("armed", [True, False])
def test_a_dive_turns_to_its_heading(armed: bool) -> None:
    """The heading of NAV_TAKEOFF was passed over; here the depth is reached before the turn is over."""
    world = PilotedWorld(start=(-1.6, 0.5, 0.45, 0.0))
    world.run(1.5)
    if armed:
        world.arm()
    assert world.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 150.0, 0, 0, math.nan) == 0, world.texts()
    if not armed:
        world.arm()
    world.run(20.0)
    assert world.custom_mode == HOLD and world.x[2] == pytest.approx(0.5, abs=0.05)
    assert math.degrees(world.x[3]) == pytest.approx(150.0, abs=6.0)
