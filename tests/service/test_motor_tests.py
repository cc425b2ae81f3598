"""DO_MOTOR_TEST through the whole service: what it turns, for how long, and what it is refused for."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from piloted_world import HOLD, MANUAL, PilotedWorld
from pymavlink.dialects.v20 import development as mav
from service_world import ServiceWorld

from autopilot.core.frames import r_ned_from_frd
from autopilot.core.samples import AhrsSample, Sample

TEST = mav.MAV_CMD_DO_MOTOR_TEST
PERCENT, PULSE = 0, 1
SPAN_US = 400
MOST_US = round(0.3 * SPAN_US)


def ordered(world: PilotedWorld, number: float, kind: float, value: float, seconds: float = 0.0) -> int:
    """The command's result."""
    return world.command(TEST, number, kind, value, seconds)


def offsets(world: PilotedWorld, seconds: float) -> Iterator[list[int]]:
    """Pulses of the four thrusters, from neutral, on every tick."""
    for _ in range(round(100 * seconds)):
        yield [pulse - 1500 for pulse in world.tick().command.pwm_us[:4]]


def manual(start: tuple[float, ...] = (-1.0, 0.5, 0.5, 0.0), *, fixes: bool = True) -> PilotedWorld:
    world = PilotedWorld(start, fixes=fixes)
    world.run(1.5)
    assert world.mode(MANUAL) == 0
    world.arm()
    world.run(0.3)
    world.inbox.clear()
    return world


@pytest.mark.parametrize("fixes", [True, False])
def test_one_motor_turns_a_little_and_stops_by_itself(fixes: bool) -> None:
    world = manual(fixes=fixes)
    for place in range(4):
        assert ordered(world, place + 1, PERCENT, 60.0, 0.6) == 0, world.texts()
        during = list(offsets(world, 0.5))
        # 20 % of the span, or what of that the present curve gives: the side that pushes ahead.
        assert all(abs(abs(now[place]) - 80) <= 2 for now in during[-20:]), during[-1]
        assert all(not now[other] for now in during[-5:] for other in range(4) if other != place)
        assert "Motor test over" not in world.texts()
        world.run(0.7)
        assert f"Motor test: {place + 1}" in world.texts() and "Motor test over" in world.texts()
        world.run(5.0)  # the same text is not said again before


def test_silence_ends_it_after_half_a_second() -> None:
    world = manual()
    said = ""
    for _ in range(8):
        assert ordered(world, 1, PERCENT, 40.0) == 0
        world.run(0.2)
        said += world.texts()
    assert next(offsets(world, 0.01))[0] == pytest.approx(-80, abs=2) and "over" not in said
    world.run(0.3)
    assert "Motor test over" in world.texts()


def test_pulses_are_taken_and_held_within_the_limit() -> None:
    world = manual()
    assert ordered(world, 2, PULSE, 1560.0, 0.6) == 0
    assert list(offsets(world, 0.4))[-1][1] == pytest.approx(60, abs=2)
    world.run(0.5)
    assert ordered(world, 2, PULSE, 1900.0, 0.6) == 0
    assert "at most 30 %" in world.texts()
    assert list(offsets(world, 0.4))[-1][1] == pytest.approx(MOST_US, abs=2)


def test_thrust_comes_and_goes_as_fast_as_a_pilots() -> None:
    world = manual()
    ordered(world, 1, PERCENT, 100.0, 0.4)
    world.run(1.0)
    steps = np.abs(np.diff(np.array(world.thrust[-140:]), axis=0)).max()
    assert 0.05 < steps <= 4.5 * 12.0 * 0.05 + 1e-6, "as at a switch of modes"


def test_five_seconds_are_the_most_at_a_stretch() -> None:
    world = manual((0.0, 0.6, 0.5, 0.0))
    turned = 0
    for _ in range(70):
        result = ordered(world, 3, PERCENT, 62.0, 5.0)
        turned += sum(now[2] > 60 for now in offsets(world, 0.06))
        if result:
            break
    assert "5 s are enough" in world.texts() and turned < 450
    world.run(1.1)
    assert ordered(world, 3, PERCENT, 62.0) == 0


