"""``autopilot doctor``: whether the vehicle would arm, and if not, why and what to do.

The service of ``autopilot run`` is run for some seconds on the same devices, parameters and plans and queried for
its reasons against arming. Its links only listen (:mod:`autopilot.run.doctor_links`), so that nobody can arm it
meanwhile, and files are copies. In addition rates, noise and plausibility of the measurements are checked. Nothing
moves.
"""

import contextlib
import re
import shutil
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from autopilot.command.arming import CHECKING
from autopilot.core.clock import TICK_US
from autopilot.core.errors import AutopilotError
from autopilot.core.messages import Inputs, LoopStats, NavHealth, Outputs
from autopilot.core.plan import PlanKind
from autopilot.core.samples import CameraFrame
from autopilot.drivers.links import open_link
from autopilot.drivers.protocols import Link
from autopilot.drivers.retry import DeviceState
from autopilot.run.config import EffectiveSettings, system_id
from autopilot.run.doctor_computer import (
    CONTROL_S,
    FLOWN_S,
    FlightLoads,
    FlightTests,
    ServiceLoad,
    ThreadMeter,
    judge_load,
)
from autopilot.run.doctor_links import ListeningLink, Speaker, company
from autopilot.run.doctor_samples import judge_samples
from autopilot.run.findings import Finding, FindingSeverity, silent_remedy
from autopilot.run.hardware import NAMES, HardwareVehicle
from autopilot.run.hardware_session import open_vehicle, state_folder, vehicle_params
from autopilot.run.session import Session
from autopilot.run.vehicle_config import VehicleConfig

SETTLE_S = 3.0
"""Devices are opened and configured in this time; it is not counted."""
UNCHANGED_S = 2.0
"""Time after which unchanged reasons against arming are final."""
PATIENCE_S = 30.0
"""Additional time while the reasons still change (parameters being read, plans being checked)."""
LEAST_FREE_MB = 500.0
LOW_FREE_MB = 2000.0
"""Free space of the log folder: an hour of log with pictures takes about 2 GB."""
REST = "fix that first"
"""For reasons that name no remedy of their own."""


class _SettledOutputs:
    """An :class:`autopilot.run.outside.Onlooker` that keeps samples after the settling time, and the last outputs."""

    def __init__(self, session_of: Callable[[], Session]) -> None:
        self.samples = defaultdict[type, list[Any]](list)
        self.aids: dict[str, int] = {}
        """When each source was last used."""
        self.reasons: tuple[str, ...] = ()
        self.outputs: Outputs | None = None
        self._session_of = session_of
        self._changed_us = 0
        self.meter = ThreadMeter()
        self._settled = False
        self.ended = False
        """What comes is no longer kept."""

    def tick(self, inputs: Inputs, outputs: Outputs, frames: Sequence[CameraFrame]) -> None:
        self.meter.tick(len(frames))
        if self.ended:
            return
        self.outputs = outputs
        self.aids.update((aid.sensor, outputs.t_us) for aid in outputs.aids if aid.fused)
        reasons = tuple(reason.text for reason in self._session_of().parts.commander.arming_reasons)
        if reasons != self.reasons:
            self.reasons, self._changed_us = reasons, outputs.t_us
        if outputs.t_us > SETTLE_S * 1e6:
            if not self._settled:
                self._settled = True
                self.meter.start()
            for sample in inputs.samples:
                self.samples[type(sample)].append(sample)
            self.samples[CameraFrame] += [frame.t_us for frame in frames]  # the pictures themselves fill the memory

    def loop_stats(self, stats: LoopStats) -> None:
        self.meter.note(stats)

    def settled(self, t_us: int, end_us: int) -> bool:
        """Whether the reasons against arming have stopped changing."""
        if t_us < end_us or t_us > end_us + PATIENCE_S * 1e6:
            return t_us >= end_us
        waits = any(CHECKING in reason for reason in self.reasons)
        return not self.reasons or (not waits and t_us - self._changed_us > UNCHANGED_S * 1e6)


