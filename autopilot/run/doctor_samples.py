"""Rates and plausibility of a vehicle's measurements over some seconds."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from autopilot.core.sensors import SENSOR_ROWS, SensorRow
from autopilot.drivers.devices import CAMERA, FLIGHT_CONTROLLER
from autopilot.run.findings import Finding, FindingSeverity, slow_remedy
from autopilot.run.vehicle_config import VehicleConfig

ENOUGH, TOO_MUCH = 0.7, 1.5
"""Share of the vehicle file's rate below which a sensor is too slow, and above which it is another."""
GRAVITY_M_S2, STILL_ACCEL_M_S2, STILL_RATE_RAD_S = 9.81, 1.5, 0.2
"""A vehicle that lies or floats shakes less."""
SHALLOWEST_M, BELOW_FLOOR_M, DEEPEST_M = -0.5, 0.5, 300.0
"""Plausible depths: weather changes the zero by 0.3 m; a floor, where one is known, has an error; no vehicle here
goes deeper."""
HIGHEST_CHARGE, DEAD_SHARE = 1.1, 0.7
"""Shares of the battery's full and empty voltage beyond which no battery of that kind is."""

ENOUGH_EQUAL = 5
"""Equal readings in a row that count as frozen: the last digits of every sensor here are noise."""
REPEATS = "it repeats itself: restart it, check its cable"

LEAST_HZ = 0.5
"""Least rate of new readings from a flight controller; the slowest (battery) sends two a second."""
AHRS = "ahrs"

Problem = tuple[FindingSeverity, str]
"""Severity and remedy."""
SampleCheck = Callable[[Sequence[Any]], tuple[str, Problem | None]]
"""Finding about samples, and its problem."""


def judge_samples(config: VehicleConfig, samples: dict[type, list[Any]], seconds: float) -> list[Finding]:
    """A line for each kind of measurement. ``samples`` of ``seconds``, by type."""
    devices = config.devices
    findings = []
    for row in SENSOR_ROWS:
        if not row.measures:
            continue
        name, rate_hz, check = (
            row.measures,
            _wanted_hz(config, row),
            _SAMPLE_CHECKS.get(row.device, _reading)(config, row),
        )
        found = [sample for each in row.kinds for sample in samples.get(each, ())]
        rate = len(found) / seconds
        controlled = rate_hz is None and row.controller_message and FLIGHT_CONTROLLER in devices
        if controlled and rate < LEAST_HZ:
            remedy = f"no new {row.controller_message} comes: check the sensor at the flight controller"
            findings.append(Finding(verdict=FindingSeverity.WARN, what=name, found=f"{rate:.1f} Hz", remedy=remedy))
            continue
        if not found and rate_hz is None:
            continue
        text, problem = check(found) if found else ("", None)
        if rate_hz is not None and (found or problem is None):
            setup = devices.get(row.device, devices.get(FLIGHT_CONTROLLER))
            problem = _rate_problem(rate, rate_hz, slow_remedy(setup)) or problem
        verdict, remedy = problem or (FindingSeverity.OK, "")
        findings.append(Finding(verdict=verdict, what=name, found=f"{rate:.1f} Hz{text}", remedy=remedy))
    return findings


def _rate_problem(rate: float, rate_hz: float, remedy: str) -> Problem | None:
    if rate < ENOUGH * rate_hz:
        return FindingSeverity.FAIL, f"{rate_hz:g} Hz expected by the vehicle file: {remedy}"
    if rate > TOO_MUCH * rate_hz:
        return FindingSeverity.WARN, f"{rate_hz:g} Hz expected by the vehicle file: correct it, or the device's rate"
    return None


def _wanted_hz(config: VehicleConfig, row: SensorRow) -> float | None:
    """Rate by the vehicle file, at most what is asked of a flight controller; None where none is wanted or known."""
    if row.device == CAMERA:
        return config.vehicle.eye.rate_hz if config.has_camera else None
    if not row.table or (row.device != AHRS and row.device not in config.devices):
        return None
    wanted_hz = float(getattr(config.vehicle, row.table).rate_hz)
    setup = config.devices.get(row.device, config.devices.get(FLIGHT_CONTROLLER))
    return min(wanted_hz, getattr(None if setup is None else setup.options, f"{row.device}_most_hz", wanted_hz))


