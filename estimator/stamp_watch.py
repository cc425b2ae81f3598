"""By how much the stamps of pictures are late, from fixes and inertial sensors alone.

What gyro and accelerometer say of the motion does not know of stamps, and nothing of the filter is in it: no gate, no
reset and no bias that has already given way to wrong stamps. Over a window of two seconds the gyro's heading and the
accelerometer's way must fit the fixes, but for what these sensors cannot know (where and how fast it began, their
biases), and they fit best when the fixes are put where they belong. For each of a grid of delays what remains is
squared and summed; a window in which nothing changes (rest, steady motion) says the same of all of them, which is
nothing. Windows are added by their likelihoods. While stamps are good as far as is known nothing is touched.
"""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from estimator.inertial import FUTURE_TOLERANCE_US, Inertial
from estimator.measure_pose import PoseFix

GRID_S = np.arange(-0.10, 0.2501, 0.005)
"""Delays that are held against each other; in between by a parabola."""
WINDOW_US = 2_000_000
LEAST_US, LEAST_FIXES = 600_000, 12
"""A window of less says nothing."""
MARGIN_US = 260_000
"""So long before its first fix a window needs inertial samples."""
GAP_US = 150_000
"""Inertial sensors that are silent for longer begin a new window."""
LOOK_S = 0.5
"""How often all is added up, unless told otherwise;"""
LOOKS_SOON = 30
"""while fixes miss with each of them, so many at most before the next that does not."""
FORGET_S = 60.0
"""Older windows count for less."""
ALIKE = 4.0
"""Errors of fixes and of inertial sensors are alike over some moments: so many count as one."""
FLOOR_RAD, FLOOR_M = 4e-4, 3e-4
"""What a window fits to at best."""
FAR = 6.0
"""Times the median miss: such a fix is an outlier."""
SURE = 12.0
"""Difference of the logarithms of two likelihoods that is acted on: 4.9 sigma."""
SUSPECTED = 4.0
AHEAD_US, AHEAD_COUNT = 200_000, 10
"""Pictures in a row from a future that is nearer than this are stamped late. Others are garbage."""
AHEAD_SIGMA_S = 0.02
APART_S, APART_FIRST_S = 0.001, 0.003
"""Smaller changes are not worth it; nor is a first one."""