def examine(
    config: VehicleConfig,
    settings: EffectiveSettings,
    seconds: float,
    overrides: dict[str, float] | None = None,
    *,
    instance: int = 0,
    speed: float = 1.0,
    on_tick: Callable[[Outputs], None] = lambda _: None,
    flying: FlightTests | None = None,
) -> list[Finding]:
    """All findings. Runs for ``seconds`` and as long as reasons against arming still change. ``speed``: of the
    devices' time; 0 for emulated devices, which follow the ticks and ``on_tick``. ``flying``: what flying
    takes of the computer is measured with it; None = the computer is not judged.
    """
    given = overrides or {}
    findings = [*_machine(), *_folders(settings)]
    with contextlib.ExitStack() as end:
        copied = end.enter_context(_copied(settings, config, instance, findings))
        if flying is not None:
            copied.put("log", str(Path(copied["log_dir"]) / "doctor.mcap"), "doctor")  # it takes its share in flight
        params, *_ = vehicle_params(copied, config, given, instance)
        speakers: dict[tuple[int, int], Speaker] = {}
        system = system_id(params, instance)
        links = _open_links(copied["connect"], system, speakers, findings)
        try:
            found = _run(config, copied, seconds, given, instance, links, speed, on_tick, flying)
        except AutopilotError as error:
            findings.append(_failed("service", str(error)))
            return findings
    session, settled, devices, computer = found
    findings += computer
    findings += devices
    watched_s = 0.0 if settled.outputs is None else 1e-6 * settled.outputs.t_us - SETTLE_S
    findings += judge_samples(config, settled.samples, max(watched_s, 1e-6))
    findings += _company(tuple(speakers.values()), system)
    findings += _flight(session, settled, config, settings)
    findings += _arming(settled.reasons)
    return findings


def _run(
    config: VehicleConfig,
    settings: EffectiveSettings,
    seconds: float,
    overrides: dict[str, float],
    instance: int,
    links: Sequence[Link],
    speed: float,
    on_tick: Callable[[Outputs], None],
    flying: FlightTests | None,
) -> tuple[Session, _SettledOutputs, list[Finding], list[Finding]]:
    """Run the service for some seconds with neutral thrusters, then close it. Findings on devices and computer."""
    made: list[Session] = []
    settled = _SettledOutputs(lambda: made[0])
    session = open_vehicle(
        settings,
        config,
        overrides,
        instance=instance,
        links=links,
        speed=speed,
        on_tick=on_tick,
        beside=settled,
    )
    made.append(session)
    devices: list[Finding] = []
    computer: list[Finding] = []
    try:
        tick, end_us = 0, round(1e6 * (SETTLE_S + seconds))
        while not settled.settled(tick * TICK_US, end_us):
            tick += 1 + session.runtime.late_ticks(tick + 1)
            session.runtime.tick(tick * TICK_US)
        vehicle = session.device
        assert isinstance(vehicle, HardwareVehicle)
        devices = _devices(vehicle, config)
        load = settled.meter.load()
        settled.ended = True
        if flying is not None:
            cost = int(session.parts.params["MPC_COST"])
            computer = judge_load(load, _flown(session, settled.meter, flying, config, tick), cost)
    finally:
        session.close()
    return session, settled, devices, computer


def _flown(session: Session, meter: ThreadMeter, flying: FlightTests, config: VehicleConfig, tick: int) -> FlightLoads:
    """Load while the service goes on after ``tick`` and the controller flies a vehicle of its own beside it."""
    runtime, loads, every = session.runtime, list[ServiceLoad](), round(CONTROL_S * 1e6 / TICK_US)
    for cost in (0, 1):
        flight = flying.start(config.vehicle, cost)
        try:
            tick += 1 + runtime.late_ticks(tick + 1)
            runtime.tick(tick * TICK_US)
            meter.start()
            for number in range(round(FLOWN_S * 1e6 / TICK_US)):
                tick += 1 + runtime.late_ticks(tick + 1)
                runtime.tick(tick * TICK_US)
                if number % every == 0:
                    flight.step()
            loads.append(meter.load())
        finally:
            flight.close()
    quadratic, energy = loads
    return FlightLoads(by_cost=(quadratic, energy), horizons=flying.horizons(config.vehicle))


