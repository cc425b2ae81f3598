"""Thrust from pulse and its inverse: the calibrated curve of a :class:`ThrusterDrive`.

Brushed thruster with amplifier: pulse -> duty -> voltage = duty * supply -> F = c V |V|, with different c ahead and
astern and a dead band of the duty. Brushless thruster with ESC: the manufacturer's tables. The inverse skips the dead
band: a request of at least half the smallest thrust gets the smallest thrust, a smaller one gets zero.
"""

import bisect
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from autopilot.core.thrusters import Thruster, ThrusterDrive

ROUNDING = 1e-9
"""Keeps a duty that is a whole pulse in exact arithmetic on that pulse."""

CREDIBLE_SUPPLY = 10.0
"""A supply of more than so many times the nominal one is a broken wire: the nominal one is taken. Less than that part
of it counts as that part: pulses are at their limits long before."""


class ThrustLaw(ABC):
    """Thrust curve of one drive. ``supply_v``: measured voltage; None = nominal. Offsets are relative to neutral,
    positive ahead.
    """

    def __init__(self, drive: ThrusterDrive) -> None:
        self.drive = drive

    def supply(self, supply_v: float | None) -> float:
        if supply_v is None or not 0.0 < supply_v <= CREDIBLE_SUPPLY * self.drive.nominal_supply_v:
            return self.drive.nominal_supply_v
        return max(supply_v, self.drive.nominal_supply_v / CREDIBLE_SUPPLY)

    @abstractmethod
    def offset_us(self, thrust_n: float, limit_n: float, supply_v: float | None) -> int:
        """Offset for one thrust [N], not 0, within ``limit_n``."""

    @abstractmethod
    def thrust_n(self, offset_us: int, supply_v: float | None) -> float:
        """Steady thrust [N] of an offset."""

    def thrusts_n(self, supply_v: float | None) -> Sequence[float]:
        """(2 span + 1) thrust of every whole offset, from full astern on [N]. Not to be written to."""
        span = self.drive.span_us
        return [self.thrust_n(offset, supply_v) for offset in range(-span, span + 1)]

    def capability_n(self, supply_v: float | None) -> float:
        """Largest thrust that both directions reach."""
        span = self.drive.span_us
        return min(self.thrust_n(span, supply_v), -self.thrust_n(-span, supply_v))


class BrushedLaw(ThrustLaw):
    """F = c V |V| beyond a deadband of duty."""

    def __init__(self, drive: ThrusterDrive) -> None:
        super().__init__(drive)
        deadband_duty, self._forward, self._reverse = drive.brushed_law
        self._edge_us = math.floor(deadband_duty * drive.span_us + ROUNDING) + 1
        """Smallest offset that turns: strictly beyond the band."""

    def offset_us(self, thrust_n: float, limit_n: float, supply_v: float | None) -> int:
        supply, span = self.supply(supply_v), self.drive.span_us
        sign = 1 if thrust_n > 0.0 else -1
        wanted = min(abs(thrust_n), limit_n)
        coefficient = self._forward if sign > 0 else self._reverse
        offset = round(math.sqrt(wanted / coefficient) / supply * span)
        if offset < self._edge_us:
            smallest = coefficient * (self._edge_us / span * supply) ** 2
            if wanted < 0.5 * smallest:
                return 0
            offset = self._edge_us
        offset = min(offset, span)
        while offset > self._edge_us and coefficient * (offset / span * supply) ** 2 > limit_n:
            offset -= 1
        return sign * offset

    def thrust_n(self, offset_us: int, supply_v: float | None) -> float:
        """F = c V |V|."""
        span = self.drive.span_us
        offset = max(-span, min(span, offset_us))
        if abs(offset) < self._edge_us:
            return 0.0
        volts = offset / span * self.supply(supply_v)
        return (self._forward if offset > 0 else self._reverse) * volts * abs(volts)

    def capability_n(self, supply_v: float | None) -> float:
        """Thrust at full duty [N]."""
        supply = self.supply(supply_v)
        return min(self._forward, self._reverse) * supply * supply


class CurveLaw(ThrustLaw):
    """Tables of thrust over pulse per voltage; linear between, with V^2 beyond the first and the last."""

    def __init__(self, drive: ThrusterDrive) -> None:
        super().__init__(drive)
        span = drive.span_us
        offsets = np.arange(-span, span + 1)
        self._supplies = [curve.supply_v for curve in drive.curve]
        self._thrusts = np.stack(
            [np.interp(offsets, np.array(curve.pulse_us) - drive.neutral_us, curve.thrust_n) for curve in drive.curve]
        )
        """(voltages, 2 span + 1) per whole pulse."""
        self._table_v = math.nan
        self._table = self._ahead = self._astern = [0.0]

    def thrusts_n(self, supply_v: float | None) -> Sequence[float]:
        """See :meth:`ThrustLaw.thrusts_n`; kept for the next question, which comes with the same voltage."""
        supply = self.supply(supply_v)
        if supply != self._table_v:
            low, high = self._supplies[0], self._supplies[-1]
            if supply <= low or supply >= high:
                end, index = (low, 0) if supply <= low else (high, -1)
                table = self._thrusts[index] * (supply / end) ** 2
            else:
                index = bisect.bisect_right(self._supplies, supply)
                fraction = (supply - self._supplies[index - 1]) / (self._supplies[index] - self._supplies[index - 1])
                table = (1.0 - fraction) * self._thrusts[index - 1] + fraction * self._thrusts[index]
            span = self.drive.span_us
            self._table_v, self._table = supply, table.tolist()
            self._ahead, self._astern = self._table[span:], (-table[span::-1]).tolist()
        return self._table

    def offset_us(self, thrust_n: float, limit_n: float, supply_v: float | None) -> int:
        """The whole pulse whose thrust is nearest."""
        self.thrusts_n(supply_v)
        side, span = self._ahead if thrust_n > 0.0 else self._astern, self.drive.span_us
        wanted = min(abs(thrust_n), limit_n)
        edge = bisect.bisect_right(side, 0.0)
        if edge > span or wanted < 0.5 * side[edge]:
            return 0
        offset = min(max(bisect.bisect_left(side, wanted), edge), span)
        if offset > edge and (side[offset] > limit_n or wanted - side[offset - 1] < side[offset] - wanted):
            offset -= 1
        return offset if thrust_n > 0.0 else -offset

    def thrust_n(self, offset_us: int, supply_v: float | None) -> float:
        span = self.drive.span_us
        return self.thrusts_n(supply_v)[max(-span, min(span, offset_us)) + span]


def law_of(drive: ThrusterDrive) -> ThrustLaw:
    """The law of a drive, by its kind."""
    return CurveLaw(drive) if drive.curve else BrushedLaw(drive)


def laws_of(thrusters: Sequence[Thruster]) -> list[ThrustLaw]:
    """The law of each thruster; those with the same drive share one."""
    laws = {id(drive): law_of(drive) for drive in {id(t.drive): t.drive for t in thrusters}.values()}
    return [laws[id(thruster.drive)] for thruster in thrusters]
