"""Notifications to systemd (sd_notify(3)): ready, alive, stopping.

Without ``NOTIFY_SOCKET`` in the environment nothing is sent. Failed notifications are ignored: the manager then
restarts the service. ``WATCHDOG=1`` is sent by the loop's thread only, so that a service whose loop hangs is
restarted although its other threads live.
"""

import os
import socket
import time
from collections.abc import Callable, Mapping

SOCKET = "NOTIFY_SOCKET"
WATCHDOG_US = "WATCHDOG_USEC"
WATCHDOG_PID = "WATCHDOG_PID"

PER_TIMEOUT = 3
"""Signs of life within the time after which the manager restarts (sd_watchdog_enabled(3) advises 2 at least)."""


class ServiceManager:
    """Notification socket of the service manager, if there is one."""

    def __init__(
        self, environment: Mapping[str, str] | None = None, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        """``now_s``: real time, for the watchdog counts that."""
        given = os.environ if environment is None else environment
        self._now_s = now_s
        self._socket: socket.socket | None = None
        self._beat_s = _beat_s(given)
        self._due_s = 0.0
        self._ready = False
        address = given.get(SOCKET, "")
        if not address.startswith(("/", "@")) or not hasattr(socket, "AF_UNIX"):
            return
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.connect("\0" + address[1:] if address.startswith("@") else address)
        except OSError:
            self.close()

    @property
    def present(self) -> bool:
        """Whether there is a service manager."""
        return self._socket is not None

    def tick(self, status: Callable[[], str] = str) -> None:
        """Once per tick of the loop: READY at the first, then WATCHDOG at the requested period. ``status`` gives
        the text for ``systemctl status``; it is called when something is sent.
        """
        if self._socket is None:
            return
        now_s = self._now_s()
        if self._ready and now_s < self._due_s:
            return
        self._due_s = now_s + self._beat_s
        lines = [] if self._ready else ["READY=1"]
        self._ready = True
        self._send("\n".join((*lines, "WATCHDOG=1", f"STATUS={status()}")))

    def stopping(self) -> None:
        """The service stops on request."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Idempotent."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text: str) -> None:
        if self._socket is None:
            return
        try:
            self._socket.send(text.encode())
        except BlockingIOError:
            return  # its queue is full: the next one counts as well
        except OSError:
            self.close()


def _beat_s(environment: Mapping[str, str]) -> float:
    """Time between signs of life [s]; a second (for the status line) where no watchdog is set for this process."""
    if environment.get(WATCHDOG_PID, str(os.getpid())) != str(os.getpid()):
        return 1.0
    try:
        timeout_s = int(environment.get(WATCHDOG_US, "0")) * 1e-6
    except ValueError:
        return 1.0
    return min(1.0, timeout_s / PER_TIMEOUT) if timeout_s > 0.0 else 1.0
