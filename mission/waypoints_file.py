"""The text format ``QGC WPL 110`` (``.waypoints``): one mission item per line.

Format: MAVLink developer guide, "File formats": ``seq current frame command p1 p2 p3 p4 x y z autocontinue``, tabs.
Ground stations of the ArduPilot family put home into the first line, a NAV_WAYPOINT in frame 0; others do not. It is
read as home unless all other lines are in frame 0 too.
"""

import math

from autopilot.core.errors import ConfigError, PlanError
from autopilot.core.geodesy import Origin
from autopilot.core.plan import PlanItem
from mission.items import Command, Frame
from mission.plan_model import PlanFile, make_item

HEADER = "QGC WPL 110"
_COLUMNS = 12


def read_waypoints(text: str, name: str) -> PlanFile:
    """The plan in a ``.waypoints`` text. PlanError names file, line and remedy."""
    lines = text.splitlines()
    if not lines or lines[0].strip() != HEADER:
        shown = lines[0].strip()[:40] if lines else ""
        raise PlanError(f"{name}: line 1 is {shown!r}, not {HEADER!r}; give a waypoints file of version 110")
    rows = [_row(line, f"{name}: line {n}") for n, line in enumerate(lines[1:], start=2) if line.strip()]
    offset = 1 if _begins_with_home(rows) else 0
    home = _home(*rows[0]) if offset else None
    items: list[PlanItem] = []
    for where, values in rows[offset:]:
        params = list(values[4:11])
        if int(values[3]) == Command.DO_JUMP:
            params[0] -= offset
        items.append(make_item(where, len(items), int(values[2]), int(values[3]), params, values[11] != 0.0))
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


def _begins_with_home(rows: list[tuple[str, tuple[float, ...]]]) -> bool:
    """Whether the first line is home and not a waypoint."""
    if not rows:
        return False
    first = rows[0][1]
    others = {int(values[2]) for _, values in rows[1:] if values[2] != Frame.MISSION}
    return first[2] == Frame.GLOBAL and first[3] == Command.NAV_WAYPOINT and others != {int(Frame.GLOBAL)}


def _home(where: str, values: tuple[float, ...]) -> Origin | None:
    """Home, None while it is not set (0, 0)."""
    lat, lon, alt = values[8:11]
    if lat == 0.0 and lon == 0.0:
        return None
    try:
        return Origin(lat_deg=lat, lon_deg=lon, alt_m=alt)
    except ConfigError as error:
        raise PlanError(f"{where}: home: {error}") from error
