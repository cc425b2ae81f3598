"""A BlueROV2 as it is sold, through its emulated ArduSub: what the operator moves moves, what it measures arrives."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ardusub_tank import Tank

from autopilot.core.messages import Outputs
from autopilot.log.reader import open_log

SET_SERVO, SET_RELAY, PITCH_YAW, MOUNT_CONTROL = 183, 181, 1000, 205
LIGHTS, TILT = 13, 16
"""Outputs of a Navigator."""


class Sold(Tank):
    def __init__(self, folder: Path) -> None:
        self.answers: list[int] = []
        super().__init__(folder, operator=False)
        self._reader: Any = self.below.codec(1, 1)
        self.tick(100)

    def _tick(self, outputs: Outputs) -> None:
        for frame in outputs.mavlink_tx:
            for message in self._reader.parse_buffer(frame.data) or ():
                if message.get_type() == "COMMAND_ACK":
                    self.answers.append(message.result)
        super()._tick(outputs)

    def tick(self, count: int) -> None:
        self.run(lambda outputs, end_us=self._t_us + 10_000 * count: outputs.t_us >= end_us, 0.01 * count)

    def ask(self, command: int, *params: float) -> int:
        """The result of a command, half a second later."""
        self.answers.clear()
        self.order(self._pilot.command_long_encode(1, 1, command, 0, *params, *[0.0] * (7 - len(params))))
        self.tick(50)
        return self.answers[-1]


@pytest.fixture(name="sold")
def sold_fixture(tmp_path: Path) -> Iterator[Sold]:
    tank = Sold(tmp_path)
    yield tank
    tank.close()


def test_lights_and_tilt_follow_the_operator(sold: Sold) -> None:
    assert sold.ask(SET_SERVO, LIGHTS, 1500) == 0
    assert sold.below.extras.spare_us == {LIGHTS: 1500}
    assert sold.ask(SET_RELAY, 0, 1) == 0
    assert sold.below.extras.relays == {0: True}
    assert sold.ask(PITCH_YAW, -30.0, math.nan, math.nan, math.nan) == 0
    assert sold.below.extras.tilt_deg == pytest.approx(-30.0, abs=0.1)
    assert sold.ask(MOUNT_CONTROL, 20.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0) == 0
    assert sold.below.extras.tilt_deg == pytest.approx(20.0, abs=0.1)
    assert sold.ask(SET_SERVO, TILT, 1100) == 0
    assert sold.below.extras.tilt_deg == pytest.approx(-45.0)
    assert sold.ask(MOUNT_CONTROL, -60.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0) == 2
    assert sold.below.extras.tilt_deg == pytest.approx(-45.0), "it has another end"


def test_what_the_flight_controller_does_not_move_is_told(sold: Sold) -> None:
    sold.below.parameters["SERVO13_FUNCTION"] = 181.0
    assert sold.ask(SET_SERVO, LIGHTS, 1500) == 0
    assert sold.reported("lights: flight controller refuses, see SERVO13_FUNCTION")
    assert sold.below.extras.spare_us == {}


def test_what_it_measures_is_in_the_log(tmp_path: Path) -> None:
    tank = Sold(tmp_path)
    tank.below.wet = True
    tank.below.extras.tilt_deg = 45.0  # its pilot
    tank.below.parameters["RNGFND1_TYPE"] = 10.0
    tank.tick(300)
    truth = tank.world.truth
    tank.close()
    log = open_log(tmp_path / "run.mcap")
    volts = log["/in/power_raw"]["voltage_v"]
    assert len(volts) >= 5 and abs(volts[-1] - truth.voltage_v) < 0.1
    assert log["/in/leak"]["wet"][-1] == 1
    assert np.degrees(log["/in/camera_tilt"]["angle_rad"][-1]) == pytest.approx(45.0)
    height_m = 1.5 - float(truth.pos_ned_m[2])
    assert abs(log["/in/altimeter"]["range_m"][-1] - height_m) < 0.1
    assert abs(log["/in/depth"]["depth_m"][-1] - truth.pos_ned_m[2]) < 0.05
