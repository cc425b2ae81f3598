"""Common interface of the measurement models, one file per kind: ``measure_*.py``."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

from autopilot.core.frames import FloatArray
from autopilot.estimator.inertial import Inertial

CHI2_999 = {1: 10.83, 2: 13.82, 3: 16.27, 4: 18.47}
"""99.9 % points of the chi-square distribution by degrees of freedom (Abramowitz & Stegun, table 26.8)."""


MAX_SIGMA_M = 10.0
"""Samples with a larger standard deviation are not used."""


def chi2_999(freedom: int) -> float:
    """99.9 % quantile of chi-square (Wilson and Hilferty's approximation from five degrees of freedom on)."""
    known = CHI2_999.get(freedom)
    if known is not None:
        return known
    variance = 2.0 / (9.0 * freedom)
    return float(freedom * (1.0 - variance + 3.0902 * variance**0.5) ** 3)


class Moment(NamedTuple):
    """The node of the history that a measurement belongs to: the last one at or before its time."""

    inertial: Inertial
    thrust_n: tuple[float, ...]
    """Acting force: the command behind the drive's lag."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Measurement(ABC):
    """A vector z = h(x) + noise of m numbers.

    ``after_s`` (0 to about 10 ms) is how long after the moment it was taken."""

    sensor: str
    """Topic-safe name."""
    t_us: int
    """Time of validity."""
    z: FloatArray
    """(m,)"""
    noise: FloatArray
    """(m, m) covariance."""

    @abstractmethod
    def predicted(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """h(x), (m,)"""
        ...

    @abstractmethod
    def jacobian(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """dh/dx, (m, 21)"""
        ...

    def residual(self, z: FloatArray, predicted: FloatArray) -> FloatArray:
        """z - h(x) (m,), angles wrapped."""
        return z - predicted
