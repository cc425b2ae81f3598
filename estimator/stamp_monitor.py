"""Latency of the image stamps from fixes and inertial sensors alone.

Gyro and accelerometer do not depend on the stamps, and the filter is not involved: no gate, no reset, no bias that has
adapted to wrong stamps. Over a window of two seconds the integrated gyro and accelerometer must fit the fixes up to
the unknowns of these sensors (initial position and velocity, biases), and they fit best when the fixes are shifted to
their true times. For a grid of delays the residuals are squared and summed; a window without dynamics (rest, steady
motion) gives the same sum for all of them, which is noise. Its information is measured by the fixes: noise of inertial
sensors explains none of their motion, real motion nearly all of it. Windows are weighted by the explained fraction,
and their log-likelihoods are added. The last two windows alone are enough to discard the earlier ones, as stamps may
jump. While stamps are correct within the uncertainty nothing is changed.

Delayed stamps fit as well as others after the correction. A sensor whose offset starts within the window fits no
delay: a window with residuals larger than expected from the fixes' noise is not used, nor one whose heading is
explained far better by an offset or scale error of the gyro that starts within it than by any delay. Position alone is
not used when only the accelerometer is wrong; the gyro enters both. The first few fixes after such an offset may fit
some delay by chance, but not the same as those after them: a delay has to persist.
"""

import math
from collections import deque
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from autopilot.estimator.estimator_tuning import STAMP_MONITOR
from autopilot.estimator.inertial import FUTURE_TOLERANCE_US, Inertial
from autopilot.estimator.measure_pose import PoseFix

GRID_S = np.arange(-0.25, 0.2501, 0.005)
"""Delays that are held against each other; in between by a parabola."""


