"""Composition root: builds the service and, for SITL, its simulated world."""

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from autopilot import __version__
from autopilot.command.commander import Commander
from autopilot.command.equipment import Equipment
from autopilot.command.margin_check import MarginCheck
from autopilot.command.photographer import Photographer
from autopilot.command.service import Autopilot
from autopilot.command.service_parts import ServiceParts
from autopilot.control.current.current_learning import Basin, EstimatedFlow
from autopilot.control.current.currents import CurrentForecast, EstimatedCurrent, NoCurrent
from autopilot.control.path.workers import BackgroundWorkers
from autopilot.control.protocol import Controller, ControllerContext, create_controller
from autopilot.control.thrust.actuation import Actuation
from autopilot.core.background import BackgroundWorker
from autopilot.core.errors import ConfigError
from autopilot.core.geodesy import Origin
from autopilot.core.guard import Guard
from autopilot.core.markers import MarkerMap
from autopilot.core.nondeterminism import NondeterminismRecorder, NondeterminismSource
from autopilot.core.params import ParamSaving, ParamSet
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.create import create_estimator
from autopilot.log.directory_reader import LogDirectoryReader
from autopilot.mavlink.api import SigningStore
from autopilot.mavlink.server import MavlinkServer
from autopilot.mavlink.stubs import VehicleFacts
from autopilot.mission.store import CurrentCheck, Plans
from autopilot.record.estimator_setup import options_of
from autopilot.run.config import system_id, vehicle_uid
from autopilot.run.provenance import revision
from autopilot.run.recorded_answers import RecordedLogDirectory, WitnessedSaving, WitnessedStore


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class KnownEnvironment:
    """The service's knowledge of vehicle and site, without the ground truth."""

    vehicle: Vehicle
    origin: Origin
    markers: MarkerMap | None
    """The surveyed floor, None without one."""
    floor_depth_m: float | None
    """Depth of the floor that the laser points at, None = unknown."""
    currents: CurrentForecast
    """The controller's knowledge of the current."""
    current_check: CurrentCheck | None = None
    """Judges workspaces by a current map, None without one."""
    pictures: bool = False
    """Whether there is a camera that delivers pictures."""
    controller: str = "nmpc"
    """Name, or package:Class (docs/extend.md); the settings may name another."""
    estimator: str = "ekf"
    """As ``controller``."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ServiceSetup(KnownEnvironment):
    """Components and settings of one service."""

    params: ParamSet
    estimator_asked_by: str | None = None
    """Option, variable or key that names it, for errors."""
    controller_asked_by: str | None = None
    profile: str
    instance: int
    links: int
    """Number of MAVLink links that are open from the start."""
    rates: Mapping[int, float] = field(default_factory=dict)
    """Bytes per second of links that are slow, by number."""
    patience: float
    """Maximum speed of service time relative to a client's clock (factor on timeouts of plan transfers)."""
    saving: ParamSaving | None = None
    """Where parameters are kept that operators set, None = nowhere."""
    signing: SigningStore | None = None
    """Where the signing key is kept, None = nowhere."""
    log_directory: LogDirectoryReader | None = None
    """The logs that clients may download, None = none."""
    waits_for_plans: bool
    """Whether the loop waits for a trajectory that is due (lockstep) or continues (paced)."""
    git: str = field(default_factory=revision)
    """Revision of the code, as reported to clients."""
    nondeterminism: NondeterminismSource = field(default_factory=NondeterminismRecorder)
    """Notes the answers that do not follow from the inputs, for the log; a replay's gives them."""


def forecast_of(kind: str, basin: Basin | str, known: Callable[[], CurrentForecast]) -> CurrentForecast:
    """The controller's current forecast. ``known`` builds it for a ``kind`` of "map"."""
    match kind:
        case "map":
            return known()
        case "none":
            return NoCurrent()
        case "uniform":
            return EstimatedCurrent()
        case _:
            return EstimatedFlow(Basin(basin))


