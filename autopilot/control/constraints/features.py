"""Boundaries of a fence as arrays (edges of polygons, circles, corners that are convex towards the free space), and
their distances from points.

Horizontal positions are complex numbers north + i east [m].
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from autopilot.control.constraints.constraints_tuning import FEATURES
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence

ComplexArray: TypeAlias = NDArray[np.complex128]
IntArray: TypeAlias = NDArray[np.intp]
BoolArray: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PolygonEdges:
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
    """Number of circles."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class VisibleEdges:
    """Edges as points see them; (m, E)."""

    fraction: FloatArray
    rho: FloatArray
    """Distance from the edge, never negative."""
    distance: FloatArray
    """Signed; ``far_m`` where the edge is not active."""
    normal: ComplexArray
    """Unit vectors that point where the vehicle has to be."""
    offset: FloatArray
    """of the boundary along them"""
    line: FloatArray
    """Distance from the edge's straight line, positive on its free side."""
    bad: BoolArray | None
    """Edges that a point is behind, None if there is none."""


class Boundaries:
    """The boundaries of a fence, and their distances from points."""

    def __init__(self, fence: Fence) -> None:
        self.edges, self.rounds = _features_of(fence)
        self.count = len(self.edges.a) + self.rounds.circles
        """Number of edges and circles."""
        self.many = self.count > FEATURES.many_features
        self.everything = np.arange(len(self.edges.a)), np.arange(len(self.rounds.center))
        self._groups = _groups(self.edges.polygon)

    def within(self, points: ComplexArray, reach_m: float) -> tuple[IntArray, IntArray]:
        """Edges and corners within ``reach_m`` of the points.

        Of a polygon within reach all edges are kept that may be the nearest to one of the points: they decide the
        side.
        """
        low, high = complex(points.real.min(), points.imag.min()), complex(points.real.max(), points.imag.max())
        middle, spread = 0.5 * (low + high), 0.5 * abs(high - low)
        reach_m += spread
        edges, rounds = self.edges, self.rounds
        near = rounds.side * np.abs(rounds.center - middle) - rounds.side * rounds.radius < reach_m
        kept_rounds = np.flatnonzero(near)
        if not len(edges.a):
            return self.everything[0], kept_rounds
        half = 0.5 * np.abs(edges.ab)
        distance = np.abs(edges.a + 0.5 * edges.ab - middle)
        surely = np.minimum.reduceat(distance + half, self._groups[0]) + 2.0 * spread
        near = distance - half < np.maximum(surely, reach_m)[edges.polygon]
        away = edges.keep_outside & (np.abs(edges.center - middle) - edges.reach > reach_m)
        return np.flatnonzero(near & ~away[edges.polygon]), kept_rounds

    def visible_edges(self, points: ComplexArray, keep: IntArray) -> VisibleEdges:
        """The edges ``keep`` as points see them."""
        edges = self.edges
        whole = len(keep) == len(edges.a)
        pick: IntArray | slice = slice(None) if whole else keep
        normal_of_edge = edges.normal[pick]
        ray = points[:, None] - edges.a[pick]
        fraction = (ray * edges.along[pick]).real
        gap = ray - np.minimum(np.maximum(fraction, 0.0), 1.0) * edges.ab[pick]
        rho = np.abs(gap)
        line = (ray * np.conj(normal_of_edge)).real
        if rho.min(initial=FEATURES.far_m) < FEATURES.tiny_m:
            normal = np.where(rho < FEATURES.tiny_m, normal_of_edge, gap / np.maximum(rho, FEATURES.tiny_m))
        else:
            normal = gap / rho
        distance = np.where(fraction >= 1.0, FEATURES.far_m, rho)
        bad = self._behind(keep, fraction, rho, line)
        if bad is not None:
            # Of a polygon with the point inside (outside) only the nearest edge is active, with the opposite sign
            # (but not from the line itself).
            first, group = self._groups if whole else _groups(edges.polygon[keep])
            distance[np.logical_or.reduceat(bad, first, axis=1)[:, group]] = FEATURES.far_m
            distance[bad] = -rho[bad]
            normal[bad & (rho >= FEATURES.tiny_m)] *= -1.0
        offset = (np.conj(normal) * (points[:, None] - gap)).real
        return VisibleEdges(
            fraction=fraction, rho=rho, distance=distance, normal=normal, offset=offset, line=line, bad=bad
        )

    def _behind(self, keep: IntArray, fraction: FloatArray, rho: FloatArray, line: FloatArray) -> BoolArray | None:
        """(m, E) nearest edges of a polygon that have the point on the wrong side; None if none has.

        A point is on the wrong side of a polygon by its nearest edge or its nearest corner.
        """
        if line.min(initial=0.0) >= 0.0:
            return None
        edges, whole = self.edges, len(keep) == len(self.edges.a)
        pick: IntArray | slice = slice(None) if whole else keep
        first, group = self._groups if whole else _groups(edges.polygon[keep])
        nearest = rho <= np.minimum.reduceat(rho, first, axis=1)[:, group]
        if not (nearest & (line < 0.0)).any():
            return None
        corner = np.where(fraction < -FEATURES.on_edge, edges.begin_hides[pick], edges.end_hides[pick])
        bad: BoolArray = nearest & np.where(
            (fraction < -FEATURES.on_edge) | (fraction > 1.0 + FEATURES.on_edge), corner, line < 0.0
        )
        return bad if bad.any() else None


