"""What only one thruster driver has: clocks and trims, an amplifier's own timeout, options that cannot be."""

import contextlib

import msgspec
import pytest
from emulators import GpioEmulator
from hypothesis import given
from hypothesis import strategies as st

from autopilot.core.errors import ConfigError, DriverError
from autopilot.core.thrusters import ThrusterTable
from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.pca9685 import Pca9685, Pca9685Options
from autopilot.drivers.sabertooth import TIMEOUT_EVERY, Sabertooth, SabertoothOptions, packet
from autopilot.drivers.sysfs_pwm import SysfsPwm, SysfsPwmOptions
from autopilot.drivers.thruster_output import INSPECT_EVERY
from autopilot.sitl.i2c_bus import EmulatedI2c, Pca9685Chip
from tests.drivers.sabertooth_emulator import SabertoothEmulator

VEHICLE = load_vehicle("lbv150")
NEUTRAL = (1500,) * 4


def navigator(chip: Pca9685Chip, options: Pca9685Options = Pca9685Options(), **more: GpioEmulator) -> Pca9685:  # noqa: B008
    bus = EmulatedI2c()
    bus.chips[options.address] = chip
    return Pca9685(VEHICLE, options, bus=bus, **more)


@given(st.floats(22e6, 28e6), st.floats(50.0, 400.0), st.integers(1100, 1900), st.booleans())
def test_pulses_are_right_when_the_clock_is_known(clock_hz: float, rate_hz: float, pulse: int, outside: bool) -> None:
    chip = Pca9685Chip(99e6, external_hz=clock_hz) if outside else Pca9685Chip(clock_hz)
    options = Pca9685Options(clock_hz=clock_hz, rate_hz=rate_hz, external_clock=outside)
    with navigator(chip, options) as output:
        output.write(0, (pulse,) * 4)
        step_us = 1e6 / (4096 * rate_hz)
        assert chip.pulses_us[0] == pytest.approx(pulse, abs=0.6 * step_us)
        assert chip.period_us == pytest.approx(1e6 / rate_hz, rel=0.1)


def test_a_clone_s_clock_and_a_crooked_amplifier_are_trimmed() -> None:
    chip = Pca9685Chip(26.3e6)
    with navigator(chip, Pca9685Options(external_clock=False, clock_hz=25e6)) as output:
        assert chip.pulses_us[0] == pytest.approx(1426, abs=2)  # nobody has measured the clock
        output.write(0, NEUTRAL)
    options = Pca9685Options(external_clock=False, clock_hz=26.3e6, trim_us={"vertical": -8.0})
    with navigator(Pca9685Chip(26.3e6), options) as output:
        output.write(0, NEUTRAL)
        seen = output._bus.chips[0x40].pulses_us  # type: ignore[attr-defined]
        assert seen[0] == pytest.approx(1500, abs=0.7)
        assert seen[2] == pytest.approx(1492, abs=0.7)


def test_channels_of_others_are_left_alone() -> None:
    chip = Pca9685Chip(25e6, external_hz=24.576e6)
    with navigator(chip) as output:
        chip.write(bytes([0x06 + 4 * 9, 0, 0, 0x00, 0x06]))  # somebody's light on channel 10
        lights = chip.pulses_us[9]
        output.write(0, (1700,) * 4)
        assert chip.pulses_us[9] == lights > 0.0


def test_outputs_are_enabled_only_while_they_are_held() -> None:
    enable = GpioEmulator()
    output = navigator(Pca9685Chip(25e6, external_hz=24.576e6), enable=enable)
    assert not enable.level
    with output:
        assert enable.level
    assert not enable.level


def test_a_board_that_was_without_power_is_noticed_and_set_up_again() -> None:
    chip = Pca9685Chip(25e6, external_hz=24.576e6)
    with navigator(chip) as output:
        output.write(0, (1700,) * 4)
        chip.power_up()
        with pytest.raises(DriverError, match="has lost its settings"):
            for k in range(INSPECT_EVERY + 1):
                output.write(k, (1700,) * 4)
                assert chip.pulses_us[0] == 0.0
        with pytest.raises(DriverError, match="has lost its settings"):
            output.write(100, (1700,) * 4)  # on every command from then on, not on every 25th
        output.close()
        output.open()
        assert chip.pulses_us[0] == pytest.approx(1500, abs=0.7)


def test_a_transfer_that_is_not_acknowledged_costs_one_command() -> None:
    chip = Pca9685Chip(25e6, external_hz=24.576e6)
    with navigator(chip) as output:
        output.write(0, (1700,) * 4)
        output._bus.refused = 1  # type: ignore[attr-defined]
        with pytest.raises(DriverError, match="Remote I/O error"):
            output.write(1, (1700,) * 4)
        assert chip.pulses_us[0] == pytest.approx(1500, abs=0.7)
        output.write(2, (1700,) * 4)
        assert chip.pulses_us[0] == pytest.approx(1700, abs=0.7)


