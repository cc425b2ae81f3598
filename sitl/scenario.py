"""The scenario file: environment, vehicle, sensors and faults of a simulated run, and its acceptance limits.

TOML, checked strictly: unknown keys, wrong types and values out of range are a ConfigError that names the path of the
key. Lengths in metres, local NED (origin at the water surface, z = depth), angles in radians, times in seconds.
Scenarios ship in ``sitl/scenarios``.
"""

from collections.abc import Callable
from functools import partial
from importlib import resources
from pathlib import Path

import msgspec

from autopilot.core.errors import ConfigError
from autopilot.core.names import unknown
from autopilot.core.params import ParamSet
from autopilot.core.toml_table import convert, mistaken, read_toml
from autopilot.core.vehicle import load_vehicle
from autopilot.sitl.fault_tables import SensorFrozen
from autopilot.sitl.mismatch import mismatched
from autopilot.sitl.scenario_tables import Scenario, SensorSilence, ThrusterLoss
from autopilot.sitl.spread import Tables, check_spread

FILE_KEYS = (("current", "file"), ("controller", "map"), ("markers", "file"))
"""Keys that name a file beside the scenario."""


def scenario_names() -> list[str]:
    """Names of the scenarios that ship with the simulator. (``NAME.mission.toml`` beside them are plans.)"""
    folder = resources.files("autopilot") / "sitl" / "scenarios"
    stems = [entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml")]
    return sorted(stem for stem in stems if "." not in stem)


def scenario_path(name_or_path: str) -> Path:
    """The file of a shipped scenario (by name) or the path as given. ConfigError if it is neither."""
    if name_or_path in scenario_names():
        return Path(str(resources.files("autopilot") / "sitl" / "scenarios" / f"{name_or_path}.toml"))
    path = Path(name_or_path)
    if path.suffix != ".toml":
        raise unknown("scenario", name_or_path, scenario_names(), more=" or a .toml file")
    return path


def load_scenario(name_or_path: str) -> Scenario:
    """A shipped scenario by name, or a scenario file by path. ConfigError names the key that is wrong."""
    path = scenario_path(name_or_path)
    return _of_tables(_located(read_toml(path), path.parent), str(path))


def load_tables(name_or_path: str) -> Tables:
    """The tables of the file, which :func:`load_scenario` has to find good. ConfigError if it cannot be read."""
    path = scenario_path(name_or_path)
    return _located(read_toml(path), path.parent)


def _located(tables: Tables, folder: Path) -> Tables:
    """The tables with files by absolute path: a campaign hands them on to other places."""
    vehicle = tables.get("vehicle")
    model = vehicle.get("model") if isinstance(vehicle, dict) else None
    if isinstance(vehicle, dict) and isinstance(model, str) and model.endswith(".toml") and (folder / model).is_file():
        vehicle["model"] = str((folder / model).resolve())
    for table, key in FILE_KEYS:
        entry, spread = tables.get(table), tables.get("spread")
        drawn = spread.get(f"{table}.{key}") if isinstance(spread, dict) else None
        if isinstance(entry, dict) and isinstance(entry.get(key), str):
            entry[key] = str((folder / entry[key]).resolve())
        if isinstance(drawn, dict) and isinstance(drawn.get("choice"), list):
            drawn["choice"] = [str((folder / c).resolve()) if isinstance(c, str) else c for c in drawn["choice"]]
    return tables


def _of_tables(tables: Tables, origin: str) -> Scenario:
    """The scenario that tables describe. ConfigError begins with ``origin``."""
    scenario: Scenario = convert(tables, Scenario, origin, partial(_broken_rules, tables))
    check_spread(tables, scenario.spread, _of_tables, origin)
    return scenario


def plan_path(name_or_path: str, scenario: Scenario) -> Path | None:
    """The scenario's plan file, None if it names none. ConfigError if the file does not exist."""
    if scenario.scenario.plan is None:
        return None
    path = scenario_path(name_or_path).parent / scenario.scenario.plan
    if not path.is_file():
        raise ConfigError(f"{path}: plan file of scenario {scenario.scenario.name!r} not found; correct scenario.plan")
    return path


def _broken_rules(tables: Tables, scenario: Scenario) -> list[str]:
    """What cannot be, beyond the types of single keys: vehicle, parameters, a camera without a floor.

    ``scenario``: what can be read of the tables."""
    found = _mistakes_of_vehicle(scenario)
    params = ParamSet()
    for name, value in scenario.params.items():
        found += [f"`$.params.{name}`: {text}" for text in _refusal(partial(params.set, name, value))]
    if "tank" not in tables and scenario.sensors.position == "camera":
        found.append('`$.sensors.position` = "camera" needs a floor; add [tank] or use "pose"')
    return found + _faults_of_no_sensor(tables, scenario)


def _faults_of_no_sensor(tables: Tables, scenario: Scenario) -> list[str]:
    """Faults of sensors that the scenario does not have: nothing would happen."""
    fitted = tables.get("sensors")
    names = {*(fitted if isinstance(fitted, dict) else ()), "hull"}
    names -= set() if scenario.sensors.hull.enabled else {"hull"}
    return [
        f'`$.fault[{index}].sensor` = "{fault.sensor}" is not in this scenario; '
        + ("enable [sensors.hull]" if fault.sensor == "hull" else f"add [sensors.{fault.sensor}]")
        for index, fault in enumerate(scenario.fault)
        if isinstance(fault, SensorSilence | SensorFrozen) and fault.sensor not in names
    ]


def _refusal(attempt: Callable[[], object]) -> list[str]:
    """Text of the ConfigError, if there is one."""
    try:
        attempt()
    except ConfigError as error:
        return [str(error)]
    return []


def with_vehicle(scenario: Scenario, vehicle: str, origin: str) -> Scenario:
    """The scenario with another vehicle in it (a shipped name or a file); clearances are judged by its ball.

    ConfigError, beginning with ``origin``, if there is none of that name, or a fault or mismatch does not fit it."""
    wider_m = load_vehicle(vehicle).radius_m - load_vehicle(scenario.vehicle.model).radius_m
    start, accept = msgspec.structs.replace(scenario.vehicle, model=vehicle), scenario.accept
    accept = msgspec.structs.replace(
        accept,
        cylinder_clearance_m=max(0.0, accept.cylinder_clearance_m + wider_m),
        wall_clearance_m=max(0.0, accept.wall_clearance_m + wider_m),
    )
    changed = msgspec.structs.replace(scenario, vehicle=start, accept=accept)
    if found := _mistakes_of_vehicle(changed):
        raise mistaken(origin, found)
    return changed


def _mistakes_of_vehicle(scenario: Scenario) -> list[str]:
    """An unknown vehicle, impossible mismatch, faults of thrusters that it does not have."""
    try:
        vehicle = load_vehicle(scenario.vehicle.model)
    except ConfigError as error:
        return [f"`$.vehicle.model`: {error}"]
    applied = partial(mismatched, vehicle, where="`$.vehicle.mismatch`")
    mismatch = scenario.vehicle.mismatch
    found = [text for key, factor in mismatch.items() for text in _refusal(partial(applied, {key: factor}))]
    found = found or _refusal(partial(applied, mismatch))
    names = [thruster.name for thruster in vehicle.thrusters]
    return found + [
        f"`$.fault[{index}].thruster`: {unknown('thruster', fault.thruster, names)}"
        for index, fault in enumerate(scenario.fault)
        if isinstance(fault, ThrusterLoss) and fault.thruster not in names
    ]
