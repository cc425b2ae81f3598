"""The keeper of an output without a watchdog of its own, by its driver alone; with the service:
tests/system/test_thruster_watchdog.py."""

import os
import resource
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import pytest
from hostile_folder import imported_from, make_hostile
from output_rigs import VEHICLE, SysfsPwmRig
from pwm_vehicle import gone, keepers_of, until

from autopilot.drivers.sysfs_pwm import SysfsPwm, SysfsPwmOptions
from autopilot.drivers.watchdog_process import LONGEST_PAUSE_US, WatchdogState

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")

MOVING = (1900, 1100, 1700, 1600)


def keep(output: SysfsPwm, done: Callable[[], bool], t_us: int = 0) -> int:
    """Ticks until something is so; the time after them."""
    for _ in range(20_000):
        t_us += 10_000
        output.write(t_us, MOVING)
        output.check(t_us)
        if done():
            return t_us
        time.sleep(0.005)
    raise AssertionError("it does not happen")


def kept(output: SysfsPwm) -> WatchdogState:
    assert output.watchdog is not None
    return output.watchdog


@pytest.fixture
def output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SysfsPwm]:
    """In a folder full of traps."""
    rig = SysfsPwmRig(tmp_path)
    monkeypatch.chdir(make_hostile(tmp_path / "project"))
    made = SysfsPwm(VEHICLE, SysfsPwmOptions(chip=str(rig.chip)))
    yield made
    made.close()
    assert rig.pulses_us() == (1500.0,) * 4
    assert imported_from(tmp_path / "project") == []


def test_it_proves_that_it_lives_and_goes_when_it_is_sent_away(output: SysfsPwm) -> None:
    output.open()
    assert output.watchdog_problem == "is starting" and not output.watchdog_failed
    keep(output, lambda: output.watchdog_problem == "")
    pid = kept(output).pid
    assert pid is not None
    os.kill(pid, signal.SIGTERM)  # as a service manager does to all of a service
    output.close()
    assert gone(pid)
    assert output.watchdog_problem == ""


def test_it_proves_that_it_lives_before_anything_is_commanded(output: SysfsPwm) -> None:
    """As the doctor asks, who commands nothing."""
    output.open()

    def answered() -> bool:
        output.check(10_000)
        return output.watchdog_problem == ""

    until(answered)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_restart_with_a_keeper_that_was_killed_or_stopped(output: SysfsPwm, number: int) -> None:
    output.open()
    t_us = keep(output, lambda: output.watchdog_problem == "")
    first = kept(output).pid
    assert first is not None
    os.kill(first, number)
    output.close()
    assert gone(first)
    output.open()
    keep(output, lambda: output.watchdog_problem == "", t_us)
    assert kept(output).pid != first


def test_one_that_is_stopped_has_a_problem_and_goes_on_when_it_is_let_go_on(output: SysfsPwm) -> None:
    output.open()
    t_us = keep(output, lambda: output.watchdog_problem == "")
    pid = kept(output).pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    t_us = keep(output, lambda: output.watchdog_problem == "hangs", t_us)
    assert output.watchdog_failed
    os.kill(pid, signal.SIGCONT)
    keep(output, lambda: output.watchdog_problem == "", t_us)
    assert kept(output).starts == 1


@contextmanager
def no_python(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with monkeypatch.context() as without:
        without.setattr("sys.executable", "/nowhere/python")
        yield


@contextmanager
def another_program(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with monkeypatch.context() as without:
        without.setattr("sys.executable", "/bin/false")
        yield


@contextmanager
def no_more_files(_: pytest.MonkeyPatch) -> Iterator[None]:
    """But one, which the output needs to look at its own files now and then; a process takes several."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    used = {name for name in os.listdir("/proc/self/fd") if os.path.lexists(f"/proc/self/fd/{name}")}
    free = (number for number in count() if str(number) not in used)
    next(free)
    resource.setrlimit(resource.RLIMIT_NOFILE, (next(free), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.mark.parametrize("state", [no_python, another_program, no_more_files])
def test_one_that_cannot_be_started_is_tried_again_with_pauses(
    output: SysfsPwm, state: Callable[..., Iterator[None]], monkeypatch: pytest.MonkeyPatch
) -> None:
    output.open()  # with a keeper that lives; then no other is to be had
    t_us = keep(output, lambda: output.watchdog_problem == "")
    watchdog = kept(output)
    with state(monkeypatch):  # type: ignore[attr-defined]
        os.kill(watchdog.pid or 0, signal.SIGKILL)
        t_us = keep(output, lambda: output.watchdog_problem not in ("", "is starting"), t_us)
        begin_us = t_us
        while t_us - begin_us < 60_000_000:
            t_us += 100_000
            output.write(t_us, MOVING)
            output.check(t_us)
            time.sleep(0.002)
        assert output.watchdog_failed
        assert 3 <= watchdog.starts <= 2 + 5 + 60_000_000 // LONGEST_PAUSE_US
    until(lambda: watchdog._coming is None or watchdog._coming.done())
    keep(output, lambda: output.watchdog_problem == "", t_us)


def test_without_a_thread_to_start_it_there_is_a_problem_and_then_one_keeper(
    output: SysfsPwm, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: object) -> None:
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as without:
        without.setattr("threading.Thread.start", refuse)
        output.open()
        output.check(10_000)
        assert output.watchdog_failed
        assert output.watchdog_problem == "cannot be started (can't start new thread)"
    keep(output, lambda: output.watchdog_problem == "", 10_000)
    assert keepers_of(os.getpid()) == [kept(output).pid]
