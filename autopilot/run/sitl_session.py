"""One SITL run: settings -> scenario, simulated vehicle, service, links, log, loop."""

import contextlib
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, cast

import msgspec

from autopilot import __version__
from autopilot.command.map_check import MapCheck, open_map
from autopilot.command.parts import Parts
from autopilot.command.service import Autopilot
from autopilot.control.water.current_learning import Basin, LearnedCurrent
from autopilot.control.water.current_map import CurrentMap
from autopilot.control.water.currents import (
    OPEN_WATER_SCALE_M,
    TANK_SCALE_M,
    CurrentForecast,
    EstimatedCurrent,
    MappedCurrent,
    NoCurrent,
    PointwiseField,
)
from autopilot.core.camera import CameraModel
from autopilot.core.desk import Desk
from autopilot.core.errors import ConfigError, LogError, PlanError
from autopilot.core.geodesy import Origin
from autopilot.core.lane import DaemonLane
from autopilot.core.marker_files import load_marker_map, marker_file_text
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import Outputs, Severity, ThrusterCommand
from autopilot.core.param_file import PersistentParams
from autopilot.core.params import ParamSaving, ParamSet
from autopilot.core.samples import CameraFrame, Sample
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.log.description import PartOrigin, RunDescription
from autopilot.log.recover import recover_unfinished
from autopilot.log.session import RunLog, free_path, log_path, open_run_log, open_run_log_beside
from autopilot.log.writer import LogHead, Payload
from autopilot.replay.setup import estimator_attachments
from autopilot.run.compose import ServiceSetup, build_service
from autopilot.run.config import Settings, chosen_part, system_id
from autopilot.run.describe import describe_run, plan_items, plans_json
from autopilot.run.doorstep import sitl_params, state_folder
from autopilot.run.kept_plans import KeptPlans
from autopilot.run.parts import part_origins
from autopilot.run.provenance import revision
from autopilot.run.recorder import NullRecorder, RunRecorder
from autopilot.run.runtime import Peer, Runtime, make_clock
from drivers.links import open_link
from drivers.protocols import Link
from estimator.frame_door import FrameDoor
from estimator.vision import MarkerDetector
from estimator.vision_lane import VisionWorker
from mission.loading import load_plan
from mission.plan_files import read_plan
from sitl.backend import SimulatedVehicle, simulated_vehicle
from sitl.currents import current_field
from sitl.floor import told_floor_m, told_markers
from sitl.operator import ScriptedOperator
from sitl.plant import Truth
from sitl.scenario import GridCurrent, Scenario, load_scenario, plan_path, with_vehicle

SITL_EPOCH_NS = int(datetime(2026, 1, 1, tzinfo=UTC).timestamp()) * 1_000_000_000
"""Log time of simulated time zero: fixed, so that two runs of a scenario and seed give the same log."""

FASTEST = 20.0
"""How much faster than real time a run without pace may be: clients get that much more of the service's time."""

THREAD_SWITCH_S = 0.0005
"""Python's default of 5 ms would let a busy thread delay a tick by half its length."""


class SimulatedDevice:
    """The simulated vehicle as the runtime's device."""

    def __init__(self, vehicle: SimulatedVehicle, thrusters: int) -> None:
        self._vehicle = vehicle
        self._thrusters = thrusters
        vehicle.open()

    @property
    def truth(self) -> Truth:
        """The plant's truth, for the log only."""
        return self._vehicle.truth

    def advance(self, t_us: int) -> None:
        """Let the plant go on."""
        self._vehicle.advance(t_us)

    def poll(self, t_us: int) -> Sequence[Sample]:
        """Samples that have arrived."""
        return self._vehicle.poll(t_us)

    def frames(self, t_us: int) -> Sequence[CameraFrame]:
        """Images that have arrived."""
        return self._vehicle.frames(t_us)

    def write(self, t_us: int, command: ThrusterCommand) -> None:
        """Drive the thrusters."""
        self._vehicle.write(command.pwm_us[: self._thrusters])

    def close(self) -> None:
        """Thrusters to neutral."""
        self._vehicle.close()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SitlSession:
    """A run that is ready to go."""

    scenario: Scenario
    vehicle: Vehicle
    service: Autopilot
    parts: Parts
    device: SimulatedDevice
    runtime: Runtime
    recorder: RunRecorder | NullRecorder
    persistent: PersistentParams
    disk: Desk
    """The lane on which both write."""
    kept: KeptPlans | None
    """Where the plans are kept, None when they are not."""
    warnings: tuple[str, ...]
    """What the operator should know of what was kept by earlier runs."""
    operator: ScriptedOperator | None
    duration_s: float | None
    seed: int
    speed: float

    def run(self, stop: Callable[[], bool] = lambda: False) -> float:
        """Run to the end; the result is the wall time it took [s]."""
        begin_s = time.monotonic()
        with contextlib.ExitStack() as end:  # whatever one of them raises, the others are done
            end.callback(self._end_slow_work)
            if self.kept is not None:
                end.callback(self.kept.finish)
            end.callback(self.persistent.finish)
            end.callback(self.recorder.close)
            self.runtime.run(duration_s=self.duration_s, stop=stop)
        return time.monotonic() - begin_s

    def _end_slow_work(self) -> None:
        """Nobody wants routes, plans and checks any more: what has not begun does not begin."""
        try:
            self.parts.plans.close()
            self.parts.controller.reset()
        finally:
            for desk in (*self.parts.desks, self.disk):
                desk.close()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _World:
    """What a scenario and the settings make of the world."""

    scenario: Scenario
    vehicle: Vehicle
    simulated: SimulatedVehicle
    seed: int
    speed: float
    origin: Origin
    """Of the local frame at the start."""
    water: CurrentMap | None
    """The map that the controller is told, None without a file."""
    markers: MarkerMap | None
    """The marker map that the vehicle is told, None when there are no pictures."""
    parts: dict[str, PartOrigin]
    """Where controller, estimator and plant come from."""


