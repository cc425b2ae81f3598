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
from collections.abc import Callable, Sequence

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
        self,
        t_us: int,
        dt_s: float,
        residual: Sequence[float],
        model_variance: Callable[[], Sequence[float]],
        *,
        anchored: bool,
        denied: bool,
        rejected: int,
    ) -> bool:
        """True when it becomes suspect now. ``residual`` (3,): reading, offset taken off, minus the model's.

        ``model_variance`` (3,): of the model's, by what is not known of current and velocity.

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
        pairs = list(zip(self._smooth, self._usual, INERTIAL_MONITOR.residual_limit_m_s2, strict=True))
        over = any(abs(smooth - usual) > limit for smooth, usual, limit in pairs)
        if over and not absurd:
            sigmas2 = INERTIAL_MONITOR.explained_sigmas**2
            over = any(
                (smooth - usual) ** 2 > limit**2 + sigmas2 * variance
                for (smooth, usual, limit), variance in zip(pairs, model_variance(), strict=True)
            )
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
        self._gap_s = self._gap = self._pulled = self._worst = 0.0
        """Length of the gap in the fixes; compass minus gyro within it [rad], the part of it that the estimate has
        followed, and the most of it beyond what is usual, squared."""
        self._denied = False

    @property
    def apart_rad(self) -> float:
        """Recent difference of gyro and compass [rad]."""
        return max(abs(self._apart), abs(self._slow))

    @property
    def quick_rad(self) -> float:
        """Difference within a third of a second, compass minus gyro [rad]."""
        return self._quick

    def coast(self, dt_s: float, pulled_rad: float) -> float:
        """Growth of the heading's variance [rad^2] by the last sample, in a gap; ``pulled_rad``: by which the estimate
        has been turned since."""
        self._gap_s += dt_s
        self._pulled += pulled_rad
        over = max(0.0, abs(self._gap) - INERTIAL_MONITOR.coast_free_rad) ** 2
        grown, self._worst = max(0.0, over - self._worst), max(over, self._worst)
        return INERTIAL_MONITOR.coast_share**2 * grown

    @property
    def heading_variance(self) -> float:
        """Of the heading beyond the filter's [rad^2]: gyro and compass have come apart, and it follows the gyro."""
        return (INERTIAL_MONITOR.coast_share * (self._gap - self._pulled)) ** 2 if self._gap_s and self.trusted else 0.0

    def anchor(self) -> None:
        """No gap, or its end."""
        self._gap_s = self._pulled = self._worst = 0.0

    def see_fix(self, miss_rad: float) -> None:
        """A fix whose heading misses the estimate by that: does it deny how the gyro has turned in the gap before?"""
        miss = miss_rad + self._pulled
        limit = INERTIAL_MONITOR.coast_denied_rad + INERTIAL_MONITOR.coast_denied_rad_s * self._gap_s
        alike = miss * self._gap > 0.0 and abs(self._gap) > 0.5 * abs(miss)
        self._denied = self._denied or (self._gap_s > 0.0 and alike and abs(miss) > limit)

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
        self._gap = self._gap + apart if self._gap_s else self._quick
        denied, self._denied = self._denied, False
        if not self.trusted:
            return False
        if anchored or denied:
            wrong = denied or (heading_denied and abs(self._quick) > QUICK_TURN_LIMIT_RAD)
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
