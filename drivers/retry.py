"""Reconnection of devices: opened in the background, reopened after a failure, no exceptions to the caller.

Back ends report failures by DriverError or OSError and do not retry; here a failure is reported once, and the device
is closed and reopened with a growing pause. Opening and closing may take long and run on a thread of the device's own.
A connected device without data is also reported; the reaction to an old reading is left to the failsafes.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from concurrent.futures import wait as wait_for
from enum import Enum
from typing import Any, ClassVar, Generic, TypeVar

from autopilot.core import operator_messages as notices
from autopilot.core.daemon_executor import DaemonExecutor
from autopilot.core.errors import DriverError
from autopilot.core.messages import Severity
from autopilot.core.notice_queue import NoticeQueue
from autopilot.drivers.protocols import Device, FlightController, Noticing, Sensor, ThrusterOutput

FIRST_PAUSE_US = 500_000
LONGEST_PAUSE_US = 10_000_000
"""The pause before the next try doubles from the first to the longest."""

SILENT_US = 3_000_000
"""Timeout without data. The slowest devices (battery, leak) send every second."""

GIVE_UP_WRITES = 50
"""Writes that fail in a row before an output is opened anew (0.5 s): a single one may be noise on the wire."""

D = TypeVar("D", bound=Device)
T = TypeVar("T")


class DeviceState(Enum):
    DOWN = "down"
    SILENT = "silent"
    UP = "up"


class RetryingDevice(NoticeQueue, Generic[D]):
    """A device that is reopened after failures. ``name``: its name for operators."""

    opening_wait_s = 0.0
    """So long a tick waits for an opening. More than 0 only in lockstep, where ticks would outrun the thread."""
    speaks: ClassVar[bool] = False
    """It is back with its first data: a UDP port opens whether or not anybody is there."""

    def __init__(self, device: D, name: str) -> None:
        super().__init__()
        self.device = device
        self.name = name
        self.problem = "not opened yet"
        """Why it is not there, "" while it is."""
        self.opened_count = 0
        self._executor = DaemonExecutor(f"device {name}")
        self._opening: Future[None] | None = None
        self._up = False
        self._silent = False
        self._told_silent = False
        """Since it was last heard."""
        self._returns = False
        """Open again, and not reported yet."""
        self._last_received_us = 0
        self._retry_us = 0
        self._pause_us = FIRST_PAUSE_US
        self._reported = ""

    @property
    def state(self) -> DeviceState:
        if not self._up:
            return DeviceState.DOWN
        return DeviceState.SILENT if self._silent else DeviceState.UP

    def attend(self, t_us: int) -> bool:
        """Whether the device can be used now; starts a reconnection if needed."""
        if self._up:
            return True
        if self._opening is None and t_us >= self._retry_us:
            self._opening = self._executor.submit(self.device.open)
            if self.opening_wait_s == 0.0:
                return False
            wait_for((self._opening,), self.opening_wait_s)
        if self._opening is not None and self._opening.done():
            opening, self._opening = self._opening, None
            error = opening.exception()
            if error is None:
                self._begin(t_us)
                return True
            if not isinstance(error, DriverError | OSError):
                self._fail(t_us, f"internal fault ({type(error).__name__})")
                raise error
            self._fail(t_us, str(error))
        return False

    def use(self, t_us: int, work: Callable[[], T], otherwise: T) -> T:
        """Call the device if it is available; an exception closes it."""
        if not self.attend(t_us):
            return otherwise
        try:
            return work()
        except (DriverError, OSError) as error:
            self.lose(t_us, str(error))
            return otherwise
        except Exception as error:
            self.lose(t_us, f"internal fault ({type(error).__name__})")
            raise

    def note_received(self, t_us: int, something: object) -> None:
        """Record whether it has delivered data at ``t_us``."""
        if something:
            self._last_received_us = t_us
            if self._returns:
                self._tell_return()
            elif self._silent:
                self._notices.append(notices.DEVICE_HEARD(name=self.name))
            self._silent = self._told_silent = False
        elif self._up and not self._silent and t_us - self._last_received_us > SILENT_US:
            self._silent = True
            if not self._told_silent:
                self._told_silent = True
                self._notices.append(notices.DEVICE_SILENT(name=self.name))

    def lose(self, t_us: int, problem: str) -> None:
        """It is gone: close it, and try again after a pause."""
        self._up = False
        self._executor.submit(self.device.close)
        self._fail(t_us, problem)

    def close(self) -> None:
        self._up = False
        self._executor.shutdown(wait=False, cancel_futures=True)
        self.device.close()

    def _begin(self, t_us: int) -> None:
        self._up, self._silent, self._last_received_us = True, False, t_us
        self.opened_count += 1
        self.problem, self._pause_us = "", FIRST_PAUSE_US
        self._returns = bool(self._reported) or self.opened_count > 1
        if self._returns and not self.speaks:
            self._tell_return()

    def _tell_return(self) -> None:
        self._returns, self._reported = False, ""
        row = notices.DEVICE_RECONNECTED if self.opened_count > 1 else notices.DEVICE_CONNECTED
        self._notices.append(row(name=self.name))

    def _fail(self, t_us: int, problem: str) -> None:
        self.problem = problem
        self._retry_us = t_us + self._pause_us
        self._pause_us = min(2 * self._pause_us, LONGEST_PAUSE_US)
        if problem != self._reported:
            self._reported = problem
            self._notices.append(notices.DEVICE_DOWN(name=self.name, problem=problem))

    def _notify(self, severity: Severity, text: str) -> None:
        self._notices.append((severity, f"{self.name}: {text}"))


class SteadySensor(RetryingDevice[Sensor[Any]]):
    """A sensor that gives nothing while it is away."""

    speaks = True

    def __init__(self, device: Sensor[Any], name: str) -> None:
        super().__init__(device, name)
        self._noticing = device if isinstance(device, Noticing) else None

    def poll(self, t_us: int) -> list[Any]:
        nothing: list[Any] = []
        samples = self.use(t_us, lambda: self.device.poll(t_us), nothing)
        self.note_received(t_us, samples)
        if self._noticing is not None:
            for severity, text in self._noticing.take_notices():
                self._notify(severity, text)
        return samples


Out = TypeVar("Out", bound=ThrusterOutput)


class SteadyOutput(RetryingDevice[Out]):
    """Thruster output with reconnection. DriverError on every tick while commands do not reach it."""

    def __init__(self, device: Out, name: str) -> None:
        super().__init__(device, name)
        self._failed = 0

    def write(self, t_us: int, pwm_us: Sequence[int]) -> None:
        if not self.attend(t_us):
            if self.opened_count == 0 and not self._reported:  # the first opening is still under way
                return
            raise DriverError(f"{self.name} down: {self.problem}")
        try:
            self.device.write(t_us, pwm_us)
        except (DriverError, OSError) as error:
            self._failed += 1
            if self._failed >= GIVE_UP_WRITES:
                self._failed = 0
                self.lose(t_us, str(error))
            raise
        self._failed = 0

    def check(self, t_us: int) -> None:
        """Once per tick: stale commands stop the thrusters."""
        if self.attend(t_us):
            self.device.check(t_us)


class SteadyController(SteadyOutput[FlightController]):
    speaks = True

    def poll(self, t_us: int) -> list[Any]:
        nothing: list[Any] = []
        samples = self.use(t_us, lambda: self.device.poll(t_us), nothing)
        self.note_received(t_us, samples)
        return samples
