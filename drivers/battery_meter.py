"""Energy used and remaining charge from voltage and current, common to all battery monitors."""

from autopilot.core.samples import PowerSample, plausible
from autopilot.core.vehicle import BatteryLimits, Vehicle
from autopilot.drivers.i2c import I2cBus, I2cSensor

LONGEST_GAP_US = 2_000_000
"""Largest gap over which the present power is integrated: the power in a longer one is unknown."""


class EnergyMeter:
    """Integrates power over time."""

    def __init__(self, capacity_j: float, limits: BatteryLimits) -> None:
        self._capacity_j = capacity_j
        self._limits = limits
        self._used_j = 0.0
        self._last: tuple[int, float] | None = None

    def sample(self, t_us: int, voltage_v: float, current_a: float) -> PowerSample | None:
        """The sample of a reading; None if it is implausible for any battery. A reading outside of this battery's
        range is not integrated: the service rejects it.
        """
        power_w = voltage_v * current_a
        before_us, before_w = (t_us, power_w) if self._last is None else self._last
        gap_s = 1e-6 * min(max(0, t_us - before_us), LONGEST_GAP_US)
        if not self._limits.can_be(voltage_v):
            power_w = before_w = 0.0
        used_j = max(0.0, self._used_j + 0.5 * (power_w + before_w) * gap_s)
        remaining = min(1.0, max(0.0, 1.0 - used_j / self._capacity_j))
        sample = PowerSample(
            t_us=t_us, voltage_v=voltage_v, current_a=current_a, energy_used_j=used_j, remaining=remaining
        )
        if not plausible(sample):
            return None
        self._used_j, self._last = used_j, (t_us, power_w)
        return sample


class BatteryMonitor(I2cSensor):
    """A battery monitor on an I2C bus."""

    def __init__(self, vehicle: Vehicle, number: int, bus: I2cBus | None) -> None:
        super().__init__(number, bus)
        self._meter = EnergyMeter(vehicle.battery.capacity_j, vehicle.battery.limits)
        self._next_us = -(1 << 62)
        self.bad_samples = 0
        """Readings that no battery gives."""

    def _samples(self, t_us: int, voltage_v: float, current_a: float) -> list[PowerSample]:
        sample = self._meter.sample(t_us, voltage_v, current_a)
        self.bad_samples += sample is None
        return [] if sample is None else [sample]
