"""Everything that one flight over markers can calibrate: latency, extrinsics and laser, each with the vehicle file that
the step before has found.
"""

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from autopilot.calibrate.extrinsics import extrinsic_values, fit_lever_arm, mounting_rpy_rad
from autopilot.calibrate.laser_dots import log_dots
from autopilot.calibrate.laser_fit import beam_values, fit_beam
from autopilot.calibrate.motion_fit import degrees, fit_motion, latency_values
from autopilot.calibrate.recorded_flight import CameraFlight, read_flight
from autopilot.calibrate.vehicle_edit import Changes, edited, vehicle_text
from autopilot.core.errors import AutopilotError, ConfigError, LogError
from autopilot.core.toml_table import convert
from autopilot.core.vehicle import Vehicle

_SHOWN_BY = {
    "x": "turn about the vertical",
    "y": "turn about the vertical",
    "z": "roll and pitch by some degrees to and fro, by hand if need be",
}
"""Component of the lever arm -> the manoeuvre that shows it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    name: str
    value: float
    sigma: float
    unit: str
    before: float
    """In the vehicle file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    name: str
    findings: tuple[Finding, ...] = ()
    keys: Changes
    """Of the vehicle file."""
    kept: tuple[tuple[str, str], ...] = ()
    """What stays as it was, and what would show it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightCalibration:
    flight: CameraFlight
    """With the new vehicle file."""
    steps: tuple[Step, ...]
    failed: tuple[tuple[str, str], ...]
    """Steps that found nothing, and why."""
    text: str
    """Of the new vehicle file."""


def calibrate_flight(log: Path, vehicle: str | None = None, markers: Path | None = None) -> FlightCalibration:
    """All steps in order; one that fails leaves its keys as they are.

    LogError or ConfigError if the log or the files cannot be used at all."""
    flight = read_flight(log, vehicle, markers)
    origin, text = vehicle_text(vehicle or flight.vehicle.name)
    if vehicle is None and _vehicle(text, origin) != flight.vehicle:
        raise ConfigError(
            f"{log}: was flown with another vehicle file than the shipped {flight.vehicle.name!r}; give it by --vehicle"
        )
    steps: list[Step] = []
    failed: list[tuple[str, str]] = []
    todo: list[tuple[str, Callable[[CameraFlight], Step]]] = [("latency", _latency), ("extrinsics", _extrinsics)]
    if flight.vehicle.laser is not None:
        todo.append(("laser", lambda known: _laser(log, known)))
    for name, fit in todo:
        try:
            step = fit(flight)
            text = edited(text, step.keys, f"autopilot calibrate flight, {name}: {log.name}", origin)
        except AutopilotError as error:
            failed.append((name, str(error)))
        else:
            steps.append(step)
            flight = flight.with_vehicle(_vehicle(text, origin))
    return FlightCalibration(flight=flight, steps=tuple(steps), failed=tuple(failed), text=text)


def _vehicle(text: str, origin: str) -> Vehicle:
    vehicle: Vehicle = convert(tomllib.loads(text), Vehicle, origin)
    return vehicle


def _latency(flight: CameraFlight) -> Step:
    values = latency_values(flight, fit_motion(flight))
    offset_s, sigma_s = values.values()
    found = Finding(
        name="camera time offset",
        value=1e3 * offset_s,
        sigma=1e3 * sigma_s,
        unit="ms",
        before=1e3 * flight.vehicle.eye.time_offset_s,
    )
    return Step(name="latency", findings=(found,), keys=values)


def _extrinsics(flight: CameraFlight) -> Step:
    fit, eye = fit_motion(flight), flight.vehicle.eye
    arm = fit_lever_arm(flight, fit)
    values = extrinsic_values(flight, fit, arm)
    findings = [
        Finding(name=f"camera {name}", value=value, sigma=sigma, unit="deg", before=math.degrees(before))
        for name, value, sigma, before in zip(
            ("roll", "pitch", "yaw"),
            degrees(mounting_rpy_rad(fit.r_frd_from_cam)),
            degrees(fit.sigma_mounting_rad),
            eye.mounting_rpy_rad,
            strict=True,
        )
    ]
    seen = np.zeros(3, dtype=bool) if arm is None else arm.observable
    kept = [(f"camera {axis}", _SHOWN_BY[axis]) for axis, good in zip("xyz", seen, strict=True) if not good]
    if "camera.position_frd_m" in values:
        place, sigma_m = values["camera.position_frd_m"], values["camera.position_sigma_m"]
        findings += [
            Finding(
                name=f"camera {'xyz'[n]}",
                value=1e3 * place[n],
                sigma=1e3 * sigma_m[n],
                unit="mm",
                before=1e3 * eye.position_frd_m[n],
            )
            for n in np.flatnonzero(seen).tolist()
        ]
    return Step(name="extrinsics", findings=tuple(findings), keys=values, kept=tuple(kept))


def _laser(log: Path, flight: CameraFlight) -> Step:
    beam = fit_beam(log_dots(log, flight), flight.camera)
    before = flight.vehicle.laser
    if before is None:
        raise LogError("the vehicle has no [laser]")
    values = beam_values(beam, flight.camera, flight.vehicle)
    across = np.abs(flight.camera.r_frd_from_cam[:2, :2])
    slope_sigma, base_sigma_m = across @ beam.sigma_slope, across @ beam.sigma_base_m
    findings = []
    for n, axis in enumerate("xy"):
        findings.append(
            Finding(
                name=f"beam towards {axis}",
                value=math.degrees(values["laser.direction_frd"][n]),
                sigma=math.degrees(slope_sigma[n]),
                unit="deg",
                before=math.degrees(before.direction_frd[n] / before.direction_frd[2]),
            )
        )
        findings.append(
            Finding(
                name=f"laser {axis}",
                value=1e3 * values["laser.position_frd_m"][n],
                sigma=1e3 * float(base_sigma_m[n]),
                unit="mm",
                before=1e3 * before.position_frd_m[n],
            )
        )
    return Step(name="laser", findings=tuple(findings), keys=values)
