"""Pace of the loop: wall time at any speed, or lockstep."""

import time


class PacedClock:
    """Wall clock scaled by ``speed``."""

    def __init__(self, speed: float) -> None:
        self.speed = speed
        """Of this clock's time relative to real time; changed by :meth:`go_on`."""
        self._start_s = time.monotonic()
        self._start_us = 0

    def now_us(self) -> int:
        """Scaled microseconds since the clock was made."""
        return self._start_us + int((time.monotonic() - self._start_s) * 1e6 * self.speed)

    def go_on(self, t_us: int, speed: float) -> None:
        """Set the time to ``t_us`` and the speed (simulation only)."""
        self._start_us, self._start_s, self.speed = t_us, time.monotonic(), speed

    def wait_until(self, t_us: int) -> int:
        time.sleep(self.left_s(t_us))
        return self.now_us()

    def left_s(self, t_us: int) -> float:
        """Real seconds until ``t_us``."""
        return max(0.0, (t_us - self.now_us()) * 1e-6 / self.speed)


class LockstepClock:
    """Time is set by the loop: no waiting, never late."""

    def __init__(self) -> None:
        self._t_us = 0

    def now_us(self) -> int:
        return self._t_us

    def wait_until(self, t_us: int) -> int:
        self._t_us = t_us
        return t_us

    def left_s(self, t_us: int) -> float:
        return 0.0


def make_clock(speed: float) -> PacedClock | LockstepClock:
    """Speed 0 = as fast as possible."""
    return PacedClock(speed) if speed > 0.0 else LockstepClock()


class DayClock:
    """Watches the machine's clock of day against the one that only counts."""

    def __init__(self) -> None:
        self._ahead_s = self._now_s()

    def jump_s(self) -> float:
        """Step of the system clock since the last call [s]; corrections by NTP slewing are close to 0."""
        before_s, self._ahead_s = self._ahead_s, self._now_s()
        return self._ahead_s - before_s

    @staticmethod
    def _now_s() -> float:
        return time.time() - time.monotonic()
