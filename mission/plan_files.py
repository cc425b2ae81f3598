"""Plan files of all formats, chosen by suffix: ``.plan``, ``.waypoints``, ``.toml``."""

import math
from dataclasses import replace
from pathlib import Path

from autopilot.core.disk import write_whole
from autopilot.core.errors import ConfigError, PlanError
from autopilot.core.geodesy import Origin
from autopilot.core.params import ParamSet
from autopilot.core.plan import PlanItem, begins_with_home, in_water
from autopilot.mission.items import Command
from autopilot.mission.local_plan import read_local_plan
from autopilot.mission.plan_model import PlanFile, make_item
from autopilot.mission.qgc_plan import read_qgc_plan, write_qgc_plan

MAX_FILE_BYTES = 8_000_000
"""A full plan of 3 x 1000 items is about 1.5 MB of JSON."""

__all__ = ["PlanFile", "read_plan", "write_plan"]
HEADER = "QGC WPL 110"
_COLUMNS = 12


def read_waypoints(text: str, name: str) -> PlanFile:
    """Parse a ``QGC WPL 110`` text.

    Parameters ---------- text Content of the file; latitude and longitude in degrees, altitude in metres. name Name of
    the file, for error messages.

    Returns ------- PlanFile In wire units; mission and home only.

    Raises ------ PlanError The message names file, line and remedy.

    Format: MAVLink developer guide, "File formats": ``seq current frame command p1 p2 p3 p4 x y z autocontinue``, tabs.
    Ground stations of the ArduPilot family put home into the first line, a NAV_WAYPOINT in frame 0; others do not. It
    is home if no other position is in frame 0 and it is not in the water (by the defaults of a vehicle's parameters),
    and keeps its number: items are numbered as in the file."""
    lines = text.splitlines()
    if not lines or lines[0].strip() != HEADER:
        shown = lines[0].strip()[:40] if lines else ""
        raise PlanError(f"{name}: line 1 is {shown!r}, not {HEADER!r}; give a waypoints file of version 110")
    rows = [_row(line, f"{name}: line {n}") for n, line in enumerate(lines[1:], start=2) if line.strip()]
    items: list[PlanItem] = []
    for where, values in rows:
        items.append(make_item(where, len(items), int(values[2]), int(values[3]), values[4:11], values[11] != 0.0))
    jumps = any(item.command == Command.DO_JUMP for item in items)
    for number, (where, values) in enumerate(rows):
        if jumps and values[0] != number:
            raise PlanError(
                f"{where}: item {number} is numbered {values[0]:g} in column 1, so that jumps do not say where to;"
                " number the items from 0 on"
            )
    home = None
    params = ParamSet()
    if begins_with_home(items) and not in_water(items[0], params["ORIGIN_ALT"], params):
        home = _home(*rows[0])
        items[0] = replace(items[0], is_home=True)
    return PlanFile(mission=tuple(items), home=home)


def _row(line: str, where: str) -> tuple[str, tuple[float, ...]]:
    fields = line.split()
    if len(fields) != _COLUMNS:
        raise PlanError(f"{where}: has {len(fields)} columns, {_COLUMNS} are needed; the file may be cut off")
    values = []
    for column, field in enumerate(fields, start=1):
        try:
            values.append(float(field))
        except ValueError as error:
            raise PlanError(f"{where}: column {column} is {field!r}; it has to be a number") from error
    for column in (0, 2, 3, 11):
        whole = math.isfinite(values[column]) and values[column] == int(values[column])
        if not whole or not 0 <= values[column] <= 65535:
            raise PlanError(f"{where}: column {column + 1} is {fields[column]!r}; it has to be a whole number")
    return where, tuple(values)


def _home(where: str, values: tuple[float, ...]) -> Origin | None:
    """Home, None while it is not set (0, 0)."""
    lat, lon, alt = values[8:11]
    if lat == 0.0 and lon == 0.0:
        return None
    try:
        return Origin(lat_deg=lat, lon_deg=lon, alt_m=alt)
    except ConfigError as error:
        raise PlanError(f"{where}: home: {error}") from error


def read_plan(path: Path) -> PlanFile:
    """Read a plan file.

    Parameters
    ----------
    path
        ``.plan`` or ``.json`` (QGroundControl), ``.waypoints`` or ``.txt`` (QGC WPL 110), ``.toml`` (local metres).

    Returns
    -------
    PlanFile
        Items in wire units (degrees times 1e7 or local metres times 1e4).

    Raises
    ------
    PlanError
        It cannot be read; one line with file, place and remedy.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise PlanError(f"{path}: unknown kind of plan file; use .plan (QGroundControl), .waypoints or .toml")
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise PlanError(f"{path}: is larger than {MAX_FILE_BYTES} bytes, which no plan is; give a plan file")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise PlanError(f"{path}: cannot be read ({error.strerror}); check the name") from error
    except UnicodeDecodeError as error:
        raise PlanError(f"{path}: is not UTF-8 text; export the plan again") from error
    return reader(text, str(path))


def write_plan(path: Path, plan: PlanFile) -> None:
    """Write a ``.plan`` file for QGroundControl.

    Parameters
    ----------
    path
        Its name, ending in ``.plan``; an existing file is replaced.
    plan
        Its content.

    Raises
    ------
    PlanError
        It cannot be written, or the name ends otherwise.
    """
    if path.suffix.lower() != ".plan":
        raise PlanError(f"{path}: plans are written as .plan only; give a name that ends so")
    text = write_qgc_plan(plan)
    try:
        write_whole(path, text)
    except OSError as error:
        raise PlanError(f"{path}: cannot be written ({error.strerror}); check folder and rights") from error


_READERS = {
    ".plan": read_qgc_plan,
    ".json": read_qgc_plan,
    ".waypoints": read_waypoints,
    ".txt": read_waypoints,
    ".toml": read_local_plan,
}
