"""A redundant estimator beside the primary one: the same sensors, another filter, and a monitored difference.

Images are processed once, by the primary estimator; the redundant one gets the poses as from a pose sensor. Common
parts (association of markers, the marker map, the AHRS) are therefore not checked; gates, biases, vehicle model,
covariances and history are.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import AidStatus, NavDoubt, NavHealth, NavState, ShadowStatus
from autopilot.core.samples import AhrsSample, LaserSample, MarkerSighting, PoseSample, Sample
from autopilot.estimator.protocol import Estimator

SIGMAS = 3.0
"""Of the difference of two estimates, treated as independent."""
POS_FLOOR_M = 0.1
YAW_FLOOR_RAD = math.radians(5.0)
"""Allowance beyond the standard deviations: the observer's variances have no correlations."""
AHRS_EVERY_US = 25_000
"""The shadow gets AHRS samples that are at least so far apart, every third one at 100 Hz: a third of the cost."""
EVERY_TICKS = 10
"""The shadow is stepped this often (with the thrust of the last tick): compared ten times a second."""
AFTER_US = 1_000_000
"""Time for which the difference has to be outside, or inside, its bounds."""


class Shadowed:
    """:class:`.estimator.protocol.Estimator`: output of the primary one, and its difference to the redundant one."""

    def __init__(self, flown: Estimator, other: Estimator) -> None:
        self._flown = flown
        self._other = other
        self._status: ShadowStatus | None = None
        self._disagrees = False
        self._changed_us: int | None = None
        self._disagreements = 0
        self._ahrs_us = -AHRS_EVERY_US
        self._waiting: list[Sample] = []
        self._ticks = 0

    def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray) -> NavState | None:
        nav = self._flown.step(t_us, samples, thrust_n)
        self._waiting += [sample for sample in samples if self._wanted(sample)]
        self._waiting += self._flown.take_made()
        self._ticks += 1
        if self._ticks % EVERY_TICKS == 0:
            other = self._other.step(t_us, self._waiting, thrust_n)
            self._waiting = []
            self._other.take_aids()
            self._status = None if nav is None or other is None else self._compared(nav, other)
        return nav

    def take_aids(self) -> tuple[AidStatus, ...]:
        return self._flown.take_aids()

    def take_made(self) -> tuple[PoseSample | LaserSample, ...]:
        """Nothing: the shadow has had it."""
        return ()

    def take_remarks(self) -> tuple[str, ...]:
        return self._flown.take_remarks()

    def counters(self) -> Mapping[str, int]:
        """Counters of the primary estimator, and of disagreements."""
        return {**self._flown.counters(), "shadow.disagreements": self._disagreements}

    @property
    def ahrs_us(self) -> int | None:
        return self._flown.ahrs_us

    @property
    def refined_map(self) -> MarkerMap | None:
        return self._flown.refined_map

    @property
    def doubts(self) -> frozenset[NavDoubt]:
        return self._flown.doubts

    @property
    def shadow(self) -> ShadowStatus | None:
        """See :class:`.estimator.protocol.Estimator`. None while one of the two is lost: nothing to compare then."""
        return self._status

    def _wanted(self, sample: Sample) -> bool:
        """Whether the shadow gets a sample as it came."""
        if isinstance(sample, AhrsSample):
            if 0 <= sample.t_us - self._ahrs_us < AHRS_EVERY_US:
                return False
            self._ahrs_us = sample.t_us
        return not isinstance(sample, MarkerSighting)

    def _compared(self, nav: NavState, other: NavState) -> ShadowStatus | None:
        if NavHealth.INVALID in (nav.health, other.health):
            self._disagrees, self._changed_us = False, None
            return None
        apart = nav.pos_ned_m - other.pos_ned_m
        yaw = wrap_pi(float(nav.rpy_rad[2] - other.rpy_rad[2]))
        sigma = np.sqrt(nav.variance[[0, 1, 2, 5]] + other.variance[[0, 1, 2, 5]])
        bound = SIGMAS * sigma + np.array([POS_FLOOR_M, POS_FLOOR_M, POS_FLOOR_M, YAW_FLOOR_RAD])
        ratio = float((np.abs([*apart.tolist(), yaw]) / bound).max())
        self._judge(nav.t_us, too_much=ratio > 1.0)
        return ShadowStatus(
            t_us=nav.t_us,
            pos_difference_ned_m=apart,
            yaw_difference_rad=yaw,
            vel_difference_frd_m_s=nav.vel_frd_m_s - other.vel_frd_m_s,
            ratio=ratio,
            disagrees=self._disagrees,
        )

    def _judge(self, t_us: int, *, too_much: bool) -> None:
        """Change the verdict once the opposite has held for :data:`AFTER_US`."""
        if too_much is self._disagrees:
            self._changed_us = None
            return
        if self._changed_us is None:
            self._changed_us = t_us
        if t_us - self._changed_us >= AFTER_US:
            self._disagrees, self._changed_us = too_much, None
            self._disagreements += too_much
