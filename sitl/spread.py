"""``[spread]``: random variation of a scenario in a campaign, one draw per run.

Every key has its own random stream, seeded by (seed of the campaign, number of the run, key): campaigns with the same
seed draw the same values for the keys that they share, whatever else is varied. Two campaigns that differ in one
factor can thus be compared run by run (common random numbers).
"""

import copy
import re
import zlib
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.sitl.scenario_tables import SpreadTable

Tables: TypeAlias = dict[str, Any]
"""A scenario file as TOML reads it."""

RUN_SEEDS = 1_000_000
"""Seeds of the runs of one campaign lie so far apart from those of the next."""

_PATH = re.compile(r"[^.\[\]]+(\[\d+\])*(\.[^.\[\]]+(\[\d+\])*)*")
_STEP = re.compile(r"\[(\d+)\]|([^.\[\]]+)")
_NOT_WORLD = ("scenario", "spread")
"""Tables that say nothing of the world."""


def run_seed(seed: int, run: int) -> int:
    """Seed of everything random in run ``run`` (from 0) of a campaign."""
    return RUN_SEEDS * seed + run


def drawn_values(spread: Mapping[str, SpreadTable], seed: int, run: int) -> dict[str, float | str]:
    """Key -> value of run ``run`` (from 0) of the campaign with that seed."""
    values: dict[str, float | str] = {}
    for path, entry in spread.items():
        rng = np.random.default_rng((seed, run, zlib.crc32(path.encode())))
        if entry.choice is not None:
            values[path] = entry.choice[int(rng.integers(len(entry.choice)))]
        elif entry.low is not None and entry.high is not None:
            values[path] = float(rng.uniform(entry.low, entry.high))
    return values


def drawn_tables(tables: Tables, spread: Mapping[str, SpreadTable], seed: int, run: int) -> Tables:
    """The scenario of one run: values drawn and put in, its seed set, nothing left to draw."""
    result = _world(tables)
    for path, value in drawn_values(spread, seed, run).items():
        _put(result, path, value)
    result["scenario"]["seed"] = run_seed(seed, run)
    return result


def check_spread(
    tables: Tables, spread: Mapping[str, SpreadTable], check: Callable[[Tables, str], object], origin: str
) -> None:
    """ConfigError that names the key if one of its values gives no valid scenario; ``check`` judges a whole one."""
    for path, entry in spread.items():
        where = f'{origin}: `$.spread."{path}"`'
        if _PATH.fullmatch(path) is None or _STEP.split(path)[2] in _NOT_WORLD:
            raise ConfigError(f'{where} is not a key of the world; write one like "vehicle.mismatch.drag"')
        for value in entry.choice if entry.choice is not None else (entry.low, entry.high):
            tried = _world(tables)
            try:
                _put(tried, path, value)
            except LookupError as error:
                raise ConfigError(
                    f"{where}: there is no {error.args[0]} in the file; correct the path or add it"
                ) from error
            check(tried, f"{where} = {value}")


def _world(tables: Tables) -> Tables:
    return copy.deepcopy({key: value for key, value in tables.items() if key != "spread"})


def _put(tables: Tables, path: str, value: Any) -> None:
    """Set one key; missing tables with defaults are created. LookupError names what does not exist."""
    steps: list[int | str] = [int(step[1]) if step[1] else step[2] for step in _STEP.finditer(path)]
    here: Any = tables
    for depth, step in enumerate(steps):
        last = depth == len(steps) - 1
        if isinstance(step, int):
            if not isinstance(here, list) or step >= len(here):
                raise LookupError(f"element [{step}]")
        elif not isinstance(here, dict):
            raise LookupError(f"key {step!r}")
        elif not last:
            here.setdefault(step, {})
        if last:
            here[step] = value
        else:
            here = here[step]