class StampMonitor:
    def __init__(self, every_s: float = STAMP_MONITOR.evaluate_s) -> None:
        self._every_us = round(1e6 * every_s)
        self.late_s = 0.0
        """By which stamps are late as far as is known: what is to be taken off."""
        self.sigma_s = 0.0
        """Its standard deviation; 0 = nothing has been found."""
        self.inertial_late_s = 0.0
        """By which stamps of the inertial sensors are late: fixes would come from the future otherwise."""
        self._imu: deque[tuple[int, float, float, float]] = deque()
        self._fixes: deque[tuple[int, float, float, float, float, float]] = deque()
        self._usual_heading, self._usual_place = _Usual(), _Usual()
        self._old, self._last = np.zeros(len(GRID_S)), np.zeros(len(GRID_S))
        self._last_us = self._checked_us = 0
        self._found_s, self._found_us = math.inf, 0
        self._soon = 0
        self.jumped_s = 0.0
        """By how much stamps have moved that were known before, 0 = they have not."""
        self._ahead_us: list[int] = []
        self._explains = False
        self._ages = Ages()
        self._moved_s, self._moved_known = 0.0, False
        self._arrived_us = self._moved_us = 0
        self._missed_us = -STAMP_MONITOR.missed_us - 1

    @property
    def suspects(self) -> bool:
        """Whether a latency explains the fixes, or the ages of images at arrival, far better."""
        moved = self._moved_s != 0.0 and self._arrived_us - self._moved_us < STAMP_MONITOR.suspect_us
        return self._explains or moved or self._ages.off_s != 0.0

    @property
    def unsure_s(self) -> float:
        """Possible undetected change of the stamps [s]: the age of images has changed by this, with residuals of fixes
        since. Images that only arrive later have no such residuals.
        """
        return abs(self._moved_s) if self._missed_us >= self._moved_us - STAMP_MONITOR.missed_us else 0.0

    def arrives(self, now_us: int, ahead_us: int, latency_s: float) -> bool:
        """An image's result has arrived with a corrected stamp that far ahead of the clock. True if :attr:`late_s` has
        changed: stamps that are always in the future are over-corrected, by the transport time on top.
        """
        self._arrived_us = now_us
        moved_us = self._ages.note(-ahead_us)
        if moved_us:
            self._moved_s, self._moved_us = self._moved_s + 1e-6 * moved_us, now_us
            self._moved_known |= self._known()
            self._forget()
            self._fixes.clear()
        self._ahead_us = [*self._ahead_us, ahead_us] if FUTURE_TOLERANCE_US < ahead_us < STAMP_MONITOR.ahead_us else []
        if len(self._ahead_us) < STAMP_MONITOR.ahead_count:
            return False
        more_s = self._moved_s if self._moved_s > 0.0 else 1e-6 * max(self._ahead_us) + latency_s
        if self._moved_known or self._known():
            self.jumped_s += more_s
        self._moved_s, self._moved_known = 0.0, False
        self.late_s += more_s
        self.sigma_s, self._ahead_us = STAMP_MONITOR.ahead_sigma_s, []
        self._ages.put_right(more_s)
        self._forget()
        self._fixes.clear()
        return True

    def feel(self, inertial: Inertial) -> None:
        if not inertial.real or (self._imu and inertial.t_us - self._imu[-1][0] > STAMP_MONITOR.gap_us):
            self._imu.clear()
            self._fixes.clear()
        if inertial.real:
            forward, right, _ = inertial.accel_level_m_s2
            self._imu.append((inertial.t_us, inertial.yaw_rate_rad_s, forward, right))
            if self._imu[0][0] < inertial.t_us - STAMP_MONITOR.window_us - 2 * STAMP_MONITOR.margin_us:
                self._imu.popleft()

    def see(self, fix: PoseFix, *, missed: bool) -> None:
        """One fix, its stamp put right by :attr:`late_s`; ``missed``: it is not where the filter expects it."""
        stamp_us = fix.t_us + round(1e6 * self.late_s)
        self._soon = self._soon + 1 if missed else 0
        if missed:
            self._missed_us = self._arrived_us
        if self._fixes and stamp_us <= self._fixes[-1][0]:
            return  # mixed up
        north, east, _, yaw = fix.z.tolist()
        variance = fix.noise.diagonal()
        self._fixes.append((stamp_us, north, east, yaw, variance.item(3), 0.5 * (variance.item(0) + variance.item(1))))
        while self._fixes[0][0] < stamp_us - STAMP_MONITOR.window_us:
            self._fixes.popleft()

    def evaluate(self) -> bool:
        """Add all up when it is due. True if :attr:`late_s` has changed."""
        if not self._fixes or not self._imu:
            return False
        now_us = self._fixes[-1][0]
        if now_us - self._checked_us < (1 if 0 < self._soon <= STAMP_MONITOR.checks_soon else self._every_us):
            return False
        if now_us - self._checked_us > 2 * self._every_us:
            self._found_s = math.inf
        self._checked_us = now_us
        window = self._window()
        if window is None:
            return False
        fresh = min(1.0, 1e-6 * (now_us - self._last_us) / (1e-6 * STAMP_MONITOR.window_us))
        recent = (1.0 - fresh) * self._last + window
        moved = _against(recent, self.late_s) > STAMP_MONITOR.sure and self._known()
        cost = recent if moved else self._old + recent
        before_s, earlier = self.late_s, self._old
        settled = self._usual_heading.count >= STAMP_MONITOR.settled_count
        sudden = settled and _against(window, self.late_s) > STAMP_MONITOR.sure
        changed = self._judge(cost)
        if changed and self._inertial_are_off(before_s):
            self._correct_inertial()
            return True
        if fresh == 1.0 and (changed or not sudden):  # evidence that may be of the newest fixes alone is not kept
            keep = math.exp(-1e-6 * (now_us - self._last_us) / STAMP_MONITOR.forget_s) if self._last_us else 0.0
            self._old = keep * (self._old + self._last)
            self._last, self._last_us = window, now_us
            self._usual_heading.learn()
            self._usual_place.learn()
        if changed:
            if moved:
                self._old = np.zeros(len(GRID_S))
            # If earlier windows allow the new delay as well, it has been found, and has not moved.
            if (moved and _against(earlier, self.late_s) > STAMP_MONITOR.sure) or self._moved_known:
                self.jumped_s += self.late_s - before_s
            self._ages.put_right(self.late_s - before_s)
        if changed or _against(cost, self.late_s + self._moved_s) > STAMP_MONITOR.sure:
            self._moved_s, self._moved_known = 0.0, False
        return changed

    def _inertial_are_off(self, before_s: float) -> bool:
        """Whether a new :attr:`late_s` is due to the inertial sensors' stamps: it puts fixes into the future, or takes
        back what these stamps have been corrected by.
        """
        if self.late_s > 0.0:
            return self.inertial_late_s > 0.0
        age_s = self._ages.lately_s
        return age_s is not None and age_s + self.late_s - before_s < 0.0

    def _correct_inertial(self) -> None:
        """Ascribe :attr:`late_s` to the inertial sensors, and begin anew: all that is known has their old stamps."""
        self.inertial_late_s = max(self.inertial_late_s - self.late_s, 0.0)
        self.late_s, self.sigma_s, self.jumped_s, self._found_s = 0.0, 0.0, 0.0, math.inf
        self._moved_s, self._moved_known = 0.0, False
        self._ages = Ages()
        self._forget()
        self._imu.clear()
        self._fixes.clear()

    def _known(self) -> bool:
        """Whether earlier windows have shown how late stamps are."""
        return bool(self._old.max() - self._old.min() > STAMP_MONITOR.sure)

    def _forget(self) -> None:
        self._old, self._last = np.zeros(len(GRID_S)), np.zeros(len(GRID_S))

    def _judge(self, cost: FloatArray) -> bool:
        k = int(cost.argmin())
        against = _against(cost, self.late_s)
        if not 0 < k < len(GRID_S) - 1:
            self._explains = against > STAMP_MONITOR.suspected
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
            self._explains = against > STAMP_MONITOR.suspected and apart > STAMP_MONITOR.apart_first_s
            if sigma_s < self.sigma_s:
                self.sigma_s = sigma_s
            if apart < max(STAMP_MONITOR.apart_s, sigma_s):
                return False
        else:
            self._explains = against > STAMP_MONITOR.suspected and apart > STAMP_MONITOR.apart_first_s
            if apart < STAMP_MONITOR.apart_first_s or against < STAMP_MONITOR.sure:
                self._found_s = math.inf
                return False
        if apart >= STAMP_MONITOR.apart_first_s and not self._lasts(late_s, sigma_s):
            return False
        self.late_s, self.sigma_s, self._explains = late_s, sigma_s, False
        return True

    def _lasts(self, late_s: float, sigma_s: float) -> bool:
        """Whether this delay has been found for long enough."""
        if abs(late_s - self._found_s) > max(STAMP_MONITOR.lasts_s, 3.0 * sigma_s):
            self._found_s, self._found_us = late_s, self._checked_us
        return (
            self._checked_us - self._found_us >= STAMP_MONITOR.lasts_us
            or self._usual_heading.count < STAMP_MONITOR.settled_count
        )

    def _window(self) -> FloatArray | None:
        """(g,) cost of each delay, from the fixes of the window; None if they are too few."""
        imu = np.array(self._imu)
        begin_us = imu[0, 0]
        fixes = np.array([fix for fix in self._fixes if fix[0] - STAMP_MONITOR.margin_us >= begin_us])
        if len(fixes) < STAMP_MONITOR.least_fixes or fixes[-1, 0] - fixes[0, 0] < STAMP_MONITOR.least_us:
            return None
        imu = np.vstack((imu, imu[-1]))
        imu[-1, 0] += STAMP_MONITOR.margin_us  # stamps that are too early lie ahead: held
        imu[:, 0] -= begin_us
        fixes[:, 0] -= begin_us
        t_s, rate = 1e-6 * imu[:, 0], imu[:, 1]
        at_s = 1e-6 * fixes[:, 0]
        dt_s = np.diff(t_s)
        turned = _summed(rate, dt_s)
        true_s = at_s[:, None] - GRID_S
        yaw = fixes[:, 3]
        if (np.abs(np.diff(yaw)) >= math.pi).any():
            yaw = np.unwrap(yaw)
        known_s = at_s - self.late_s
        one, since = np.ones(len(at_s)), at_s - at_s.mean()
        # The last column is without any delay: the motion in the fixes themselves.
        by_delay = yaw[:, None] - np.interp(true_s, t_s, turned)
        heading = _Fit(np.column_stack((one, since)), np.column_stack((by_delay, yaw)))
        psi = turned + _median(yaw - np.interp(known_s, t_s, turned))
        c, s = np.cos(psi), np.sin(psi)
        travel_n = _summed(_summed(c * imu[:, 2] - s * imu[:, 3], dt_s), dt_s)
        travel_e = _summed(_summed(s * imu[:, 2] + c * imu[:, 3], dt_s), dt_s)
        by_c, by_s = (np.interp(known_s, t_s, _summed(_summed(part, dt_s), dt_s)) for part in (c, s))
        none = np.zeros(len(at_s))
        north = np.column_stack((one, none, since, none, by_c, -by_s))
        east = np.column_stack((none, one, none, since, by_s, by_c))
        off = np.concatenate(
            (fixes[:, 1, None] - np.interp(true_s, t_s, travel_n), fixes[:, 2, None] - np.interp(true_s, t_s, travel_e))
        )
        alone = np.concatenate((fixes[:, 1] - fixes[0, 1], fixes[:, 2] - fixes[0, 2]))
        place = _Fit(np.concatenate((north, east)), np.column_stack((off, alone)))
        near_heading, near_place = heading.near(), np.logical_and(*np.split(place.near(), 2))
        good = near_heading & near_place
        turns, moves = (
            bool(near_heading[-STAMP_MONITOR.newest :].any()),
            bool(near_place[-STAMP_MONITOR.newest :].any()),
        )
        if not good.all():
            if good.sum() < STAMP_MONITOR.least_fixes:
                return None
            heading, place = heading.only(good), place.only(np.tile(good, 2))
            fixes, known_s = fixes[good], known_s[good]
        turns &= self._usual_heading.fits(heading.fit(STAMP_MONITOR.floor_rad), _median(fixes[:, 4]))
        turns = turns and not heading.beaten(
            int(np.abs(GRID_S - self.late_s).argmin()), _wrong_gyro(known_s, t_s, turned), STAMP_MONITOR.floor_rad
        )
        moves &= self._usual_place.fits(place.fit(STAMP_MONITOR.floor_m), _median(fixes[:, 5]))
        result: FloatArray = turns * heading.cost(STAMP_MONITOR.floor_rad) + (turns and moves) * place.cost(
            STAMP_MONITOR.floor_m
        )
        return result if np.isfinite(result).all() else None


