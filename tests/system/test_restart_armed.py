"""A service that is killed armed, started again and ended: the processes, and the flight controller as it is heard."""

import contextlib
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from autopilot.run.children import autopilot_command, free_port

GUARD_S = 120.0
"""Against a hang: nothing is timed."""
ARM, ARMED = 400, 128


class Listener:
    """One end of a link; what is heard stays."""

    def __init__(self, port: int) -> None:
        self._mav: Any = mavutil.mavlink_connection(
            f"udpin:127.0.0.1:{port}", source_system=250, source_component=190, dialect="ardupilotmega"
        )
        self.armed: bool | None = None
        self.beats = 0
        self.answers: list[int] = []
        self.ready = False

    def listen(self) -> None:
        while (message := self._mav.recv_msg()) is not None:
            kind = message.get_type()
            if message.get_srcComponent() != 1:
                continue
            if kind == "HEARTBEAT":
                self.armed, self.beats = bool(message.base_mode & ARMED), self.beats + 1
            elif kind == "COMMAND_ACK" and message.command == ARM and message.result != 5:
                self.answers.append(message.result)
            elif kind == "SYS_STATUS":
                self.ready = bool(message.onboard_control_sensors_health & mavutil.mavlink.MAV_SYS_STATUS_PREARM_CHECK)

    def ask(self, armed: bool) -> None:
        self.answers.clear()
        self._mav.mav.command_long_send(1, 1, ARM, 0, float(armed), 0, 0, 0, 0, 0, 0)

    def warn_only(self) -> None:
        """A ground station that is lost does not disarm it: how long a start takes does not count."""
        self._mav.mav.param_set_send(1, 1, b"FS_GCS_ENABLE", 1.0, 9)

    def close(self) -> None:
        self._mav.close()


class Rig:
    """Flight controller with a vehicle, service, ground station, and an ear on the flight controller."""

    def __init__(self, folder: Path, stack: contextlib.ExitStack) -> None:
        self._folder, self._stack = folder, stack
        below, pose, ear, station = (free_port() for _ in range(4))
        (folder / "rov.toml").write_text(
            'vehicle = "bluerov2"\n[service]\nstate_dir = "state"\nlog_dir = "logs"\n'
            f'connect = ["udpin:127.0.0.1:{pose}", "udpout:127.0.0.1:{station}"]\n'
            '[devices.flight_controller]\ndriver = "ardusub"\nframe = "vectored"\n'
            f'connect = "udpin:127.0.0.1:{below}"\n'
        )
        self.ear, self.station = Listener(ear), Listener(station)
        for listener in (self.ear, self.station):
            stack.callback(listener.close)
        links = ("--link", f"udpout:127.0.0.1:{below}", "--link", f"udpout:127.0.0.1:{ear}")
        self._start("emulate", "open-water", *links, "--pose", f"udpout:127.0.0.1:{pose}")

    def _start(self, *arguments: str) -> subprocess.Popen[bytes]:
        command = autopilot_command(*arguments)
        process = subprocess.Popen(command, cwd=self._folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)
        return process

    def service(self) -> subprocess.Popen[bytes]:
        return self._start("run", "--config", str(self._folder / "rov.toml"))

    def until(self, done: Callable[[], bool]) -> None:
        end_s = time.monotonic() + GUARD_S
        while not done():
            assert time.monotonic() < end_s, "nothing comes of it"
            self.ear.listen()
            self.station.listen()
            time.sleep(0.01)

    def beats(self, count: int) -> None:
        """So many heartbeats of the flight controller later."""
        last = self.ear.beats + count
        self.until(lambda: self.ear.beats >= last)


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    with contextlib.ExitStack() as stack:
        yield Rig(tmp_path, stack)


def test_killed_armed_started_again_and_ended(rig: Rig) -> None:
    rig.beats(1)
    rig.ear.warn_only()
    service = rig.service()
    rig.until(lambda: rig.station.ready)
    rig.station.ask(armed=True)
    rig.until(lambda: rig.ear.armed is True)
    service.send_signal(signal.SIGKILL)
    service.wait()
    rig.beats(2)
    assert rig.ear.armed is True
    rig.station.armed, rig.station.ready = None, True
    again = rig.service()
    rig.until(lambda: rig.station.armed is True and not rig.station.ready)  # shown, and no arming
    rig.station.ask(armed=False)
    rig.until(lambda: bool(rig.station.answers))
    assert rig.station.answers == [0]
    rig.beats(2)
    assert rig.ear.armed is False
    rig.until(lambda: rig.station.ready)
    rig.station.ask(armed=True)
    rig.until(lambda: rig.ear.armed is True)
    again.send_signal(signal.SIGTERM)
    assert again.wait() == 0
    rig.beats(2)
    assert rig.ear.armed is False
