"""QGroundControl's ``.plan`` format, version 1 (JSON): reading and writing.

Format: QGroundControl developer guide, "Plan File Format"; QGroundControl's src/MissionManager. DO_JUMP targets in the
file are ``doJumpId`` values and not item numbers.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from autopilot.core.errors import ConfigError, PlanError
from autopilot.core.geodesy import Origin, deg_from_e7, m_from_local_e4
from autopilot.core.plan import PlanItem
from autopilot.mission.items import Command, MavFrame
from autopilot.mission.mission_tuning import QGC_PLAN
from autopilot.mission.plan_model import PlanFile, make_item, without_home

FILE_TYPE = "Plan"
_RALLY_VERSIONS = (QGC_PLAN.part_version, 1)
"""QGroundControl has written rallyPoints as version 1 for years; the points are the same."""
_COMPLEX_NODES = ("TransectStyleComplexItem",)
"""Where a survey or corridor scan keeps the simple items that it was turned into."""
_REQUIRED = object()


def read_qgc_plan(text: str, name: str) -> PlanFile:
    """Parse a ``.plan`` text.

    Parameters
    ----------
    text
        Content of the file.
    name
        Name of the file, for error messages.

    Returns
    -------
    PlanFile

    Raises
    ------
    PlanError
        File, place and remedy in one line.
    """
    try:
        root = json.loads(text, object_pairs_hook=_once_each)
    except json.JSONDecodeError as error:
        raise PlanError(
            f"{name}: is not complete JSON (line {error.lineno}: {error.msg}); export the plan again"
        ) from error
    except ValueError as error:
        raise PlanError(f"{name}: holds a number of thousands of digits; export the plan again") from error
    except PlanError as error:
        raise PlanError(f"{name}: {error}; remove one of them") from error
    except RecursionError as error:
        raise PlanError(f"{name}: is nested too deeply to be a plan; export the plan again") from error
    root = _typed(root, dict, name, "the file")
    if _get(root, "fileType", str, name) != FILE_TYPE:
        raise PlanError(f"{name}: fileType is {root['fileType']!r}, not {FILE_TYPE!r}; give a QGroundControl plan file")
    if _get(root, "version", int, name) != QGC_PLAN.version:
        raise PlanError(
            f"{name}: plan version {root['version']} is not supported; save it as version {QGC_PLAN.version}"
        )
    mission = _get(root, "mission", dict, name)
    home = _home(mission, f"{name}: mission")
    return PlanFile(
        mission=_mission(mission, f"{name}: mission"),
        fence=_fence(_get(root, "geoFence", dict, name, {}), f"{name}: geoFence"),
        rally=_rally(_get(root, "rallyPoints", dict, name, {}), f"{name}: rallyPoints"),
        home=home,
    )


def _once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object. PlanError if it has a key twice: the earlier one, a fence perhaps, would be lost."""
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        raise PlanError(f"key {next(key for key in keys if keys.count(key) > 1)!r} stands twice in one object")
    return table


def _typed(value: Any, kind: type, where: str, what: str) -> Any:
    """``value`` if it is of that type (int also where a float is expected); PlanError otherwise."""
    fits = isinstance(value, int | float) if kind is float else isinstance(value, kind)
    if not fits or (isinstance(value, bool) and kind is not bool):
        names = {dict: "an object", list: "a list", str: "a text", float: "a number", int: "a whole number"}
        shown = "null" if value is None else type(value).__name__
        raise PlanError(f"{where}: {what} is {shown}; it has to be {names.get(kind, 'true or false')}")
    return value


def _get(table: Mapping[str, Any], key: str, kind: type, where: str, default: Any = _REQUIRED) -> Any:
    """``table[key]`` checked; PlanError when it is missing or of another type."""
    if key not in table:
        if default is _REQUIRED:
            raise PlanError(f"{where}: key {key!r} is missing; export the plan again")
        return default
    return _typed(table[key], kind, where, key)


def _numbers(value: Any, count: int, where: str, what: str) -> list[float]:
    """A list of at least ``count`` numbers; null = NaN, as QGroundControl writes it."""
    items = _typed(value, list, where, what)
    if len(items) < count:
        raise PlanError(f"{where}: {what} has {len(items)} numbers; {count} are needed")
    return [math.nan if v is None else _float(v, where, what) for v in items[:count]]


def _float(value: Any, where: str, what: str) -> float:
    """A number as a float; JSON's whole numbers may be larger than any."""
    try:
        return float(_typed(value, float, where, what))
    except OverflowError as error:
        raise PlanError(f"{where}: {what} holds a number that is too large; correct it") from error


def _part_version(table: Mapping[str, Any], where: str, known: Sequence[int] = (QGC_PLAN.part_version,)) -> None:
    version = _get(table, "version", int, where, QGC_PLAN.part_version)
    if version not in known:
        raise PlanError(f"{where}: version {version} is not supported; save it as version {QGC_PLAN.part_version}")