def open_sitl(
    settings: Settings,
    overrides: dict[str, float],
    *,
    instance: int = 0,
    log: bool = True,
    links: Sequence[Link] | None = None,
    peers: Sequence[Peer] = (),
    on_tick: Callable[[Outputs], None] = lambda _: None,
) -> SitlSession:
    """Everything of a SITL run. ConfigError, PlanError, DriverError, LogError name what is wrong; nothing runs then.

    ``links``: the connections of the settings if they are already open (:mod:`autopilot.run.doorstep`).
    """
    sys.setswitchinterval(THREAD_SWITCH_S)
    scenario = load_scenario(settings["scenario"])
    if settings["vehicle"] is not None:
        scenario = with_vehicle(scenario, settings["vehicle"], "--vehicle")
    disk = Desk(DaemonLane("disk"), patient=float(settings["speed"]) == 0.0)
    params, persistent, warnings = sitl_params(settings, scenario, overrides, instance, disk)
    world = _world(settings, scenario, params)
    operator = ScriptedOperator(system_id(params, instance)) if settings["start"] else None
    all_peers = (*peers, operator) if operator is not None else tuple(peers)
    links_count = len(settings["connect"]) + len(all_peers)
    service, parts = _service(settings, world, params, instance, links=links_count, saving=persistent)
    plan = _plan(settings, world.scenario)
    kept = _kept_plans(settings, parts, instance, disk)
    if plan is not None:
        problem = load_plan(parts.plans, read_plan(plan), str(plan))
        if problem and operator is not None:
            raise PlanError(f"{plan}: cannot be flown: {problem}; mend the plan, or start without --start")
        if problem:
            print(f"warning: {plan}: {problem}; the vehicle will not arm before that is mended", file=sys.stderr)
        if kept is not None:
            kept.skip()
    elif kept is not None:
        warnings += kept.load()
    device = SimulatedDevice(world.simulated, len(world.vehicle.thrusters))
    opened: list[Link] = [] if links is None else list(links)
    try:
        if links is None:
            opened.extend(open_link(connection) for connection in settings["connect"])
        recorder = _recorder(settings, world, parts, device) if log else NullRecorder()
    except BaseException:
        device.close()
        for link in opened:
            link.close()
        raise
    news: list[tuple[Severity, str]] = [(Severity.WARNING, text) for text in warnings]

    def each_tick(outputs: Outputs) -> None:
        if kept is not None:
            kept.tick(outputs.t_us)
        on_tick(outputs)

    def notices() -> Sequence[tuple[Severity, str]]:
        told = (*news, *recorder.take_notices(), *(() if kept is None else kept.take_notices()))
        news.clear()
        return told

    runtime = Runtime(
        service,
        device,
        _vision(world),
        opened,
        recorder,
        make_clock(world.speed),
        peers=all_peers,
        on_tick=each_tick,
        paced=world.speed > 0.0,
        notices=notices,
    )
    for desk in (*parts.desks, disk):
        desk.idle = runtime.attend
    given_s = settings["duration"]
    return SitlSession(
        scenario=world.scenario,
        vehicle=world.vehicle,
        service=service,
        parts=parts,
        device=device,
        runtime=runtime,
        recorder=recorder,
        persistent=persistent,
        disk=disk,
        kept=kept,
        warnings=warnings,
        operator=operator,
        duration_s=world.scenario.scenario.duration_s if given_s is None else given_s,
        seed=world.seed,
        speed=world.speed,
    )