def _features_of(fence: Fence) -> tuple[PolygonEdges, Rounds]:
    polygons: list[tuple[FloatArray, bool]] = []
    circles: list[tuple[Circle, float]] = []
    for shapes, inside in ((fence.inclusions, True), (fence.exclusions, False)):
        for shape in shapes:
            if isinstance(shape, Circle):
                circles.append((shape, -1.0 if inside else 1.0))
            else:
                corners = np.asarray(shape.vertices_ned_m, dtype=float).reshape(-1, 2)
                if len(corners):
                    polygons.append((corners, inside))
    edges = _edges(polygons)
    stand_out = ~edges.begin_hides
    standing = edges.a[stand_out]
    centers = np.array([complex(*np.asarray(c.center_ned_m, dtype=float)[:2]) for c, _ in circles], dtype=complex)
    rounds = Rounds(
        center=np.concatenate([centers, standing]),
        radius=np.concatenate([[float(c.radius_m) for c, _ in circles], np.zeros(len(standing))]),
        side=np.concatenate([[side for _, side in circles], np.ones(len(standing))]),
        polygon=np.concatenate([np.full(len(circles), -1), edges.polygon[stand_out]]).astype(np.intp),
        circles=len(circles),
    )
    return edges, rounds


def _edges(polygons: list[tuple[FloatArray, bool]]) -> PolygonEdges:
    """All polygons at once: a new fence is for the control step in which it comes."""
    inside = np.array([each for _, each in polygons], dtype=bool)
    v, ring = _counter_clockwise([corners for corners, _ in polygons])
    following = v[ring.after]
    ab, before = following - v, v - v[ring.before]
    free_left = np.where(inside, 1.0, -1.0)[ring.number]
    # A corner that is convex towards the free side hides the boundary behind it.
    begin_hides = (np.conj(before) * ab).imag * free_left > 0.0
    length = np.abs(ab)
    center: ComplexArray = np.zeros(0, dtype=complex)
    reach: FloatArray = np.zeros(0)
    if len(v):
        center = np.zeros(len(polygons), dtype=complex)
        center.real = 0.5 * (ring.least(v.real) - ring.least(-v.real))
        center.imag = 0.5 * (ring.least(v.imag) - ring.least(-v.imag))
        reach = -ring.least(-np.abs(v - center[ring.number]))
    return PolygonEdges(
        a=v,
        ab=ab,
        along=np.conj(ab) / np.maximum(length, FEATURES.tiny_m) ** 2,
        normal=1j * ab / np.maximum(length, FEATURES.tiny_m) * free_left,
        begin_hides=begin_hides,
        end_hides=begin_hides[ring.after],
        polygon=ring.number,
        keep_outside=~inside,
        center=center,
        reach=reach,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Rings:
    """Corners of polygons that stand one after the other in one array."""

    first: IntArray
    """(P,) where each begins."""
    number: IntArray
    """(E,) the polygon of every corner."""
    before: IntArray
    after: IntArray
    """(E,) the neighbours of every corner."""

    @classmethod
    def of(cls, counts: IntArray) -> "_Rings":
        """Rings with that number of corners each (possibly none)."""
        first = np.cumsum(counts) - counts
        number = np.repeat(np.arange(len(counts)), counts)
        before, after = np.arange(len(number)) - 1, np.arange(len(number)) + 1
        before[first], after[first + counts - 1] = first + counts - 1, first
        return cls(first, number, before, after)

    def least(self, values: FloatArray) -> FloatArray:
        """(P,) the least of (E,) per polygon."""
        return np.minimum.reduceat(values, self.first)


def _counter_clockwise(polygons: list[FloatArray]) -> tuple[ComplexArray, _Rings]:
    """Corners in the order that has the inside at +90 degrees from every edge; repeated ones once."""
    counts = np.array([len(corners) for corners in polygons], dtype=np.intp)
    ring = _Rings.of(counts)
    if not len(counts):
        return np.zeros(0, dtype=complex), ring
    v = as_complex(np.concatenate(polygons))
    different = np.abs(v - v[ring.before]) > FEATURES.tiny_m
    if not different.all():
        enough = np.add.reduceat(different.astype(np.intp), ring.first) > 2
        kept = different | ~enough[ring.number]
        counts = np.add.reduceat(kept.astype(np.intp), ring.first)
        v, ring = v[kept], _Rings.of(counts)
    area = np.add.reduceat((np.conj(v) * v[ring.after]).imag, ring.first)
    mirrored = ring.first[ring.number] + (ring.first + counts - 1)[ring.number] - np.arange(len(v))
    return np.where((area > 0.0)[ring.number], v, v[mirrored]), ring


def as_complex(points_ned_m: FloatArray) -> ComplexArray:
    """(m, 2) as north + i east (m,)."""
    return np.ascontiguousarray(points_ned_m, dtype=float).view(np.complex128)[:, 0]


def unit_rays(ray: ComplexArray, rho: FloatArray) -> ComplexArray:
    """Unit vectors along rays; north where there is none."""
    if rho.min(initial=FEATURES.far_m) < FEATURES.tiny_m:
        return np.where(rho < FEATURES.tiny_m, 1.0, ray / np.maximum(rho, FEATURES.tiny_m))
    return ray / rho


def _groups(polygon: IntArray) -> tuple[IntArray, IntArray]:
    """Start index of each polygon's edges, and (E,) the number of its group."""
    begins = np.ones(len(polygon), dtype=bool)
    begins[1:] = polygon[1:] != polygon[:-1]
    return np.flatnonzero(begins), np.cumsum(begins) - 1