def _against(cost: FloatArray, delay_s: float) -> float:
    """Evidence of costs (g,) against a delay."""
    return float(np.interp(delay_s, GRID_S, cost) - cost.min())


class _Goodness(NamedTuple):
    """Fit of a window at the best delay."""

    variance: float
    """Remaining, per degree of freedom."""
    shown: float
    """The same without inertial sensors."""
    freedom: float
    """Degrees of freedom, those that are alike counted as one."""


class _Usual:
    """Typical residual of windows relative to the fixes' stated variance."""

    def __init__(self) -> None:
        self._ratios: deque[float] = deque(maxlen=STAMP_MONITOR.usual_count)
        self._ratio = 0.0

    @property
    def count(self) -> int:
        return len(self._ratios)

    def fits(self, found: _Goodness, stated: float) -> bool:
        """Whether a window fits as well as others, fixes stating this variance. The first one does."""
        self._ratio = found.variance / stated
        if not self._ratios:
            return True
        usual = median(self._ratios) * stated
        return (
            found.variance <= usual * _chance(found.freedom) + STAMP_MONITOR.scale * STAMP_MONITOR.scale * found.shown
        )

    def learn(self) -> None:
        """Add the last queried window."""
        self._ratios.append(self._ratio)


class Ages:
    def __init__(self) -> None:
        self._last_us: deque[int] = deque(maxlen=STAMP_MONITOR.age_count)
        self._usual_us: float | None = None
        self._off = 0
        """Pictures in a row that are older or younger than usual: their number, with the sign."""

    @property
    def off_s(self) -> float:
        """Excess of the last ages over the usual one [s], 0 = not significant."""
        if abs(self._off) < STAMP_MONITOR.age_soon or self._usual_us is None:
            return 0.0
        return 1e-6 * (self._usual_us - self._last_us[-1])

    @property
    def lately_s(self) -> float | None:
        """Median of the last ages, None before the first."""
        return 1e-6 * median(self._last_us) if self._last_us else None

    def note(self, age_us: int) -> float:
        """One more picture. By how much stamps seem to be later for good [us], 0 = they do not."""
        self._last_us.append(age_us)
        if self._usual_us is None:
            if len(self._last_us) == STAMP_MONITOR.age_count:
                self._usual_us = median(self._last_us)
            return 0.0
        off_us = age_us - self._usual_us
        if abs(off_us) <= STAMP_MONITOR.age_step_us:
            self._off = 0
            self._usual_us += STAMP_MONITOR.age_gain * off_us
            return 0.0
        side = 1 if off_us > 0.0 else -1
        self._off = self._off + side if self._off * side > 0 else side
        if (
            abs(self._off) < STAMP_MONITOR.age_count
            or max(self._last_us) - min(self._last_us) > STAMP_MONITOR.age_step_us
        ):
            return 0.0  # a busy machine delays each picture by another time
        before_us, self._usual_us, self._off = self._usual_us, median(self._last_us), 0
        return before_us - self._usual_us

    def put_right(self, more_s: float) -> None:
        """The correction of the stamps has increased by that much."""
        if self._usual_us is not None:
            self._usual_us += 1e6 * more_s
        self._last_us.clear()
        self._off = 0


