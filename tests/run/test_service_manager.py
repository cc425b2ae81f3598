"""What a service manager hears, from the class and from a whole process."""

import os
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from autopilot.run.children import autopilot_command
from autopilot.run.service_manager import ServiceManager

WAIT_S = 120.0


@pytest.fixture
def ear(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ear:
        ear.bind(str(tmp_path / "notify"))
        ear.settimeout(WAIT_S)
        yield ear


def heard(ear: socket.socket) -> list[str]:
    ear.setblocking(False)
    found = []
    while True:
        try:
            found.append(ear.recv(4096).decode())
        except BlockingIOError:
            return found


def test_ready_once_then_alive_three_times_within_the_timeout(tmp_path: Path, ear: socket.socket) -> None:
    now_s = 100.0
    told = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "600000", "WATCHDOG_PID": str(os.getpid())}
    manager = ServiceManager(told, lambda: now_s)
    for tick in range(110):
        now_s = 100.0 + 0.01 * tick
        manager.tick(lambda: "armed")
    assert heard(ear) == [f"{'READY=1' + chr(10) if n == 0 else ''}WATCHDOG=1\nSTATUS=armed" for n in range(6)]
    manager.stopping()
    assert heard(ear) == ["STOPPING=1"]
    manager.close()


@pytest.mark.parametrize("told", [{}, {"NOTIFY_SOCKET": ""}, {"NOTIFY_SOCKET": "/nobody/is/here"}])
def test_without_a_manager_nothing_happens(told: dict[str, str]) -> None:
    manager = ServiceManager(told)
    assert not manager.present
    manager.tick()
    manager.stopping()
    manager.close()


@pytest.mark.parametrize("wrong", [{"WATCHDOG_USEC": "soon"}, {"WATCHDOG_USEC": "1000", "WATCHDOG_PID": "1"}])
def test_a_watchdog_of_somebody_else_is_not_fed_faster(tmp_path: Path, ear: socket.socket, wrong) -> None:  # type: ignore[no-untyped-def]
    now_s = 0.0
    manager = ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "notify"), **wrong}, lambda: now_s)
    for tick in range(100):
        now_s = 0.01 * tick
        manager.tick()
    assert len(heard(ear)) == 1
    manager.close()


def test_a_manager_that_does_not_read_or_goes_stops_nothing(tmp_path: Path, ear: socket.socket) -> None:
    now_s = 0.0
    manager = ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "notify")}, lambda: now_s)
    for tick in range(2000):
        now_s = 2.0 * tick
        manager.tick()
    assert manager.present, "a full queue is no reason to give up"
    ear.close()
    manager.tick()
    now_s += 2.0
    manager.tick()
    assert not manager.present


def test_a_service_tells_when_it_is_ready_and_when_it_stops(tmp_path: Path, ear: socket.socket) -> None:
    command = autopilot_command(
        "sitl", "--sensors", "pose", "--quiet", "--connect", "udpout:127.0.0.1:9", "--log", str(tmp_path / "run.mcap")
    )
    told = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "AUTOPILOT_STATE_DIR": str(tmp_path)}
    process = subprocess.Popen(command, env={**os.environ, **told})
    try:
        first = ear.recv(4096).decode().split("\n")
        assert first[:2] == ["READY=1", "WATCHDOG=1"]
        assert first[2].startswith("STATUS=") and "disarmed, HOLD" in first[2]
        process.terminate()
        said = [ear.recv(4096).decode()]
        while said[-1] != "STOPPING=1":
            said.append(ear.recv(4096).decode())
        assert process.wait(WAIT_S) == 0
    finally:
        process.kill()
        process.wait()