def _reading(_: VehicleConfig, row: SensorRow) -> SampleCheck:
    """Of a sensor of which no more is known: mean and noise of a reading that is one number."""

    def check(found: Sequence[Any]) -> tuple[str, Problem | None]:
        readings = np.array([getattr(sample, row.reading) for sample in found] if row.reading else [])
        if readings.ndim != 1 or not len(readings):
            return "", None
        text = f", {readings.mean():.3f} {row.reading.rsplit('_', 1)[-1]}, noise {readings.std():.4f}"
        stuck = len(readings) >= ENOUGH_EQUAL and readings.max() == readings.min()
        return text, (FindingSeverity.WARN, REPEATS) if stuck else None

    return check


def _attitude(found: Sequence[Any]) -> tuple[str, Problem | None]:
    accel = np.array([sample.accel_frd_m_s2 for sample in found])
    rate = np.array([sample.rate_frd_rad_s for sample in found])
    size, turns = float(np.linalg.norm(accel.mean(axis=0))), float(np.abs(rate.mean(axis=0)).max())
    text = f", noise {accel.std(axis=0).max():.3f} m/s2 and {rate.std(axis=0).max():.4f} rad/s, weight {size:.2f} m/s2"
    if abs(size - GRAVITY_M_S2) > STILL_ACCEL_M_S2:
        return text, (FindingSeverity.FAIL, f"{GRAVITY_M_S2:g} m/s2 expected at rest: check range, mounting and units")
    if len(found) >= ENOUGH_EQUAL and not accel.std(axis=0).any() and not rate.std(axis=0).any():
        return text, (FindingSeverity.FAIL, REPEATS)
    if turns > STILL_RATE_RAD_S:
        return f"{text}, turns at {turns:.2f} rad/s", (
            FindingSeverity.WARN,
            "hold it still; if it is, calibrate the gyro",
        )
    return text, None


def _depth(config: VehicleConfig) -> SampleCheck:
    floor_m = config.file.place.floor_depth_m
    deepest_m = DEEPEST_M if floor_m is None else floor_m + BELOW_FLOOR_M

    def check(found: Sequence[Any]) -> tuple[str, Problem | None]:
        depths = np.array([sample.depth_m for sample in found])
        mean = float(depths.mean())
        text = f", {mean:.3f} m, noise {1e3 * depths.std():.1f} mm"
        if not SHALLOWEST_M <= mean <= deepest_m:
            remedy = f"{SHALLOWEST_M:g} to {deepest_m:g} m can be true: check the sensor, set its zero at the surface"
            return text, (FindingSeverity.FAIL, f"{remedy} (surface_pa, BARO2_GND_PRESS)")
        if len(depths) >= ENOUGH_EQUAL and depths.max() == depths.min():
            return text, (FindingSeverity.WARN, REPEATS)
        return text, None

    return check


def _power(config: VehicleConfig) -> SampleCheck:
    battery = config.vehicle.battery

    def check(found: Sequence[Any]) -> tuple[str, Problem | None]:
        last = found[-1]
        text = f", {last.voltage_v:.1f} V, {last.current_a:.1f} A, {100.0 * last.remaining:.0f} % left"
        low_v, high_v = DEAD_SHARE * battery.empty_v, HIGHEST_CHARGE * battery.open_circuit_v
        if not low_v <= last.voltage_v <= high_v:
            remedy = f"{low_v:.1f} to {high_v:.1f} V can be true: check the monitor's scale, and [battery]"
            return text, (FindingSeverity.FAIL, f"{remedy} of the vehicle file")
        if last.voltage_v < battery.empty_v:
            return text, (FindingSeverity.WARN, f"empty is {battery.empty_v:g} V: charge it")
        return text, None

    return check


def _leak(found: Sequence[Any]) -> tuple[str, Problem | None]:
    if found[-1].wet:
        return ", water in the hull", (FindingSeverity.FAIL, "open and dry it, look at the seals")
    return ", dry", None


_SAMPLE_CHECKS: dict[str, Callable[[VehicleConfig, SensorRow], SampleCheck]] = {
    AHRS: lambda config, row: _attitude,
    "depth": lambda config, row: _depth(config),
    "battery": lambda config, row: _power(config),
    "leak": lambda config, row: _leak,
}
"""Of sensors of which more is known."""
