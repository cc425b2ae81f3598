"""Battery: the voltage decreases linearly with the energy drawn and with the current.

EMF = open_circuit - (open_circuit - empty) * drawn / capacity, terminals = EMF - I R, I = P / V.
"""

import math

from autopilot.core.vehicle import Battery as BatteryTable


class SimulatedBattery:
    """One battery, full at the start."""

    def __init__(self, table: BatteryTable) -> None:
        self._table = table
        self._drawn_j = 0.0
        self.used_j = 0.0
        """Energy delivered at the terminals, integral of the power [J]."""
        self.voltage_v = table.open_circuit_v
        """At the terminals [V]."""
        self.current_a = 0.0
        """Out of the battery [A]."""

    @property
    def remaining(self) -> float:
        """Share of the capacity that is left, 0..1. Losses inside the battery count as drawn."""
        return max(0.0, 1.0 - self._drawn_j / self._table.capacity_j)

    @property
    def empty(self) -> bool:
        """True once the capacity is used up: nothing turns any more."""
        return self._drawn_j >= self._table.capacity_j

    def lose(self, remaining: float) -> None:
        """No more than this share of the capacity is left from now on."""
        self._drawn_j = max(self._drawn_j, (1.0 - remaining) * self._table.capacity_j)

    def load(self, power_w: float) -> None:
        """Set voltage and current for a power drawn now. More than the battery can give sags to half its EMF."""
        table = self._table
        emf = table.empty_v + (table.open_circuit_v - table.empty_v) * self.remaining
        root = emf * emf - 4.0 * power_w * table.internal_resistance_ohm
        self.voltage_v = 0.5 * (emf + math.sqrt(max(root, 0.0)))
        self.current_a = power_w / self.voltage_v

    def step(self, begin_w: float, end_w: float, dt_s: float) -> None:
        """Draw a power that changes evenly from ``begin_w`` to ``end_w`` in ``dt_s``."""
        mean_w = 0.5 * (begin_w + end_w)
        self.load(end_w)
        self.used_j += mean_w * dt_s
        self._drawn_j += (mean_w + self.current_a * self.current_a * self._table.internal_resistance_ohm) * dt_s