def _world(settings: Settings, scenario: Scenario, params: ParamSet) -> _World:
    """Scenario, vehicle and the simulated vehicle, and what the controller may know of the water."""
    vehicle = load_vehicle(scenario.vehicle.model)
    seed = scenario.scenario.seed if settings["seed"] is None else settings["seed"]
    sensors = scenario.sensors.position if settings["sensors"] is None else settings["sensors"]
    position = cast(Literal["camera", "pose"], sensors)
    speed = float(settings["speed"])
    plant, plant_by = chosen_part(settings, "plant", scenario.plugins.plant)
    simulated = simulated_vehicle(
        scenario, vehicle, seed=seed, position=position, paced=speed > 0.0, plant=plant, plant_asked_by=plant_by
    )
    origin = Origin(lat_deg=params["ORIGIN_LAT"], lon_deg=params["ORIGIN_LON"], alt_m=params["ORIGIN_ALT"])
    return _World(
        scenario=scenario,
        vehicle=vehicle,
        simulated=simulated,
        seed=seed,
        speed=speed,
        origin=origin,
        water=_map(settings, scenario, origin),
        markers=_told_markers(settings, scenario, simulated.markers),
        parts=part_origins(settings, scenario),
    )


def _told_markers(settings: Settings, scenario: Scenario, true: MarkerMap | None) -> MarkerMap | None:
    """The map of ``--markers``, else what the scenario gives to the vehicle. ConfigError if there is no use for it."""
    if settings["markers"] is None:
        return None if true is None else told_markers(scenario)
    if true is None:
        raise ConfigError("--markers needs pictures, and this run has none; use --sensors camera or leave it out")
    return load_marker_map(Path(settings["markers"]))


def _service(
    settings: Settings, world: _World, params: ParamSet, instance: int, *, links: int, saving: ParamSaving
) -> tuple[Autopilot, Parts]:
    """The service for that world: it learns marker map, floor depth and origin, and nothing of the truth."""
    controller, controller_by = chosen_part(settings, "controller", world.scenario.plugins.controller)
    estimator, estimator_by = chosen_part(settings, "estimator", world.scenario.plugins.estimator)
    return build_service(
        ServiceSetup(
            vehicle=world.vehicle,
            params=params,
            origin=world.origin,
            markers=world.markers,
            floor_depth_m=told_floor_m(world.scenario),
            estimator=estimator,
            estimator_asked_by=estimator_by,
            controller=controller,
            controller_asked_by=controller_by,
            profile=settings["profile"],
            instance=instance,
            currents=_currents(settings, world),
            water=None if world.water is None else MapCheck(world.water, world.origin),
            links=links,
            patience=FASTEST if world.speed == 0.0 else max(1.0, world.speed),
            waits_for_plans=world.speed == 0.0,
            saving=saving,
        )
    )


def _plan(settings: Settings, scenario: Scenario) -> Path | None:
    """The plan to have on board: --plan, or the scenario's when an operator in-process is to start it."""
    if settings["plan"] is not None:
        return Path(settings["plan"])
    if not settings["start"]:
        return None
    plan = plan_path(settings["scenario"], scenario)
    if plan is None:
        raise ConfigError(f"--start: scenario {scenario.scenario.name!r} has no plan; give one with --plan FILE")
    return plan


def _vision(world: _World) -> VisionWorker | None:
    """Detection beside the loop, None when there are no pictures."""
    if world.markers is None:
        return None
    camera = world.vehicle.eye
    detector = MarkerDetector(CameraModel.of(camera, world.vehicle.laser), world.markers)
    return VisionWorker(
        detector,
        delay_s=0.5 * camera.latency_s,
        door=FrameDoor(camera.width_px, camera.height_px),
        paced=world.speed > 0.0,
    )


def _knowledge(settings: Settings, scenario: Scenario) -> str:
    """What the controller is told of the water: the setting, a given map, or what the scenario says."""
    if settings["currents"] is not None:
        return str(settings["currents"])
    return "map" if settings["currents_map"] is not None else scenario.controller.currents


def _map(settings: Settings, scenario: Scenario, origin: Origin) -> CurrentMap | None:
    """The map file of the settings, else the scenario's; None when there is none. ConfigError if it is no good."""
    if _knowledge(settings, scenario) != "map":
        if settings["currents_map"] is not None:
            raise ConfigError(f"--currents-map needs --currents map, not {settings['currents']}")
        return None
    path = settings["currents_map"] or scenario.controller.map
    if path is None and isinstance(scenario.current, GridCurrent):
        path = scenario.current.file
    return None if path is None else open_map(Path(path), origin, settings["currents_start"])


def _currents(settings: Settings, world: _World) -> CurrentForecast:
    """What the controller is told of the current. Without a map file a map is the scenario's own formula."""
    scale_m = OPEN_WATER_SCALE_M if world.scenario.tank is None else TANK_SCALE_M
    match _knowledge(settings, world.scenario):
        case "map" if world.water is not None:
            return MappedCurrent(world.water)
        case "map":
            return MappedCurrent(PointwiseField(current_field(world.scenario.current).velocity, scale_m))
        case "none":
            return NoCurrent()
        case "uniform":
            return EstimatedCurrent()
        case _:
            return LearnedCurrent(Basin(settings["basin"] or world.scenario.controller.basin))


