"""Fault detection of accelerometer and gyro against thrust model, compass and fixes.

Vehicle model and accelerometer agree within 0.1 m/s^2, thruster losses, tether and jets included; gyro and AHRS
heading within two degrees per second. A broken, hit or saturated sensor differs by far more. Fixes decide which of the
two is wrong: while they pass the gate, the sensor is right, whatever the model gives (a held hull, a lost thruster).
Without fixes the unbounded one is rejected: the position error of an accelerometer fault grows with the square of
time, that of the model does not.

A rejected sensor is still monitored. It is used again, with its new offset, after a period of constant difference to
its reference with fixes available.
"""

import math
from collections.abc import Sequence

from autopilot.core.frames import wrap_pi
from autopilot.estimator.estimator_tuning import INERTIAL_MONITOR
from autopilot.estimator.monitor import MonitorFinding

TURN_LIMIT_RAD = math.radians(4.5)
"""Gyro against compass, forgotten within the time: healthy flights in a steel tank show two degrees."""
SLOW_TURN_LIMIT_RAD = math.radians(4.0)
"""The same over longer, when the compass is rejected as well."""
QUICK_TURN_LIMIT_RAD = math.radians(0.5)


class _InertialMonitor(MonitorFinding):
    """A sensor that is used again when its difference to the reference has been constant for a while."""

    def __init__(self, size: int, limit: float) -> None:
        """``limit``: of the scatter of its ``size`` values that counts as steady."""
        super().__init__()
        self._limit = limit
        self._mean = [0.0] * size
        self._scatter = [limit * 10.0] * size
        self._steady_s = 0.0

    def _cease(self, t_us: int, first: Sequence[float]) -> None:
        """It is suspect from now on; its first offset is ``first``."""
        self.suspect(t_us)
        self._mean = list(first)
        self._scatter = [self._limit * 10.0] * len(self._mean)
        self._steady_s = 0.0

    def steady_offset(self, dt_s: float, unexplained: Sequence[float], *, anchored: bool) -> list[float] | None:
        """The offset with which it can be used again, once known. ``unexplained``: reading minus reference."""
        gain = min(1.0, dt_s / INERTIAL_MONITOR.steady_time_s)
        for i, value in enumerate(unexplained):
            self._mean[i] += gain * (value - self._mean[i])
            self._scatter[i] += gain * (abs(value - self._mean[i]) - self._scatter[i])
        steady = anchored and max(self._scatter) < self._limit
        self._steady_s = self._steady_s + dt_s if steady else 0.0
        return list(self._mean) if self._steady_s >= INERTIAL_MONITOR.steady_s else None


class AccelMonitor(_InertialMonitor):
    """Accelerometer against vehicle model."""

    def __init__(self) -> None:
        super().__init__(3, INERTIAL_MONITOR.steady_m_s2)
        self._smooth = [0.0, 0.0, 0.0]
        self._usual = [0.0, 0.0, 0.0]

    def check(
        self, t_us: int, dt_s: float, residual: Sequence[float], *, anchored: bool, denied: bool, rejected: int
    ) -> bool:
        """True when it becomes suspect now. ``residual`` (3,): reading, offset taken off, minus the model's.

        ``anchored``: fixes or velocities over ground are being used; ``denied``: they are being rejected.
        """
        gain, slow = min(1.0, dt_s / INERTIAL_MONITOR.residual_time_s), min(1.0, dt_s / INERTIAL_MONITOR.usual_time_s)
        (x, y, z), (now_x, now_y, now_z) = self._smooth, residual
        x, y, z = x + gain * (now_x - x), y + gain * (now_y - y), z + gain * (now_z - z)
        self._smooth = [x, y, z]
        if not self.trusted:
            return False
        absurd = max(abs(x), abs(y), abs(z)) > INERTIAL_MONITOR.absurd_m_s2
        if anchored and not denied and not absurd:
            u, v, w = self._usual
            self._usual = [u + slow * (x - u), v + slow * (y - v), w + slow * (z - w)]
            return False
        pairs = zip(self._smooth, self._usual, INERTIAL_MONITOR.residual_limit_m_s2, strict=True)
        over = any(abs(smooth - usual) > limit for smooth, usual, limit in pairs)
        if not (absurd or over or (rejected >= INERTIAL_MONITOR.rejections and not anchored)):
            return False
        self._cease(t_us, residual)
        return True

    def reinstate(self) -> None:
        self.since_us = None
        self._smooth, self._usual = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]


class GyroMonitor(_InertialMonitor):
    """Gyro against the AHRS's heading."""

    def __init__(self) -> None:
        super().__init__(1, INERTIAL_MONITOR.steady_rad_s)
        self.jumps = 0
        self._quick = self._apart = self._slow = 0.0

    @property
    def apart_rad(self) -> float:
        """Recent difference of gyro and compass [rad]."""
        return max(abs(self._apart), abs(self._slow))

    @property
    def quick_rad(self) -> float:
        """Difference within a third of a second, compass minus gyro [rad]."""
        return self._quick

    def jumped_rad(self, dt_s: float, turn_rad: float, rate_rad_s: float) -> float:
        """Jump of the compass in one sample [rad]: ``turn_rad`` by the compass, ``rate_rad_s`` by the gyro."""
        jump = wrap_pi(turn_rad - rate_rad_s * dt_s)
        if abs(jump) > INERTIAL_MONITOR.jump_rad:
            self.jumps += 1
            return jump
        return 0.0

    def check(
        self,
        t_us: int,
        dt_s: float,
        turn_rad: float,
        rate_rad_s: float,
        *,
        anchored: bool,
        heading_denied: bool,
        compass_rejected: int,
    ) -> bool:
        """True when it becomes suspect now. Rates without the gyro's estimated bias.

        ``heading_denied``: fixes are being rejected for their heading.
        """
        apart = wrap_pi(turn_rad - rate_rad_s * dt_s)
        self._quick += apart - min(1.0, dt_s / INERTIAL_MONITOR.quick_turn_time_s) * self._quick
        self._apart += apart - min(1.0, dt_s / INERTIAL_MONITOR.turn_time_s) * self._apart
        self._slow += apart - min(1.0, dt_s / INERTIAL_MONITOR.slow_turn_time_s) * self._slow
        if not self.trusted:
            return False
        if anchored:
            wrong = heading_denied and abs(self._quick) > QUICK_TURN_LIMIT_RAD
        else:
            wrong = abs(self._apart) > TURN_LIMIT_RAD
            wrong = wrong or (compass_rejected >= 2 and abs(self._slow) > SLOW_TURN_LIMIT_RAD)
        if not wrong:
            return False
        self._cease(t_us, (rate_rad_s,))
        return True

    def reinstate(self) -> None:
        self.since_us = None
        self._quick = self._apart = self._slow = 0.0
