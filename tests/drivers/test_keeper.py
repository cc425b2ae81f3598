"""Outputs without a watchdog of their own stand still when the program is killed or hangs."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from output_rigs import VEHICLE, SysfsPwmRig

from drivers.sysfs_pwm import SysfsPwm, SysfsPwmOptions

PROGRAM = """
import sys, time
from autopilot.core.vehicle import load_vehicle
from drivers.sysfs_pwm import SysfsPwm, SysfsPwmOptions
output = SysfsPwm(load_vehicle("lbv150"), SysfsPwmOptions(chip=sys.argv[1]))
output.open()
print(output._keeper.pid, flush=True)
for tick in range(1_000_000):
    output.write(10_000 * tick, (1900, 1100, 1700, 1600))
    if tick == 50:
        print("moving", flush=True)
    time.sleep(0.01)
"""
NEUTRAL, MOVING = (1500.0,) * 4, (1900.0, 1100.0, 1700.0, 1600.0)


def until(look: Callable[[], bool]) -> None:
    """Wait for another process."""
    for _ in range(4000):
        if look():
            return
        time.sleep(0.005)
    raise AssertionError("it does not happen")


def gone(pid: int) -> bool:
    """Whether no such process runs."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return True
    return state == "Z"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_program_that_is_killed_or_hangs_leaves_thrusters_neutral(number: int, tmp_path: Path) -> None:
    rig = SysfsPwmRig(tmp_path)
    program = subprocess.Popen([sys.executable, "-c", PROGRAM, str(rig.chip)], stdout=subprocess.PIPE, text=True)
    assert program.stdout is not None
    keeper = int(program.stdout.readline())
    assert program.stdout.readline() == "moving\n"
    assert rig.pulses_us() == MOVING
    os.kill(keeper, signal.SIGTERM)  # as a service manager does to all of a service
    program.send_signal(number)
    until(lambda: rig.pulses_us() == NEUTRAL)
    if number == signal.SIGSTOP:
        program.send_signal(signal.SIGCONT)
        until(lambda: rig.pulses_us() == MOVING)  # it was only late
        program.kill()
        until(lambda: rig.pulses_us() == NEUTRAL)
    program.wait()
    program.stdout.close()
    until(lambda: gone(keeper))


def test_an_end_in_order_leaves_no_keeper_and_a_killed_keeper_is_replaced(tmp_path: Path) -> None:
    rig = SysfsPwmRig(tmp_path)
    with SysfsPwm(VEHICLE, SysfsPwmOptions(chip=str(rig.chip))) as output:
        first = output._keeper
        assert first is not None
        first.kill()
        first.wait()
        output.write(0, (1900, 1100, 1700, 1600))
        second = output._keeper
        assert output.keepers == 2
        assert second is not None and second.poll() is None
    assert second.poll() == 0
    assert rig.pulses_us() == NEUTRAL