def test_it_ends_at_once_by_disarming_another_mode_or_a_stick() -> None:
    world = manual()
    assert ordered(world, 1, PERCENT, 70.0, 5.0) == 0
    world.run(0.3)
    assert world.command(400, 0.0) == 0
    assert not any(any(now) for now in offsets(world, 1.0))
    world.arm()
    assert world.mode(MANUAL) == 0
    assert ordered(world, 1, PERCENT, 70.0, 5.0) == 0
    world.run(0.3)
    assert world.mode(HOLD) == 0
    assert "Motor test over: HOLD" in world.texts()
    assert world.mode(MANUAL) == 0
    assert ordered(world, 1, PERCENT, 70.0, 5.0) == 0
    world.steer(0.3, r=600)
    assert "Motor test over: let go of the sticks" in world.texts()


def test_what_speaks_against_it_is_said() -> None:
    world = PilotedWorld((-1.0, 0.5, 0.5, 0.0))
    world.run(1.5)
    assert ordered(world, 1, PERCENT, 60.0) == 2 and "arm first" in world.texts()
    world.arm()
    assert ordered(world, 1, PERCENT, 60.0) == 2 and "choose MANUAL" in world.texts()
    assert world.mode(MANUAL) == 0
    for wrong, reason in (
        ((5, PERCENT, 60.0), "no motor 5, use 1 to 4"),
        ((0, PERCENT, 60.0), "motor 0"),
        ((1, PERCENT, 101.0), "use 0 to 100"),
        ((1, 2, 60.0), "throttle type 2"),
        ((1, PERCENT, float("nan")), "value nan"),
        ((1, PERCENT, 60.0, float("inf")), "inf s"),
    ):
        assert ordered(world, *wrong) == 2 and reason in world.texts(), reason
    world.run(0.5)
    assert max(abs(x) for x in world.thrust[-1]) < 1.0
    near = manual((-2.1, 0.5, 0.5, 0.0))
    assert ordered(near, 1, PERCENT, 60.0) == 2 and "too near to the fence" in near.texts()


def test_who_is_not_in_control_turns_nothing() -> None:
    world = manual()
    assert world.command(32100, 1.0, 0.0, 10.0) == 0
    mine = world._mav
    world._mav = mav.MAVLink(None, srcSystem=254, srcComponent=190)
    world._mav.robust_parsing = True
    assert ordered(world, 1, PERCENT, 70.0, 1.0) == 10
    world._mav = mine
    assert max(abs(now[0]) for now in offsets(world, 0.5)) < 60


class HeavyInABucket(ServiceWorld):
    """Held askew, and swayed."""

    vehicle_name = "bluerov2-heavy"

    def samples(self) -> tuple[Sample, ...]:
        first, *others = super().samples()
        assert isinstance(first, AhrsSample)
        tilt, sway = np.array([0.25, -0.2, 0.0]), 0.1 * np.sin(self.t_us * 2e-6)
        tilted = r_ned_from_frd(tilt).T @ np.array([0.0, 0.0, -9.81])
        rate = first.rate_frd_rad_s + np.array([0.0, sway, 0.0])
        return (replace(first, rpy_rad=first.rpy_rad + tilt, rate_frd_rad_s=rate, accel_frd_m_s2=tilted), *others)


def test_nothing_but_the_motor_turns_though_the_vehicle_is_held_askew() -> None:
    """Levelling would turn those that push up: whoever tests a motor has a hand at the others."""
    world = HeavyInABucket()
    world.run(1.5)
    assert world.command(mav.MAV_CMD_DO_SET_MODE, 1.0, float(MANUAL >> 16 & 0xFF)) == 0
    assert world.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == 0, world.texts()
    world.run(0.3)
    for place in range(8):
        assert world.command(TEST, place + 1, PERCENT, 60.0, 0.6) == 0, world.texts()
        for _ in range(40):
            pulses = [pulse - 1500 for pulse in world.tick().command.pwm_us]
            assert not any(pulses[:place] + pulses[place + 1 :]), pulses
        assert pulses[place]
        world.run(1.0)
