"""TE MS5837 pressure sensor on I2C (Blue Robotics Bar30 and Bar02): depth below the surface.

A measurement consists of two conversions, pressure (D1) and temperature (D2); the driver does one short transaction
per poll and never waits. Formulas of both variants after the manufacturer's data sheets, second order included.
"""

import time
from collections.abc import Sequence
from typing import Annotated, Literal

import msgspec

from autopilot.core.errors import DriverError
from autopilot.core.samples import DepthSample
from autopilot.core.toml_table import Positive, Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.base import G_M_S2
from autopilot.drivers.i2c import I2cBus, I2cSensor, register

ADDRESS = 0x76
"""Every MS5837 has this one."""
RESET, READ_ADC, READ_PROM = 0x1E, 0x00, 0xA0
CONVERT_PRESSURE, CONVERT_TEMPERATURE = 0x4A, 0x5A
"""At 8192 samples, the least noise."""
CONVERSION_US = 19_000
"""Data sheet: 18.08 ms at most."""
RESET_S = 0.01
WORDS = 7
MAX_BAD = 5
"""Useless answers in a row after which it is reset."""

Kind = Literal["30ba", "02ba"]
_RANGE_PA: dict[str, tuple[float, float]] = {"30ba": (0.0, 3.2e6), "02ba": (1e3, 2.5e5)}
_RANGE_DEGC = (-30.0, 90.0)


class Ms5837Options(Table, frozen=True, kw_only=True):
    """``[devices.depth]`` of driver "ms5837"."""

    bus: Annotated[int, msgspec.Meta(ge=0)] = 1
    """N of ``/dev/i2c-N``."""
    kind: Kind = "30ba"
    """Bar30 or Bar02."""
    surface_pa: Positive = 101_325.0
    """Pressure at the surface, as the sensor reads it in air."""
    density_kg_m3: Annotated[float, msgspec.Meta(ge=900.0, le=1100.0)] = 998.0
    """Of the water: 998 fresh, 1025 sea."""
    sigma_m: Positive = 0.01


def crc4(words: Sequence[int]) -> int:
    """Checksum of the calibration words, which stands in the first four bits of the first (data sheet's routine)."""
    rest = 0
    for index, word in enumerate([words[0] & 0x0FFF, *words[1:], 0]):
        for byte in (word >> 8, word & 0xFF):
            rest ^= byte
            for _ in range(8):
                rest = (rest << 1) ^ 0x3000 if rest & 0x8000 else rest << 1
        assert index < 8
    return rest >> 12 & 0xF


def compensated(kind: Kind, words: Sequence[int], d1: int, d2: int) -> tuple[float, float]:
    """Pressure [Pa] and temperature [degC] of two conversions; ``words`` is the calibration, C1 at index 1."""
    c1, c2, c3, c4, c5, c6 = words[1:7]
    dt = d2 - c5 * 256
    temp = 2000 + dt * c6 / 2**23
    below = temp - 2000
    if kind == "30ba":
        offset, slope = c2 * 2**16 + c4 * dt / 2**7, c1 * 2**15 + c3 * dt / 2**8
        if below < 0:
            temp_less, offset_less, slope_less = 3 * dt**2 / 2**33, 1.5 * below**2, 5 * below**2 / 8
            if temp < -1500:
                offset_less += 7 * (temp + 1500) ** 2
                slope_less += 4 * (temp + 1500) ** 2
        else:
            temp_less, offset_less, slope_less = 2 * dt**2 / 2**37, below**2 / 16, 0.0
        tenths_mbar = (d1 * (slope - slope_less) / 2**21 - (offset - offset_less)) / 2**13
        return 10.0 * tenths_mbar, (temp - temp_less) / 100
    offset, slope = c2 * 2**17 + c4 * dt / 2**6, c1 * 2**16 + c3 * dt / 2**7
    temp_less = offset_less = slope_less = 0.0
    if below < 0:
        temp_less, offset_less, slope_less = 11 * dt**2 / 2**35, 31 * below**2 / 8, 63 * below**2 / 32
    hundredths_mbar = (d1 * (slope - slope_less) / 2**21 - (offset - offset_less)) / 2**15
    return hundredths_mbar, (temp - temp_less) / 100


