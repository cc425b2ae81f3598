"""What every thruster driver keeps: neutral at start, exit, exception, stale command; there again after a cut wire."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from output_rigs import RIGS, TICK_US, VEHICLE, OutputRig

from autopilot.core.errors import DriverError
from autopilot.drivers.registry import BACKENDS
from autopilot.drivers.retry import DeviceState

NEUTRAL = (1500, 1500, 1500, 1500)
COMMAND = (1600, 1400, 1537, 1900)
TIMEOUT_TICKS = round(VEHICLE.drive.command_timeout_s * 1e6) // TICK_US


@pytest.fixture(params=RIGS)
def rig(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[OutputRig]:
    made = RIGS[request.param](tmp_path)
    yield made
    made.close()


def up(rig: OutputRig) -> None:
    """Have the device opened, without a command."""
    for _ in range(2):
        rig.tick(None)
    assert rig.steady.state is not DeviceState.DOWN


def test_every_thruster_driver_stands_in_this_suite() -> None:
    assert set(BACKENDS["thrusters"]) == set(RIGS)


def test_neutral_when_opened_whatever_was_before(rig: OutputRig) -> None:
    with rig.make() as before:
        before.write(0, COMMAND)
        rig.see(COMMAND)
        up(rig)  # another process has been killed in the middle
        rig.see(NEUTRAL)


def test_carries_what_is_commanded(rig: OutputRig) -> None:
    up(rig)
    rng = np.random.default_rng(2)
    for _ in range(60):
        pulses = tuple(int(pulse) for pulse in rng.integers(1100, 1901, 4))
        rig.tick(pulses)
        rig.see(pulses)


def test_neutral_on_exit_and_after_an_exception(rig: OutputRig) -> None:
    with contextlib.suppress(ZeroDivisionError), rig.device as output:
        output.write(0, COMMAND)
        rig.see(COMMAND)
        raise ZeroDivisionError
    rig.see(NEUTRAL)
    with pytest.raises(DriverError, match="closed"):
        rig.device.write(0, COMMAND)


def test_neutral_when_commands_stop_coming(rig: OutputRig) -> None:
    up(rig)
    rig.tick(COMMAND)
    for _ in range(TIMEOUT_TICKS):
        rig.tick(None)
    rig.see(COMMAND)
    rig.tick(None)
    rig.see(NEUTRAL)
    rig.tick(COMMAND)
    rig.see(COMMAND)


def test_pulses_out_of_range_and_too_few(rig: OutputRig) -> None:
    up(rig)
    rig.tick((3000, 0, 1500, 1100))
    rig.see((1900, 1100, 1500, 1100))
    with pytest.raises(DriverError, match="3 pulses for 4 thrusters"):
        rig.tick((1700, 1700, 1700))
    rig.see(NEUTRAL)


def test_a_cut_wire_is_said_on_every_tick_and_mended_without_a_restart(rig: OutputRig) -> None:
    up(rig)
    rig.tick(COMMAND)
    rig.unplug()
    for _ in range(250):
        with contextlib.suppress(DriverError, OSError):
            rig.tick(COMMAND)
    assert rig.steady.state is DeviceState.DOWN
    for _ in range(50):
        with pytest.raises(DriverError):
            rig.tick(COMMAND)
    rig.plug()
    for _ in range(1100):
        with contextlib.suppress(DriverError, OSError):
            rig.tick(COMMAND)
            break
    for _ in range(60):
        rig.tick(COMMAND)
    rig.see(COMMAND)


def test_absent_at_the_start_it_is_found_later(rig: OutputRig) -> None:
    rig.unplug()
    rig.tick(None)  # while the first opening is under way nothing is said
    for _ in range(20):
        with pytest.raises(DriverError, match="thrusters down"):
            rig.tick(COMMAND)
    rig.plug()
    for _ in range(200):
        rig.tick(None)
    rig.see(NEUTRAL)
    rig.tick(COMMAND)
    rig.see(COMMAND)


def test_a_board_that_loses_its_power_for_a_moment_is_working_again_soon(rig: OutputRig) -> None:
    up(rig)
    rig.tick(COMMAND)
    rig.unplug()
    rig.plug()
    for _ in range(250):
        with contextlib.suppress(DriverError, OSError):
            rig.tick(COMMAND)
    rig.see(COMMAND)
