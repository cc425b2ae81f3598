"""What a pilot's display shows, through the whole service: gain, lights, turns of the tether, pulses of all outputs."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import development as mav
from service_world import ServiceWorld

from autopilot.core.samples import AhrsSample, PoseSample, Sample

GAIN_UP, GAIN_DOWN, BRIGHTER = 42, 43, 32
LIGHTS, GRABBER, ACCESSORY = 17, 18, 19
"""Channels of the lbv150's outputs."""


class TurningWorld(ServiceWorld):
    """A vehicle that turns on the spot."""

    yaw_rate_rad_s = 0.0
    yaw_rad = 0.0

    def samples(self) -> tuple[Sample, ...]:
        self.yaw_rad += self.yaw_rate_rad_s * 0.01
        heading = float(np.remainder(self.yaw_rad + np.pi, 2.0 * np.pi) - np.pi)
        turned, turning = np.array([0.0, 0.0, heading]), np.array([0.0, 0.0, self.yaw_rate_rad_s])
        said: list[Sample] = []
        for sample in super().samples():
            if isinstance(sample, AhrsSample):
                rpy, rate = sample.rpy_rad + turned, sample.rate_frd_rad_s + turning
                said.append(replace(sample, rpy_rad=rpy, rate_frd_rad_s=rate))
            elif isinstance(sample, PoseSample):
                said.append(replace(sample, yaw_rad=heading))
            else:
                said.append(sample)
        return tuple(said)


def named(world: ServiceWorld) -> dict[str, float]:
    """What the last second of NAMED_VALUE_FLOAT says."""
    world.inbox.clear()
    world.run(1.05)
    return {m.name: m.value for m in world.inbox if m.get_type() == "NAMED_VALUE_FLOAT"}


def press(world: ServiceWorld, buttons: int) -> None:
    for down in (buttons, 0):
        message = mav.MAVLink_manual_control_message(1, 0, 0, 500, 0, down)
        world.tick([world.pack(message)])


def servos(world: ServiceWorld) -> dict[int, int]:
    """Channel -> pulse of the newest SERVO_OUTPUT_RAW of each port."""
    world.inbox.clear()
    world.run(0.3)
    found: dict[int, int] = {}
    for message in world.inbox:
        if message.get_type() == "SERVO_OUTPUT_RAW":
            for n in range(1, 17):
                found[16 * message.port + n] = getattr(message, f"servo{n}_raw")
    return {channel: pulse for channel, pulse in found.items() if pulse}


def test_the_pilots_gain_and_the_lights_are_shown_as_ardusub_shows_them() -> None:
    world = ServiceWorld({"BTN0_FUNCTION": GAIN_UP, "BTN1_FUNCTION": GAIN_DOWN, "BTN2_FUNCTION": BRIGHTER})
    world.run(0.2)
    values = named(world)
    assert set(values) <= {"PilotGain", "Lights1", "TetherTrn"}, "one light, no camera that tilts, no sonar to follow"
    assert values["PilotGain"] == 0.5 and values["Lights1"] == 0.0
    press(world, 1 << 0)
    press(world, 1 << 0)
    press(world, 1 << 2)
    values = named(world)
    assert values["PilotGain"] == pytest.approx(0.7) and values["Lights1"] == pytest.approx(0.125)
    press(world, 1 << 1)
    assert named(world)["PilotGain"] == pytest.approx(0.6)


def test_the_gain_is_the_parameters_until_a_button_changes_it() -> None:
    world = ServiceWorld({"PILOT_GAIN": 0.8})
    world.run(0.2)
    assert named(world)["PilotGain"] == pytest.approx(0.8)
    world.params.set("PILOT_GAIN", 0.3)
    assert named(world)["PilotGain"] == pytest.approx(0.3)


def test_turns_are_counted_beyond_north_and_back() -> None:
    world = TurningWorld()
    world.run(1.0)
    assert named(world)["TetherTrn"] == pytest.approx(0.0, abs=0.02)
    world.yaw_rate_rad_s = 0.6
    world.run(2.0 * np.pi * 1.75 / 0.6)
    world.yaw_rate_rad_s = 0.0
    assert named(world)["TetherTrn"] == pytest.approx(1.75, abs=0.05)
    world.yaw_rate_rad_s = -0.6
    world.run(2.0 * np.pi * 2.25 / 0.6)
    world.yaw_rate_rad_s = 0.0
    assert named(world)["TetherTrn"] == pytest.approx(-0.5, abs=0.05)


def test_what_is_carried_is_among_the_outputs() -> None:
    world = ServiceWorld()
    world.run(0.2)
    found = servos(world)
    assert found == {1: 1500, 2: 1500, 3: 1500, 4: 1500, LIGHTS: 1100, GRABBER: 1900, ACCESSORY: 1100}
    assert world.command(mav.MAV_CMD_DO_SET_SERVO, LIGHTS, 1500) == 0
    assert world.command(mav.MAV_CMD_DO_GRIPPER, 1, 1) == 0
    assert world.command(mav.MAV_CMD_DO_SET_RELAY, 0, 1) == 0
    found = servos(world)
    assert (found[LIGHTS], found[GRABBER], found[ACCESSORY]) == (1500, 1100, 1900)
    status = asked(world, mav.MAVLINK_MSG_ID_ACTUATOR_OUTPUT_STATUS)[0]
    assert status.actuator[:4] == [1500.0] * 4 and status.actuator[LIGHTS - 1 : ACCESSORY] == [1500.0, 1100.0, 1900.0]
    assert status.active == 0b1111 | 0b111 << LIGHTS - 1


def test_outputs_that_nothing_drives_are_not_shown() -> None:
    world = ServiceWorld()
    world.parts.equipment.leave_out({"grabber": "not wired", "lights": "not wired"})
    world.run(0.2)
    assert set(servos(world)) == {1, 2, 3, 4, ACCESSORY}
    assert "Lights1" not in named(world)


def test_all_of_a_kind_come_on_request() -> None:
    world = ServiceWorld()
    world.run(0.5)
    assert {m.port for m in asked(world, mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW)} == {0, 1}
    names = {m.name for m in asked(world, mav.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT)}
    assert names == {"PilotGain", "Lights1", "TetherTrn"}


def asked(world: ServiceWorld, number: int) -> list[Any]:
    """What REQUEST_MESSAGE brings."""
    for message in (mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, mav.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT, number):
        world.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, message, -1)
    assert world.command(mav.MAV_CMD_REQUEST_MESSAGE, number) == 0
    return [m for m in world.inbox if m.get_msgId() == number]
