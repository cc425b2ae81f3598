"""``autopilot doctor``: what is there of a vehicle, how well it works, what is wrong and how to mend it.

Nothing is armed and nothing is written but the log folder, if it is not there. What devices have against flying comes
from the same place as at arming (:meth:`autopilot.run.hardware.HardwareVehicle.refusals`); to it come what only a look
over some seconds shows: rates and noise.
"""

import shutil
import sys
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.core.clock import TICK_US
from autopilot.core.errors import AutopilotError
from autopilot.core.samples import (
    AhrsSample,
    CameraFrame,
    DepthSample,
    ImuSample,
    LeakSample,
    PowerSample,
    VelocitySample,
)
from autopilot.core.vehicle import Vehicle
from autopilot.run.clocks import make_clock
from autopilot.run.config import Settings
from autopilot.run.hardware import HardwareVehicle
from autopilot.run.vehicle_config import VehicleConfig

SETTLE_S = 3.0
"""Devices are opened and configured in this time; it is not counted."""
ENOUGH = 0.7
"""Share of the vehicle file's rate below which a sensor is too slow."""
LEAST_FREE_MB = 500.0
LOW_FREE_MB = 2000.0
"""Free space of the log folder: an hour of log with pictures takes about 2 GB."""
STILL_ACCEL_M_S2, STILL_RATE_RAD_S = 1.5, 0.2
"""A vehicle on the bench shakes less."""


class Verdict(Enum):
    """How bad it is."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One line of the doctor's."""

    verdict: Verdict
    what: str
    found: str
    remedy: str = ""


def examine(config: VehicleConfig, settings: Settings, seconds: float) -> list[Finding]:
    """All findings. The devices are looked at for ``seconds``."""
    findings = [*_machine(), *_folders(settings)]
    vehicle = HardwareVehicle(config)
    try:
        samples = _listen(vehicle, seconds)
        findings += _devices(vehicle, round(1e6 * (SETTLE_S + seconds)))
        findings += _rates(config.vehicle, config, samples, seconds)
    finally:
        vehicle.close()
    return findings


def _machine() -> list[Finding]:
    from autopilot.core.compiled import missing

    python = ".".join(str(part) for part in sys.version_info[:3])
    slow = missing()
    return [
        Finding(verdict=Verdict.OK, what="Python", found=python),
        Finding(verdict=Verdict.OK, what="control step", found="compiled")
        if slow is None
        else Finding(verdict=Verdict.WARN, what="control step", found="not compiled: slower", remedy=slow),
    ]


def _folders(settings: Settings) -> list[Finding]:
    findings = []
    for name in ("log_dir", "state_dir"):
        folder = Path(settings[name])
        try:
            folder.mkdir(parents=True, exist_ok=True)
            free_mb = shutil.disk_usage(folder).free / 1e6
            probe = folder / ".doctor"
            probe.write_bytes(b"")
            probe.unlink()
        except OSError as error:
            remedy = f"give the service the right to write there, or set {name} elsewhere"
            findings.append(
                Finding(verdict=Verdict.FAIL, what=name, found=f"{folder}: {error.strerror}", remedy=remedy)
            )
            continue
        verdict = Verdict.OK if free_mb > LOW_FREE_MB else Verdict.WARN if free_mb > LEAST_FREE_MB else Verdict.FAIL
        remedy = "" if verdict is Verdict.OK else "remove old logs, or set log_quota_mb"
        findings.append(Finding(verdict=verdict, what=name, found=f"{folder}: {free_mb:.0f} MB free", remedy=remedy))
    return findings


def _listen(vehicle: HardwareVehicle, seconds: float) -> dict[type, list[Any]]:
    """What the devices say, by type."""
    clock, samples = make_clock(1.0), defaultdict[type, list[Any]](list)
    for tick in range(1, round((SETTLE_S + seconds) * 1e6 / TICK_US) + 1):
        t_us = clock.wait_until(tick * TICK_US)
        vehicle.advance(t_us)
        heard = [*vehicle.poll(t_us), *vehicle.frames(t_us)]
        if t_us > SETTLE_S * 1e6:
            for sample in heard:
                samples[type(sample)].append(sample)
    return samples


