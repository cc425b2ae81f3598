"""One SITL run: settings -> scenario, simulated vehicle, service, links, log, loop."""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, cast

import msgspec

from autopilot import __version__
from autopilot.compose import ServiceSetup, build_service, load_plan, revision
from autopilot.config import Settings
from autopilot.control.currents import CurrentForecast, EstimatedCurrent, MappedCurrent, NoCurrent
from autopilot.core.camera import CameraModel
from autopilot.core.messages import CameraFrame, Outputs, Sample, ThrusterCommand
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.describe import describe_run
from autopilot.log.description import RunDescription
from autopilot.log.recover import recover_unfinished
from autopilot.log.session import RunLog, log_path, open_run_log
from autopilot.operator import ScriptedOperator
from autopilot.param_file import PersistentParams
from autopilot.recorder import NullRecorder, RunRecorder
from autopilot.runtime import Peer, Runtime, make_clock
from autopilot.service import Autopilot, Parts
from autopilot.vision import VisionWorker
from drivers.links import open_link
from drivers.protocols import Link
from estimator.vision import MarkerDetector
from mission.geodesy import Origin
from mission.plan_files import read_plan
from sitl.backend import SimulatedVehicle, simulated_vehicle
from sitl.currents import current_field
from sitl.plant import Truth
from sitl.scenario import Scenario, load_scenario

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
    runtime: Runtime
    recorder: RunRecorder | NullRecorder
    persistent: PersistentParams
    operator: ScriptedOperator | None
    duration_s: float | None
    seed: int
    speed: float

    def run(self, stop: Callable[[], bool] = lambda: False) -> float:
        """Run to the end; the result is the wall time it took [s]."""
        begin_s = time.monotonic()
        try:
            self.runtime.run(duration_s=self.duration_s, stop=stop)
        finally:
            self.recorder.close()
            self.persistent.save_changes()
        return time.monotonic() - begin_s


def open_sitl(
    settings: Settings,
    overrides: dict[str, float],
    *,
    instance: int = 0,
    log: bool = True,
    peers: Sequence[Peer] = (),
    on_tick: Callable[[Outputs], None] = lambda _: None,
) -> SitlSession:
    """Everything of a SITL run. ConfigError, PlanError, DriverError, LogError name what is wrong; nothing runs then."""
    sys.setswitchinterval(THREAD_SWITCH_S)
    scenario = load_scenario(settings["scenario"])
    vehicle = load_vehicle(scenario.vehicle.model)
    seed = scenario.scenario.seed if settings["seed"] is None else settings["seed"]
    speed = float(settings["speed"])
    sensors = scenario.sensors.position if settings["sensors"] is None else settings["sensors"]
    params, persistent = _params(settings, scenario, overrides, instance)
    simulated = simulated_vehicle(scenario, vehicle, seed=seed, position=cast(Literal["camera", "pose"], sensors))
    connections = tuple(settings["connect"])
    operator = ScriptedOperator(int(params["SYSID_THISMAV"]) + instance) if settings["start"] else None
    peers = (*peers, operator) if operator is not None else tuple(peers)
    service, parts = build_service(
        ServiceSetup(
            vehicle=vehicle,
            params=params,
            origin=Origin(lat_deg=params["ORIGIN_LAT"], lon_deg=params["ORIGIN_LON"], alt_m=params["ORIGIN_ALT"]),
            markers=simulated.markers,
            floor_depth_m=None if scenario.tank is None else scenario.tank.depth_m,
            estimator=settings["estimator"],
            profile=settings["profile"],
            instance=instance,
            currents=_currents(scenario),
            links=len(connections) + len(peers),
            patience=FASTEST if speed == 0.0 else max(1.0, speed),
        )
    )
    if settings["plan"] is not None:
        load_plan(parts.plans, read_plan(Path(settings["plan"])), settings["plan"])
    device = SimulatedDevice(simulated, len(vehicle.thruster))
    links: list[Link] = []
    try:
        links.extend(open_link(connection) for connection in connections)
        recorder = _recorder(settings, scenario, parts, device, seed=seed, speed=speed) if log else NullRecorder()
    except BaseException:
        device.close()
        for link in links:
            link.close()
        raise
    vision = None
    if simulated.markers is not None:
        detector = MarkerDetector(CameraModel.of(vehicle.camera, vehicle.laser), simulated.markers)
        vision = VisionWorker(detector, delay_s=0.5 * vehicle.camera.latency_s)
    persistent.mark()

    def each_tick(outputs: Outputs) -> None:
        persistent.save_changes()
        on_tick(outputs)

    runtime = Runtime(
        service,
        device,
        vision,
        links,
        recorder,
        make_clock(speed),
        peers=peers,
        on_tick=each_tick,
        paced=speed > 0.0,
    )
    return SitlSession(
        scenario=scenario,
        vehicle=vehicle,
        service=service,
        parts=parts,
        runtime=runtime,
        recorder=recorder,
        persistent=persistent,
        operator=operator,
        duration_s=settings["duration"],
        seed=seed,
        speed=speed,
    )


def _currents(scenario: Scenario) -> CurrentForecast:
    """What the scenario lets the controller know of the current."""
    if scenario.controller.currents == "map":
        return MappedCurrent(current_field(scenario.current).velocity)
    return NoCurrent() if scenario.controller.currents == "none" else EstimatedCurrent()


def _params(
    settings: Settings, scenario: Scenario, overrides: dict[str, float], instance: int
) -> tuple[ParamSet, PersistentParams]:
    """Defaults < scenario's origin < saved by earlier runs < command line."""
    params = ParamSet()
    params.set("ORIGIN_LAT", scenario.origin.lat_deg)
    params.set("ORIGIN_LON", scenario.origin.lon_deg)
    params.set("ORIGIN_ALT", scenario.origin.alt_m)
    persistent = PersistentParams(Path(settings["state_dir"]) / f"sitl-{instance}" / "parameters.params", params)
    persistent.load()
    for name, value in overrides.items():
        params.set(name, value)
    return params, persistent


def _recorder(
    settings: Settings, scenario: Scenario, parts: Parts, device: SimulatedDevice, *, seed: int, speed: float
) -> RunRecorder:
    """The log: one file where ``--log`` says, else one per arming in the log folder."""
    fixed = settings["log"]
    folder = Path(settings["log_dir"])
    if fixed is None:
        recover_unfinished(folder)

    def describe() -> RunDescription:
        return describe_run(scenario, parts, seed=seed, speed=speed)

    def open_log() -> RunLog:
        path = Path(fixed) if fixed is not None else log_path(folder, time.time_ns())
        return open_run_log(
            path,
            epoch_ns=SITL_EPOCH_NS,
            description=describe(),
            metadata={
                "version": __version__,
                "revision": revision(),
                "scenario": scenario.scenario.name,
                "seed": str(seed),
                "speed": f"{speed:g}",
                "vehicle": parts.vehicle.name,
                "estimator": str(settings["estimator"]),
                "started": datetime.now(UTC).isoformat(timespec="seconds"),
            },
            attachments={
                "config.json": msgspec.json.encode(settings.values(), enc_hook=str),
                "scenario.json": msgspec.json.encode(scenario),
                "vehicle.json": msgspec.json.encode(parts.vehicle),
            },
            lossless=True,
        )

    return RunRecorder(open_log, describe, truth=device, per_arming=fixed is None)
