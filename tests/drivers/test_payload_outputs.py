"""What a vehicle carries, moved by the drivers: spare channels of a PWM board, the flight controller below."""

import math
from pathlib import Path

import msgspec
from output_rigs import CLOCK_HZ
from test_ardusub import Bench

from autopilot.core.samples import CameraTiltSample
from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.pca9685 import Pca9685, Pca9685Options
from autopilot.drivers.protocols import PayloadOutput
from autopilot.drivers.sabertooth import Sabertooth, SabertoothOptions
from autopilot.drivers.sysfs_pwm import SysfsPwm, SysfsPwmOptions
from autopilot.sitl.i2c_bus import EmulatedI2c, Pca9685Chip


def test_spare_channels_of_the_board_move_and_stay_when_thrusters_stop() -> None:
    vehicle = load_vehicle("lbv150")
    outputs = tuple(
        msgspec.structs.replace(output, channel=channel)
        for output, channel in zip(vehicle.payload, (9, 10, 17), strict=True)
    )
    bus, chip = EmulatedI2c(), Pca9685Chip(25e6, external_hz=CLOCK_HZ)
    bus.chips[0x40] = chip
    board = Pca9685(msgspec.structs.replace(vehicle, payload=outputs), Pca9685Options(), bus=bus)
    assert isinstance(board, PayloadOutput)
    assert set(board.unwired()) == {"accessory"}, "the board has 16 channels"
    with board:
        assert seen(chip) == [1500, 1500, 1500, 1500, 0, 0, 0, 0, 1100, 1900]
        board.set_payload(0, (1700, 1100, 1900))
        board.write(10_000, (1600, 1500, 1500, 1500))
        assert seen(chip) == [1600, 1500, 1500, 1500, 0, 0, 0, 0, 1700, 1100]
        assert board.check(2_000_000), "no commands: thrusters stand"
        assert seen(chip) == [1500, 1500, 1500, 1500, 0, 0, 0, 0, 1700, 1100]


def seen(chip: Pca9685Chip) -> list[int]:
    """Pulses of the first ten channels, to 5 us."""
    return [5 * round(pulse / 5) for pulse in chip.pulses_us[:10]]


def test_outputs_without_a_channel_say_so(tmp_path: Path) -> None:
    vehicle = load_vehicle("lbv150")
    sabertooth = Sabertooth(vehicle, SabertoothOptions(port=str(tmp_path / "none")))
    assert set(sabertooth.unwired()) == {"lights", "grabber", "accessory"}
    chip = SysfsPwm(vehicle, SysfsPwmOptions(outputs={"lights": 5}), kept=False)
    assert set(chip.unwired()) == {"grabber", "accessory"}


def test_ardusub_is_asked_until_it_acknowledges_and_a_refusal_is_told() -> None:
    bench = Bench()
    try:
        bench.run(1.0)
        wanted = [1100, 1900, 1100, 0]
        for _ in range(50):
            bench.driver.set_payload(bench.t_us, wanted)
            bench.tick()
        assert bench.below.extras.spare_us == {} and bench.below.extras.relays == {}, "nothing was changed"
        wanted = [1500, 1100, 1900, 0]
        for _ in range(200):
            bench.driver.set_payload(bench.t_us, wanted)
            bench.tick()
        assert bench.below.extras.spare_us == {13: 1500, 9: 1100}
        assert bench.below.extras.relays == {0: True}
        bench.below.mute = True  # the cable is off: what is asked for meanwhile comes later
        for _ in range(300):
            bench.driver.set_payload(bench.t_us, [1600, 1100, 1900, 0])
            bench.tick()
        bench.below.mute = False
        for _ in range(300):
            bench.driver.set_payload(bench.t_us, [1600, 1100, 1900, 0])
            bench.tick()
        assert bench.below.extras.spare_us[13] == 1600
    finally:
        bench.close()


def test_ardusub_tilts_its_mount_by_angle_and_reports_whoever_tilts_it() -> None:
    bench = Bench()
    try:
        bench.run(1.0)
        assert bench.below.extras.tilt_deg == 0.0 and seen_tilts(bench)[-1] == 0.0
        for _ in range(50):
            bench.driver.set_payload(bench.t_us, [1100, 1900, 1100, 0])
            bench.tick()
        assert bench.below.extras.tilt_deg == 0.0, "nobody has asked for it"
        for _ in range(100):
            bench.driver.set_payload(bench.t_us, [1100, 1900, 1100, 1300])
            bench.tick()
        assert bench.below.extras.tilt_deg == -22.5 and seen_tilts(bench)[-1] == -22.5
        bench.below.extras.tilt_deg = 40.0  # its pilot's buttons
        bench.run(0.1)
        assert abs(seen_tilts(bench)[-1] - 40.0) < 0.1
        quiet = len(seen_tilts(bench))
        bench.run(2.0)
        assert 8 <= len(seen_tilts(bench)) - quiet <= 12, "5 a second while it stands"
    finally:
        bench.close()


def seen_tilts(bench: Bench) -> list[float]:
    """Reported angles [deg]."""
    return [math.degrees(sample.angle_rad) for sample in bench.samples if isinstance(sample, CameraTiltSample)]


def test_outputs_of_ardusub_that_would_not_move_as_the_file_says_are_told() -> None:
    bench = Bench({"SERVO13_FUNCTION": 181.0, "SERVO16_FUNCTION": 0.0})
    try:
        bench.ready()
        told = dict(bench.driver.advice())
        assert told["SERVO13_FUNCTION = 181: lights does not move"] == "set 0, or 59 or 60 for lights"
        assert told["SERVO16_FUNCTION = 0: camera tilt does not move"] == "set 7"
        bench.below.parameters |= {"SERVO13_FUNCTION": 59.0, "SERVO16_FUNCTION": 7.0, "MNT1_PITCH_MIN": -90.0}
        bench.run(40.0)
        assert [found for found, _ in bench.driver.advice()] == ["MNT1_PITCH_MIN = -90: camera tilt gets another angle"]
    finally:
        bench.close()