def _home(mission: Mapping[str, Any], where: str) -> Origin | None:
    planned = mission.get("plannedHomePosition")
    if planned is None:
        return None
    lat, lon, alt = _numbers(planned, 3, where, "plannedHomePosition")
    try:
        return Origin(lat_deg=lat, lon_deg=lon, alt_m=0.0 if math.isnan(alt) else alt)
    except ConfigError as error:
        raise PlanError(f"{where}: plannedHomePosition: {error}") from error


def _simple_items(entries: Sequence[Any], where: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Simple items in order; complex items are replaced by their generated ones."""
    for index, entry in enumerate(entries):
        here = f"{where} item {index}"
        item = _typed(entry, dict, here, "the item")
        kind = _get(item, "type", str, here)
        if kind == "SimpleItem":
            yield here, item
            continue
        nested = next((item[node] for node in _COMPLEX_NODES if node in item), item)
        nested = _typed(nested, dict, here, "the complex item")
        if not isinstance(nested.get("Items"), list):
            name = item.get("complexItemType", kind)
            raise PlanError(f"{here}: complex item {name!r} has no list of simple items; turn it into waypoints")
        for k, sub in enumerate(nested["Items"]):
            yield f"{here}.{k}", _typed(sub, dict, f"{here}.{k}", "the item")


def _mission(mission: Mapping[str, Any], where: str) -> tuple[PlanItem, ...]:
    _part_version(mission, where)
    entries = list(_simple_items(_get(mission, "items", list, where), where))
    jump_ids = [_get(item, "doJumpId", int, here, seq + 1) for seq, (here, item) in enumerate(entries)]
    items = []
    for seq, (here, item) in enumerate(entries):
        command = _get(item, "command", int, here)
        frame = _get(item, "frame", int, here)
        params = _numbers(_get(item, "params", list, here), 7, here, "params")
        if isinstance(item.get("Altitude"), int | float):
            shown = _float(item["Altitude"], here, "Altitude")
            if math.isnan(params[6]):
                params[6] = shown
            elif item.get("AltitudeMode") in (1, 2) and abs(shown - params[6]) > 1e-3:  # else it is over the terrain
                raise PlanError(
                    f"{here}: Altitude is {shown:g}, which ground stations show, params[6] is {params[6]:g}, which is"
                    " flown; correct the one that is wrong"
                )
        if command == Command.DO_JUMP:
            count = jump_ids.count(params[0])
            if count != 1:
                have = (
                    "which no item has; correct params[0]" if not count else f"which {count} items have; correct them"
                )
                raise PlanError(f"{here}: jumps to doJumpId {params[0]:g}, {have}")
            params[0] = float(jump_ids.index(int(params[0])))
        autocontinue = _get(item, "autoContinue", bool, here, True)
        items.append(make_item(here, seq, frame, command, params, autocontinue))
    return tuple(items)


def _fence(fence: Mapping[str, Any], where: str) -> tuple[PlanItem, ...]:
    """Polygons, then circles, then the return point: the order in which QGroundControl sends them."""
    _part_version(fence, where)
    items: list[PlanItem] = []
    for index, entry in enumerate(_get(fence, "polygons", list, where, [])):
        here = f"{where} polygon {index}"
        polygon = _typed(entry, dict, here, "the polygon")
        inclusion = _get(polygon, "inclusion", bool, here)
        command = Command.FENCE_POLYGON_VERTEX_INCLUSION if inclusion else Command.FENCE_POLYGON_VERTEX_EXCLUSION
        vertices = _get(polygon, "polygon", list, here)
        if not vertices:
            raise PlanError(f"{here}: polygon has no vertices, so that it is no fence; draw it again, or remove it")
        for k, vertex in enumerate(vertices):
            lat, lon = _numbers(vertex, 2, f"{here} vertex {k}", "the vertex")
            params = (float(len(vertices)), 0.0, 0.0, 0.0, lat, lon, 0.0)
            items.append(make_item(f"{here} vertex {k}", len(items), MavFrame.GLOBAL, command, params))
    for index, entry in enumerate(_get(fence, "circles", list, where, [])):
        here = f"{where} circle {index}"
        outer = _typed(entry, dict, here, "the circle")
        inclusion = _get(outer, "inclusion", bool, here)
        command = Command.FENCE_CIRCLE_INCLUSION if inclusion else Command.FENCE_CIRCLE_EXCLUSION
        circle = _get(outer, "circle", dict, here)
        lat, lon = _numbers(_get(circle, "center", list, here), 2, here, "center")
        radius = _float(_get(circle, "radius", float, here), here, "radius")
        params = (radius, 0.0, 0.0, 0.0, lat, lon, 0.0)
        items.append(make_item(here, len(items), MavFrame.GLOBAL, command, params))
    if fence.get("breachReturn") is not None:
        lat, lon, alt = _numbers(fence["breachReturn"], 3, where, "breachReturn")
        params = (0.0, 0.0, 0.0, 0.0, lat, lon, alt)
        frame = MavFrame.GLOBAL_RELATIVE_ALT
        items.append(make_item(f"{where} breachReturn", len(items), frame, Command.FENCE_RETURN_POINT, params))
    return tuple(items)


def _rally(rally: Mapping[str, Any], where: str) -> tuple[PlanItem, ...]:
    _part_version(rally, where, _RALLY_VERSIONS)
    items = []
    for seq, point in enumerate(_get(rally, "points", list, where, [])):
        here = f"{where} point {seq}"
        lat, lon, alt = _numbers(point, 3, here, "the point")
        params = (0.0, 0.0, 0.0, 0.0, lat, lon, alt)
        items.append(make_item(here, seq, MavFrame.GLOBAL_RELATIVE_ALT, Command.RALLY_POINT, params))
    return tuple(items)


def write_qgc_plan(plan: PlanFile) -> str:
    """Text of a ``.plan`` file.

    Parameters
    ----------
    plan
        Content of the file.

    Returns
    -------
    str
        JSON.

    Raises
    ------
    PlanError
        The format cannot hold it (fence or rally points in a local frame).
    """
    home = plan.drawing_origin()
    document = {
        "fileType": FILE_TYPE,
        "version": QGC_PLAN.version,
        "groundStation": "QGroundControl",
        "mission": {
            "version": QGC_PLAN.part_version,
            "firmwareType": QGC_PLAN.autopilot_px4,
            "vehicleType": QGC_PLAN.type_submarine,
            "globalPlanAltitudeMode": 1,
            "cruiseSpeed": QGC_PLAN.speed_m_s,
            "hoverSpeed": QGC_PLAN.speed_m_s,
            "plannedHomePosition": [home.lat_deg, home.lon_deg, home.alt_m],
            "items": [_mission_entry(item) for item in without_home(plan.mission)],
        },
        "geoFence": _fence_entry(plan.fence),
        "rallyPoints": {"version": QGC_PLAN.part_version, "points": [_point(i, "rally point") for i in plan.rally]},
    }
    return json.dumps(document, indent=4, allow_nan=False) + "\n"


def _json_number(value: float) -> float | None:
    """A parameter; "not given" is NaN on the wire and null in this format."""
    return value if math.isfinite(value) else None


def _mission_entry(item: PlanItem) -> dict[str, Any]:
    local, none = item.frame == MavFrame.LOCAL_NED, item.frame == MavFrame.MISSION
    x, y = (float(v) if none else m_from_local_e4(v) if local else deg_from_e7(v) for v in (item.x, item.y))
    p1 = item.param1 + 1.0 if item.command == Command.DO_JUMP else item.param1
    params = [p1, item.param2, item.param3, item.param4, x, y, item.z]
    entry: dict[str, Any] = {
        "type": "SimpleItem",
        "autoContinue": item.autocontinue != 0,
        "command": item.command,
        "doJumpId": item.seq + 1,
        "frame": item.frame,
        "params": [_json_number(v) for v in params],
    }
    if not none:
        entry["Altitude"] = _json_number(item.z)
        entry["AltitudeMode"] = 2 if item.frame in (MavFrame.GLOBAL, MavFrame.GLOBAL_INT) else 1
        entry["AMSLAltAboveTerrain"] = None
    return entry


def _place(item: PlanItem, what: str) -> list[float]:
    if item.frame in (MavFrame.LOCAL_NED, MavFrame.MISSION):
        raise PlanError(f"{what} {item.seq}: frame {item.frame} cannot be written to a .plan file; use a global frame")
    return [deg_from_e7(item.x), deg_from_e7(item.y)]


def _point(item: PlanItem, what: str) -> list[float]:
    return [*_place(item, what), item.z]


def _fence_entry(items: Sequence[PlanItem]) -> dict[str, Any]:
    polygons: list[dict[str, Any]] = []
    circles: list[dict[str, Any]] = []
    entry: dict[str, Any] = {"version": QGC_PLAN.part_version, "circles": circles, "polygons": polygons}
    index = 0
    while index < len(items):
        item = items[index]
        inclusion = item.command in (Command.FENCE_POLYGON_VERTEX_INCLUSION, Command.FENCE_CIRCLE_INCLUSION)
        taken = 1
        if item.command == Command.FENCE_RETURN_POINT:
            entry["breachReturn"] = _point(item, "fence item")
        elif item.command in (Command.FENCE_CIRCLE_INCLUSION, Command.FENCE_CIRCLE_EXCLUSION):
            circle = {"center": _place(item, "fence item"), "radius": item.param1}
            circles.append({"circle": circle, "inclusion": inclusion, "version": 1})
        else:
            taken = max(1, int(item.param1)) if math.isfinite(item.param1) else 1
            vertices = [_place(v, "fence item") for v in items[index : index + taken]]
            polygons.append({"inclusion": inclusion, "polygon": vertices, "version": 1})
        index += taken
    return entry
