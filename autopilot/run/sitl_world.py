"""World of a SITL run, from scenario and settings, and the part of it that the vehicle knows."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, cast

import msgspec

from autopilot.command.map_check import MapCheck, open_map
from autopilot.command.service_parts import ServiceParts
from autopilot.control.current.current_map import CurrentMap
from autopilot.control.current.current_tuning import CURRENTS
from autopilot.control.current.currents import CurrentForecast, MappedCurrent, PointwiseField
from autopilot.core.background import BackgroundWorker
from autopilot.core.daemon_executor import DaemonExecutor
from autopilot.core.errors import ConfigError
from autopilot.core.geodesy import Origin
from autopilot.core.marker_files import load_marker_map
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import FlightControllerState, Inputs, Severity, ThrusterCommand
from autopilot.core.origin_params import params_origin
from autopilot.core.payload import PayloadState
from autopilot.core.samples import CameraFrame, Sample
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.log.description import RunDescription
from autopilot.mission.plan_files import PlanFile
from autopilot.run.clocks import LockstepClock, PacedClock
from autopilot.run.compose import KnownEnvironment, forecast_of
from autopilot.run.config import EffectiveSettings, chosen_part, system_id
from autopilot.run.outside import InProcessClient
from autopilot.run.sitl_describe import describe_run, part_origins
from autopilot.run.sitl_fence import scenario_plan
from autopilot.run.sitl_params import sitl_params, state_folder
from autopilot.run.sitl_view import Steering, WatchedSitl
from autopilot.run.world import CurrentSource, World
from autopilot.sitl.backend import SimulatedVehicle, simulated_vehicle
from autopilot.sitl.current_fields import GridCurrent, current_field
from autopilot.sitl.floor import given_floor_m, given_markers
from autopilot.sitl.hil import Wire, wires
from autopilot.sitl.machine_faults import MachineFaults
from autopilot.sitl.operator import ScriptedOperator
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario import load_scenario, plan_path, with_vehicle
from autopilot.sitl.scenario_tables import Scenario

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
    def payload_levels(self) -> tuple[float, ...]:
        """Positions of the payload (0 to 1), for the log only."""
        return self._vehicle.payload.levels

    def actuate(self, t_us: int, state: PayloadState) -> None:
        self._vehicle.payload.set(state.pulses_us)

    def advance(self, t_us: int) -> None:
        self._vehicle.advance(t_us)

    def poll(self, t_us: int) -> Sequence[Sample]:
        return self._vehicle.poll(t_us)

    def frames(self, t_us: int) -> Sequence[CameraFrame]:
        return self._vehicle.frames(t_us)

    def write(self, t_us: int, command: ThrusterCommand) -> None:
        self._armed = command.armed
        self._vehicle.write(command.pwm_us[: self._thrusters])

    def below(self, t_us: int) -> FlightControllerState | None:
        """State of the flight controller, in a scenario that has one."""
        return self._vehicle.below(t_us, armed=self._armed)

    def close(self) -> None:
        self._vehicle.close()


class SimulatedWorld(World):
    device: SimulatedDevice
    simulated = True

    def __init__(
        self,
        settings: EffectiveSettings,
        overrides: dict[str, float],
        instance: int,
        peers: Sequence[InProcessClient] = (),
    ) -> None:
        scenario = load_scenario(settings["scenario"])
        if settings["vehicle"] is not None:
            scenario = with_vehicle(scenario, settings["vehicle"], "--vehicle")
        self.settings, self.scenario, self.speed = settings, scenario, float(settings["speed"])
        self.folder = state_folder(settings, instance)
        self.disk = BackgroundWorker(DaemonExecutor("disk"), blocking=self.speed == 0.0)
        self.params, self.persistent, self.warnings = sitl_params(settings, scenario, overrides, instance, self.disk)
        self.seed: int = scenario.scenario.seed if settings["seed"] is None else settings["seed"]
        vehicle = load_vehicle(scenario.vehicle.model)
        self._vehicle = _simulated(settings, scenario, vehicle, self.seed, self.speed)
        self._parts = part_origins(settings, scenario)
        origin = params_origin(self.params)
        self._map = _map(settings, scenario, origin)
        markers = _known_markers(settings, scenario, self._vehicle.markers)
        kind, basin = knowledge(settings, scenario), settings["basin"] or scenario.controller.basin
        self.known = KnownEnvironment(
            vehicle=vehicle,
            origin=origin,
            markers=markers,
            floor_depth_m=given_floor_m(scenario),
            # Without a map file a map is the scenario's own formula.
            currents=forecast_of(
                kind, basin, lambda: formula(scenario) if self._map is None else MappedCurrent(self._map)
            ),
            current_check=None if self._map is None else MapCheck(self._map, origin),
            pictures=self._vehicle.pictured,
            controller=scenario.plugins.controller,
            estimator=scenario.plugins.estimator,
        )
        self.current_source = CurrentSource(
            kind=kind,
            basin=basin,
            map_file=None if self._map is None else map_path(settings, scenario),
            map_start=settings["currents_start"],
        )
        layout = scenario.markers
        # Without a file the scenario is the only source.
        self.markers_from_file = (settings["markers"], layout.file, layout.laid) != (None, None, None)
        self.operator = (
            ScriptedOperator(system_id(self.params, instance), scenario.fault) if settings["start"] else None
        )
        self.peers = tuple(peers) if self.operator is None else (*peers, self.operator)
        self.plan, self.flown_at_once = _plan(settings, scenario), self.operator is not None
        self.keeps_plans = bool(
            settings["keep_plans"]
        )  # a simulation starts without stored state unless configured otherwise
        given_s = settings["duration"]
        self.duration_s = scenario.scenario.duration_s if given_s is None else given_s
        self._machine = MachineFaults(scenario.fault)
        self.steering: Steering | None = None

    def open_device(self, parts: ServiceParts) -> None:
        self.device = self.truth_source = SimulatedDevice(self._vehicle, len(self.known.vehicle.thrusters))

    def epoch_ns(self, t_us: int) -> int:
        """Constant, for reproducible logs."""
        return SITL_EPOCH_NS

    def finish_plan(self, plan: PlanFile) -> tuple[PlanFile, tuple[str, ...]]:
        """With the fence that the scenario draws."""
        return scenario_plan(plan, self.scenario)

    def describe(self, parts: ServiceParts) -> RunDescription:
        return describe_run(self.scenario, parts, seed=self.seed, speed=self.speed, origins=self._parts)

    def metadata(self) -> dict[str, str]:
        return {
            "scenario": self.scenario.scenario.name,
            "seed": str(self.seed),
            "speed": f"{self.speed:g}",
            **{kind: part.name for kind, part in self._parts.items()},
            "currents": self.current_source.kind,
            "basin": self.current_source.basin,
            "currents_map": "" if self._map is None else self._map.name,
            "currents_map_sha256": "" if self._map is None else self._map.nodes.digest,
        }

    def attachments(self) -> dict[str, bytes]:
        return {"scenario.json": msgspec.json.encode(self.scenario)}

    def watched(self, parts: ServiceParts) -> WatchedSitl:
        return WatchedSitl(parts, lambda: self.describe(parts), self._vehicle)

    def controls(self, clock: PacedClock | LockstepClock) -> Steering:
        self.steering = Steering(self.scenario, self._vehicle, clock)
        return self.steering

    def truth(self) -> Truth:
        return self._vehicle.truth

    def below(self, t_us: int) -> FlightControllerState | None:
        """A flight controller's word, in a scenario that has one."""
        return self.device.below(t_us)

    def notices(self) -> Sequence[tuple[Severity, str]]:
        return () if self.steering is None else self.steering.take_notices()

    def mishaps(self, inputs: Inputs) -> Inputs:
        return self._machine.put_into(inputs)

    def hold(self, t_us: int) -> bool:
        return self.steering is not None and self.steering.hold(t_us)


