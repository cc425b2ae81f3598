"""One SITL run: settings -> scenario, simulated vehicle, service, links, log, loop."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from autopilot.command.map_check import MapCheck
from autopilot.command.parts import Parts
from autopilot.core.desk import Desk
from autopilot.core.errors import ConfigError
from autopilot.core.lane import DaemonLane
from autopilot.core.messages import Below, Outputs, ThrusterCommand
from autopilot.core.payload import PayloadState
from autopilot.core.samples import CameraFrame, Sample
from autopilot.drivers.protocols import Link
from autopilot.log.description import RunDescription
from autopilot.run.assembly import Told, onlooker, service_setup
from autopilot.run.clocks import make_clock
from autopilot.run.compose import ServiceSetup, build_service
from autopilot.run.config import Settings, system_id
from autopilot.run.kept_plans import KeptPlans
from autopilot.run.outside import Peer
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
from autopilot.run.sitl_describe import describe_run
from autopilot.run.sitl_fence import scenario_plan
from autopilot.run.sitl_params import sitl_params, state_folder
from autopilot.run.sitl_view import Steering, WatchedSitl
from autopilot.run.sitl_world import World, forecast, knowledge, make_world, map_path
from autopilot.run.stills import StillStore
from autopilot.sitl.backend import SimulatedVehicle
from autopilot.sitl.floor import told_floor_m
from autopilot.sitl.machine_faults import MachineFaults
from autopilot.sitl.operator import ScriptedOperator
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario import Scenario, load_scenario, plan_path, with_vehicle
from autopilot.view.foxglove import FoxgloveServer
from autopilot.view.hub import Hub

SITL_EPOCH_NS = int(datetime(2026, 1, 1, tzinfo=UTC).timestamp()) * 1_000_000_000
"""Log time of simulated time zero: fixed, so that two runs of a scenario and seed give the same log."""


class SimulatedDevice:
    """The simulated vehicle as the runtime's device."""

    def __init__(self, vehicle: SimulatedVehicle, thrusters: int) -> None:
        self._vehicle = vehicle
        self._thrusters = thrusters
        self._armed = False
        vehicle.open()

    @property
    def truth(self) -> Truth:
        """The plant's truth, for the log only."""
        return self._vehicle.truth

    @property
    def payload_shares(self) -> tuple[float, ...]:
        """Where what it carries is, for the log only."""
        return self._vehicle.payload.shares

    def actuate(self, t_us: int, state: PayloadState) -> None:
        """Move what it carries."""
        self._vehicle.payload.set(state.pulses_us)

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
        self._armed = command.armed
        self._vehicle.write(command.pwm_us[: self._thrusters])

    def below(self, t_us: int) -> Below | None:
        """What the flight controller below says, in a scenario that has one."""
        return self._vehicle.below(t_us, armed=self._armed)

    def close(self) -> None:
        """Thrusters to neutral."""
        self._vehicle.close()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SitlSession(Session):
    """A simulated run that is ready to go."""

    device: SimulatedDevice
    scenario: Scenario
    operator: ScriptedOperator | None
    seed: int
    speed: float
    steering: Steering | None
    """Who does to the simulation what the live view asks for; None without one."""


