"""Error model of a marker map: which markers were laid together, as a sheet, and with which accuracy.

Markers on one sheet are placed by the printer; the sheet is placed by hand. The errors of its markers are therefore
common: a translation and a rotation. Sheets that the map does not name are found by their lattice: markers of one
heading whose distances are multiples of a grid step belong to one sheet, as hand-laid sheets never align so well.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray

SHEET_SIGMA_M, SHEET_SIGMA_RAD = 0.005, 0.01
"""Laying accuracy with ruler and tape: 5 mm, and 3 mm over the half length of an A2 sheet."""
SHEET_SIGMA_DOWN_M = 0.001
"""Standard deviation of a sheet's depth: uneven floor."""
PRINT_SIGMA_M = 0.0001
"""Standard deviation of a marker on its sheet."""
SCALE_SIGMA = 0.003
"""Of the printed size, as a share of it: printers that make 99.7 % of 100 %."""
DEPTH_SIGMA_M = 0.005
"""Of the depth of the whole map, measured from the surface with a folding rule."""
SAME_M, SAME_RAD = 5e-5, 1e-4
"""Neighbours that fit one grid so well were printed together."""
REACH = 1.6
"""Neighbours are markers up to so many times the usual distance apart."""
CELL_M = 0.6
"""Loose markers are taken together in squares of this side: their errors average to one of the square's."""
STATES = 4
"""Of a sheet: north, east, down [m], heading [rad]."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MapErrors:
    """Sheets of a map and how far they may lie off where it has them."""

    sheet: NDArray[np.int64]
    """(n,) number of each marker's sheet, -1 = the marker is where the map has it."""
    names: tuple[str, ...]
    """(k,) of the sheets."""
    pivot_ned_m: FloatArray
    """(k, 3) middle of each sheet, which it turns about."""
    sigma: FloatArray
    """(k, 4) north, east, down [m], heading [rad]."""
    marker_sigma_m: FloatArray
    """(n,) place of each marker on its sheet, per axis."""
    loose: frozenset[int] = frozenset()
    """Sheets that are none: markers that only lie close together, each with an error of its own."""
    frame_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of the whole map against the frame that it was laid in: horizontally per axis, down [m], heading [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Laid:
    """Laying accuracy of one marker as stated by the map; None = not stated."""

    sheet: str | None = None
    sigma_m: float | None = None
    sigma_rad: float | None = None


def map_errors(
    centers_ned_m: FloatArray,
    yaw_rad: FloatArray,
    laid: Sequence[Laid],
    *,
    frame_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0),
    print_sigma_m: float = PRINT_SIGMA_M,
    loose_sigma_m: float = SHEET_SIGMA_M,
) -> MapErrors | None:
    """Sheets of markers by name, else by lattice; None for a single sheet without stated errors.

    ``loose_sigma_m``: standard deviation of markers on no sheet without a stated one. A single sheet defines its own
    frame: its position in the tank is unobservable.
    """
    stated = any(entry.sigma_m is not None or entry.sigma_rad is not None for entry in laid)
    groups = _groups(centers_ned_m, yaw_rad, laid)
    if (len(groups) < 2 and not stated) or all(entry.sigma_m == 0.0 for entry in laid):
        return None
    sheet = np.full(len(laid), -1, dtype=np.int64)
    marker_sigma = np.full(len(laid), print_sigma_m)
    cells: set[int] = set()
    names: list[str] = []
    pivots: list[FloatArray] = []
    sigmas: list[tuple[float, float, float, float]] = []
    for name, members, loose in groups:
        entry = laid[members[0]]
        usual_m = loose_sigma_m if loose else SHEET_SIGMA_M
        sigma_m = usual_m if entry.sigma_m is None else entry.sigma_m
        sigma_rad = SHEET_SIGMA_RAD if entry.sigma_rad is None else entry.sigma_rad
        if sigma_m == 0.0:
            continue
        down_m = min(sigma_m, SHEET_SIGMA_DOWN_M)
        if loose:
            # Each has an error of its own; common to all is its mean.
            cells.add(len(names))
            marker_sigma[members] = sigma_m
            factor = 2.0 / math.sqrt(len(members) + 3.0)
            sigma_m, down_m = factor * sigma_m, factor * down_m
            sigma_rad = min(sigma_rad, sigma_m / (0.3 * CELL_M))
        sheet[members] = len(names)
        names.append(name)
        pivots.append(centers_ned_m[members].mean(axis=0))
        sigmas.append((sigma_m, sigma_m, down_m, sigma_rad))
    if not names:
        return None
    return MapErrors(
        sheet=sheet,
        names=tuple(names),
        pivot_ned_m=np.array(pivots),
        sigma=np.array(sigmas),
        marker_sigma_m=marker_sigma,
        loose=frozenset(cells),
        frame_sigma=frame_sigma,
    )


