"""The settings of a flight by a program: keywords as the options of ``autopilot sitl``."""

import sys
from collections.abc import Callable, Mapping
from itertools import chain, count
from operator import attrgetter
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.run.config import EffectiveSettings, allowed, flight_settings
from autopilot.sitl.scenario import load_scenario, plan_path

PARTS = ("controller", "estimator", "plant")
Part = str | Callable[..., Any]
"""A name (docs/extend.md), or the class itself (any callable that takes the context and makes one)."""


class Local:
    """Attributes are the parts that no module has under their own name (those of a function, a lambda)."""


def part_name(part: Part | None) -> str | None:
    """The name under which :func:`autopilot.core.plugins.find_plugin` finds that part."""
    if part is None or isinstance(part, str):
        return part
    module, path = getattr(part, "__module__", "") or "", getattr(part, "__qualname__", "")
    try:
        if attrgetter(path)(sys.modules[module]) is part:
            return f"{module}:{path}"
    except (KeyError, AttributeError):
        pass
    stem = path.rpartition(".")[2]
    stem = stem if stem.isidentifier() else type(part).__name__
    names = chain((stem,), (f"{stem}_{number}" for number in count(2)))
    name = next(name for name in names if getattr(Local, name, part) is part)
    setattr(Local, name, part)
    return f"{Local.__module__}:{Local.__qualname__}.{name}"


class FlightOptions(TypedDict, total=False):
    """What may be chosen of a simulated flight; what is left out is the scenario's."""

    vehicle: str
    """Name or file of a vehicle."""
    plan: str | Path
    """Mission and fence."""
    controller: Part
    estimator: Part
    plant: Part
    """A name, or the class itself (docs/extend.md)."""
    sensors: str
    """``"camera"`` or ``"pose"``."""
    markers: str | Path
    """Marker map that the estimator uses."""
    currents: str
    """What the controller knows of them: ``"estimate"``, ``"map"``, ``"none"``, ``"uniform"``."""
    currents_map: str | Path
    currents_start: str
    basin: str
    """``"closed"``, ``"open"``, ``"unknown"``"""
    params: Mapping[str, float]
    """Vehicle parameters (docs/parameters.md)."""


def settings_of(
    scenario: str | Path, folder: Path, options: FlightOptions, **given: object
) -> tuple[EffectiveSettings, dict[str, float]]:
    """Settings and parameters of a flight in lockstep whose state lies in ``folder``. ``given``: further settings.

    ConfigError names an option that does not exist or a value that it cannot have.
    """
    known = FlightOptions.__annotations__
    values: dict[str, object] = {"scenario": str(scenario), "plan": _plan(str(scenario)), **given}
    for name, value in options.items():
        if name not in known:
            raise ConfigError(f"{name}={value!r} is no option of a flight; use one of {', '.join(known)}")
        if name in PARTS:
            value = part_name(value)  # type: ignore[arg-type] # checked below
        elif isinstance(value, Path):
            value = str(value)
        if name != "params" and value is not None:
            values[name] = value
    values = {name: value.item() if isinstance(value, np.generic) else value for name, value in values.items()}
    checked_seed(values.get("seed"))
    for name, value in values.items():
        if value is not None:
            _check(name, value)
    return flight_settings(folder, values), _params(options.get("params") or {})


def checked_seed(given: object) -> int | None:
    """The seed as Python's own number. ConfigError unless it is None or a whole number from 0 on."""
    seed = given.item() if isinstance(given, np.generic) else given
    if seed is None or (isinstance(seed, int) and not isinstance(seed, bool) and seed >= 0):
        return seed
    raise ConfigError(f"seed={given!r} is not valid; use a whole number, 0 or more, or leave it out")


def _plan(scenario: str) -> str | None:
    """The scenario's own plan, whose fence the vehicle needs, None if it has none."""
    path = plan_path(scenario, load_scenario(scenario))
    return None if path is None else str(path)


def _check(name: str, value: object) -> None:
    text = f"{name}={value!r}"
    try:
        allowed(name, value, text, "leave it out")
    except TypeError as error:
        raise ConfigError(f"{text} is a {type(value).__name__}, which it cannot be; correct it") from error


def _params(given: Mapping[str, float]) -> dict[str, float]:
    try:
        return {str(name): float(value) for name, value in given.items()}
    except (AttributeError, TypeError, ValueError) as error:
        raise ConfigError(f"params={given!r}: write {{NAME: number}} ({error})") from error
