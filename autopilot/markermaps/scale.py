"""Scale of a survey from measured lengths, each of which must agree with the markers' size and with the others."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.markers import ID_SPAN
from autopilot.markermaps.adjustment import Adjusted, Network
from autopilot.markermaps.markermaps_tuning import SCALE


@dataclass(frozen=True, slots=True, kw_only=True)
class Length:
    """Two markers and how far apart their middles are."""

    first: int
    second: int
    metres: float

    def __str__(self) -> str:
        return f"--length {self.first % ID_SPAN} {self.second % ID_SPAN} {self.metres:g}"


@dataclass(frozen=True, slots=True)
class _Measured:
    length: Length
    surveyed_m: float
    sigma_m: float
    """Of the difference, the scale apart."""

    @property
    def factor(self) -> float:
        return self.length.metres / self.surveyed_m

    @property
    def sigma(self) -> float:
        """Of the factor."""
        return self.sigma_m / self.surveyed_m


def apply_lengths(network: Network, result: Adjusted, ids: list[int], lengths: Sequence[Length]) -> float:
    """Make everything larger or smaller until the lengths fit, in the mean; by which factor. ConfigError if markers of
    one were not seen, or if it disagrees."""
    if not lengths:
        return 1.0
    measured = [_measure(network, result, ids, length) for length in lengths]
    for one, other in combinations(measured, 2):
        apart = one.factor - other.factor
        if abs(apart) > SCALE.sigmas * np.hypot(one.sigma, other.sigma):
            raise ConfigError(
                f"{one.length} and {other.length} disagree by {abs(apart):.1%}: in the survey these markers are"
                f" {one.surveyed_m:.3f} and {other.surveyed_m:.3f} m apart; measure both again"
            )
    weight = np.array([one.sigma**-2 for one in measured])
    factor = float(np.average([one.factor for one in measured], weights=weight))
    origin = network.centers_ned_m[0]
    network.centers_ned_m = origin + factor * (network.centers_ned_m - origin)
    network.eyes_ned_m = origin + factor * (network.eyes_ned_m - origin)
    network.sizes_m = factor * network.sizes_m
    result.sigma_m[:] *= factor
    return factor


def _measure(network: Network, result: Adjusted, ids: list[int], length: Length) -> _Measured:
    """What the survey has where a length was measured. ConfigError if that cannot be."""
    for marker_id in (length.first, length.second):
        if ids.count(marker_id) != 1:
            raise ConfigError(
                f"{length}: marker {marker_id % ID_SPAN} is {ids.count(marker_id)} times in the survey; name two that"
                " are there once"
            )
    pair = [ids.index(length.first), ids.index(length.second)]
    first, second = network.centers_ned_m[pair]
    surveyed_m = float(np.linalg.norm(first - second))
    spread: FloatArray = SCALE.network_factor * result.sigma_m[pair].max(axis=1)
    one = _Measured(length, surveyed_m, float(np.hypot(SCALE.tape_m, np.linalg.norm(spread))))
    limit_m = SCALE.sigmas * float(np.hypot(one.sigma_m, SCALE.print_fraction * surveyed_m))
    if abs(length.metres - surveyed_m) > limit_m:
        size_mm = 1e3 * float(network.sizes_m[pair].mean())
        raise ConfigError(
            f"{length}: markers of {size_mm:.1f} mm are {surveyed_m:.3f} m apart here, at most {limit_m:.3f} m off;"
            f" {length.metres:g} m would make them {one.factor * size_mm:.1f} mm: measure the length and a black"
            " square again, correct the one that is wrong"
        )
    return one
