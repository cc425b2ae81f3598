"""Thrusters one by one on the bench: what is sent to the amplifiers, and that nothing can get out of hand."""

import pytest
from click.testing import CliRunner

from autopilot.cli.motors import motors
from autopilot.core.errors import ConfigError
from autopilot.core.marker_files import load_marker_map
from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.sabertooth import Sabertooth, SabertoothOptions
from autopilot.run.motor_test import MOST_S, pulses, turn
from autopilot.run.vehicle_config import load_config
from tests.drivers.sabertooth_emulator import SabertoothEmulator

VEHICLE = load_vehicle("lbv150")


class Clock:
    """Time that passes by sleeping."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


def test_one_thruster_turns_within_its_limits_and_stops() -> None:
    line, clock = SabertoothEmulator(), Clock()
    seen: list[dict[tuple[int, int], float]] = []

    def sleep(seconds: float) -> None:
        clock.sleep(seconds)
        seen.append(dict(line.duty))

    with Sabertooth(VEHICLE, SabertoothOptions(port="none"), port=line) as output:
        assert turn(output, pulses(VEHICLE, 2, -20.0, 1.0), lambda: False, clock_s=clock, sleep=sleep)
        assert not any(line.duty.values())
        vertical = [duty[129, 1] for duty in seen]
        assert len(vertical) == 100
        assert min(vertical) == pytest.approx(-0.2, abs=0.01)
        assert max(vertical) <= 0.0
        assert vertical[5] > -0.1  # run up, not thrown on
        assert not any(value for duty in seen for motor, value in duty.items() if motor != (129, 1))


def test_it_stops_when_it_is_told_to() -> None:
    line, clock = SabertoothEmulator(), Clock()
    with Sabertooth(VEHICLE, SabertoothOptions(port="none"), port=line) as output:
        commands = pulses(VEHICLE, 0, 30.0, MOST_S)
        assert not turn(output, commands, lambda: clock.now_s > 1.0, clock_s=clock, sleep=clock.sleep)
        assert clock.now_s < 1.1
        assert not any(line.duty.values())


@pytest.mark.parametrize(("percent", "seconds"), [(31.0, 1.0), (0.0, 1.0), (-31.0, 1.0), (10.0, 5.1), (10.0, 0.0)])
def test_more_than_a_little_is_refused(percent: float, seconds: float) -> None:
    with pytest.raises(ConfigError, match=r"--(level|seconds)"):
        list(pulses(VEHICLE, 0, percent, seconds))


def test_nothing_turns_without_a_yes() -> None:
    refused = CliRunner().invoke(motors, ["--config", "lbv150", "--thruster", "port"], input="n\n")
    assert refused.exit_code == 1
    assert "fingers and hair clear" in refused.output
    unknown = CliRunner().invoke(motors, ["--config", "lbv150", "--thruster", "bow", "--yes"])
    assert "the vehicle has port, starboard, vertical, lateral" in str(unknown.exception)
    below = CliRunner().invoke(motors, ["--config", "bluerov2-ardusub", "--yes"])
    assert "the flight controller's" in str(below.exception)


def test_the_lbv150_s_configuration_is_whole() -> None:
    config = load_config("lbv150")
    assert {kind: setup.driver for kind, setup in config.devices.items()} == {
        "ahrs": "ig500", "camera": "opencv", "thrusters": "sabertooth",
    }  # fmt: skip
    assert config.markers is not None
    floor = load_marker_map(config.markers)
    assert len(floor.ids) == 960
    corners = floor.corners_ned_m.reshape(-1, 3)
    assert abs(corners[:, 0]).max() < 1.5 and abs(corners[:, 1]).max() < 2.5  # it fits in the tank