def end_slow_work(parts: ServiceParts, *more: BackgroundWorker) -> None:
    """Cancel pending background work on routes, plans and checks. ``more``: further workers to close."""
    try:
        parts.plans.close()
        parts.guard.run("controller", parts.controller.reset, None)
    finally:
        for worker in (*parts.workers, *more):
            worker.close()


def build_service(
    setup: ServiceSetup,
    *,
    around: Callable[[Controller], Controller] | None = None,
) -> tuple[Autopilot, ServiceParts]:
    """The service and its parts (the runtime needs some of them for persistence and the log). ``around``: puts
    something round the controller.
    """
    params, vehicle, nondeterminism = setup.params, setup.vehicle, setup.nondeterminism
    desks = BackgroundWorkers.beside(blocking=setup.waits_for_plans)
    checks = BackgroundWorker(ThreadPoolExecutor(1, thread_name_prefix="plans"), blocking=setup.waits_for_plans)
    for name, worker in zip((*desks.names, "plans"), (*desks.executors, checks), strict=True):
        worker.witnessed(name, nondeterminism)
    context = ControllerContext(vehicle=vehicle, model=vehicle.to_model(), currents=setup.currents, desks=desks)
    controller = create_controller(setup.controller, context, setup.controller_asked_by)
    controller = controller if around is None else around(controller)
    margin_m = controller.goal_margin_m(params)
    if not (isinstance(margin_m, int | float | np.number) and math.isfinite(margin_m)):
        raise ConfigError(f"{setup.controller}: goal_margin_m() returns {margin_m!r}; return a clearance in metres")
    plans = Plans(
        params, vehicle.radius_m, setup.origin, setup.current_check, checks, lambda: controller.goal_margin_m(params)
    )
    check = MarginCheck(controller, params, plans)
    commander = Commander(
        vehicle,
        params,
        plans,
        controller_check=check,
        speed_m_s=check.planar_speed_m_s,
        has_markers=setup.markers is not None,
    )
    guard = Guard()
    sysid = system_id(params, setup.instance)
    photographer = Photographer(vehicle) if setup.pictures else None
    equipment = Equipment(vehicle)
    parts = ServiceParts(
        equipment=equipment,
        photographer=photographer,
        guard=guard,
        nondeterminism=nondeterminism,
        workers=(*desks.executors, checks, *(() if setup.log_directory is None else (setup.log_directory.worker,))),
        vehicle=vehicle,
        params=params,
        plans=plans,
        estimator=create_estimator(
            setup.estimator,
            vehicle,
            setup.markers,
            floor_depth_m=setup.floor_depth_m,
            options=options_of(params),
            shadow=params["EST_SHADOW"] > 0.0,
            asked_by=setup.estimator_asked_by,
        ),
        controller=controller,
        actuation=Actuation(vehicle, params),
        commander=commander,
        server=MavlinkServer(
            sysid=sysid,
            profile=setup.profile,
            params=params,
            plans=plans,
            vehicle=commander,
            version=__version__,
            git=setup.git,
            uid=vehicle_uid(setup.instance),
            links=range(setup.links),
            patience=setup.patience,
            guard=guard,
            saving=None if setup.saving is None else WitnessedSaving(setup.saving, nondeterminism),
            signing=None if setup.signing is None else WitnessedStore(setup.signing, nondeterminism),
            log_directory=None
            if setup.log_directory is None
            else RecordedLogDirectory(setup.log_directory, nondeterminism),
            nondeterminism=nondeterminism,
            rates=setup.rates,
            camera=photographer,
            equipment=equipment,
            facts=VehicleFacts(
                sysid=sysid,
                thrusters=len(vehicle.thrusters),
                full_v=vehicle.battery.open_circuit_v,
                empty_v=vehicle.battery.empty_v,
                gripper=any(output.kind == "gripper" for output in vehicle.payload),
            ),
        ),
    )
    return Autopilot(parts), parts