def error_arrays(errors: MapErrors) -> dict[str, Any]:
    """As arrays by name, for a file."""
    return {
        "sheet": errors.sheet,
        "sheet_names": np.array(errors.names),
        "sheet_pivot_ned_m": errors.pivot_ned_m,
        "sheet_sigma": errors.sigma,
        "marker_sigma_m": errors.marker_sigma_m,
        "loose_sheets": np.array(sorted(errors.loose), dtype=np.int64),
        "frame_sigma": np.array(errors.frame_sigma),
    }


def errors_of_arrays(arrays: Mapping[str, Any]) -> MapErrors:
    """Inverse of :func:`error_arrays`."""
    across, down, turn = np.asarray(arrays["frame_sigma"]).tolist()
    return MapErrors(
        sheet=arrays["sheet"],
        names=tuple(str(name) for name in arrays["sheet_names"]),
        pivot_ned_m=arrays["sheet_pivot_ned_m"],
        sigma=arrays["sheet_sigma"],
        marker_sigma_m=arrays["marker_sigma_m"],
        loose=frozenset(np.asarray(arrays["loose_sheets"]).tolist()),
        frame_sigma=(across, down, turn),
    )


def _groups(
    centers_ned_m: FloatArray, yaw_rad: FloatArray, laid: Sequence[Laid]
) -> list[tuple[str, NDArray[np.int64], bool]]:
    """Name and members of each sheet, and whether its members are loose markers that only lie close together."""
    named: dict[str, list[int]] = {}
    unnamed: list[int] = []
    for n, entry in enumerate(laid):
        if entry.sheet is None:
            unnamed.append(n)
        else:
            named.setdefault(entry.sheet, []).append(n)
    result = [(name, np.array(members, dtype=np.int64), False) for name, members in named.items()]
    loose: dict[tuple[int, int], list[int]] = {}
    rest = np.array(unnamed, dtype=np.int64)
    for part in lattices(centers_ned_m[rest], yaw_rad[rest]) if len(rest) else []:
        members = rest[part]
        if len(members) > 1:
            result.append((f"{len(result) + 1}", members, False))
        elif laid[int(members[0])].sigma_m != 0.0:
            cell = np.floor(centers_ned_m[members[0], :2] / CELL_M).astype(int)
            loose.setdefault((int(cell[0]), int(cell[1])), []).append(int(members[0]))
    for (row, column), cell_members in loose.items():
        result.append((f"at {CELL_M * row:.1f} {CELL_M * column:.1f}", np.array(cell_members, dtype=np.int64), True))
    return result


def lattices(centers_ned_m: FloatArray, yaw_rad: FloatArray) -> list[NDArray[np.int64]]:
    """Markers that were printed together: connected by neighbours that fit one grid."""
    n = len(centers_ned_m)
    if n == 1:
        return [np.zeros(1, dtype=np.int64)]
    pitch = max(_usual_distance(centers_ned_m), SAME_M)
    order = np.argsort(centers_ned_m[:, 0], kind="stable")
    north = centers_ned_m[order, 0]
    ends = np.searchsorted(north, north + REACH * pitch, side="right")
    parent = list(range(n))

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for k, end in enumerate(ends.tolist()):
        i = int(order[k])
        others = order[k + 1 : end]
        apart = centers_ned_m[others] - centers_ned_m[i]
        near = np.hypot(apart[:, 0], apart[:, 1]) <= REACH * pitch
        turned = (yaw_rad[others] - yaw_rad[i] + math.pi) % (2.0 * math.pi) - math.pi
        c, s = math.cos(float(yaw_rad[i])), math.sin(float(yaw_rad[i]))
        along, across = c * apart[:, 0] + s * apart[:, 1], c * apart[:, 1] - s * apart[:, 0]
        off = np.maximum(
            np.abs(along - pitch * np.rint(along / pitch)), np.abs(across - pitch * np.rint(across / pitch))
        )
        off = np.maximum(off, np.abs(apart[:, 2]))
        for j in others[near & (off <= SAME_M) & (np.abs(turned) <= SAME_RAD)].tolist():
            parent[root(j)] = root(i)
    roots = np.array([root(i) for i in range(n)])
    return [np.flatnonzero(roots == r) for r in np.unique(roots)]


def _usual_distance(centers_ned_m: FloatArray) -> float:
    """The grid's step: that between most markers and their nearest ones [m]."""
    nearest = []
    for k in range(0, len(centers_ned_m), max(1, len(centers_ned_m) // 200)):
        apart = np.linalg.norm(centers_ned_m - centers_ned_m[k], axis=1)
        apart[k] = np.inf
        nearest.append(float(apart.min()))
    # On a sheet the nearest ones are exactly a step away; across an edge they are closer or farther.
    steps = np.sort(np.array(nearest))
    width = max(1, len(steps) // 4)
    start = int(np.argmin(steps[width - 1 :] - steps[: len(steps) - width + 1]))
    return float(np.median(steps[start : start + width]))
