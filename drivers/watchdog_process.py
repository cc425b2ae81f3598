"""The service's side of the watchdog process: started, supervised, replaced when it ends or hangs.

Every command's heartbeat carries a number, which the watchdog returns. A missing reply shows that it hangs (stopped,
out of processor time or memory), a closed connection that it has ended. In either case another one is started, in the
background and with a growing pause. Until a watchdog has replied, and while none does, there is a ``problem``.
"""

import contextlib
import os
import signal
import socket
import subprocess
from concurrent.futures import Future

from autopilot.core.daemon_executor import DaemonExecutor
from autopilot.core.own_python import python_command

FAREWELL = 255
HELLO = 0
"""First request to a new watchdog, before any command: it replies, and expects no further heartbeat."""
LAST_NUMBER = 250
"""Beats are numbered 1 to this, one byte each, and around again."""

CODE = "from autopilot.drivers.watchdog import main; main()"

HANG_US = 1_000_000
"""Timeout of the reply to a heartbeat: the watchdog hangs. It replies within a millisecond on an idle machine."""
START_US = 30_000_000
"""Timeout of the first reply of a new watchdog: loading Python takes a second of processor time."""
REPLACE_US = 2_500_000
"""One that has hung for so long is replaced: the new one can answer before the failsafe begins."""
FIRST_PAUSE_US = 500_000
LONGEST_PAUSE_US = 10_000_000
"""The first new one comes at once, the pause before each further one doubles from the first to the longest."""
SETTLED_US = 10_000_000
"""After so long without trouble the pauses begin anew."""
END_S = 5.0
"""Timeout (real time) after which a dismissed watchdog is killed: only a stopped process takes that long."""

_ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_Running = tuple["subprocess.Popen[bytes]", socket.socket]


class WatchdogState:
    """Not thread-safe. Times are the service's [us]."""

    def __init__(self, request: bytes) -> None:
        """``request``: the line that it begins with, the output's driver, vehicle and options."""
        self._request = request
        self._executor = DaemonExecutor("keeper")
        self._coming: Future[_Running] | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._line: socket.socket | None = None
        self._number = HELLO
        self._last_request_us: int | None = None
        """When the number that is on its way was first sent."""
        self._answered = False
        """This one has answered."""
        self._pause_us = 0
        self._retry_us: int | None = None
        self._well_us: int | None = None
        """Since when it has answered without trouble."""
        self.problem = "is starting"
        """Problem of the watchdog, "" while it replies."""
        self.failed = False
        """The problem is more than that the first one is starting."""
        self.starts = 0

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    def start(self) -> None:
        """Begin to start one, if there is none. Does not wait for it."""
        if self._line is not None or self._coming is not None:
            return
        self.starts += 1
        try:
            self._coming = self._executor.submit(_start, self._request)
        except RuntimeError as error:  # no thread available; the queue keeps the job
            self._executor, self._coming = DaemonExecutor("keeper"), Future()
            self._coming.set_exception(OSError(str(error)))

    def beat(self, t_us: int) -> None:
        if self._line is None:
            return
        if self._last_request_us is None or self._number == HELLO:
            self._number = self._number % LAST_NUMBER + 1
            self._last_request_us = t_us
        self._send(t_us)

    def _send(self, t_us: int) -> None:
        line = self._line
        try:
            if line is not None:
                line.send(bytes([self._number]))
        except BlockingIOError:
            return  # it has enough of them
        except OSError:
            self._lose(t_us, "has ended")

    def check(self, t_us: int) -> None:
        """Once per tick: read replies, check the process, start another one when due."""
        if self._coming is not None and self._coming.done():
            self._take(t_us, self._coming)
        if self._line is None:
            if self._coming is None and self._retry_us is not None and t_us >= self._retry_us:
                self.start()
            return
        try:
            received = self._line.recv(4096)
        except BlockingIOError:
            self._wait_for_it(t_us)
            return
        except OSError:
            received = b""
        if not received:
            self._lose(t_us, "has ended")
        elif received[-1] == self._number:
            self._note_answer(t_us)

    def end(self, *, neutral: bool) -> None:
        """Shut the watchdog down. ``neutral``: the thrusters are stopped; otherwise it sets neutral once more."""
        if self._coming is not None:
            with contextlib.suppress(OSError):
                self._process, self._line = self._coming.result()
        self._coming = None
        if self._line is not None and neutral:
            with contextlib.suppress(OSError):
                self._line.send(bytes([FAREWELL]))
        self._let_go()
        self._reap(END_S)
        self._executor.shutdown(wait=False)

    def _take(self, t_us: int, coming: "Future[_Running]") -> None:
        self._coming = None
        try:
            self._process, self._line = coming.result()
        except OSError as error:
            self._lose(t_us, f"cannot be started ({error.strerror or error})")
            return
        self._answered, self._last_request_us, self._well_us = False, t_us, None
        self._number = HELLO
        self._send(t_us)

    def _note_answer(self, t_us: int) -> None:
        self._last_request_us, self._answered = None, True
        self.problem, self.failed = "", False
        if self._well_us is None:
            self._well_us = t_us
        elif t_us - self._well_us >= SETTLED_US:
            self._pause_us = 0

    def _wait_for_it(self, t_us: int) -> None:
        late_us = 0 if self._last_request_us is None else t_us - self._last_request_us
        if late_us <= (HANG_US if self._answered else START_US):
            return
        self.problem, self.failed, self._well_us = "hangs", True, None
        if late_us > REPLACE_US:
            self._lose(t_us, "hangs")

    def _lose(self, t_us: int, problem: str) -> None:
        self.problem, self.failed, self._well_us = problem, True, None
        self._let_go()
        if self._process is not None:
            self._process.kill()  # one that is stopped ends too
        self._reap(0.0)
        self._retry_us = t_us + self._pause_us
        self._pause_us = min(max(2 * self._pause_us, FIRST_PAUSE_US), LONGEST_PAUSE_US)

    def _let_go(self) -> None:
        line, self._line = self._line, None
        if line is not None:
            line.close()

    def _reap(self, patience_s: float) -> None:
        """Wait for its end, on a thread unless it is due at once."""
        process, self._process = self._process, None
        if process is None:
            return
        if patience_s == 0.0:
            self._executor.submit(process.wait)
            return
        try:
            process.wait(patience_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _start(request: bytes) -> _Running:
    """A new process and the line to it. OSError if there is none to be had."""
    ours, its = socket.socketpair()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDINGS)  # inherited: no moment in which they would end it
    try:
        process = subprocess.Popen(
            python_command(CODE), stdin=its.fileno(), stdout=subprocess.DEVNULL, start_new_session=True
        )
    except BaseException:
        ours.close()
        raise
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        its.close()
    with contextlib.suppress(OSError):  # it has ended: detected by the next look()
        ours.sendall(request)
    ours.setblocking(False)
    return process, ours


def listen() -> tuple[socket.socket, bytes]:
    """In the watchdog: the socket to the service, and the request; b"" if the service has gone."""
    for number in _ENDINGS:
        signal.signal(number, signal.SIG_IGN)
    line = socket.socket(fileno=os.dup(0))
    request = b""
    while not request.endswith(b"\n"):
        byte = receive(line, 1)
        if not byte:
            return line, b""
        request += byte
    return line, request


def receive(line: socket.socket, size: int = 4096) -> bytes:
    """In the watchdog: data from the service, b"" when it has ended, with or without having read all replies."""
    try:
        return line.recv(size)
    except OSError:
        return b""