def test_opening_without_neutral_is_no_opening() -> None:
    chip = Pca9685Chip(25e6, external_hz=24.576e6)
    output = navigator(chip)
    output._bus.refused = 1  # type: ignore[attr-defined]
    with pytest.raises(OSError, match="Remote I/O"):
        output.open()
    with pytest.raises(DriverError, match="closed"):
        output.write(0, NEUTRAL)
    output.open()
    assert chip.pulses_us[0] == pytest.approx(1500, abs=0.7)
    output.close()


def test_amplifiers_stop_by_themselves_when_the_program_is_killed() -> None:
    line = SabertoothEmulator()
    output = Sabertooth(VEHICLE, SabertoothOptions(port="none"), port=line)
    output.open()
    assert line.timeout_s == {128: 0.5, 129: 0.5}
    output.write(0, (1900,) * 4)
    assert set(line.duty.values()) == {1.0}
    line.read(500_000)
    assert set(line.duty.values()) == {1.0}
    line.read(500_001)
    assert set(line.duty.values()) == {0.0}


def test_amplifiers_learn_their_timeout_again_after_a_loss_of_power() -> None:
    line = SabertoothEmulator()
    with Sabertooth(VEHICLE, SabertoothOptions(port="none"), port=line) as output:
        line.power_up()
        for k in range(TIMEOUT_EVERY):
            output.write(k, (1900,) * 4)
        assert line.timeout_s == {128: 0.5, 129: 0.5}


@given(st.integers(128, 135), st.integers(0, 17), st.integers(0, 127), st.integers(0, 3), st.integers(0, 6))
def test_a_damaged_packet_moves_no_motor(address: int, command: int, data: int, at: int, bit: int) -> None:
    line = SabertoothEmulator()
    damaged = bytearray(packet(address, command, data))
    damaged[at] ^= 1 << bit
    line.write(bytes(damaged))
    assert not any(line.duty.values())


def test_options_that_cannot_be_are_refused_with_a_remedy() -> None:
    with pytest.raises(ConfigError, match="`baud` = 9600: 4 motors need 16000; set 38400"):
        Sabertooth(VEHICLE, SabertoothOptions(port="x", baud=9600))
    with pytest.raises(ConfigError, match=r"two thrusters on motor \[128, 2\]"):
        Sabertooth(VEHICLE, SabertoothOptions(port="x", motors={"port": (128, 2)}))
    with pytest.raises(ConfigError, match="`motors` names 'bow', which is no thruster; use one of port, starboard"):
        Sabertooth(VEHICLE, SabertoothOptions(port="x", motors={"bow": (128, 2)}))
    with pytest.raises(ConfigError, match="`outputs`: two thrusters on output 1"):
        SysfsPwm(VEHICLE, SysfsPwmOptions(outputs={"port": 1}))
    with pytest.raises(ConfigError, match="`trim_us` names 'bow'"):
        Pca9685(VEHICLE, Pca9685Options(trim_us={"bow": 1.0}), bus=EmulatedI2c())
    far = msgspec.structs.replace(VEHICLE, drive=msgspec.structs.replace(VEHICLE.drive, span_us=1100))
    with pytest.raises(ConfigError, match="`rate_hz` = 400: a pulse of 2600 us does not fit"):
        Pca9685(far, Pca9685Options(rate_hz=400.0), bus=EmulatedI2c())
    with pytest.raises(ConfigError, match="`rate_hz` = 400: a pulse of 2600 us does not fit"):
        SysfsPwm(far, SysfsPwmOptions(rate_hz=400.0))


def test_any_place_of_the_thrusters_on_the_board() -> None:
    tables = VEHICLE.thruster_tables
    placed = [msgspec.structs.replace(t, channel=c) for t, c in zip(tables, (2, 3, 9, 16), strict=True)]
    assert all(isinstance(table, ThrusterTable) for table in placed)
    vehicle = msgspec.structs.replace(VEHICLE, thruster_tables=tuple(placed))
    chip = Pca9685Chip(25e6, external_hz=24.576e6)
    bus = EmulatedI2c()
    bus.chips[0x40] = chip
    with contextlib.closing(Pca9685(vehicle, Pca9685Options(), bus=bus)) as output:
        output.open()
        output.write(0, (1600, 1700, 1300, 1850))
        seen = {n + 1: round(pulse) for n, pulse in enumerate(chip.pulses_us) if pulse}
    assert seen == pytest.approx({2: 1600, 3: 1700, 9: 1300, 16: 1850}, abs=1)