class _Fit:
    """Least squares of (n, g) columns on common regressors (n, p), and of one more column: the data without delay."""

    def __init__(self, by: FloatArray, what: FloatArray) -> None:
        self._by, self._what = by, what
        self._q, _ = np.linalg.qr(by)
        self._rest = self._without(what)
        self._squares = np.square(self._rest).sum(axis=0)

    def _without(self, columns: FloatArray) -> FloatArray:
        """Residual of (n, k) after the fit."""
        return columns - self._q @ (self._q.T @ columns)

    def beaten(self, known: int, others: FloatArray, floor: float) -> bool:
        """Whether one of (n, k) other causes explains the residual of column ``known`` far better than any delay."""
        n, p = self._by.shape
        least = float(self._squares[:-1].min()) + n * floor * floor
        if self._squares[known] + n * floor * floor <= 1.1 * least:
            return False
        first = self._without(others)
        both, second = first[:, :-1], first[:, 1:]  # an onset between two fixes is a mixture of onsets at both
        rest = self._rest[:, known]
        a, b, c = (np.einsum("ij,ij->j", x, y) for x, y in ((both, both), (both, second), (second, second)))
        by_first, by_second = both.T @ rest, second.T @ rest
        det = a * c - b * b
        observable = det > np.maximum(1e-6 * a * c, 1e-18)
        if not observable.any():
            return False
        gain = (by_first**2 * c - 2.0 * by_first * by_second * b + by_second**2 * a)[observable] / det[observable]
        left = max(0.0, float(self._squares[known] - gain.max())) + n * floor * floor
        return bool(0.5 / STAMP_MONITOR.alike * (n - p) * math.log(least / left) > STAMP_MONITOR.suspected)

    def near(self) -> NDArray[np.bool_]:
        """(n,) which are no outliers."""
        rest = np.abs(self._rest[:, self._squares[:-1].argmin()])
        return rest <= STAMP_MONITOR.far * max(_median(rest), 1e-5)

    def only(self, good: NDArray[np.bool_]) -> "_Fit":
        return _Fit(self._by[good], self._what[good])

    def fit(self, floor: float) -> _Goodness:
        n, p = self._by.shape
        *_, shown = squares = self._squares + n * floor * floor
        return _Goodness(float(squares[:-1].min()) / (n - p), float(shown) / (n - p), (n - p) / STAMP_MONITOR.alike)

    def cost(self, floor: float) -> FloatArray:
        """(g,) negative log-likelihood minus its minimum, with unknown noise variance.

        It is weighted by the fraction of the fixes' motion that the inertial sensors explain: noise explains none.
        """
        n, p = self._by.shape
        *_, shown = squares = self._squares + n * floor * floor
        squares = squares[:-1]
        weight = min(1.0, max(0.0, 2.0 - 2.0 * squares.min() / (STAMP_MONITOR.unexplained * shown)))
        result: FloatArray = 0.5 / STAMP_MONITOR.alike * (n - p) * weight * np.log(squares / squares.min())
        return result


def _chance(freedom: float) -> float:
    """Chi-square per degree of freedom that is exceeded by chance beyond ``STAMP_MONITOR.unfit_sigma``
    (Wilson and Hilferty 1931)."""
    spread = 2.0 / (9.0 * freedom)
    return (1.0 - spread + STAMP_MONITOR.unfit_sigma * math.sqrt(spread)) ** 3


def _wrong_gyro(at_s: FloatArray, t_s: FloatArray, turned: FloatArray) -> FloatArray:
    """(n, 2 n) effect on the heading of an offset and a scale error of the gyro that start at each of the fixes."""
    since_s = np.maximum(at_s[:, None] - at_s, 0.0)
    heading = np.interp(at_s, t_s, turned)
    return np.hstack((since_s, np.where(since_s > 0.0, heading[:, None] - heading, 0.0)))


def _median(values: FloatArray) -> float:
    """As numpy's, in a third of its time."""
    return float(median(values.tolist()))


def _summed(values: FloatArray, dt_s: FloatArray) -> FloatArray:
    """Integral by the trapezoidal rule, from 0."""
    return np.concatenate(([0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * dt_s)))
