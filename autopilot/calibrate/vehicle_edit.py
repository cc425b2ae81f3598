"""New values in a copy of a vehicle file: comments and everything else stay as they are."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import TypeAlias

from autopilot.core.errors import ConfigError
from autopilot.core.toml_table import convert
from autopilot.core.vehicle import Vehicle, vehicle_names

Value: TypeAlias = float | int | str | Sequence[float]
Changes: TypeAlias = Mapping[str, Value]
"""``table.key`` -> new value."""

_TABLE = re.compile(r"^\s*\[+\s*([^\[\]]+?)\s*\]+")


def toml_value(value: Value) -> str:
    """A number, a string or a list of floats as TOML."""
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, Sequence):
        return "[" + ", ".join(toml_value(float(v)) for v in value) + "]"
    if isinstance(value, int):
        return str(value)
    text = f"{value:.10g}"
    return text if any(mark in text for mark in ".en") else text + ".0"


def snippet(changes: Changes) -> str:
    """The changes as TOML tables."""
    tables: dict[str, list[str]] = {}
    for place, value in changes.items():
        table, _, key = place.rpartition(".")
        tables.setdefault(table, []).append(f"{key} = {toml_value(value)}")
    return "\n\n".join("\n".join([f"[{table}]", *lines]) for table, lines in tables.items()) + "\n"


def edited(text: str, changes: Changes, source: str, origin: str, notes: Mapping[str, str] | None = None) -> str:
    """The text of a vehicle file with the changes made, and ``source`` as their origin in ``[sources]``, and ``notes``.

    ConfigError, beginning with ``origin``, if the result is not a good vehicle file."""
    lines = text.splitlines()
    for place, value in changes.items():
        table, _, key = place.rpartition(".")
        _put(lines, table, key, toml_value(value))
        _put(lines, "sources", f'"{place}"', toml_value(source))
    for place, note in (notes or {}).items():
        _put(lines, "sources", f'"{place}"', toml_value(note))
    result = "\n".join(lines) + "\n"
    try:
        tables = tomllib.loads(result)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{origin}: cannot be edited ({error}); enter the values by hand") from error
    convert(tables, Vehicle, origin)
    return result


def write_updated(vehicle: str, changes: Changes, source: str, target: Path) -> None:
    """Copy the vehicle (a shipped name or a file) to ``target`` with the changes made. ConfigError if that fails."""
    path = Path(vehicle)
    if vehicle in vehicle_names():
        path = Path(str(resources.files("autopilot") / "data" / "vehicles" / f"{vehicle}.toml"))
    try:
        text = path.read_text(encoding="utf-8")
        target.write_text(edited(text, changes, source, str(path)), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{error.filename}: {error.strerror}; choose another place with --out") from error


def write_curves(vehicle: str, curves: str, source: str, target: Path) -> None:
    """Copy the vehicle to ``target`` with these ``[[drive.curve]]`` tables for its own. ConfigError if that fails."""
    path = Path(vehicle)
    if vehicle in vehicle_names():
        path = Path(str(resources.files("autopilot") / "data" / "vehicles" / f"{vehicle}.toml"))
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        kept, inside = [], False
        for line in lines:
            inside = _name(line) == "drive.curve" if _name(line) is not None else inside
            if not inside:
                kept.append(line)
        at = next(n for n, line in enumerate(kept) if _name(line) == "drive") + 1
        at = next((n for n in range(at, len(kept)) if _name(kept[n]) is not None), len(kept))
        text = "\n".join([*kept[:at], *curves.splitlines(), "", *kept[at:]])
        target.write_text(edited(text, {}, source, str(path), notes={"drive.curve": source}), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{error.filename}: {error.strerror}; choose another place with --out") from error


def _put(lines: list[str], table: str, key: str, value: str) -> None:
    """Set a key of a table, in place; both are made if they are not there."""
    begin = next((n for n, line in enumerate(lines) if _name(line) == table), None)
    if begin is None:
        lines += ["", f"[{table}]"]
        begin = len(lines) - 1
    end = next((n for n in range(begin + 1, len(lines)) if _name(lines[n]) is not None), len(lines))
    for n in range(begin + 1, end):
        if lines[n].partition("=")[0].strip() == key:
            last = _last_line(lines, n)
            comment = _comment(lines[last])
            lines[n : last + 1] = [f"{key} = {value}{comment}"]
            return
    while end > begin + 1 and not lines[end - 1].strip():
        end -= 1
    lines.insert(end, f"{key} = {value}")


def _name(line: str) -> str | None:
    """Name of the table that a line opens, None if it opens none."""
    match = _TABLE.match(line)
    return match.group(1) if match and "=" not in line.split("]")[0] else None


def _last_line(lines: list[str], first: int) -> int:
    """Last line of a value that may be an array over several lines."""
    depth = 0
    for n in range(first, len(lines)):
        code = lines[n].split("#")[0]
        depth += code.count("[") - code.count("]")
        if depth <= 0:
            return n
    return first


def _comment(line: str) -> str:
    """The comment at the end of a line of numbers, with its blanks."""
    match = re.search(r'\s+#[^"]*$', line)
    return match.group(0) if match else ""
