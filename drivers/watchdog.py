"""Watchdog process for an output without a hardware watchdog: stops the thrusters when the service fails.

The PCA9685 and the PWM of a computer repeat their last pulse for ever. The watchdog receives a heartbeat with every
command over a socket and acknowledges it (:mod:`autopilot.drivers.watchdog_process`): when the connection ends without
a shutdown message (the program was killed) or the heartbeats stop for the command timeout (it hangs), it opens the
output itself, which sets it to neutral. It ignores the signals that end the program, which sends the shutdown message
on a regular exit.
"""

import contextlib
import select
from collections.abc import Mapping
from typing import Any

import msgspec

from autopilot.core.errors import DriverError
from autopilot.core.toml_table import Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.registry import load_backend
from autopilot.drivers.thruster_output import SafeThrusterOutput
from autopilot.drivers.watchdog_process import FAREWELL, HELLO, WatchdogState, listen, receive

TRIES, PAUSE_S = 20, 0.05
"""Attempts to set neutral."""


class KeptOutput(SafeThrusterOutput):
    """Base class of an output that needs a watchdog process; see :class:`SafeThrusterOutput`."""

    driver: str
    """Its name in the registry."""

    def __init__(self, vehicle: Vehicle, options: Table, *, kept: bool, spare: Mapping[int, int] | None = None) -> None:
        """``options``: those with which the watchdog opens the output; ``kept`` False: none is used (the watchdog's
        own output, an emulated board). The watchdog sets the payload to its initial state.
        """
        super().__init__(vehicle, spare)
        self._kept = kept
        self._request = msgspec.json.encode([self.driver, vehicle, options]) + b"\n"
        self.watchdog: WatchdogState | None = None

    @property
    def watchdog_problem(self) -> str:
        """Problem of the watchdog process, "" while it replies or none is needed."""
        return "" if self.watchdog is None else self.watchdog.problem

    @property
    def watchdog_failed(self) -> bool:
        """Whether the problem is more than the first process still starting."""
        return self.watchdog is not None and self.watchdog.failed

    def open(self) -> None:
        """Set the device to neutral and start the watchdog."""
        super().open()
        if self._kept and self.watchdog is None:
            self.watchdog = WatchdogState(self._request)
            self.watchdog.start()

    def write(self, t_us: int, pwm_us: Any) -> None:
        super().write(t_us, pwm_us)
        if self.watchdog is not None:
            self.watchdog.beat(t_us)

    def check(self, t_us: int) -> bool:
        if self.watchdog is not None:
            self.watchdog.check(t_us)
        return super().check(t_us)

    def close(self) -> None:
        super().close()
        watchdog, self.watchdog = self.watchdog, None
        if watchdog is not None:
            watchdog.end(neutral=self._at_rest)


def main() -> None:
    """Supervise the output until the shutdown message."""
    line, request = listen()
    if not request:
        return  # nothing was commanded yet
    driver, vehicle, options = msgspec.json.decode(request, type=tuple[str, msgspec.Raw, msgspec.Raw])
    kind = load_backend("thrusters", driver)
    output = kind(
        msgspec.json.decode(vehicle, type=Vehicle), msgspec.json.decode(options, type=kind.Options), kept=False
    )
    timeout_s = min(thruster.drive.command_timeout_s for thruster in output.vehicle.thrusters)
    moving = False
    while True:
        ready, _, _ = select.select([line], [], [], timeout_s if moving else None)
        received = receive(line) if ready else b""
        if FAREWELL in received:
            return
        if received:
            moving = moving or any(number != HELLO for number in received)
            with contextlib.suppress(OSError):  # it is not reading now, or has ended, which the next read shows
                line.send(received[-1:])
            continue
        _stop(output)
        if ready:  # the line has ended
            return
        moving = False


def _stop(output: SafeThrusterOutput) -> None:
    """Neutral, however often it has to be tried."""
    for _ in range(TRIES):
        try:
            output.open()
            output.close()
            return
        except (DriverError, OSError):
            select.select([], [], [], PAUSE_S)
