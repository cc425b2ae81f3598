"""The fence in the form that the controller uses: clearances, nearest boundaries, half-planes per stage.

A boundary constrains the vehicle's centre by the half-plane that touches it at the point nearest to the predicted
path. On the free side the half-plane keeps the centre a radius away; on the wrong side (inside an obstacle, outside
the workspace) its sign changes, and it leads out on the shortest path. Motion between the nodes:
:mod:`autopilot.control.constraints.chords`.
"""

import ctypes
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from autopilot.control.constraints.chords import NEAR_M, RECOVERY_M_S, Movers, Path
from autopilot.control.constraints.constraints_tuning import FEATURES
from autopilot.control.constraints.features import (
    Boundaries,
    ComplexArray,
    IntArray,
    PolygonEdges,
    Rounds,
    as_complex,
    unit_rays,
)
from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence

__all__ = ["Features", "Movers", "clearance_m", "fence_key"]

POINTS_TOGETHER = 64
"""Points per block when far features are left out: a tile of 8 x 8 cells, a few metres of a line."""

POINTS_AT_ONCE = 4096
"""Bound on the arrays of points by features."""
_POINTERS = ("a", "ab", "along", "normal", "polygon", "center", "radius", "side")


class _Boundaries(compiled.Mirror):
    """ctypes layout of the struct in surroundings.c."""

    _fields_ = (
        ("edges", ctypes.c_long),
        ("rounds", ctypes.c_long),
        *((name, ctypes.c_void_p) for name in _POINTERS),
        ("tiny", ctypes.c_double),
        ("far", ctypes.c_double),
        ("recovery_m_s", ctypes.c_double),
    )


STRUCTS = (_Boundaries,)


class CompiledHalfPlanes:
    """The boundaries of a fence as the library takes them.

    Ten times as fast as :mod:`autopilot.control.constraints.chords`, which documents the quantities and handles the
    remaining cases (forbidden areas, crossed walls)."""

    def __init__(self, library: Any, edges: PolygonEdges, rounds: Rounds) -> None:
        kinds: dict[str, Any] = dict.fromkeys(("a", "ab", "along", "normal", "center"), np.complex128)
        kinds |= {"polygon": np.dtype(ctypes.c_long), "radius": float, "side": float}
        own = {"center": rounds.center, "radius": rounds.radius, "side": rounds.side}
        values = {name: own[name] if name in own else getattr(edges, name) for name in kinds}
        self._arrays = {name: np.ascontiguousarray(values[name], dtype=kind) for name, kind in kinds.items()}
        addresses = {name: array.ctypes.data for name, array in self._arrays.items()}
        self._struct = _Boundaries(
            edges=len(edges.a),
            rounds=len(rounds.center),
            tiny=FEATURES.tiny_m,
            far=FEATURES.far_m,
            recovery_m_s=RECOVERY_M_S,
            **addresses,
        )
        self._reference, self._call = ctypes.byref(self._struct), library.half_planes
        self._seen: tuple[tuple[FloatArray | int | None, ...], tuple[int | None, ...]] = (None,) * 6, ()

    def margin_m(
        self,
        points_ned_m: FloatArray,
        t_s: FloatArray,
        radius_m: FloatArray | float,
        slots: int = 0,
        normals: FloatArray | None = None,
        offsets: FloatArray | None = None,
    ) -> float | None:
        """As :meth:`autopilot.control.constraints.obstacles.Features.half_planes`; without ``normals`` its margin
        alone. None where this is not a common case: the arrays are then undefined. ValueError: an array does not fit
        to the points."""
        m = len(points_ned_m) - 1
        keep_m = np.full(m, radius_m) if isinstance(radius_m, float) else radius_m
        seen, known = self._seen
        if all(a is b for a, b in zip(seen, (points_ned_m, t_s, keep_m, normals, offsets, slots), strict=True)):
            return self._margin_m(m, known, slots)
        tight = points_ned_m.strides[1] == t_s.itemsize and t_s.flags.c_contiguous and keep_m.flags.c_contiguous
        if m < 1 or not tight or not points_ned_m.dtype == t_s.dtype == keep_m.dtype == np.float64:
            return None
        stride = points_ned_m.strides[0] // points_ned_m.itemsize
        out: tuple[int | None, int | None] = None, None
        if normals is not None and offsets is not None:
            if not (normals.flags.c_contiguous and offsets.flags.c_contiguous):
                return None
            out = compiled.fitting("normals", normals, m, slots, 2), compiled.fitting("offsets", offsets, m, slots)
        # The optimiser's arrays are the same at every step; to ask for an address takes as long as the call.
        times = compiled.fitting("t_s", t_s, m + 1), compiled.fitting("radius_m", keep_m, m)
        known = (points_ned_m.ctypes.data, stride, *times, *out)
        self._seen = (points_ned_m, t_s, keep_m, normals, offsets, slots), known
        return self._margin_m(m, known, slots)

    def _margin_m(self, m: int, known: tuple[int | None, ...], slots: int) -> float | None:
        points, stride, t_s, keep_m, *out = known
        margin: float = self._call(self._reference, m, points, stride, t_s, keep_m, slots, *out)
        return None if math.isnan(margin) else margin


