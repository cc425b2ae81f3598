"""Definition of a campaign: a scenario with its spread, a seed, and all other inputs of its results."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from autopilot import __version__
from autopilot.campaign.results import Task
from autopilot.core.errors import ConfigError
from autopilot.core.params import ParamSet
from autopilot.core.plugins import find_plugin
from autopilot.core.shipped_parts import SHIPPED_PARTS
from autopilot.mission.plan_files import read_plan
from autopilot.run.provenance import revision
from autopilot.sitl.scenario import FILE_KEYS, load_scenario, load_tables, plan_path, with_vehicle
from autopilot.sitl.scenario_tables import Scenario
from autopilot.sitl.spread import Tables, drawn_tables, drawn_values, run_seed
from autopilot.sitl.toml_text import toml_text

FORMAT = 1
"""Of the campaign's folder."""


class CampaignIdentity(msgspec.Struct, frozen=True, kw_only=True):
    """``campaign.json``: runs of one folder agree in all of it."""

    format: int
    version: str
    revision: str
    """Of the code, empty when it is not a checkout."""
    scenario: dict[str, Any]
    """The tables of the scenario file, ``[spread]`` among them."""
    plan_name: str
    plan: str
    seed: int
    estimator: str
    sensors: str | None
    duration_s: float | None
    params: dict[str, float]
    own_code: dict[str, str] = {}
    """SHA-256 of the files of a controller, an estimator, a plant that do not ship, by kind."""
    files: dict[str, str] = {}
    """SHA-256 of the files that the tables name, by path; campaigns of before have none."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Campaign:
    """A campaign that can be flown."""

    identity: CampaignIdentity
    scenario: Scenario
    tables: Tables

    def task(self, run: int) -> Task:
        mine, spread = self.identity, self.scenario.spread
        return Task(
            run=run,
            seed=run_seed(mine.seed, run),
            drawn=drawn_values(spread, mine.seed, run),
            scenario_toml=toml_text(drawn_tables(self.tables, spread, mine.seed, run)),
            plan_name=mine.plan_name,
            plan=mine.plan.encode(),
            estimator=mine.estimator,
            sensors=mine.sensors,
            duration_s=mine.duration_s,
            params=mine.params,
        )


def define(
    name_or_path: str,
    *,
    seed: int | None = None,
    controller: str | None = None,
    estimator: str | None = None,
    plant: str | None = None,
    sensors: str | None = None,
    duration_s: float | None = None,
    params: dict[str, float] | None = None,
    vehicle: str | None = None,
) -> Campaign:
    """Campaign over a scenario.

    Parameters
    ----------
    name_or_path
        Shipped scenario, or a scenario file.
    seed
        Base seed of all runs, None = the scenario's.
    controller, estimator, plant
        Their names (docs/extend.md), None = the scenario's.
    sensors
        Sensor set, None = the scenario's.
    duration_s
        Length of a run [s], None = the scenario's.
    params
        Parameter name -> value, in the units of docs/parameters.md.
    vehicle
        Shipped name or vehicle file, None = the scenario's.

    Returns
    -------
    Campaign

    Raises
    ------
    ConfigError, PlanError
        The scenario or its plan cannot be flown.
    """
    scenario, tables = load_scenario(name_or_path), load_tables(name_or_path)
    if vehicle is not None:
        scenario = with_vehicle(scenario, vehicle, "--vehicle")
        tables = _flown_by(vehicle, scenario, tables)
    parts = {"controller": controller, "estimator": estimator, "plant": plant}
    given = {kind: name for kind, name in parts.items() if name is not None}
    if given:
        scenario = msgspec.structs.replace(scenario, plugins=msgspec.structs.replace(scenario.plugins, **given))
        tables = {**tables, "plugins": {**tables.get("plugins", {}), **given}}
    plugins = [find_plugin(kind, getattr(scenario.plugins, kind)) for kind in SHIPPED_PARTS]
    plan = plan_path(name_or_path, scenario)
    if plan is None:
        raise ConfigError(f"scenario {scenario.scenario.name!r} has no plan; name one in scenario.plan")
    if duration_s is None and scenario.scenario.duration_s is None:
        raise ConfigError(
            f"scenario {scenario.scenario.name!r} does not say when a run ends; add scenario.duration_s or --duration"
        )
    read_plan(plan)
    known = ParamSet()
    for name, value in (params or {}).items():
        known.set(name, value)
    identity = CampaignIdentity(
        format=FORMAT,
        version=__version__,
        revision=revision(),
        scenario=tables,
        plan_name=plan.name,
        plan=plan.read_text(encoding="utf-8"),
        seed=scenario.scenario.seed if seed is None else seed,
        estimator=scenario.plugins.estimator,
        sensors=sensors,
        duration_s=duration_s,
        params=params or {},
        own_code={plugin.kind: plugin.sha256 for plugin in plugins if plugin.sha256},
        files=_digests(tables),
    )
    return Campaign(identity=identity, scenario=scenario, tables=tables)


def _digests(tables: Tables) -> dict[str, str]:
    """SHA-256 of the vehicle file, maps and grids that the tables name or draw, by path."""
    named: list[Any] = []
    for table, key in (("vehicle", "model"), *FILE_KEYS):
        named.append(tables.get(table, {}).get(key))
        named += tables.get("spread", {}).get(f"{table}.{key}", {}).get("choice") or []
    paths = sorted({name for name in named if isinstance(name, str) and Path(name).is_file()})
    return {path: hashlib.sha256(Path(path).read_bytes()).hexdigest() for path in paths}


def _flown_by(vehicle: str, scenario: Scenario, tables: Tables) -> Tables:
    """The tables with that vehicle and the clearances that its ball leaves."""
    accept = scenario.accept
    clearances = {
        "cylinder_clearance_m": accept.cylinder_clearance_m,
        "wall_clearance_m": accept.wall_clearance_m,
    }
    model = str(Path(vehicle).resolve()) if vehicle.endswith(".toml") else vehicle
    return {
        **tables,
        "vehicle": {**tables["vehicle"], "model": model},
        "accept": {**tables.get("accept", {}), **clearances},
    }


def first_difference(old: Any, new: Any, place: str) -> str:
    """``place: OLD instead of NEW`` of the first value in which nested tables differ; empty if they agree."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}):
            found = first_difference(old.get(key), new.get(key), f"{place}.{key}" if place else str(key))
            if found:
                return found
        return ""
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for index, (mine, other) in enumerate(zip(old, new, strict=True)):
            found = first_difference(mine, other, f"{place}[{index}]")
            if found:
                return found
        return ""
    if old == new:
        return ""
    return f"{place} was {_short(old)} and is now {_short(new)}"


def _short(value: Any) -> str:
    text = "absent" if value is None else repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
