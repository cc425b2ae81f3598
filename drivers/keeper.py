"""A process that stands by an output without a watchdog of its own, and stops the thrusters when nobody else does.

The PCA9685 and the PWM of a computer repeat their last pulse for ever. The keeper hears every command's beat over a
pipe: when the pipe ends without a farewell (the program was killed) or the beats stop for the command timeout (it
hangs), the keeper opens the same output by itself, which sets it to neutral. It ignores the signals that end the
program, which says farewell when it ends in order.
"""

import contextlib
import os
import select
import signal
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

import msgspec

from autopilot.core.errors import DriverError
from autopilot.core.toml_table import Table
from autopilot.core.vehicle import Vehicle
from drivers.registry import load_backend
from drivers.thruster_output import SafeThrusterOutput

BEAT, FAREWELL = b".", b"!"
TRIES, PAUSE_S = 20, 0.05
"""How often neutral is tried when it does not get through."""

_ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class KeptOutput(SafeThrusterOutput):
    """Template of an output that needs a keeper: as :class:`SafeThrusterOutput`."""

    driver: str
    """Its name in the registry."""

    def __init__(self, vehicle: Vehicle, options: Table, *, kept: bool, spare: Mapping[int, int] | None = None) -> None:
        """``options`` are those that the keeper opens it with; ``kept`` False: it has none (the keeper's own output,
        an emulated board). The keeper sets what is carried to where it was at the start."""
        super().__init__(vehicle, spare)
        self._kept = kept
        self._told = msgspec.json.encode([self.driver, vehicle, options]) + b"\n"
        self._keeper: subprocess.Popen[bytes] | None = None
        self.keepers = 0
        """How many have been started."""

    def open(self) -> None:
        """Set the device to neutral, and have somebody stand by."""
        super().open()
        self._stand_by()

    def write(self, t_us: int, pwm_us: Any) -> None:
        """Command one pulse per thruster [us]."""
        super().write(t_us, pwm_us)
        self._tell(BEAT)

    def close(self) -> None:
        """Neutral, and nobody stands by any more."""
        super().close()
        keeper, self._keeper = self._keeper, None
        if keeper is not None and keeper.stdin is not None:
            with contextlib.suppress(OSError):
                os.write(keeper.stdin.fileno(), FAREWELL)
            with contextlib.suppress(OSError):
                keeper.stdin.close()
            keeper.wait()

    def _stand_by(self) -> None:
        if not self._kept or self._keeper is not None:
            return
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDINGS)  # inherited: no moment in which they would end it
        try:
            self._keeper = subprocess.Popen(
                [sys.executable, "-m", "drivers.keeper"], stdin=subprocess.PIPE, start_new_session=True
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self.keepers += 1
        if self._keeper.stdin is not None:
            self._keeper.stdin.write(self._told)
            self._keeper.stdin.flush()
            os.set_blocking(self._keeper.stdin.fileno(), False)

    def _tell(self, what: bytes) -> None:
        if self._keeper is None or self._keeper.stdin is None:
            return
        try:
            os.write(self._keeper.stdin.fileno(), what)
        except BlockingIOError:
            return  # it has enough of them
        except OSError:  # somebody has killed it
            self._keeper.wait()
            self._keeper = None
            self._stand_by()


def main() -> None:
    """Stand by until the farewell."""
    for number in _ENDINGS:
        signal.signal(number, signal.SIG_IGN)
    pipe = sys.stdin.fileno()
    told = b""
    while not told.endswith(b"\n"):
        byte = os.read(pipe, 1)
        if not byte:
            return  # nothing was commanded yet
        told += byte
    driver, vehicle, options = msgspec.json.decode(told, type=tuple[str, msgspec.Raw, msgspec.Raw])
    kind = load_backend("thrusters", driver)
    output = kind(
        msgspec.json.decode(vehicle, type=Vehicle), msgspec.json.decode(options, type=kind.Options), kept=False
    )
    timeout_s = min(thruster.drive.command_timeout_s for thruster in output.vehicle.thrusters)
    moving = False
    while True:
        ready, _, _ = select.select([pipe], [], [], timeout_s if moving else None)
        heard = os.read(pipe, 4096) if ready else b""
        if FAREWELL in heard:
            return
        if heard:
            moving = True
            continue
        _stop(output)
        if ready:  # the pipe has ended
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


if __name__ == "__main__":
    main()