class Features(Boundaries):
    """A fence, ready for many questions."""

    def __init__(self, fence: Fence) -> None:
        super().__init__(fence)
        library = compiled.library(*STRUCTS) if self.count > 0 else None
        self._quick = None if library is None else CompiledHalfPlanes(library, self.edges, self.rounds)

    def nearest(
        self, points: ComplexArray, keep: tuple[IntArray, IntArray] | None = None
    ) -> tuple[FloatArray, ComplexArray, FloatArray]:
        """Per point (m,) and edge or circle: signed distance (m, F), unit normal (m, F), offset of the boundary (m,
        F).

        ``keep`` selects features. Their constraint is ``normal . p >= offset``; distance is positive in the free
        space. Features without effect at that point (shared ends, far walls seen from outside) have distance
        ``far_m``.
        """
        edges, rounds = keep or self.everything
        seen = self.visible_edges(points, edges)
        circles = rounds[rounds < self.rounds.circles]
        if not len(circles):
            return seen.distance, seen.normal, seen.offset
        center, side = self.rounds.center[circles], self.rounds.side[circles]
        ray = points[:, None] - center
        rho = np.abs(ray)
        normal = unit_rays(ray, rho) * side
        signed_radius = side * self.rounds.radius[circles]
        offset = (np.conj(normal) * center).real + signed_radius
        return (
            np.concatenate([seen.distance, rho * side - signed_radius], axis=1),
            np.concatenate([seen.normal, normal], axis=1),
            np.concatenate([seen.offset, offset], axis=1),
        )

    def clearance_m(self, points_ned_m: FloatArray) -> FloatArray:
        """Distance (m,) of points (m, 2) to the nearest boundary, negative where forbidden; ``far_m`` without a fence.

        A point in forbidden ground of one shape may be in free ground of others: the worst of all decides.
        """
        if self.count == 0:
            return np.full(len(points_ned_m), FEATURES.far_m)
        distance, _, _ = self.nearest(as_complex(points_ned_m))
        result: FloatArray = distance.min(axis=1)
        return result

    def clearance_up_to_m(self, points_ned_m: FloatArray, cap_m: float) -> FloatArray:
        """min(:meth:`clearance_m`, ``cap_m``). Fast for many features if consecutive points of the array (m, 2) are
        close to each other: features are evaluated only where they are near.
        """
        if not self.many:
            return np.minimum(self.clearance_m(points_ned_m), cap_m)
        points = as_complex(points_ned_m)
        result = np.full(len(points), cap_m)
        for begin in range(0, len(points), POINTS_TOGETHER):
            part = slice(begin, begin + POINTS_TOGETHER)
            keep = self.within(points[part], cap_m)
            if len(keep[0]) or len(keep[1]):
                distance, _, _ = self.nearest(points[part], keep)
                result[part] = np.minimum(distance.min(axis=1, initial=cap_m), cap_m)
        return result

    def push_out(self, points_ned_m: FloatArray, radius_m: float) -> FloatArray:
        """Steps (m, 2) that bring each point to ``radius_m`` from its nearest boundary; zero where farther away.

        Neighbours in the array should be neighbours in the plane.
        """
        points, steps = as_complex(points_ned_m), np.zeros(len(points_ned_m), dtype=complex)
        together = POINTS_TOGETHER // 4 if self.many else len(points)
        for begin in range(0, len(points), max(together, 1)):
            part = points[begin : begin + together]
            keep = self.within(part, radius_m) if self.many else self.everything
            distance, normal, _ = self.nearest(part, keep)
            if distance.shape[1]:
                nearest = distance.argmin(axis=1)[:, None]
                lack = np.maximum(radius_m - np.take_along_axis(distance, nearest, axis=1), 0.0)
                steps[begin : begin + together] = (lack * np.take_along_axis(normal, nearest, axis=1))[:, 0]
        return steps.view(float).reshape(-1, 2)

    def near(self, places: FloatArray, reach_m: float) -> tuple[FloatArray, FloatArray]:
        points = as_complex(places)
        clearance, slope = np.full(len(points), reach_m), np.zeros(len(points), dtype=complex)
        for part in self._tiles(points):
            keep = self.within(points[part], reach_m) if self.many else self.everything
            distance, normal, _ = self.nearest(points[part], keep)
            if not distance.shape[1]:
                continue
            nearest = distance.argmin(axis=1)[:, None]
            found = np.take_along_axis(distance, nearest, axis=1)[:, 0]
            inside = found < reach_m
            clearance[part[inside]] = found[inside]
            slope[part[inside]] = np.take_along_axis(normal, nearest, axis=1)[inside, 0]
        return clearance, slope.view(float).reshape(-1, 2)

    def _tiles(self, points: ComplexArray) -> Iterator[IntArray]:
        """Indices of points that are neighbours in the plane, together; of few features all at once."""
        if not self.many or len(points) <= POINTS_TOGETHER:
            for begin in range(0, len(points), POINTS_AT_ONCE):
                yield np.arange(begin, min(begin + POINTS_AT_ONCE, len(points)))
            return
        low, high = complex(points.real.min(), points.imag.min()), complex(points.real.max(), points.imag.max())
        side = max(abs(high - low) / math.sqrt(len(points) / POINTS_TOGETHER), FEATURES.tiny_m)
        row, column = ((points.real - low.real) // side).astype(int), ((points.imag - low.imag) // side).astype(int)
        order = np.lexsort((column, row))
        change = (np.diff(row[order]) != 0) | (np.diff(column[order]) != 0)
        yield from np.split(order, np.flatnonzero(change) + 1)

    # The prediction.

    def half_planes(
        self,
        points_ned_m: FloatArray,
        t_s: FloatArray,
        radius_m: FloatArray | float,
        slots: int,
        normals: FloatArray,
        offsets: FloatArray,
        movers: Movers | None = None,
    ) -> float:
        """Fill ``normals`` (m, slots, 2) and ``offsets`` (m, slots) with the nearest boundaries of a predicted path.

        ``points_ned_m`` (m + 1, 2) begins with the present position, ``t_s`` (m + 1,) are their times. ``radius_m``,
        scalar or (m,), is the required distance of predicted positions from a boundary (the present one as the first).
        A boundary that is violated now is approached at RECOVERY_M_S instead of at once, so that other limits are kept
        on the way back. Unused slots get a zero normal and offset -1, which is always satisfied. Returns the smallest
        clearance beyond ``radius_m`` of the path, chords included (of many features, those within NEAR_M are
        evaluated).
        """
        if self._quick is not None and movers is None:
            margin = self._quick.margin_m(points_ned_m, t_s, radius_m, slots, normals, offsets)
            if margin is not None:
                return min(margin, NEAR_M) if self.many else margin
        normals[:], offsets[:] = 0.0, -1.0
        if self.count == 0 and movers is None:
            return FEATURES.far_m
        path = Path(self, points_ned_m, t_s, radius_m, movers)
        path.end_at_walls()
        path.fill(slots, normals.view(np.complex128)[..., 0], offsets)
        return path.margin_m()

    def margin_m(
        self, points_ned_m: FloatArray, t_s: FloatArray, radius_m: FloatArray | float, movers: Movers | None = None
    ) -> float:
        """The smallest clearance beyond ``radius_m`` of a path, as :meth:`half_planes` returns it."""
        if self.count == 0 and movers is None:
            return FEATURES.far_m
        margin = None
        if self._quick is not None and movers is None:
            margin = self._quick.margin_m(points_ned_m, t_s, radius_m)
        if margin is None:
            return Path(self, points_ned_m, t_s, radius_m, movers).margin_m()
        return min(margin, NEAR_M) if self.many else margin


def clearance_m(fence: Fence, points_ned_m: Sequence[Sequence[float]] | FloatArray) -> FloatArray:
    """Signed clearance (m,) of points (m, 2) to the fence, for checks that need no speed."""
    return Features(fence).clearance_m(np.asarray(points_ned_m, dtype=float).reshape(-1, 2))


def fence_key(fence: Fence) -> tuple[object, ...]:
    """Horizontal content of a fence as a key, equal for equal fences."""
    parts: list[object] = []
    for shapes in (fence.inclusions, fence.exclusions):
        parts.append(len(shapes))
        for shape in shapes:
            if isinstance(shape, Circle):
                parts.append((np.asarray(shape.center_ned_m, dtype=float).tobytes(), float(shape.radius_m)))
            else:
                parts.append(np.asarray(shape.vertices_ned_m, dtype=float).tobytes())
    return tuple(parts)
