"""What a scenario and the settings make of the world, and what the vehicle is told of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

from autopilot.command.map_check import open_map
from autopilot.control.water.current_map import CurrentMap
from autopilot.control.water.currents import (
    OPEN_WATER_SCALE_M,
    TANK_SCALE_M,
    CurrentForecast,
    MappedCurrent,
    PointwiseField,
)
from autopilot.core.errors import ConfigError
from autopilot.core.geodesy import Origin
from autopilot.core.marker_files import load_marker_map
from autopilot.core.markers import MarkerMap
from autopilot.core.origin_params import params_origin
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.log.description import PartOrigin
from autopilot.run.compose import forecast_of
from autopilot.run.config import Settings, chosen_part
from autopilot.run.sitl_parts import part_origins
from autopilot.sitl.backend import SimulatedVehicle, simulated_vehicle
from autopilot.sitl.currents import current_field
from autopilot.sitl.floor import told_markers
from autopilot.sitl.hil import Wire, wires
from autopilot.sitl.scenario import GridCurrent, Scenario


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class World:
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


def make_world(settings: Settings, scenario: Scenario, params: ParamSet) -> World:
    """Scenario, vehicle and the simulated vehicle, and what the controller may know of the water."""
    vehicle = load_vehicle(scenario.vehicle.model)
    seed = scenario.scenario.seed if settings["seed"] is None else settings["seed"]
    sensors = scenario.sensors.position if settings["sensors"] is None else settings["sensors"]
    position = cast(Literal["camera", "pose"], sensors)
    speed = float(settings["speed"])
    plant, plant_by = chosen_part(settings, "plant", scenario.plugins.plant)
    simulated = simulated_vehicle(
        scenario,
        vehicle,
        seed=seed,
        position=position,
        paced=speed > 0.0,
        hil=_wires(settings),
        plant=plant,
        plant_asked_by=plant_by,
    )
    origin = params_origin(params)
    return World(
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


def _wires(settings: Settings) -> frozenset[Wire]:
    """What is wired as on a real vehicle. ConfigError when time is not real."""
    speed = float(settings["speed"])
    if settings["hil"] and speed != 1.0:
        raise ConfigError(f"--hil takes the time that bytes take, --speed {speed:g} does not; use --speed 1")
    return wires(settings["hil"])


def _told_markers(settings: Settings, scenario: Scenario, true: MarkerMap | None) -> MarkerMap | None:
    """The map of ``--markers``, else what the scenario gives to the vehicle. ConfigError if there is no use for it."""
    if settings["markers"] is None:
        return None if true is None else told_markers(scenario)
    if true is None:
        raise ConfigError("--markers needs pictures, and this run has none; use --sensors camera or leave it out")
    return load_marker_map(Path(settings["markers"]))


def knowledge(settings: Settings, scenario: Scenario) -> str:
    """What the controller is told of the water: the setting, a given map, or what the scenario says."""
    if settings["currents"] is not None:
        return str(settings["currents"])
    return "map" if settings["currents_map"] is not None else scenario.controller.currents


def _map(settings: Settings, scenario: Scenario, origin: Origin) -> CurrentMap | None:
    """The map file of the settings, else the scenario's; None when there is none. ConfigError if it is no good."""
    if knowledge(settings, scenario) != "map":
        if settings["currents_map"] is not None:
            raise ConfigError(f"--currents-map needs --currents map, not {settings['currents']}")
        return None
    path = map_path(settings, scenario)
    return None if path is None else open_map(path, origin, settings["currents_start"])


def map_path(settings: Settings, scenario: Scenario) -> Path | None:
    """The file of the map of the current, None when there is none."""
    path = settings["currents_map"] or scenario.controller.map
    if path is None and isinstance(scenario.current, GridCurrent):
        path = scenario.current.file
    return None if path is None else Path(path)


def formula(scenario: Scenario) -> CurrentForecast:
    """A scenario's current as a map."""
    scale_m = OPEN_WATER_SCALE_M if scenario.tank is None else TANK_SCALE_M
    return MappedCurrent(PointwiseField(current_field(scenario.current).velocity, scale_m))


def forecast(settings: Settings, world: World) -> CurrentForecast:
    """What the controller is told of the current. Without a map file a map is the scenario's own formula."""
    scenario, water = world.scenario, world.water
    return forecast_of(
        knowledge(settings, scenario),
        settings["basin"] or scenario.controller.basin,
        lambda: formula(scenario) if water is None else MappedCurrent(water),
    )