def _simulated(
    settings: EffectiveSettings, scenario: Scenario, vehicle: Vehicle, seed: int, speed: float
) -> SimulatedVehicle:
    sensors = scenario.sensors.position if settings["sensors"] is None else settings["sensors"]
    plant, plant_by = chosen_part(settings, "plant", scenario.plugins.plant)
    return simulated_vehicle(
        scenario,
        vehicle,
        seed=seed,
        position=cast(Literal["camera", "pose"], sensors),
        paced=speed > 0.0,
        hil=_wires(settings),
        plant=plant,
        plant_asked_by=plant_by,
    )


def _plan(settings: EffectiveSettings, scenario: Scenario) -> Path | None:
    """The plan to have on board: --plan, or the scenario's when an operator in-process is to start it."""
    if settings["plan"] is not None:
        return Path(settings["plan"])
    if not settings["start"]:
        return None
    plan = plan_path(settings["scenario"], scenario)
    if plan is None:
        raise ConfigError(f"--start: scenario {scenario.scenario.name!r} has no plan; give one with --plan FILE")
    return plan


def _wires(settings: EffectiveSettings) -> frozenset[Wire]:
    """Devices on real links. ConfigError when time is not real."""
    speed = float(settings["speed"])
    if settings["hil"] and speed != 1.0:
        raise ConfigError(f"--hil takes the time that bytes take, --speed {speed:g} does not; use --speed 1")
    return wires(settings["hil"])


def _known_markers(settings: EffectiveSettings, scenario: Scenario, true: MarkerMap | None) -> MarkerMap | None:
    """Marker map of ``--markers``, else the one that the scenario gives to the vehicle. ConfigError if it cannot
    be used.
    """
    if settings["markers"] is None:
        return None if true is None else given_markers(scenario)
    if true is None:
        raise ConfigError("--markers needs pictures, and this run has none; use --sensors camera or leave it out")
    return load_marker_map(Path(settings["markers"]))


def knowledge(settings: EffectiveSettings, scenario: Scenario) -> str:
    """The controller's knowledge of the current: the setting, a given map, or the scenario's."""
    if settings["currents"] is not None:
        return str(settings["currents"])
    return "map" if settings["currents_map"] is not None else scenario.controller.currents


def _map(settings: EffectiveSettings, scenario: Scenario, origin: Origin) -> CurrentMap | None:
    """Map file of the settings, else the scenario's, None without one. ConfigError if it is invalid."""
    if knowledge(settings, scenario) != "map":
        if settings["currents_map"] is not None:
            raise ConfigError(f"--currents-map needs --currents map, not {settings['currents']}")
        return None
    path = map_path(settings, scenario)
    return None if path is None else open_map(path, origin, settings["currents_start"])


def map_path(settings: EffectiveSettings, scenario: Scenario) -> Path | None:
    """Path of the current map, None without one."""
    path = settings["currents_map"] or scenario.controller.map
    if path is None and isinstance(scenario.current, GridCurrent):
        path = scenario.current.file
    return None if path is None else Path(path)


def formula(scenario: Scenario) -> CurrentForecast:
    """A scenario's current as a map."""
    scale_m = CURRENTS.open_water_scale_m if scenario.tank is None else CURRENTS.tank_scale_m
    return MappedCurrent(PointwiseField(current_field(scenario.current).velocity, scale_m))
