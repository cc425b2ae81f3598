"""Thrust to servo pulses and back, by the calibrated curve of the drive (Vehicle.drive).

Thruster and amplifier: pulse -> duty -> voltage = duty * supply -> F = c V |V|, with different c forward and reverse
and a band of duty in which the motor does not turn. The inverse jumps that band: a request of at least half the
smallest thrust gets the smallest thrust, a smaller one gets none.
"""

import math
from collections.abc import Sequence

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.vehicle import Drive

ROUNDING = 1e-9
"""Keeps a duty that is a whole pulse in exact arithmetic on that pulse."""

CREDIBLE_SUPPLY = 10.0
"""A supply of more than so many times the nominal one is a broken wire: the nominal one is taken. Less than that part
of it counts as that part: pulses are at their limits long before."""


class Allocation:
    """Inverse and forward curve of one drive. ``supply_v`` is the measured voltage; None = nominal."""

    def __init__(self, drive: Drive) -> None:
        self.drive = drive
        self._edge_us = math.floor(drive.deadband_duty * drive.span_us + ROUNDING) + 1
        """Smallest pulse that turns: strictly beyond the band."""

    @property
    def neutral_us(self) -> int:
        """The pulse that stops a thruster."""
        return self.drive.neutral_us

    def neutral(self, count: int) -> tuple[int, ...]:
        """Neutral pulses for ``count`` thrusters."""
        return (self.drive.neutral_us,) * count

    def _supply(self, supply_v: float | None) -> float:
        if supply_v is None or not 0.0 < supply_v <= CREDIBLE_SUPPLY * self.drive.nominal_supply_v:
            return self.drive.nominal_supply_v
        return max(supply_v, self.drive.nominal_supply_v / CREDIBLE_SUPPLY)

    def pulse_us(self, thrust_n: float, supply_v: float | None = None) -> int:
        """Pulse [us] for one thrust [N]; neutral for anything that is not a number."""
        drive = self.drive
        if not math.isfinite(thrust_n) or thrust_n == 0.0:
            return drive.neutral_us
        supply = self._supply(supply_v)
        sign = 1 if thrust_n > 0.0 else -1
        wanted = min(abs(thrust_n), drive.limit_n)
        coefficient = drive.forward_n_v2 if sign > 0 else drive.reverse_n_v2
        offset = round(math.sqrt(wanted / coefficient) / supply * drive.span_us)
        if offset < self._edge_us:
            smallest = coefficient * (self._edge_us / drive.span_us * supply) ** 2
            if wanted < 0.5 * smallest:
                return drive.neutral_us
            offset = self._edge_us
        offset = min(offset, drive.span_us)
        while offset > self._edge_us and coefficient * (offset / drive.span_us * supply) ** 2 > drive.limit_n:
            offset -= 1
        return drive.neutral_us + sign * offset

    def thrust_n(self, pulse_us: int, supply_v: float | None = None) -> float:
        """Steady thrust [N] of a pulse: the forward curve."""
        drive = self.drive
        offset = max(-drive.span_us, min(drive.span_us, pulse_us - drive.neutral_us))
        if abs(offset) < self._edge_us:
            return 0.0
        volts = offset / drive.span_us * self._supply(supply_v)
        return (drive.forward_n_v2 if offset > 0 else drive.reverse_n_v2) * volts * abs(volts)

    def pulses_us(
        self,
        thrust_n: Sequence[float] | FloatArray,
        supply_v: float | None = None,
        effectiveness: FloatArray | None = None,
    ) -> tuple[int, ...]:
        """Pulses for all thrusters. One that gives only the share ``effectiveness`` (n,) of its thrust gets a larger
        pulse, up to its limit; a dead one (0) stands still."""
        if effectiveness is None:
            return tuple(self.pulse_us(float(thrust), supply_v) for thrust in thrust_n)
        return tuple(
            self.pulse_us(float(thrust) / float(share) if share > 0.0 else 0.0, supply_v)
            for thrust, share in zip(thrust_n, effectiveness, strict=True)
        )

    def thrusts_n(self, pulses_us: Sequence[int], supply_v: float | None = None) -> FloatArray:
        """Steady thrust of sound thrusters, what the pulses will really give."""
        return np.array([self.thrust_n(pulse, supply_v) for pulse in pulses_us])

    def capability_n(self, supply_v: float | None = None) -> float:
        """Largest thrust that both directions reach at this supply, at most the limit: a bound for the controller."""
        supply = self._supply(supply_v)
        weaker = min(self.drive.forward_n_v2, self.drive.reverse_n_v2)
        return min(self.drive.limit_n, weaker * supply * supply)
