"""Altitude above the floor from the downward range sensors."""

import math
from collections import deque
from dataclasses import dataclass, field
from statistics import median_low

from autopilot.core.echoes import RecentEchoes
from autopilot.core.frames import FloatArray

FRESH_US = 1_000_000
"""Age beyond which a range is invalid: the vehicle has moved."""

SLOW_INTERVALS = 2.5
"""The newest range of a slow sonar is valid for so many of its intervals, each taken for ``FRESH_US`` at most: a lost
reading is no loss of the floor."""

READINGS = 5
"""Length of the median filter: rejects fish and multipath echoes. Of an even number the nearer one counts."""

SENSORS = ("altimeter", "laser")
"""Order of preference among sensors with recent data: a sonar's wide beam sees the floor also through silt."""

_NOWHERE = (math.nan, math.nan, math.nan)


@dataclass(slots=True, eq=False)
class _Ranges:
    position_frd_m: tuple[float, float, float] = _NOWHERE
    direction_frd: tuple[float, float, float] = _NOWHERE
    readings: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=READINGS))
    """Time and range, multiples left out."""
    echoes: RecentEchoes = field(default_factory=RecentEchoes)

    def valid_m(self, t_us: int) -> list[float]:
        """Ranges that count, none = the floor is not seen."""
        fresh = [range_m for then_us, range_m in self.readings if t_us - then_us <= FRESH_US]
        if fresh or len(self.readings) < 2:
            return fresh
        (first_us, _), (newest_us, newest_m) = self.readings[0], self.readings[-1]
        interval_us = min((newest_us - first_us) / (len(self.readings) - 1), FRESH_US)
        return [newest_m] if t_us - newest_us <= SLOW_INTERVALS * interval_us else []


class FloorRanges:
    """The newest ranges of each sensor."""

    def __init__(self) -> None:
        self._ranges = {name: _Ranges() for name in SENSORS}

    def mount(
        self, name: str, position_frd_m: tuple[float, float, float], direction_frd: tuple[float, float, float]
    ) -> None:
        """Position and direction (any length) of a sensor in the body frame."""
        x, y, z = direction_frd
        length = math.hypot(x, y, z)
        self._ranges[name] = _Ranges(position_frd_m, (x / length, y / length, z / length))

    def note(self, name: str, t_us: int, range_m: float) -> None:
        """One reading of a sensor, along its beam."""
        ranges = self._ranges[name]
        # A single one at half the range is a fish above the floor.
        if math.isfinite(range_m) and range_m > 0.0 and ranges.echoes.add(t_us, range_m).at_half < 2:
            ranges.readings.append((t_us, range_m))

    def height_m(self, t_us: int, rpy_rad: FloatArray | None) -> float | None:
        """Of the vehicle's centre over the floor, None = not known; ``rpy_rad`` (3,), None = level."""
        for name in SENSORS:
            ranges = self._ranges[name]
            valid_m = ranges.valid_m(t_us)
            if valid_m:
                below_m = median_low(valid_m) * _below(rpy_rad, ranges.direction_frd)
                height_m = below_m + _below(rpy_rad, ranges.position_frd_m)
                return height_m if height_m > 0.0 else None
        return None


def _below(rpy_rad: FloatArray | None, frd: tuple[float, float, float]) -> float:
    """The part of a vector that points down."""
    forward, right, down = frd
    if rpy_rad is None:
        return down
    roll, pitch, _ = rpy_rad.tolist()
    sideways = right * math.sin(roll) + down * math.cos(roll)
    return float(sideways * math.cos(pitch) - forward * math.sin(pitch))