class StampWatch:
    """Of one estimator."""

    def __init__(self, every_s: float = LOOK_S) -> None:
        self._every_us = round(1e6 * every_s)
        self.late_s = 0.0
        """By which stamps are late as far as is known: what is to be taken off."""
        self.sigma_s = 0.0
        """Its standard deviation; 0 = nothing has been found."""
        self.suspects = False
        """Whether late stamps would explain by far better what fixes say."""
        self._imu: deque[tuple[int, float, float, float]] = deque()
        self._fixes: deque[tuple[int, float, float, float]] = deque()
        self._old, self._last = np.zeros(len(GRID_S)), np.zeros(len(GRID_S))
        self._last_us = self._looked_us = 0
        self._soon = 0
        self._ahead_us: list[int] = []

    def arrives(self, ahead_us: int, latency_s: float) -> bool:
        """A picture's result is there whose stamp, put right, is so far ahead of the clock. True if :attr:`late_s` has
        changed: what always comes from the future is late, most likely by what it needs to get here on top."""
        self._ahead_us = [*self._ahead_us, ahead_us] if FUTURE_TOLERANCE_US < ahead_us < AHEAD_US else []
        if len(self._ahead_us) < AHEAD_COUNT:
            return False
        self.late_s += 1e-6 * max(self._ahead_us) + latency_s
        self.sigma_s, self._ahead_us = AHEAD_SIGMA_S, []
        return True

    def feel(self, inertial: Inertial) -> None:
        """One inertial sample."""
        if not inertial.real or (self._imu and inertial.t_us - self._imu[-1][0] > GAP_US):
            self._imu.clear()
            self._fixes.clear()
        if inertial.real:
            forward, right, _ = inertial.accel_level_m_s2
            self._imu.append((inertial.t_us, inertial.yaw_rate_rad_s, forward, right))
            if self._imu[0][0] < inertial.t_us - WINDOW_US - 2 * MARGIN_US:
                self._imu.popleft()

    def see(self, fix: PoseFix, *, missed: bool) -> None:
        """One fix, its stamp put right by :attr:`late_s`; ``missed``: it is not where the filter expects it."""
        stamp_us = fix.t_us + round(1e6 * self.late_s)
        self._soon = self._soon + 1 if missed else 0
        if self._fixes and stamp_us <= self._fixes[-1][0]:
            return  # mixed up
        north, east, _, yaw = fix.z.tolist()
        self._fixes.append((stamp_us, north, east, yaw))
        while self._fixes[0][0] < stamp_us - WINDOW_US:
            self._fixes.popleft()

    def look(self) -> bool:
        """Add all up when it is due. True if :attr:`late_s` has changed."""
        if not self._fixes or not self._imu:
            return False
        now_us = self._fixes[-1][0]
        if now_us - self._looked_us < (1 if 0 < self._soon <= LOOKS_SOON else self._every_us):
            return False
        self._looked_us = now_us
        window = self._window()
        if window is None:
            return False
        fresh = min(1.0, 1e-6 * (now_us - self._last_us) / (1e-6 * WINDOW_US))
        cost = self._old + (1.0 - fresh) * self._last + window
        if fresh == 1.0:
            keep = math.exp(-1e-6 * (now_us - self._last_us) / FORGET_S) if self._last_us else 0.0
            self._old = keep * (self._old + self._last)
            self._last, self._last_us = window, now_us
        return self._judge(cost)

    def _judge(self, cost: FloatArray) -> bool:
        k = int(cost.argmin())
        against = float(np.interp(self.late_s, GRID_S, cost)) - cost.item(k)
        if not 0 < k < len(GRID_S) - 1:
            self.suspects = against > SUSPECTED
            return False
        step = float(GRID_S[1] - GRID_S[0])
        before, least, after = cost[k - 1 : k + 2].tolist()
        bend = before - 2.0 * least + after
        late_s = float(GRID_S[k]) + (0.5 * step * (before - after) / bend if bend > 0.0 else 0.0)
        apart = abs(late_s - self.late_s)
        if bend <= 0.0:
            return False
        sigma_s = step / math.sqrt(bend)
        if self.sigma_s:  # found before: nothing but better
            self.suspects = against > SUSPECTED and apart > APART_FIRST_S
            if sigma_s < self.sigma_s:
                self.sigma_s = sigma_s
            if apart < max(APART_S, sigma_s):
                return False
        else:
            self.suspects = against > SUSPECTED and apart > APART_FIRST_S
            if apart < APART_FIRST_S or against < SURE:
                return False
        self.late_s, self.sigma_s, self.suspects = late_s, sigma_s, False
        return True

    def _window(self) -> FloatArray | None:
        """(g,) what speaks against each delay, from the fixes at hand; None if they are too few."""
        imu = np.array(self._imu)
        begin_us = imu[0, 0]
        fixes = np.array([fix for fix in self._fixes if fix[0] - MARGIN_US >= begin_us])
        if len(fixes) < LEAST_FIXES or fixes[-1, 0] - fixes[0, 0] < LEAST_US:
            return None
        imu = np.vstack((imu, imu[-1]))
        imu[-1, 0] += MARGIN_US  # stamps that are too early lie ahead: held
        imu[:, 0] -= begin_us
        fixes[:, 0] -= begin_us
        t_s, rate = 1e-6 * imu[:, 0], imu[:, 1]
        at_s = 1e-6 * fixes[:, 0]
        dt_s = np.diff(t_s)
        turned = _summed(rate, dt_s)
        true_s = at_s[:, None] - GRID_S
        yaw = np.unwrap(fixes[:, 3])
        known_s = at_s - self.late_s
        one, since = np.ones(len(at_s)), at_s - at_s.mean()
        heading = _Fit(np.column_stack((one, since)), yaw[:, None] - np.interp(true_s, t_s, turned))
        psi = turned + float(np.median(yaw - np.interp(known_s, t_s, turned)))
        c, s = np.cos(psi), np.sin(psi)
        way_n = _summed(_summed(c * imu[:, 2] - s * imu[:, 3], dt_s), dt_s)
        way_e = _summed(_summed(s * imu[:, 2] + c * imu[:, 3], dt_s), dt_s)
        by_c, by_s = (np.interp(known_s, t_s, _summed(_summed(part, dt_s), dt_s)) for part in (c, s))
        none = np.zeros(len(at_s))
        north = np.column_stack((one, none, since, none, by_c, -by_s))
        east = np.column_stack((none, one, none, since, by_s, by_c))
        off = np.concatenate(
            (fixes[:, 1, None] - np.interp(true_s, t_s, way_n), fixes[:, 2, None] - np.interp(true_s, t_s, way_e))
        )
        place = _Fit(np.concatenate((north, east)), off)
        good = heading.near() & np.logical_and(*np.split(place.near(), 2))
        if not good.all():
            if good.sum() < LEAST_FIXES:
                return None
            heading, place = heading.only(good), place.only(np.tile(good, 2))
        result: FloatArray = heading.cost(FLOOR_RAD) + place.cost(FLOOR_M)
        return result if np.isfinite(result).all() else None


class _Fit:
    """Least squares of (n, g) columns by the same (n, p)."""

    def __init__(self, by: FloatArray, what: FloatArray) -> None:
        self._by, self._what = by, what
        q, _ = np.linalg.qr(by)
        self._rest = what - q @ (q.T @ what)
        self._squares = np.square(self._rest).sum(axis=0)

    def near(self) -> NDArray[np.bool_]:
        """(n,) which are no outliers."""
        rest = np.abs(self._rest[:, self._squares.argmin()])
        result: NDArray[np.bool_] = rest <= FAR * max(float(np.median(rest)), 1e-5)
        return result

    def only(self, good: NDArray[np.bool_]) -> "_Fit":
        """Of some rows."""
        return _Fit(self._by[good], self._what[good])

    def cost(self, floor: float) -> FloatArray:
        """(g,) negative logarithm of the likelihood, its least taken off; how large the errors are is not known."""
        n, p = self._by.shape
        squares = self._squares + n * floor * floor
        result: FloatArray = 0.5 / ALIKE * (n - p) * np.log(squares / squares.min())
        return result


def _summed(values: FloatArray, dt_s: FloatArray) -> FloatArray:
    """Integral by the trapezoidal rule, from 0."""
    return np.concatenate(([0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * dt_s)))