def open_sitl(
    settings: Settings,
    overrides: dict[str, float],
    *,
    instance: int = 0,
    log: bool = True,
    links: Sequence[Link] | None = None,
    peers: Sequence[Peer] = (),
    on_tick: Callable[[Outputs], None] = lambda _: None,
    view: Hub | None = None,
    foxglove: FoxgloveServer | None = None,
    now_s: float | None = None,
) -> SitlSession:
    """Everything of a SITL run. ConfigError, PlanError, DriverError, LogError name what is wrong; nothing runs then.

    ``links``: the connections of the settings if they are already open (:mod:`autopilot.run.boot_links`).
    ``view``: who looks at the run and may steer it. ``foxglove``: who is sent what is logged. ``now_s``: Unix time at
    which signatures begin, None = the machine's.
    """
    scenario = load_scenario(settings["scenario"])
    if settings["vehicle"] is not None:
        scenario = with_vehicle(scenario, settings["vehicle"], "--vehicle")
    disk = Desk(DaemonLane("disk"), patient=float(settings["speed"]) == 0.0)
    params, persistent, warnings = sitl_params(settings, scenario, overrides, instance, disk)
    world = make_world(settings, scenario, params)
    operator = ScriptedOperator(system_id(params, instance), scenario.fault) if settings["start"] else None
    all_peers = (*peers, operator) if operator is not None else tuple(peers)
    signing = SigningFiles(state_folder(settings, instance), disk, now_s=now_s)
    warnings += signing.warnings
    setup = service_setup(
        settings,
        _told(settings, world),
        params,
        instance=instance,
        links=len(settings["connect"]) + len(all_peers),
        speed=world.speed,
        saving=persistent,
        signing=signing,
    )
    service, parts = build_service(setup)
    plan, plans = _plan(settings, scenario), _kept_plans(settings, parts, instance, disk)
    warnings += take_plans(
        parts, plan, plans, flown_at_once=operator is not None, finish=lambda file: scenario_plan(file, scenario)
    )
    device = SimulatedDevice(world.simulated, len(world.vehicle.thrusters))
    with opened(device, settings["connect"], links) as open_links:
        recorder = _recorder(settings, world, setup, parts, device) if log else NullRecorder()
    clock = make_clock(world.speed)
    steering = None if view is None else Steering(scenario, world.simulated, clock)
    watched = WatchedSitl(parts, lambda: _described(world, parts), world.simulated)
    outside = Outside(
        device=device,
        vision=marker_vision(world.vehicle, world.markers, paced=world.speed > 0.0),
        links=open_links,
        peers=all_peers,
        recorder=recorder,
        speed=world.speed,
        clock=clock,
        stills=StillStore(recorder, disk, Path(settings["log_dir"])) if world.simulated.pictured else None,
        below=device.below,
        mishaps=MachineFaults(scenario.fault).put_into,
        onlooker=onlooker(
            view,
            foxglove,
            watched,
            world.vehicle,
            steering,
            simulated=True,
            pictures=world.simulated.pictured,
            truth=lambda: world.simulated.truth,
        ),
        hold=(lambda _: False) if steering is None else steering.hold,
        notices=(lambda: ()) if steering is None else steering.take_notices,
    )
    kept = Kept(folder=state_folder(settings, instance), params=persistent, plans=plans, disk=disk, signing=signing)
    runtime = loop_round(service, parts, outside, kept, warnings, on_tick)
    given_s = settings["duration"]
    return SitlSession(
        scenario=scenario,
        vehicle=world.vehicle,
        service=service,
        parts=parts,
        device=device,
        runtime=runtime,
        recorder=recorder,
        kept=kept,
        warnings=warnings,
        operator=operator,
        duration_s=scenario.scenario.duration_s if given_s is None else given_s,
        seed=world.seed,
        speed=world.speed,
        steering=steering,
    )


def _told(settings: Settings, world: World) -> Told:
    """What the service is told of that world: marker map, floor depth and origin, and nothing of the truth."""
    return Told(
        vehicle=world.vehicle,
        origin=world.origin,
        markers=world.markers,
        floor_depth_m=told_floor_m(world.scenario),
        currents=forecast(settings, world),
        water=None if world.water is None else MapCheck(world.water, world.origin),
        pictures=world.simulated.pictured,
        controller=world.scenario.plugins.controller,
        estimator=world.scenario.plugins.estimator,
    )


def _described(world: World, parts: Parts) -> RunDescription:
    """The run as things stand now."""
    return describe_run(world.scenario, parts, seed=world.seed, speed=world.speed, origins=world.parts)


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


def _kept_plans(settings: Settings, parts: Parts, instance: int, disk: Desk) -> KeptPlans | None:
    """Where plans are kept, None without --keep-plans: a simulation begins anew each time unless it is told to."""
    if not settings["keep_plans"]:
        return None
    return KeptPlans(state_folder(settings, instance) / "plans.json", parts.plans, parts.commander, disk, parts.witness)


def _recorder(
    settings: Settings, world: World, setup: ServiceSetup, parts: Parts, device: SimulatedDevice
) -> RunRecorder:
    """The log of a simulated run, with the plant's truth."""
    scenario, layout = world.scenario, world.scenario.markers
    from_file = settings["markers"] is not None or layout.file is not None or layout.laid is not None
    contents = LogContents(
        settings,
        parts,
        lambda: _described(world, parts),
        estimator=world.parts["estimator"].name,
        markers=world.markers,
        floor_depth_m=told_floor_m(scenario),
        metadata={
            "scenario": scenario.scenario.name,
            "seed": str(world.seed),
            "speed": f"{world.speed:g}",
            **{kind: part.name for kind, part in world.parts.items()},
            "currents": knowledge(settings, scenario),
            "basin": settings["basin"] or scenario.controller.basin,
            "currents_map": "" if world.water is None else world.water.name,
            "currents_map_sha256": "" if world.water is None else world.water.nodes.digest,
        },
        attachments={
            "scenario.json": msgspec.json.encode(scenario),
            **service_attachments(
                setup,
                parts,
                currents=knowledge(settings, scenario),
                basin=settings["basin"] or scenario.controller.basin,
                map_file=None if world.water is None else map_path(settings, scenario),
                map_start=settings["currents_start"],
            ),
            # Without a file the scenario says all.
            **(marker_attachment(world.markers) if world.markers is not None and from_file else {}),
        },
    )
    lockstep = world.speed == 0.0
    return open_recorder(settings, parts, contents, epoch_ns=SITL_EPOCH_NS, lockstep=lockstep, truth=device)
