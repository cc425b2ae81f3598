"""Samples that no sound sensor gives: wrong numbers, wrong times, twice, too late, from nowhere."""

import math
import random
from collections.abc import Sequence
from dataclasses import replace
from enum import Enum
from typing import Any

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.samples import MarkerSighting, Sample
from autopilot.log.sample_table import SAMPLE_ROWS, SampleRow
from tests.sample_kinds import sample_of

ODD = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1e-308, 1e308, -1e308, 1e38, -2e68, 1e9, -1e9, 1e4, 10.0, -10.0)
ODD_TIMES_US = (0, -1, -(1 << 62), 1 << 62, 1_000, -1_000, 10_000, -10_000, -1_000_000, 1_000_000, -10_000_000)

SCALES = {
    **dict.fromkeys(("rpy_rad", "rate_frd_rad_s", "vel_ned_m_s"), 0.2),
    **dict.fromkeys(("sigma_pos_m", "sigma_yaw_rad"), 0.05),
    **dict.fromkeys(("sigma_m", "covariance"), 0.01),
    "accel_frd_m_s2": 10.0,
    "yaw_rad": 3.0,
    "vel_frd_m_s": 0.3,
    "sigma_m_s": 0.02,
    "radius_m": 0.3,
    "voltage_v": 24.0,
    "current_a": 5.0,
    "energy_used_j": 1e4,
    "remaining": 0.5,
    "pressure_pa": 1e5,
    "temperature_c": 20.0,
}
"""What a sound sensor gives, by the name of the attribute; 1 where none is given."""


class Noise:
    def __init__(self, seed: int) -> None:
        self._rng = random.Random(seed)
        self._before: list[Sample] = []

    def samples(self, t_us: int, healthy: Sequence[Sample]) -> tuple[Sample, ...]:
        """What comes on a tick beside or in place of what sound sensors say."""
        rng = self._rng
        given: list[Sample] = [sample for sample in healthy if rng.random() > 0.05]
        count = rng.choice((0, 0, 1, 1, 2, 4))
        given.extend(self._any(rng.choice(SAMPLE_ROWS), self._time(t_us)) for _ in range(count))
        if given and rng.random() < 0.2:
            given.append(replace(rng.choice(given), t_us=self._time(t_us)))
        if self._before and rng.random() < 0.2:
            given.append(rng.choice(self._before))
        self._before = given[-4:]
        if rng.random() < 0.3:
            rng.shuffle(given)
        return tuple(given)

    def _any(self, row: SampleRow, t_us: int) -> Sample:
        sample: Sample = self._sighting(t_us) if row.of is MarkerSighting else sample_of(row, t_us, self)
        return sample

    def missing(self) -> bool:
        return self._rng.random() < 0.5

    def scalar(self, name: str, kind: type) -> Any:
        if kind is bool:
            return self._rng.random() < 0.02
        return self._rng.randrange(-3, 60) if kind is int else self._number(SCALES.get(name, 1.0))

    def member(self, kind: type[Enum]) -> Enum:
        return self._rng.choice(list(kind))

    def array(self, name: str, size: int) -> FloatArray:
        return self._array(size, SCALES.get(name, 1.0))

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