class Ms5837(I2cSensor):
    """The driver: a :class:`autopilot.drivers.protocols.Sensor`."""

    Options = Ms5837Options

    def __init__(self, vehicle: Vehicle, options: Ms5837Options, *, bus: I2cBus | None = None) -> None:
        """At the rate of the vehicle file's ``[depth_sensor]``, or the sensor's own if that is less."""
        super().__init__(options.bus, bus)
        self._options = options
        self._period_us = max(round(1e6 / vehicle.depth_sensor.rate_hz), 2 * CONVERSION_US)
        self._words: tuple[int, ...] = ()
        self._stage: Literal["idle", "pressure", "temperature"] = "idle"
        self._requested_us = self._start_us = 0
        self._next_us: int | None = None
        self._d1 = 0
        self._bad = 0
        self.bad_samples = 0
        """Readings that no water gives."""
        self.pressure_pa: float | None = None
        """Last reading, absolute."""

    def open(self) -> None:
        """Reset the sensor and read its calibration. DriverError or OSError if it is not there."""
        self._bus.open()
        self._bus.write(ADDRESS, bytes([RESET]))
        time.sleep(RESET_S)
        self._words = self._calibration()
        self._stage, self._next_us, self._bad = "idle", None, 0

    def poll(self, t_us: int) -> list[DepthSample]:
        """One small step of a measurement; the sample with the last."""
        if self._stage == "idle":
            if self._next_us is None or t_us >= self._next_us:
                # Paced by the plan and not by the poll; after a pause the plan begins anew.
                behind = self._next_us is None or t_us - self._next_us > self._period_us
                self._next_us = (t_us if behind or self._next_us is None else self._next_us) + self._period_us
                self._start_us = t_us
                self._convert(CONVERT_PRESSURE, "pressure", t_us)
        elif t_us - self._requested_us >= CONVERSION_US:
            if self._stage == "pressure":
                self._d1 = self._adc()
                self._convert(CONVERT_TEMPERATURE, "temperature", t_us)
            else:
                self._stage = "idle"
                return self._sample(self._adc())
        return []

    def _convert(self, command: int, stage: Literal["pressure", "temperature"], t_us: int) -> None:
        self._bus.write(ADDRESS, bytes([command]))
        self._stage, self._requested_us = stage, t_us

    def _adc(self) -> int:
        """A conversion; 0 when it was not ready."""
        data = self._bus.exchange(ADDRESS, bytes([READ_ADC]), 3)
        return int.from_bytes(data, "big") if len(data) == 3 else 0

    def _calibration(self) -> tuple[int, ...]:
        words = [register(self._bus, ADDRESS, READ_PROM + 2 * index, 2) for index in range(WORDS)]
        if not any(words[1:]) or crc4(words) != words[0] >> 12:
            raise DriverError("calibration words have a wrong checksum; check the cable")
        return tuple(words)

    def _sample(self, d2: int) -> list[DepthSample]:
        pressure_pa, temperature_degc = compensated(self._options.kind, self._words, self._d1, d2)
        low_pa, high_pa = _RANGE_PA[self._options.kind]
        sane = low_pa < pressure_pa < high_pa and _RANGE_DEGC[0] < temperature_degc < _RANGE_DEGC[1]
        if not (self._d1 and d2 and sane):
            self.bad_samples += 1
            self._bad += 1
            if self._bad >= MAX_BAD:
                raise DriverError("gives no sensible pressure; check `kind` and cable")
            return []
        self._bad = 0
        self.pressure_pa = pressure_pa
        depth_m = (pressure_pa - self._options.surface_pa) / (self._options.density_kg_m3 * G_M_S2)
        taken_us = self._start_us + CONVERSION_US // 2
        return [DepthSample(t_us=taken_us, depth_m=depth_m, sigma_m=self._options.sigma_m)]
