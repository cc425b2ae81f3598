"""Child processes and their liveness.

A child runs the same code as its parent, whatever its working directory contains
(:mod:`autopilot.core.own_python`). Elapsed time is no criterion on a busy machine: a child is alive if it runs and
its CPU time increases.
"""

import os
import socket
import subprocess
import time
from collections.abc import Sequence
from typing import IO

import psutil

from autopilot.core.errors import AutopilotError
from autopilot.core.own_python import ROOT, python_command

__all__ = ("LOCAL", "ROOT", "Child", "autopilot_command", "free_port", "python_command")

_MAIN = "from autopilot.cli.main import main; main()"

STUCK_S = 120.0
"""Time without CPU use after which a child is stuck."""
LEAST_SHARE = 0.002
"""Of a core, over :data:`STUCK_S`: less only sleeps. Beside ten busy processes it gets thirty times that."""
LOOK_S = 0.5


LOCAL = "127.0.0.1"


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    """A free port of this machine for a child to listen on: UDP, or SOCK_STREAM for TCP."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind((LOCAL, 0))
        return int(probe.getsockname()[1])


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