def _machine() -> list[Finding]:
    from autopilot.core.compiled import missing, switched_off

    python = ".".join(str(part) for part in sys.version_info[:3])
    why, verdict = missing(), FindingSeverity.WARN if switched_off() else FindingSeverity.FAIL
    return [
        Finding(verdict=FindingSeverity.OK, what="Python", found=python),
        Finding(verdict=FindingSeverity.OK, what="control step", found="compiled")
        if why is None
        else Finding(verdict=verdict, what="control step", found="not compiled", remedy=why),
    ]


def _folders(settings: EffectiveSettings) -> list[Finding]:
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
                Finding(verdict=FindingSeverity.FAIL, what=name, found=f"{folder}: {error.strerror}", remedy=remedy)
            )
            continue
        verdict = (
            FindingSeverity.OK
            if free_mb > LOW_FREE_MB
            else FindingSeverity.WARN
            if free_mb > LEAST_FREE_MB
            else FindingSeverity.FAIL
        )
        remedy = "" if verdict is FindingSeverity.OK else "remove old logs, or set log_quota_mb"
        findings.append(Finding(verdict=verdict, what=name, found=f"{folder}: {free_mb:.0f} MB free", remedy=remedy))
    return findings


@contextlib.contextmanager
def _copied(
    settings: EffectiveSettings, config: VehicleConfig, instance: int, findings: list[Finding]
) -> Iterator[EffectiveSettings]:
    """Settings with a copy of the state files, damaged ones included."""
    kept = state_folder(settings, config, instance)
    with tempfile.TemporaryDirectory(prefix="doctor-") as folder:
        copied = EffectiveSettings(dict(settings.table))
        for name, value in (("state_dir", folder), ("log_dir", folder), ("log", None)):
            copied.put(name, value, "doctor")
        try:
            if kept.exists():
                shutil.copytree(kept, state_folder(copied, config, instance))
        except (OSError, shutil.Error) as error:
            remedy = "give the service the right to read it"
            findings.append(
                Finding(verdict=FindingSeverity.FAIL, what="state_dir", found=f"{kept}: {error}", remedy=remedy)
            )
        yield copied


def _open_links(
    connections: Sequence[str], system: int, speakers: dict[tuple[int, int], Speaker], findings: list[Finding]
) -> list[Link]:
    links: list[Link] = []
    for connection in connections:
        try:
            links.append(ListeningLink(open_link(connection), system, speakers))
        except (AutopilotError, OSError) as error:
            findings.append(_failed("link", str(error)))
    return links


def _devices(vehicle: HardwareVehicle, config: VehicleConfig) -> list[Finding]:
    findings = []
    setups = {NAMES[kind]: setup for kind, setup in config.devices.items()}
    for device in vehicle.devices:
        counts = {name: getattr(device.device, name, 0) for name in ("bad_frames", "bad_samples")}
        bad = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items() if count)
        found = device.state.value + (f" ({bad})" if bad else "")
        up = device.state is DeviceState.UP
        others = ", ".join(map(str, getattr(device.device, "other_systems", ())))
        remedy = "" if up else device.problem or silent_remedy(setups[device.name])
        if not up and others:
            found, remedy = f"{found}; system {others} is heard", "correct `system` in [devices], or MAV_SYS_ID of it"
        verdict = FindingSeverity.OK if up else FindingSeverity.FAIL
        findings.append(Finding(verdict=verdict, what=device.name, found=found, remedy=remedy))
    findings += [
        Finding(verdict=FindingSeverity.WARN, what="Flight controller", found=what, remedy=remedy)
        for what, remedy in vehicle.advice()
    ]
    return findings


