"""Writes new values into a copy of a vehicle file; comments and everything else are kept."""

import tomllib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, TypeAlias

import tomlkit
from tomlkit.exceptions import TOMLKitError

from autopilot.core.disk import write_result
from autopilot.core.errors import ConfigError
from autopilot.core.toml_table import convert
from autopilot.core.vehicle import Vehicle, vehicle_names

Value: TypeAlias = float | int | str | Sequence[float]
Changes: TypeAlias = Mapping[str, Value]
"""``table.key`` -> new value."""


def snippet(changes: Changes) -> str:
    """The changes as TOML tables."""
    document: Any = tomlkit.document()
    for place, value in changes.items():
        _put(document, place, value)
    return str(document.as_string()).strip() + "\n"


def edited(text: str, changes: Changes, source: str, origin: str, notes: Mapping[str, str] | None = None) -> str:
    """The text of a vehicle file with the changes made, and ``source`` as their origin in ``[sources]``, and ``notes``.

    ConfigError, beginning with ``origin``, if the result is not a good vehicle file."""
    document = _parsed(text, origin)
    for place, value in changes.items():
        _put(document, place, value)
    for place, note in {**dict.fromkeys(changes, source), **(notes or {})}.items():
        document.setdefault("sources", tomlkit.table())[place] = note
    result: str = document.as_string()
    convert(tomllib.loads(result), Vehicle, origin)
    return result


def write_updated(vehicle: str, changes: Changes, source: str, target: Path) -> None:
    """Copy the vehicle (a shipped name or a file) to ``target`` with the changes made. ConfigError if that fails."""
    origin, text = vehicle_text(vehicle)
    _write(target, edited(text, changes, source, origin))


def write_curves(vehicle: str, curves: str, source: str, target: Path) -> None:
    """Copy the vehicle to ``target`` with these ``[[drive.curve]]`` tables for its own. ConfigError if that fails."""
    origin, text = vehicle_text(vehicle)
    document = _parsed(text, origin)
    document["drive"]["curve"] = _parsed(curves, "curves")["drive"]["curve"]
    _write(target, edited(document.as_string(), {}, source, origin, notes={"drive.curve": source}))


def _write(target: Path, text: str) -> None:
    """ConfigError for a name that no command takes for a vehicle's: a log, perhaps, that would be lost."""
    if target.suffix != ".toml":
        raise ConfigError(f"{target}: vehicle files end in .toml; give --out such a name")
    write_result(target, text)


def vehicle_text(vehicle: str) -> tuple[str, str]:
    """Path and text of a vehicle, a shipped name or a file. ConfigError if it cannot be read."""
    path = Path(vehicle)
    if vehicle in vehicle_names():
        path = Path(str(resources.files("autopilot") / "data" / "vehicles" / f"{vehicle}.toml"))
    try:
        return str(path), path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(f"vehicle {vehicle}: {error.strerror}; name its file by --vehicle") from error


def _parsed(text: str, origin: str) -> Any:
    try:
        return tomlkit.parse(text)
    except TOMLKitError as error:
        raise ConfigError(f"{origin}: cannot be edited ({error}); enter the values by hand") from error


def _put(document: Any, place: str, value: Value) -> None:
    """Set a key of a table; both are made if they are not there. Floats have ten digits."""
    *tables, key = place.split(".")
    for name in tables:
        document = document.setdefault(name, tomlkit.table())
    if isinstance(value, str | int):
        document[key] = value
    elif isinstance(value, Sequence):
        document[key] = [_rounded(float(v)) for v in value]
    else:
        document[key] = _rounded(value)


def _rounded(value: float) -> float:
    return float(f"{value:.10g}")
