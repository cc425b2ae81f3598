"""Survey and corridor scan as QGroundControl's plan view turns them into simple items.

As TransectStyleComplexItem of QGroundControl emits them: waypoints in frame GLOBAL_RELATIVE_ALT with a free heading,
turnarounds beyond the area, camera triggered by distance within it; with PX4 the entry and exit points are
CONDITION_GATE, with others waypoints.
"""

import math

import numpy as np

from autopilot.core.geodesy import Origin, geodetic_from_ned
from autopilot.core.plan import PlanItem

NAN = math.nan
RELATIVE, MISSION = 3, 2


def _placed(seq: int, command: int, origin: Origin, place: complex, depth: float, p4: float) -> PlanItem:
    lat, lon, _ = geodetic_from_ned(origin, np.array([place.real, place.imag, 0.0]))
    return PlanItem(
        seq=seq, frame=RELATIVE, command=command, param4=p4, x=round(lat * 1e7), y=round(lon * 1e7), z=-depth
    )


def _trigger(seq: int, distance_m: float) -> PlanItem:
    """DO_SET_CAM_TRIGG_DIST; p3 1 = one picture at once."""
    return PlanItem(
        seq=seq, frame=MISSION, command=206, param1=distance_m, param2=0.0, param3=float(distance_m > 0), param4=0.0
    )


def transects(
    lines: list[tuple[complex, complex]], origin: Origin, *, depth: float, turn_m: float, gates: bool, trigger_m: float
) -> list[PlanItem]:
    """Legs (north + 1j east), each with its turnarounds and pictures on the way."""
    items: list[PlanItem] = []

    def add(command: int, place: complex) -> None:
        items.append(_placed(len(items), command, origin, place, depth, 0.0 if command == 4501 else NAN))

    for begin, end in lines:
        ahead = turn_m * (end - begin) / abs(end - begin)
        edge = 4501 if gates and turn_m else 16
        if turn_m:
            add(16, begin - ahead)
        for place, pictures_m in ((begin, trigger_m), (end, 0.0)):
            add(edge, place)
            if trigger_m:
                items.append(_trigger(len(items), pictures_m))
        if turn_m:
            add(16, end + ahead)
    return items


def survey(
    origin: Origin, corner: complex, size: complex, spacing_m: float, *, depth: float, **more: float
) -> list[PlanItem]:
    """Parallel legs to and fro over a rectangle, along north."""
    count = int(size.imag / spacing_m) + 1
    lines = []
    for k in range(count):
        begin = corner + 1j * k * spacing_m
        leg = begin, begin + size.real
        lines.append(leg if k % 2 == 0 else leg[::-1])
    return transects(
        lines,
        origin,
        depth=depth,
        turn_m=more.get("turn_m", 0.0),
        gates=bool(more.get("gates", 0.0)),
        trigger_m=more.get("trigger_m", 0.0),
    )


def corridor(
    origin: Origin, path: list[complex], offsets_m: tuple[float, ...], *, depth: float, trigger_m: float
) -> list[PlanItem]:
    """A path to and fro, shifted sideways: its inner corners are plain waypoints."""
    items: list[PlanItem] = []
    for k, offset in enumerate(offsets_m):
        step = np.diff(path)
        side = 1j * np.array([*step, step[-1]]) / np.abs([*step, step[-1]])
        places = list(np.array(path) + offset * side)[:: 1 if k % 2 == 0 else -1]
        for n, place in enumerate(places):
            items.append(_placed(len(items), 16, origin, complex(place), depth, NAN))
            if trigger_m and n in (0, len(places) - 1):
                items.append(_trigger(len(items), trigger_m if n == 0 else 0.0))
    return items
