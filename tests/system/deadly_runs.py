"""Runs that kill their process, in a module that a process of a pool has loaded at once."""

import os
import signal
import threading
from typing import Any


class Deadly:
    """A run that kills its process every time, or does no harm."""

    def __init__(self, number: int, deadly: bool) -> None:
        self.number, self.deadly = number, deadly

    def fly(self, stop: Any) -> str:
        if self.deadly:
            os.kill(os.getpid(), signal.SIGKILL)
        return f"run {self.number}"

    def failed(self, error: str) -> str:
        return f"run {self.number} failed: {error}"


class Spinning(Deadly):
    """A run whose process is killed at any moment while it asks whether to stop, as all do all the time."""

    def fly(self, stop: Any) -> str:
        if self.deadly:
            threading.Timer(0.02, os.kill, (os.getpid(), signal.SIGKILL)).start()
            while True:
                stop()
        return f"run {self.number}"
