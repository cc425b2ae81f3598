"""Processes of our own that we start, and whether they get on.

A child runs the same code as its parent, whatever lies in the folder in which it is started: without ``-P`` Python
looks for modules there first, and a ``mission.py`` of the user's would be imported in place of ours. How long something
takes says nothing on a busy machine, so a child is judged by what it does: it lives, and its CPU time moves.
"""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO

import psutil

from autopilot.core.errors import AutopilotError

ROOT = Path(__file__).resolve().parents[2]
"""The folder that holds our packages: a checkout, or site-packages."""

_MAIN = "from autopilot.cli.main import main; main()"

STUCK_S = 120.0
"""A child that has hardly computed for so long is stuck."""
LEAST_SHARE = 0.002
"""Of a core, over :data:`STUCK_S`: less only sleeps. Beside ten busy processes it gets thirty times that."""
LOOK_S = 0.5


LOCAL = "127.0.0.1"


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    """A port of this machine that nobody uses now, for a child to listen on: UDP, or SOCK_STREAM for TCP."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind((LOCAL, 0))
        return int(probe.getsockname()[1])


def python_command(code: str) -> list[str]:
    """Command that runs ``code`` with our packages and nothing from the current folder."""
    root = str(ROOT)
    door = f"import os, sys; sys.path[:0] = [] if {root!r} in map(os.path.realpath, sys.path) else [{root!r}]\n"
    return [sys.executable, "-P", "-c", door + code]


def autopilot_command(*arguments: str) -> list[str]:
    """Command that runs ``autopilot ARGUMENTS`` with our code."""
    return [*python_command(_MAIN), *arguments]


class Child:
    """A child process and how it gets on."""

    def __init__(
        self, command: Sequence[str], environment: dict[str, str] | None = None, stderr: IO[str] | None = None
    ) -> None:
        self.process = subprocess.Popen(command, env={**os.environ, **(environment or {})}, stderr=stderr)
        self._mark = (time.monotonic(), 0.0)
        """When it was last seen to compute, and its CPU time then."""

    def cpu_s(self) -> float | None:
        """CPU time so far of all its threads, None when it has ended."""
        if self.process.poll() is not None:
            return None
        try:
            times = psutil.Process(self.process.pid).cpu_times()
        except psutil.Error:
            return None
        return float(times.user + times.system)

    def works(self) -> bool:
        """Whether it lives and computes."""
        cpu_s, now_s = self.cpu_s(), time.monotonic()
        if cpu_s is None:
            return False
        since_s, before_s = self._mark
        if cpu_s - before_s >= LEAST_SHARE * STUCK_S:
            self._mark = (now_s, cpu_s)
            return True
        return now_s - since_s < STUCK_S

    def at_work(self) -> bool:
        """Whether it computes; AutopilotError when it has ended."""
        code = self.process.poll()
        if code is not None:
            raise AutopilotError(f"the service ended with exit code {code}; its message is above")
        return self.works()

    def end(self) -> int:
        """SIGTERM, then as long as it needs to finish; one that is stuck is killed. Its exit code."""
        if self.process.poll() is None:
            self.process.terminate()
        while True:
            try:
                return self.process.wait(LOOK_S)
            except subprocess.TimeoutExpired:
                if not self.works():
                    self.process.kill()
                    return self.process.wait()
