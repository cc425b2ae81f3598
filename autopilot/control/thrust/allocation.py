"""Thrust to servo pulses and back for all thrusters of a vehicle (:mod:`autopilot.core.thrust_law`)."""

import math
from collections.abc import Sequence

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.thrust_law import laws_of
from autopilot.core.thrusters import Thruster


class Allocation:
    """Inverse and forward curves of a vehicle's thrusters, in the file's order."""

    def __init__(self, thrusters: Sequence[Thruster]) -> None:
        self._thrusters = tuple(thrusters)
        self._laws = laws_of(self._thrusters)
        self._sides = [-1 if thruster.reversed else 1 for thruster in self._thrusters]
        self.neutral_us = tuple(thruster.drive.neutral_us for thruster in self._thrusters)
        """The pulses that stop them."""
        self._able: tuple[float | None, FloatArray] | None = None
        """Supply voltage and capability of the last question: it is asked several times per tick."""

    def pulse_us(self, index: int, thrust_n: float, supply_v: float | None = None) -> int:
        """Pulse [us] for the thrust [N] of one thruster; neutral for anything that is not a number."""
        neutral = self.neutral_us[index]
        if not math.isfinite(thrust_n) or thrust_n == 0.0:
            return neutral
        limit_n = self._thrusters[index].limit_n
        return neutral + self._sides[index] * self._laws[index].offset_us(thrust_n, limit_n, supply_v)

    def thrust_n(self, index: int, pulse_us: int, supply_v: float | None = None) -> float:
        """Steady thrust [N] of one thruster's pulse: the forward curve."""
        offset = self._sides[index] * (pulse_us - self.neutral_us[index])
        return self._laws[index].thrust_n(offset, supply_v)

    def pulses_us(
        self,
        thrust_n: Sequence[float] | FloatArray,
        supply_v: float | None = None,
        effectiveness: FloatArray | None = None,
    ) -> tuple[int, ...]:
        """Pulses for all thrusters. One that gives only the share ``effectiveness`` (n,) of its thrust gets a larger
        pulse, up to its limit; a dead one (0) stands still."""
        wanted: list[float] = np.asarray(thrust_n, dtype=float).tolist()
        if effectiveness is not None:
            factors = effectiveness.tolist()
            wanted = [thrust / factor if factor > 0.0 else 0.0 for thrust, factor in zip(wanted, factors, strict=True)]
        return tuple(self.pulse_us(index, thrust, supply_v) for index, thrust in enumerate(wanted))

    def thrusts_n(self, pulses_us: Sequence[int], supply_v: float | None = None) -> FloatArray:
        """Steady thrust of the pulses for healthy thrusters [N]."""
        return np.array([self.thrust_n(index, pulse, supply_v) for index, pulse in enumerate(pulses_us)])

    def capability_n(self, supply_v: float | None = None) -> FloatArray:
        """(n,) largest thrust that both directions reach at this supply, at most the limits. Not to be written to."""
        if self._able is None or self._able[0] != supply_v:
            able_n = np.array(
                [
                    min(thruster.limit_n, law.capability_n(supply_v))
                    for thruster, law in zip(self._thrusters, self._laws, strict=True)
                ]
            )
            able_n.setflags(write=False)
            self._able = (supply_v, able_n)
        return self._able[1]