def _company(speakers: Sequence[Speaker], system: int) -> list[Finding]:
    verdicts = {True: FindingSeverity.FAIL, None: FindingSeverity.WARN, False: FindingSeverity.OK}
    found = [
        Finding(verdict=verdicts[bad], what="who speaks", found=what, remedy=remedy)
        for bad, what, remedy in company(speakers, system)
    ]
    return found or [Finding(verdict=FindingSeverity.OK, what="who speaks", found="no ground station on our links")]


def _flight(
    session: Session, settled: _SettledOutputs, config: VehicleConfig, settings: EffectiveSettings
) -> list[Finding]:
    """Position, fence and limits."""
    plans, params = session.parts.plans, session.parts.params
    missions, shapes = len(plans.items(PlanKind.MISSION)), len(plans.items(PlanKind.FENCE))
    names = ("ORIGIN_LAT", "ORIGIN_LON")
    given = config.file.place.origin_lat_deg is not None
    set_up = given or any(params[name] != params.spec(name).default for name in names)
    place = f"{plans.origin.lat_deg:.7f} N {plans.origin.lon_deg:.7f} E"
    return [
        _position(settled, config, settings),
        _thing(
            "origin",
            set_up,
            place if set_up else f"not set, {place} stands for it",
            "set it in [place], or from the ground station",
        ),
        _thing("fence", shapes > 0, f"{shapes} items", "draw one in the ground station and upload it"),
        _thing("plan", missions > 0, f"{missions} items", "upload a mission, or fly by hand and go-to only"),
    ]


def _thing(what: str, there: bool, found: str, remedy: str) -> Finding:
    if there:
        return Finding(verdict=FindingSeverity.OK, what=what, found=found)
    return Finding(
        verdict=FindingSeverity.WARN, what=what, found="none on board" if what != "origin" else found, remedy=remedy
    )


def _position(settled: _SettledOutputs, config: VehicleConfig, settings: EffectiveSettings) -> Finding:
    nav = None if settled.outputs is None else settled.outputs.nav
    places = [name for name in ("markers", "external") if name in settled.aids]
    source = "markers in view" if config.has_camera else "VISION_POSITION_ESTIMATE or ODOMETRY"
    used = "it is used too rarely" if places else "nothing of it was used"
    remedy = f"{source}: {used}; " + (
        "put the vehicle over its markers, check map, light and lens"
        if config.has_camera
        else f"let the tracking system send to {' or '.join(settings['connect'])}"
    )
    if nav is None or not places:
        return Finding(verdict=FindingSeverity.FAIL, what="position", found="no source", remedy=remedy)
    sigma_m = float(max(nav.variance[:3])) ** 0.5
    health = nav.health.name.lower().replace("_", " ")
    found = f"{health}, from {', '.join(places)}, sigma {1e3 * sigma_m:.0f} mm"
    good = nav.health is NavHealth.GOOD
    return Finding(
        verdict=FindingSeverity.OK if good else FindingSeverity.FAIL,
        what="position",
        found=found,
        remedy="" if good else remedy,
    )


def _failed(what: str, text: str) -> Finding:
    """A text of the service's: the fault, and after the last sign of that kind outside of parentheses the remedy."""
    found, remedy = text, REST
    outside = re.sub(r"\([^)]*\)", lambda inside: "_" * len(inside[0]), text)
    for sign in ("; ", ": ", ", "):
        at = outside.rfind(sign)
        if at >= 0:
            found, remedy = text[:at], text[at + len(sign) :]
            break
    return Finding(verdict=FindingSeverity.FAIL, what=what, found=found, remedy=remedy)


def _arming(reasons: Sequence[str]) -> list[Finding]:
    """The service's reasons against arming, verbatim."""
    findings = [_failed("arming", reason) for reason in reasons]
    return findings or [Finding(verdict=FindingSeverity.OK, what="arming", found="would be accepted")]


def failed_config(error: AutopilotError) -> list[Finding]:
    return [_failed("configuration", str(error))]
