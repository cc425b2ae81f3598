"""A run on a real vehicle: configuration -> devices, service, links, log, loop. What SITL shares stands in
:mod:`autopilot.run.session`."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from autopilot.command.parts import Parts
from autopilot.control.water.currents import NoCurrent
from autopilot.core.desk import Desk
from autopilot.core.lane import DaemonLane
from autopilot.core.marker_files import load_marker_map
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import Outputs
from autopilot.core.origin_params import params_origin
from autopilot.core.param_file import PersistentParams, kept_params
from autopilot.core.params import ParamSet
from autopilot.drivers.protocols import Link
from autopilot.run.assembly import Told, onlooker, service_setup
from autopilot.run.boot_links import BootLinks, open_boot_links
from autopilot.run.compose import ServiceSetup, build_service, forecast_of
from autopilot.run.config import Settings, chosen_part
from autopilot.run.describe import describe_service
from autopilot.run.hardware import HardwareVehicle
from autopilot.run.kept_plans import KeptPlans
from autopilot.run.outside import Onlooker
from autopilot.run.recorder import NullRecorder, RunRecorder
from autopilot.run.service_record import service_attachments
from autopilot.run.session import (
    Kept,
    Outside,
    Session,
    loop_round,
    marker_vision,
    opened,
    take_plans,
)
from autopilot.run.session_log import LogContents, marker_attachment, open_recorder
from autopilot.run.signing_files import SigningFiles
from autopilot.run.stills import StillStore
from autopilot.run.vehicle_config import VehicleConfig, apply_parameters
from autopilot.run.watched import WatchedService
from autopilot.view.controls import ReadOnly
from autopilot.view.foxglove import FoxgloveServer
from autopilot.view.hub import Hub


def open_vehicle_links(
    settings: Settings, config: VehicleConfig, overrides: dict[str, float], *, instance: int
) -> BootLinks:
    """Open a vehicle's links. ConfigError and DriverError name what is wrong; nothing is open then."""
    params, *_ = vehicle_params(settings, config, overrides, instance)
    folder = state_folder(settings, config, instance)
    return open_boot_links(settings["connect"], params, instance, settings["profile"], folder)


def vehicle_params(
    settings: Settings, config: VehicleConfig, overrides: dict[str, float], instance: int, disk: Desk | None = None
) -> tuple[ParamSet, PersistentParams, tuple[str, ...]]:
    """Defaults < the file's < saved by earlier runs < command line; as in SITL (:mod:`autopilot.run.sitl_params`)."""
    params = ParamSet()
    apply_parameters(config, params)
    persistent, warnings = kept_params(state_folder(settings, config, instance), params, overrides, disk)
    return params, persistent, warnings


def state_folder(settings: Settings, config: VehicleConfig, instance: int) -> Path:
    """What an instance keeps between runs."""
    return Path(settings["state_dir"]) / f"{config.vehicle.name}-{instance}"


def open_vehicle(
    settings: Settings,
    config: VehicleConfig,
    overrides: dict[str, float],
    *,
    instance: int = 0,
    links: Sequence[Link] | None = None,
    speed: float = 1.0,
    on_tick: Callable[[Outputs], None] = lambda _: None,
    view: Hub | None = None,
    foxglove: FoxgloveServer | None = None,
    now_s: float | None = None,
    beside: Onlooker | None = None,
) -> Session:
    """Everything of a run. ConfigError, PlanError, DriverError, LogError name what is wrong; nothing runs then.

    ``links``: the connections of the settings if they are already open (:mod:`autopilot.run.boot_links`). ``speed``: of
    the devices' time; 0 where they, being emulated, follow the ticks. ``view``: who looks at the run.
    ``foxglove``: who is sent what is logged. ``now_s``: Unix time at which signatures begin, None = the machine's.
    ``beside``: who looks on instead of these.
    """
    disk = Desk(DaemonLane("disk"), patient=speed == 0.0)
    params, persistent, warnings = vehicle_params(settings, config, overrides, instance, disk)
    markers = None if config.markers is None else load_marker_map(config.markers)
    signing = SigningFiles(state_folder(settings, config, instance), disk, now_s=now_s)
    warnings += signing.warnings
    setup = service_setup(
        settings,
        _told(config, params, markers),
        params,
        instance=instance,
        links=len(settings["connect"]),
        speed=speed,
        saving=persistent,
        signing=signing,
    )
    service, parts = build_service(setup)
    place = state_folder(settings, config, instance) / "plans.json"
    plans = KeptPlans(place, parts.plans, parts.commander, disk, parts.witness)
    plan = None if settings["plan"] is None else Path(settings["plan"])
    warnings += take_plans(parts, plan, plans, flown_at_once=False)
    device = HardwareVehicle(config)
    parts.equipment.leave_out(device.unwired)
    with opened(device, settings["connect"], links) as open_links:
        recorder = _recorder(settings, config, setup, parts, markers, lockstep=speed == 0.0)
    watched = WatchedService(parts, lambda: describe_service(parts, config.file.place.name))
    outside = Outside(
        device=device,
        vision=marker_vision(config.vehicle, markers, paced=speed > 0.0),
        links=open_links,
        peers=(),
        recorder=recorder,
        speed=speed,
        stills=StillStore(recorder, disk, Path(settings["log_dir"])) if config.has_camera else None,
        below=device.below,
        notices=device.take_notices,
        refusals=device.refusals,
        skips=speed > 0.0,
        onlooker=beside
        or onlooker(view, foxglove, watched, config.vehicle, ReadOnly(), simulated=False, pictures=config.has_camera),
    )
    kept = Kept(
        folder=state_folder(settings, config, instance), params=persistent, plans=plans, disk=disk, signing=signing
    )
    return Session(
        vehicle=config.vehicle,
        service=service,
        parts=parts,
        device=device,
        runtime=loop_round(service, parts, outside, kept, warnings, on_tick),
        recorder=recorder,
        kept=kept,
        warnings=warnings,
        duration_s=settings["duration"],
    )


def _told(config: VehicleConfig, params: ParamSet, markers: MarkerMap | None) -> Told:
    """What the service is told of that vehicle and place."""
    return Told(
        vehicle=config.vehicle,
        origin=params_origin(params),
        markers=markers,
        floor_depth_m=config.file.place.floor_depth_m,
        currents=forecast_of(config.file.place.currents, config.file.place.basin, NoCurrent),
        pictures=config.has_camera,
        controller="nmpc",
        estimator="ekf",
    )


def _recorder(
    settings: Settings,
    config: VehicleConfig,
    setup: ServiceSetup,
    parts: Parts,
    markers: MarkerMap | None,
    *,
    lockstep: bool,
) -> RunRecorder | NullRecorder:
    """The log; its time is the clock's."""
    place = config.file.place
    contents = LogContents(
        settings,
        parts,
        lambda: describe_service(parts, place.name),
        estimator=chosen_part(settings, "estimator", "ekf")[0],
        markers=markers,
        floor_depth_m=place.floor_depth_m,
        metadata={
            "config": config.path.name,
            "place": place.name,
            "currents": place.currents,
            "basin": place.basin,
            **{f"device.{kind}": setup.driver for kind, setup in config.devices.items()},
        },
        attachments={
            "config_file.json": msgspec.json.encode(config.file),
            **service_attachments(
                setup, parts, currents=place.currents, basin=place.basin, map_file=None, map_start=None
            ),
            **({} if markers is None else marker_attachment(markers)),
        },
    )
    return open_recorder(settings, parts, contents, epoch_ns=time.time_ns(), lockstep=lockstep)