def _devices(vehicle: HardwareVehicle, t_us: int) -> list[Finding]:
    findings = []
    for device in vehicle.devices:
        counts = {name: getattr(device.device, name, 0) for name in ("bad_frames", "bad_samples")}
        told = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items() if count)
        found = device.state.value + (f" ({told})" if told else "")
        remedy = device.problem or ("check power and settings" if device.state.value != "up" else "")
        verdict = Verdict.OK if device.state.value == "up" else Verdict.FAIL
        findings.append(Finding(verdict=verdict, what=device.name, found=found, remedy=remedy))
    below = vehicle.below(t_us)
    told_already = {finding.remedy for finding in findings}
    for text in () if below is None else below.refusals:
        if text not in told_already:
            what, _, remedy = text.rpartition(": ")
            findings.append(Finding(verdict=Verdict.FAIL, what="arming", found=what, remedy=remedy))
    findings += [
        Finding(verdict=Verdict.WARN, what="Flight controller", found=what, remedy=remedy)
        for what, remedy in vehicle.advice()
    ]
    return findings


def _rates(vehicle: Vehicle, config: VehicleConfig, samples: dict[type, list[Any]], seconds: float) -> list[Finding]:
    wanted: list[tuple[str, tuple[type, ...], float | None, Callable[[Sequence[Any]], str]]] = [
        ("attitude", (AhrsSample, ImuSample), vehicle.ahrs.rate_hz, _shaking),
        ("depth", (DepthSample,), vehicle.depth_sensor.rate_hz if "depth" in config.devices else None, _depth),
        ("velocity", (VelocitySample,), vehicle.dvl.rate_hz if "dvl" in config.devices else None, _nothing),
        ("pictures", (CameraFrame,), vehicle.eye.rate_hz if config.has_camera else None, _nothing),
        ("battery", (PowerSample,), None, _power),
        ("leak", (LeakSample,), None, _leak),
    ]
    findings = []
    for name, kinds, rate_hz, describe in wanted:
        found = [sample for kind in kinds for sample in samples.get(kind, ())]
        if not found and rate_hz is None:
            continue
        rate = len(found) / seconds
        text = f"{rate:.1f} Hz" + (describe(found) if found else "")
        slow = rate_hz is not None and rate < ENOUGH * rate_hz
        bad = text.endswith("!")
        verdict = Verdict.FAIL if slow or bad else Verdict.OK
        remedy = f"{rate_hz:g} Hz expected by the vehicle file: check baud rate, divider, load" if slow else ""
        findings.append(
            Finding(verdict=verdict, what=name, found=text, remedy=remedy or ("mend that first" if bad else ""))
        )
    return findings


def _nothing(_: Sequence[Any]) -> str:
    return ""


def _shaking(found: Sequence[Any]) -> str:
    accel = np.array([sample.accel_frd_m_s2 for sample in found])
    rate = np.array([sample.rate_frd_rad_s for sample in found])
    size = float(np.linalg.norm(accel.mean(axis=0)))
    text = f", noise {accel.std(axis=0).max():.3f} m/s2 and {rate.std(axis=0).max():.4f} rad/s, weight {size:.2f} m/s2"
    return text + (": no gravity!" if abs(size - 9.81) > STILL_ACCEL_M_S2 else "")


def _depth(found: Sequence[Any]) -> str:
    depths = np.array([sample.depth_m for sample in found])
    return f", {depths.mean():.3f} m, noise {1e3 * depths.std():.1f} mm"


def _power(found: Sequence[Any]) -> str:
    last = found[-1]
    return f", {last.voltage_v:.1f} V, {last.current_a:.1f} A, {100.0 * last.remaining:.0f} % left"


def _leak(found: Sequence[Any]) -> str:
    return ", water in the hull!" if found[-1].wet else ", dry"


def failed_config(error: AutopilotError) -> list[Finding]:
    """What is said when the configuration itself is no good."""
    return [Finding(verdict=Verdict.FAIL, what="configuration", found=str(error))]
