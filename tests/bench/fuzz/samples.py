"""Samples that no sound sensor gives: wrong numbers, wrong times, twice, too late, from nowhere."""

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.samples import (
    AhrsSample,
    DepthSample,
    ExternalFrame,
    ExternalPoseSample,
    HullSample,
    ImuSample,
    LaserSample,
    LeakSample,
    MarkerSighting,
    ObstacleTrack,
    PilotSample,
    PoseSample,
    PowerSample,
    Sample,
    VelocityLock,
    VelocitySample,
)

ODD = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1e-308, 1e308, -1e308, 1e38, -2e68, 1e9, -1e9, 1e4, 10.0, -10.0)
ODD_TIMES_US = (0, -1, -(1 << 62), 1 << 62, 1_000, -1_000, 10_000, -10_000, -1_000_000, 1_000_000, -10_000_000)


class Noise:
    """Wild samples of every kind."""

    def __init__(self, seed: int) -> None:
        self._rng = random.Random(seed)
        self._before: list[Sample] = []
        self._makers: tuple[Callable[[int], Sample], ...] = (
            lambda t_us: AhrsSample(
                t_us=t_us,
                rpy_rad=self._array(3, 0.2),
                rate_frd_rad_s=self._array(3, 0.2),
                accel_frd_m_s2=self._array(3, 10.0),
            ),
            lambda t_us: ImuSample(
                t_us=t_us,
                rate_frd_rad_s=self._array(3, 0.2),
                accel_frd_m_s2=self._array(3, 10.0),
                mag_frd=self._rng.choice((None, self._array(3, 1.0))),
            ),
            self._sighting,
            lambda t_us: PoseSample(
                t_us=t_us,
                pos_ned_m=self._array(3, 1.0),
                yaw_rad=self._number(3.0),
                sigma_pos_m=self._array(3, 0.05),
                sigma_yaw_rad=self._number(0.05),
            ),
            lambda t_us: LaserSample(t_us=t_us, range_m=self._number(1.0), sigma_m=self._number(0.01)),
            lambda t_us: DepthSample(t_us=t_us, depth_m=self._number(1.0), sigma_m=self._number(0.01)),
            lambda t_us: VelocitySample(
                t_us=t_us,
                vel_frd_m_s=self._array(3, 0.3),
                sigma_m_s=self._array(3, 0.02),
                lock=self._rng.choice(list(VelocityLock)),
            ),
            lambda t_us: ExternalPoseSample(
                t_us=t_us,
                pos_m=self._array(3, 1.0),
                yaw_rad=self._number(3.0),
                covariance=self._rng.choice(
                    (None, self._array(16, 0.01).reshape(4, 4), np.eye(4) * self._number(0.01))
                ),
                frame=self._rng.choice(list(ExternalFrame)),
                reset_counter=self._rng.randrange(3),
            ),
            lambda t_us: PowerSample(
                t_us=t_us,
                voltage_v=self._number(24.0),
                current_a=self._number(5.0),
                energy_used_j=self._number(1e4),
                remaining=self._number(0.5),
            ),
            lambda t_us: LeakSample(t_us=t_us, wet=self._rng.random() < 0.02),
            lambda t_us: HullSample(
                t_us=t_us,
                pressure_pa=self._rng.choice((None, 1e5 + self._number(1e3))),
                temperature_c=self._rng.choice((None, 20.0 + self._number(5.0))),
            ),
            lambda t_us: PilotSample(t_us=t_us),
            lambda t_us: ObstacleTrack(
                t_us=t_us,
                track_id=self._rng.randrange(-3, 60),
                pos_ned_m=self._array(2, 2.0),
                vel_ned_m_s=self._array(2, 0.2),
                radius_m=self._number(0.3),
            ),
        )

    def samples(self, t_us: int, sound: Sequence[Sample]) -> tuple[Sample, ...]:
        """What comes on a tick beside or in place of what sound sensors say."""
        rng = self._rng
        given: list[Sample] = [sample for sample in sound if rng.random() > 0.05]
        count = rng.choice((0, 0, 1, 1, 2, 4))
        given.extend(rng.choice(self._makers)(self._time(t_us)) for _ in range(count))
        if given and rng.random() < 0.2:
            given.append(replace(rng.choice(given), t_us=self._time(t_us)))
        if self._before and rng.random() < 0.2:
            given.append(rng.choice(self._before))
        self._before = given[-4:]
        if rng.random() < 0.3:
            rng.shuffle(given)
        return tuple(given)

    def _time(self, t_us: int) -> int:
        rng = self._rng
        return t_us if rng.random() < 0.7 else t_us + rng.choice(ODD_TIMES_US)

    def _number(self, scale: float) -> float:
        rng = self._rng
        return rng.gauss(0.0, scale) if rng.random() < 0.7 else rng.choice(ODD)

    def _array(self, size: int, scale: float) -> FloatArray:
        return np.array([self._number(scale) if self._rng.random() < 0.3 else scale for _ in range(size)])

    def _sighting(self, t_us: int) -> MarkerSighting:
        rng = self._rng
        count = rng.choice((0, 1, 2, 5))
        return MarkerSighting(
            t_us=t_us,
            ids=tuple(rng.choice((-1, 0, 1, 7, 49, 2**40)) for _ in range(count)),
            corners_px=self._array(count * 8, 200.0).reshape(count, 4, 2),
            laser_px=rng.choice((None, self._array(2, 200.0))),
        )