def _kept_plans(settings: Settings, parts: Parts, instance: int, disk: Desk) -> KeptPlans | None:
    """Where plans are kept, None without --keep-plans: a simulation begins anew each time unless it is told to."""
    if not settings["keep_plans"]:
        return None
    return KeptPlans(state_folder(settings, instance) / "plans.json", parts.plans, parts.commander, disk)


def _make_folder(folder: Path) -> None:
    """The log folder, now and not at the first arming. LogError if it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LogError(f"log folder {folder}: cannot be made ({error.strerror}); choose another place") from error


def _marker_file(settings: Settings, world: _World) -> dict[str, bytes]:
    """The marker map as an attachment, if it came from a file; else the scenario says all."""
    layout = world.scenario.markers
    from_file = settings["markers"] is not None or layout.file is not None or layout.laid is not None
    if world.markers is None or not from_file:
        return {}
    return {"markers.toml": marker_file_text(world.markers).encode()}


def _recorder(settings: Settings, world: _World, parts: Parts, device: SimulatedDevice) -> RunRecorder:
    """The log: one file where ``--log`` says, else one per arming in the log folder.

    In lockstep it is made and finished in the tick, which is the same on every machine; at a speed beside the loop, but
    for a file that is there from the start.
    """
    fixed = None if settings["log"] is None else Path(settings["log"])
    folder = Path(settings["log_dir"])
    if fixed is None:
        _make_folder(folder)
        recover_unfinished(folder)
    lockstep = world.speed == 0.0
    contents = _LogContents(settings, world, parts)
    opened = 0

    def open_log() -> RunLog:
        nonlocal opened
        opened += 1
        at_start = opened == 1 and fixed is not None

        def path() -> Path:
            if fixed is None:
                return log_path(folder, time.time_ns())
            return fixed if at_start else free_path(fixed)

        head, description = contents.head(path), contents.description()
        if not (lockstep or at_start):
            return open_run_log_beside(head, epoch_ns=SITL_EPOCH_NS, description=description)
        given = head()
        return open_run_log(
            given.path,
            epoch_ns=SITL_EPOCH_NS,
            description=description,
            metadata=given.metadata,
            attachments=given.attachments,
            lossless=lockstep,
        )

    return RunRecorder(
        open_log,
        lambda: (contents.description(), contents.plans()),
        plan_revision=lambda: parts.plans.revision,
        truth=device,
        per_arming=fixed is None,
        waits=lockstep,
    )


class _LogContents:
    """What the logs of a session begin with. What does not change is made once, at the start and not in a tick."""

    def __init__(self, settings: Settings, world: _World, parts: Parts) -> None:
        self._world, self._parts = world, parts
        self._metadata = {
            "version": __version__,
            "revision": revision(),
            "scenario": world.scenario.scenario.name,
            "seed": str(world.seed),
            "speed": f"{world.speed:g}",
            "vehicle": parts.vehicle.name,
            **{kind: part.name for kind, part in world.parts.items()},
            "currents": _knowledge(settings, world.scenario),
            "basin": settings["basin"] or world.scenario.controller.basin,
            "currents_map": "" if world.water is None else world.water.name,
            "currents_map_sha256": "" if world.water is None else world.water.nodes.digest,
        }
        self._attachments = {
            "config.json": msgspec.json.encode(settings.values(), enc_hook=str),
            "scenario.json": msgspec.json.encode(world.scenario),
            "vehicle.json": msgspec.json.encode(parts.vehicle),
            **estimator_attachments(
                world.parts["estimator"].name, parts.params, world.markers, told_floor_m(world.scenario)
            ),
            **_marker_file(settings, world),
        }

    def description(self) -> RunDescription:
        """The run as things stand now."""
        return describe_run(
            self._world.scenario,
            self._parts,
            seed=self._world.seed,
            speed=self._world.speed,
            origins=self._world.parts,
        )

    def plans(self) -> dict[str, Payload]:
        """The plans in force now, to be encoded by whoever writes them."""
        items = plan_items(self._parts.plans)
        return {"plans.json": lambda: plans_json(items)}

    def head(self, path: Callable[[], Path]) -> Callable[[], LogHead]:
        """What a log that begins now starts with, to be made by whoever writes it."""
        items = plan_items(self._parts.plans)
        return lambda: LogHead(
            path=path(),
            metadata={**self._metadata, "started": datetime.now(UTC).isoformat(timespec="seconds")},
            attachments={**self._attachments, "plans.json": plans_json(items)},
        )
