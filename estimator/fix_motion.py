"""Comparison of the motion of fixes with dead reckoning.

While no fix is used the filter runs on inertial sensors and the vehicle model alone. The residuals of fixes then drift
by the difference of the two motions, whatever the offset between them: relative motion is accurate even when the
position is not.
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.estimator.estimator_tuning import FIX_MOTION
from autopilot.estimator.measurement import CHI2_999
from autopilot.estimator.states import DOWN, GYRO_BIAS, VEL

FLOOR = np.array([0.002, 0.002, 0.002, 0.001])
"""[m, rad] added to the standard deviation of fixes: the part that belongs to a place on the floor."""
SYSTEMATIC = np.array([0.02, 0.02, 0.02, 0.005])
"""[m/s, rad/s] by which dead reckoning is off beyond the filter's own word: tether, drag, scale of the gyro,"""


class FixResidual(NamedTuple):
    """Residual of a fix against dead reckoning."""

    t_us: int
    z: FloatArray
    """(4,) north, east, down [m], heading [rad]."""
    y: FloatArray
    """(4,) residual against the prediction."""
    variance: FloatArray
    """(4,) of the fix."""
    drift: FloatArray
    """(4,) variance of the velocity and the rate that it was predicted with [m^2/s^2, rad^2/s^2]."""
    inside: bool
    """Whether it passes its gate."""


class FixMotion:
    """A run of fixes none of which was used."""

    def __init__(self) -> None:
        self._run: deque[FixResidual] = deque(maxlen=FIX_MOTION.most)

    def __len__(self) -> int:
        return len(self._run)

    def clear(self) -> None:
        self._run.clear()

    def add(self, seen: FixResidual) -> None:
        """One more, in the order of their times; one that comes late is left out."""
        if self._run and seen.t_us <= self._run[-1].t_us:
            return
        self._run.append(seen)
        while self._run[0].t_us < seen.t_us - FIX_MOTION.span_us:
            self._run.popleft()

    def last(self, *, count: int = FIX_MOTION.least, span_us: int = 0) -> "FixRun | None":
        """The newest fixes: as many as make at least ``count`` and ``span_us``; None if there are not so many."""
        run: list[FixResidual] = []
        for seen in reversed(self._run):
            run.append(seen)
            if len(run) >= count and run[0].t_us - seen.t_us >= span_us:
                return FixRun(run[::-1])
        return None


class FixRun:
    def __init__(self, run: Sequence[FixResidual]) -> None:
        self.count = len(run)
        self.inside = all(seen.inside for seen in run)
        t_s = 1e-6 * np.array([seen.t_us - run[0].t_us for seen in run])
        self._since = (t_s - t_s.mean())[:, None]
        self._z, y = _unwrapped([seen.z for seen in run]), _unwrapped([seen.y for seen in run])
        self.turned_rad = float(y[:, 3].mean())
        """By which fixes have another heading than dead reckoning has: its way is turned by that."""
        self._y = self._z - _turned(self._z - y, self.turned_rad)
        self._variance = FIX_MOTION.alike * (np.mean([seen.variance for seen in run], axis=0) + FLOOR**2)
        self._drift = np.array(run[-1].drift)
        if self._drift[DOWN] > FIX_MOTION.unknown_m_s * FIX_MOTION.unknown_m_s:
            self._variance[DOWN] = math.inf  # says nothing
        squares = float((self._since**2).sum())
        self._slope = (self._since * self._y).sum(axis=0) / squares
        self._slope_variance = self._variance / squares

    @property
    def apart(self) -> float:
        """Squared distance of the motion of the fixes from dead reckoning over its gate, > 1 = they contradict."""
        return float((self._slope**2 / (self._slope_variance + self._drift)).sum() / CHI2_999[4])

    @property
    def denies_gyro(self) -> bool:
        """Whether the fixes agree with the vehicle's translation, and contradict the gyro only."""
        translation = slice(0, 3)
        squares = self._slope[translation] ** 2 / (self._slope_variance[translation] + self._drift[translation])
        return self.apart > 1.0 and float(squares.sum()) <= CHI2_999[3] and self.moves > FIX_MOTION.sure and self.fits

    def velocity(self, reckoned_ned_m_s: FloatArray) -> FloatArray:
        """(3,) NED of the fixes, where that of dead reckoning is (3,)."""
        result: FloatArray = _turned(reckoned_ned_m_s[None], self.turned_rad)[0] + self._slope[:3]
        return result

    @property
    def follows(self) -> bool:
        return self.apart <= 1.0 and self.fits

    @property
    def fits(self) -> bool:
        """Whether, but for a steady difference, they move together from fix to fix."""
        rest = self._y - self._y.mean(axis=0) - self._slope * self._since
        return float((rest**2 / self._variance).sum()) <= FIX_MOTION.good_fit * 4.0 * max(
            self.count / FIX_MOTION.alike, 2.0
        )

    @property
    def moves(self) -> float:
        """Logarithm of the likelihood that fixes move with the vehicle over that of standing still."""
        still = ((self._z - self._z.mean(axis=0)) ** 2 / self._variance).sum()
        # A difference in velocity is likely as far as dead reckoning may be off by it.
        slope = self._slope * self._drift / (self._drift + self._slope_variance)
        rest = self._y - self._y.mean(axis=0) - slope * self._since
        return 0.5 * float(still - (rest**2 / self._variance).sum() - (slope**2 / self._drift).sum())


def drift_variance(variance: FloatArray, gap_s: float, *, accel: bool, gyro: bool) -> FloatArray:
    """(4,) variance of the predicted velocity and yaw rate, ``gap_s`` after the last fix.

    ``variance`` (21,) of the filter's states; ``accel``, ``gyro``: whether that sensor is used.
    """
    more_m_s = FIX_MOTION.systematic_per_s * gap_s + (0.0 if accel else FIX_MOTION.unaided)
    result: FloatArray = np.append(variance[VEL] + more_m_s * more_m_s, variance[GYRO_BIAS]) + SYSTEMATIC**2
    if not gyro:
        result[3] += FIX_MOTION.unaided * FIX_MOTION.unaided
    return result


def plausible(y: FloatArray, variance: FloatArray, drift: FloatArray, gap_s: float) -> bool:
    """Whether dead reckoning may have drifted by ``y`` (4,) within a gap, ``variance`` (4,) by its own word and
    ``drift`` (4,) as in :class:`FixResidual`."""
    return float((y**2 / (variance + drift * gap_s * gap_s)).sum()) <= CHI2_999[4]


def _turned(path: FloatArray, by_rad: float) -> FloatArray:
    """Places or velocities NED in rows, turned about the vertical through the origin."""
    c, s = math.cos(by_rad), math.sin(by_rad)
    result = path.copy()
    result[:, 0], result[:, 1] = c * path[:, 0] - s * path[:, 1], s * path[:, 0] + c * path[:, 1]
    return result


def _unwrapped(rows: Sequence[FloatArray]) -> FloatArray:
    """(n, 4) with the heading counting turns."""
    result = np.array(rows)
    result[:, 3] = np.unwrap(result[:, 3], period=2.0 * math.pi)
    return result
