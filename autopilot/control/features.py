"""The boundaries of a fence as arrays: edges of polygons, circles, and corners that stand out into free ground.

Horizontal positions are complex numbers north + i east.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Polygon

ComplexArray: TypeAlias = NDArray[np.complex128]
IntArray: TypeAlias = NDArray[np.intp]
BoolArray: TypeAlias = NDArray[np.bool_]

TINY_M = 1e-9

FAR_M = 1e6
"""Stands for "no boundary anywhere near"."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Edges:
    """Edges of all polygons; those of one polygon stand together, in its order, with its inside at +90 degrees."""

    a: ComplexArray
    """(E,) where they begin."""
    ab: ComplexArray
    """(E,) from there to where they end."""
    along: ComplexArray
    """(E,) real(along * (p - a)) is the share of the edge at which a point p projects."""
    normal: ComplexArray
    """(E,) unit vectors towards the free side."""
    begin_hides: BoolArray
    """(E,) a point whose nearest place of the polygon is the corner at which the edge begins is in forbidden ground."""
    end_hides: BoolArray
    """(E,) the same of the corner at which the edge ends."""
    polygon: IntArray
    """(E,) number of the polygon."""
    keep_outside: BoolArray
    """(P,) per polygon: exclusion."""
    center: ComplexArray
    """(P,) of a circle round each polygon."""
    reach: FloatArray
    """(P,) its radius."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Rounds:
    """Things with one centre: circles, then corners (radius 0)."""

    center: ComplexArray
    """(C,)"""
    radius: FloatArray
    """(C,)"""
    side: FloatArray
    """(C,) +1 keep away from it, -1 keep inside it."""
    polygon: IntArray
    """(C,) number of the polygon whose corner it is, -1 = a circle."""
    circles: int
    """How many circles there are."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Seen:
    """Edges as points see them; (m, E)."""

    share: FloatArray
    rho: FloatArray
    """Distance from the edge, never negative."""
    distance: FloatArray
    """Signed; FAR_M where the edge has nothing to say."""
    normal: ComplexArray
    """Unit vectors that point where the vehicle has to be."""
    offset: FloatArray
    """of the boundary along them"""
    line: FloatArray
    """Distance from the edge's straight line, positive on its free side."""
    bad: BoolArray | None
    """Edges that a point is behind, None if there is none."""


def features_of(fence: Fence) -> tuple[Edges, Rounds]:
    """The boundaries of a fence."""
    polygons: list[tuple[ComplexArray, bool]] = []
    circles: list[tuple[Circle, float]] = []
    for shapes, inside in ((fence.inclusions, True), (fence.exclusions, False)):
        for shape in shapes:
            if isinstance(shape, Circle):
                circles.append((shape, -1.0 if inside else 1.0))
            else:
                polygons.append((_counter_clockwise(shape), inside))
    edges = _edges(polygons)
    stand_out = ~edges.begin_hides
    corners = edges.a[stand_out]
    centers = np.array([complex(*np.asarray(c.center_ned_m, dtype=float)[:2]) for c, _ in circles], dtype=complex)
    rounds = Rounds(
        center=np.concatenate([centers, corners]),
        radius=np.concatenate([[float(c.radius_m) for c, _ in circles], np.zeros(len(corners))]),
        side=np.concatenate([[side for _, side in circles], np.ones(len(corners))]),
        polygon=np.concatenate([np.full(len(circles), -1), edges.polygon[stand_out]]).astype(np.intp),
        circles=len(circles),
    )
    return edges, rounds


def _edges(polygons: list[tuple[ComplexArray, bool]]) -> Edges:
    nothing = np.zeros(0, dtype=complex)
    corners = np.concatenate([nothing, *(v for v, _ in polygons)])
    ab = np.concatenate([nothing, *(np.roll(v, -1) - v for v, _ in polygons)])
    free_left = np.concatenate([np.zeros(0), *(np.full(len(v), 1.0 if inside else -1.0) for v, inside in polygons)])
    before = np.concatenate([nothing, *(v - np.roll(v, 1) for v, _ in polygons)])
    # A corner hides what is behind it where the boundary turns towards the free side.
    begin_hides = (np.conj(before) * ab).imag * free_left > 0.0
    ends, at = [np.zeros(0, dtype=bool)], 0
    for v, _ in polygons:
        ends.append(np.roll(begin_hides[at : at + len(v)], -1))
        at += len(v)
    length = np.abs(ab)
    middle = [0.5 * complex(v.real.min() + v.real.max(), v.imag.min() + v.imag.max()) for v, _ in polygons]
    return Edges(
        a=corners,
        ab=ab,
        along=np.conj(ab) / np.maximum(length, TINY_M) ** 2,
        normal=1j * ab / np.maximum(length, TINY_M) * free_left,
        begin_hides=begin_hides,
        end_hides=np.concatenate(ends),
        polygon=np.repeat(np.arange(len(polygons)), [len(v) for v, _ in polygons]).astype(np.intp),
        keep_outside=np.array([not inside for _, inside in polygons], dtype=bool),
        center=np.array(middle, dtype=complex),
        reach=np.array([float(np.abs(v - m).max()) for (v, _), m in zip(polygons, middle, strict=True)]),
    )


def _counter_clockwise(polygon: Polygon) -> ComplexArray:
    """Corners in the order that has the inside at +90 degrees from every edge; repeated ones once."""
    v = as_complex(np.array(polygon.vertices_ned_m, dtype=float).reshape(-1, 2))
    different = np.abs(v - np.roll(v, 1)) > TINY_M
    v = v[different] if different.sum() > 2 else v
    return v if float((np.conj(v) * np.roll(v, -1)).imag.sum()) > 0.0 else v[::-1].copy()


def as_complex(points_ned_m: FloatArray) -> ComplexArray:
    """(m, 2) as north + i east (m,)."""
    return np.ascontiguousarray(points_ned_m, dtype=float).view(np.complex128)[:, 0]


def away(ray: ComplexArray, rho: FloatArray) -> ComplexArray:
    """Unit vectors along rays; north where there is none."""
    if rho.min(initial=FAR_M) < TINY_M:
        return np.where(rho < TINY_M, 1.0, ray / np.maximum(rho, TINY_M))
    result: ComplexArray = ray / rho
    return result
