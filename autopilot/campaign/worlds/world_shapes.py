"""Random outlines and solids of a world, with clearances of single points."""

import math
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from autopilot.core import shapes
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Polygon

Point: TypeAlias = tuple[float, float]
Corners: TypeAlias = tuple[Point, ...]


@dataclass(frozen=True, slots=True)
class Disc:
    """A vertical cylinder seen from above."""

    center_m: Point
    radius_m: float


@dataclass(frozen=True, slots=True)
class Block:
    """A vertical prism seen from above."""

    corners_m: Corners


Solid: TypeAlias = Disc | Block


@dataclass(frozen=True, slots=True)
class WorldLayout:
    outline_m: Corners | None
    """Walls all round, None = open water."""
    solids: tuple[Solid, ...] = ()
    walls: bool = True
    """The outline is solid; else it is only the fence."""
    doors_m: tuple[float, ...] = field(default=())
    """Widths of the openings in inner walls, for the record."""


def polygon_clearance_m(corners: Corners, place: Point) -> float:
    """Distance to the rim of a polygon, negative inside."""
    return float(shapes.clearance_m(Polygon(vertices_ned_m=np.array(corners)), np.array([place]))[0])


def clearance_m(layout: WorldLayout, place: Point) -> float:
    """Distance of a point from everything solid or fenced, negative where it is forbidden; inf in open water."""
    walls = math.inf if layout.outline_m is None else -polygon_clearance_m(layout.outline_m, place)
    return min([walls, *(solid_clearance_m(solid, place) for solid in layout.solids)])


def solid_clearance_m(solid: Solid, place: Point) -> float:
    """Distance of a point from a solid, negative inside."""
    if isinstance(solid, Disc):
        return math.dist(solid.center_m, place) - solid.radius_m
    return polygon_clearance_m(solid.corners_m, place)


def rounded(corners: FloatArray) -> Corners:
    """Corners rounded to centimetres."""
    return tuple((round(float(north), 2), round(float(east), 2)) for north, east in corners)


def box(center: Point, length_m: float, width_m: float, angle_rad: float) -> Corners:
    """A rectangle turned about its centre."""
    half = 0.5 * np.array([(-length_m, -width_m), (length_m, -width_m), (length_m, width_m), (-length_m, width_m)])
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return rounded(half @ np.array([(c, s), (-s, c)]) + np.array(center))


def star(rng: np.random.Generator, center: Point, radius_m: float, corners: int, roughness: float) -> Corners:
    """An irregular polygon round a centre; ``roughness`` 0 = all corners at the radius, 0.6 = deep bays."""
    step = 2.0 * math.pi / corners
    angles = step * (np.arange(corners) + rng.uniform(-0.3, 0.3, corners))
    radii = radius_m * (1.0 - roughness * rng.uniform(0.0, 1.0, corners))
    return rounded(np.array(center) + radii[:, None] * np.stack((np.cos(angles), np.sin(angles)), axis=1))


def l_shape(length_m: float, width_m: float, notch: Point) -> Corners:
    """A rectangle about the origin without the corner to the north-east; ``notch``: share of each side cut away."""
    a, b = 0.5 * length_m, 0.5 * width_m
    n, e = a - notch[0] * length_m, b - notch[1] * width_m
    return rounded(np.array([(-a, -b), (a, -b), (a, e), (n, e), (n, b), (-a, b)]))


def wall_pieces(
    outline: Corners | None, foot: Point, direction_rad: float, length_m: float, doors: list[tuple[float, float]]
) -> list[tuple[Point, Point]]:
    """Pieces (ends) of an inner wall through ``foot``, from rim to rim of the outline or ``length_m`` long.
    ``doors``: position (share of the wall, 0 to 1) and width [m] of each opening.
    """
    unit = np.array((math.cos(direction_rad), math.sin(direction_rad)))
    low, high = -0.5 * length_m, 0.5 * length_m
    if outline is not None:
        found = _chord(np.array(outline), np.array(foot), unit)
        if found is None:
            return []
        # A little into the rim on both sides, so that nothing passes there.
        low, high = found[0] - 0.05, found[1] + 0.05
    cuts = sorted((low + fraction * (high - low) - 0.5 * width, width) for fraction, width in doors)
    pieces, at = [], low
    for begin, width in [*cuts, (high, 0.0)]:
        if begin - at > 0.08:
            pieces.append((_on(foot, unit, at), _on(foot, unit, begin)))
        at = max(at, begin + width)
    return pieces


def _on(foot: Point, unit: FloatArray, along: float) -> Point:
    return (foot[0] + along * float(unit[0]), foot[1] + along * float(unit[1]))


def _chord(outline: FloatArray, foot: FloatArray, unit: FloatArray) -> tuple[float, float] | None:
    """Ends of the chord of a line through an inner point; None if the point is not inside."""
    if not shapes.inside_polygon(outline, foot[None])[0]:
        return None
    rel = outline - foot
    across = rel[:, 1] * unit[0] - rel[:, 0] * unit[1]
    along = rel @ unit
    after, along_after = np.roll(across, -1), np.roll(along, -1)
    crosses = (across > 0.0) != (after > 0.0)
    fraction = across[crosses] / (across[crosses] - after[crosses])
    hits = along[crosses] + fraction * (along_after[crosses] - along[crosses])
    return float(np.max(hits[hits <= 0.0], initial=-1e3)), float(np.min(hits[hits > 0.0], initial=1e3))
