"""The process that stops the thrusters when the service cannot: the real service, from a folder full of traps."""

import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hostile_folder import imported_from, make_hostile
from pwm_vehicle import PwmVehicle, gone, keepers_of, until

from autopilot.core.messages import Failsafe, Outputs
from autopilot.drivers.watchdog_process import WatchdogState
from autopilot.mavlink.api import CommandResult, FlightMode
from autopilot.run.children import autopilot_command
from autopilot.run.config import gather, vehicle_defaults
from autopilot.run.hardware_session import open_vehicle
from autopilot.run.session import Session
from autopilot.run.vehicle_config import load_config

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP, signal.SIGTERM])
def test_a_service_that_ends_or_hangs_leaves_thrusters_neutral_wherever_it_was_started(
    number: int, tmp_path: Path
) -> None:
    hostile = make_hostile(tmp_path / "project")
    command = autopilot_command("run", "--config", str(tmp_path / "vehicle" / "pwm.toml"))
    with PwmVehicle(tmp_path / "vehicle") as vehicle:
        service = subprocess.Popen(command, cwd=hostile, stdout=subprocess.DEVNULL)
        try:
            vehicle.fly()
            (watchdog,) = keepers_of(service.pid)
            service.send_signal(number)
            until(lambda: vehicle.still)
            assert imported_from(hostile) == []
            if number == signal.SIGSTOP:
                service.send_signal(signal.SIGCONT)
                until(lambda: not vehicle.still)  # it was only late
                service.terminate()
                until(lambda: vehicle.still)
        finally:
            if number != signal.SIGTERM:
                service.kill()
            service.wait()
        until(lambda: gone(watchdog))
        assert vehicle.still


class Flight:
    def __init__(self, vehicle: PwmVehicle, folder: Path) -> None:
        settings = gather(vehicle_defaults(0), {"state_dir": str(folder), "log": str(folder / "run.mcap")}, {})
        config = load_config(str(vehicle.config))
        settings.put("connect", tuple(config.file.service.connect or ()), "test")
        self.outputs: Outputs | None = None
        self.texts: list[str] = []
        self.session: Session = open_vehicle(settings, config, {"FS_WDOG_ACT": 2.0}, speed=1.0, on_tick=self._tick)
        self._tick_count = 0

    def _tick(self, outputs: Outputs) -> None:
        self.outputs = outputs
        self.texts += [event.text for event in outputs.events]

    def until(self, done: Callable[[], bool], at_most_s: float) -> None:
        """Ticks until something is so, at most so much of the vehicle's time."""
        for _ in range(round(100 * at_most_s)):
            if self._tick_count and done():
                return
            self._tick_count += 1
            self.session.runtime.tick(10_000 * self._tick_count)
        raise AssertionError(f"not within {at_most_s} s: {self.texts[-6:]}")

    @property
    def watchdog(self) -> WatchdogState | None:
        return self.session.device._output.device.watchdog  # type: ignore[union-attr, no-any-return]

    @property
    def pid(self) -> int:
        assert self.watchdog is not None and self.watchdog.pid is not None
        return self.watchdog.pid

    @property
    def alive(self) -> bool:
        return self.watchdog is not None and self.watchdog.problem == ""

    def arm(self) -> None:
        """In MANUAL, which needs no position."""
        commander = self.session.parts.commander
        self.until(lambda: self.alive and commander.set_mode(FlightMode.MANUAL).result is CommandResult.ACCEPTED, 90.0)
        self.until(lambda: commander.arm(force=False).result is CommandResult.ACCEPTED, 90.0)

    def failing(self) -> bool:
        assert self.outputs is not None
        return bool(self.outputs.mode.failsafes >> Failsafe.WATCHDOG & 1)

    def refusals(self) -> str:
        commander = self.session.parts.commander
        return commander.arm(force=False).reason

    def close(self) -> None:
        self.session.close()


@pytest.fixture
def flight(tmp_path: Path) -> Iterator[Flight]:
    with PwmVehicle(tmp_path / "vehicle") as vehicle:
        made = Flight(vehicle, tmp_path)
        yield made
        made.close()
        assert vehicle.still


def test_nobody_arms_before_the_watchdog_has_answered(flight: Flight, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as slow:
        slow.setattr("autopilot.drivers.watchdog_process.CODE", "import time; time.sleep(600)")
        flight.until(lambda: "thruster watchdog is starting: wait" in flight.refusals(), 60.0)
        flight.until(lambda: flight.watchdog is not None and flight.watchdog.pid is not None, 60.0)
    os.kill(flight.pid, signal.SIGKILL)
    flight.until(lambda: flight.alive, 90.0)
    flight.until(lambda: "watchdog" not in flight.refusals(), 30.0)


@pytest.mark.parametrize(("number", "problem"), [(signal.SIGKILL, "has ended"), (signal.SIGSTOP, "hangs")])
def test_a_watchdog_that_ends_or_hangs_is_told_once_and_replaced(flight: Flight, number: int, problem: str) -> None:
    flight.arm()
    first, text = flight.pid, f"Thruster watchdog failed: {problem}"
    os.kill(first, number)
    flight.until(lambda: text in flight.texts, 30.0)
    flight.until(lambda: "Thruster watchdog: working again" in flight.texts, 90.0)
    until(lambda: gone(first))
    assert flight.alive and flight.pid != first
    assert flight.texts.count(text) == 1
    assert flight.session.parts.commander.armed


def test_a_watchdog_that_ends_again_and_again_is_a_failsafe_and_no_storm(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight.arm()
    watchdog = flight.watchdog
    assert watchdog is not None
    before = watchdog.starts
    monkeypatch.setattr("autopilot.drivers.watchdog_process.CODE", "raise SystemExit(1)")
    os.kill(flight.pid, signal.SIGKILL)
    flight.until(lambda: flight.failing() and flight.session.parts.commander.mode is FlightMode.SURFACE, 30.0)
    assert 1 <= watchdog.starts - before <= 8
    assert flight.texts.count("Thruster watchdog failed: has ended") == 1
    assert flight.texts.count("Failsafe: thruster watchdog has ended: surface") == 1
    assert flight.session.parts.commander.disarm(force=False).result is CommandResult.ACCEPTED
    flight.until(lambda: "thruster watchdog has ended: restart the service" in flight.refusals(), 30.0)
