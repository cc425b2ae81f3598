"""MAVProxy, a client that we did not write, on the process: plans, parameters, modes, arming, logs, files."""

import importlib.util
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest
from system_harness import RunningService

from autopilot.cli.console_output import EXIT_LOSS
from autopilot.run.children import Child, autopilot_command, free_port

if importlib.util.find_spec("MAVProxy") is None:
    pytest.skip("MAVProxy is not installed (pip install MAVProxy)", allow_module_level=True)

HEAD = "QGC WPL 110"
WAYPOINTS = (
    (0, 16, 0, 0.0, 37.9755, 23.7790, 0.0),  # home, as files of this format begin
    (1, 16, 3, 0.0, 37.9754856, 23.7789960, -0.45),
    (2, 16, 3, 0.0, 37.9755158, 23.7790000, -0.30),
)
CORNERS = ((37.97548, 23.77898), (37.97548, 23.77902), (37.97552, 23.77902), (37.97552, 23.77898))
FENCE = tuple((n, 5001, 0, 4.0, lat, lon, 0.0) for n, (lat, lon) in enumerate(CORNERS))
RALLY = ((0, 5100, 3, 0.0, 37.9754856, 23.7789960, -0.45),)


def plan_file(rows: Sequence[tuple[float, ...]]) -> str:
    """Numbers with tabs between them."""
    lines = [HEAD]
    for seq, command, frame, p1, lat, lon, alt in rows:
        lines.append(f"{seq}\t0\t{frame}\t{command}\t{p1}\t0.3\t0\t0\t{lat:.7f}\t{lon:.7f}\t{alt}\t1")
    return "\n".join(lines) + "\n"


class MavProxy:
    """The real client; commands go to its standard input."""

    def __init__(self, service: RunningService, folder: Path) -> None:
        self.service = service
        self.process = subprocess.Popen(
            [
                *(sys.executable, "-m", "MAVProxy.mavproxy"),
                *(f"--master=udpout:127.0.0.1:{service.port}", f"--state-basedir={folder}", "--aircraft=test"),
            ],
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        self.said = ""
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        while chunk := self.process.stdout.read(1):
            self.said += chunk

    def wait(self, *wanted: str) -> None:
        """Until all of it has been said."""
        while not all(text in self.said for text in wanted):
            assert self.process.poll() is None, self.said[-2000:]
            self.service.keep_waiting(120.0)
            time.sleep(0.1)

    def do(self, line: str, *wanted: str) -> str:
        """A command; until all of it has been said. It is typed again, as a person would who sees nothing."""
        begin, typed_s = len(self.said), -math.inf
        assert self.process.stdin is not None
        while typed_s < 0.0 or not all(text in self.said[begin:] for text in wanted):
            assert self.process.poll() is None, self.said[-2000:]
            self.service.keep_waiting(120.0)
            if time.monotonic() - typed_s > 20.0:
                typed_s = time.monotonic()
                self.process.stdin.write(line + "\n")
                self.process.stdin.flush()
            time.sleep(0.1)
        return self.said[begin:]

    def end(self) -> None:
        """It does not always listen to SIGTERM while it reads what is typed."""
        self.process.kill()
        self.process.wait()
        self._thread.join()


@contextmanager
def flying(folder: Path, profile: str) -> Iterator[MavProxy]:
    port = free_port()
    command = autopilot_command(
        *("sitl", "paper-tank", "--quiet", "--sensors", "pose", "--speed", "1", "--profile", profile),
        *("--connect", f"udpin:127.0.0.1:{port}"),
    )
    places = {"AUTOPILOT_STATE_DIR": str(folder / "state"), "AUTOPILOT_LOG_DIR": str(folder / "logs")}
    child = Child(command, places)
    proxy = MavProxy(RunningService(child=child, port=port, log=folder), folder)
    try:
        yield proxy
    finally:
        proxy.end()
        assert child.end() in (0, EXIT_LOSS)


@pytest.mark.parametrize("profile", ["ardusub", "px4"])
def test_what_an_operator_types_has_its_outcome(profile: str, tmp_path: Path) -> None:
    for name, rows in (("plan", WAYPOINTS), ("fence", FENCE), ("rally", RALLY)):
        (tmp_path / f"{name}.txt").write_text(plan_file(rows))
    with flying(tmp_path, profile) as proxy:
        proxy.wait("Received", "parameters")
        proxy.do("param show SPD_CRUISE", "SPD_CRUISE       0.3")
        proxy.do("param set SPD_CRUISE 0.25")
        proxy.do("param set FS_SOLVER_N 41")
        proxy.do("param fetch", "Received")
        proxy.do("param show SPD_CRUISE", "SPD_CRUISE       0.25")
        proxy.do("param show FS_SOLVER_N", "FS_SOLVER_N      41")
        if profile == "ardusub":  # the home row of this format is ArduPilot's
            proxy.do("wp load plan.txt", "TYPE_MISSION: ACCEPTED")
            proxy.do("wp list", "37.9754856", "-0.450000", "-0.300000")
        proxy.do("fence load fence.txt", "TYPE_FENCE: ACCEPTED")
        proxy.do("fence list", "Requesting 4 fence items")
        proxy.do("rally load rally.txt", "TYPE_RALLY: ACCEPTED")
        proxy.do("rally list", "Requesting 1 rally items")
        proxy.do("ftp list", "@MAV_LOG", "general.json.xz")
        proxy.do("arm throttle", "COMPONENT_ARM_DISARM: ACCEPTED", "Armed")
        # Its own mode command fails for PX4's two numbers before anything is sent ("required argument is not a float").
        proxy.do("mode POSHOLD" if profile == "ardusub" else "long DO_SET_MODE 209 4 3", "DO_SET_MODE: ACCEPTED")
        proxy.do("disarm", "Disarmed")
        proxy.do("log list", "Log ", "numLogs 1")
