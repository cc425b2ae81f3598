"""Free space of the vehicle and its connectivity, shared by upload checks, routes and energy plans.

Quadtree over the area: a cell is free if the vehicle can be at *some* position in it (found by ascent of the
clearance), and neighbours are linked if the straight line between their positions keeps the radius. A cell is
subdivided if it may be free but no position is found, and if a link to a neighbour is blocked without a detour close
by. Passages of two radii plus a few millimetres are found in a basin of any size, while open water and straight walls
stay coarse.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from autopilot.core.core_tuning import SPACE
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.shapes import bounding_box

IntArray: TypeAlias = NDArray[np.intp]
BoolArray: TypeAlias = NDArray[np.bool_]


CHORD_LOSS_M = 1e-3
"""By how much the line between two places may cut a corner."""


KING = ((0, 1), (1, 0), (1, 1), (1, -1), (0, -1), (-1, 0), (-1, -1), (-1, 1))


class FenceDistances(Protocol):
    """Distances to the boundaries of a fence."""

    def near(self, places: FloatArray, reach_m: float) -> tuple[FloatArray, FloatArray]:
        """(n,) clearance of places (n, 2), at most ``reach_m``, and (n, 2) its slope (zero where it is cut off)."""
        ...


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Area:
    low_m: FloatArray
    """(2,) north, east"""
    high_m: FloatArray
    """(2,)"""


def workspace_of(fence: Fence) -> Area | None:
    """Bounding box of the intersection of all inclusions, None without any (open water); empty if low is above high."""
    if not fence.inclusions:
        return None
    boxes = [bounding_box(shape) for shape in fence.inclusions]
    return Area(low_m=np.max([b[0] for b in boxes], axis=0), high_m=np.min([b[1] for b in boxes], axis=0))


class FreeSpace:
    """Places that keep ``radius_m`` from every boundary, and the straight lines between them that do."""

    def __init__(
        self,
        ground: FenceDistances,
        area: Area,
        radius_m: float,
        *,
        long_moves: float = 0.0,
        check_cancel: Callable[[], None] = lambda: None,
    ) -> None:
        """``long_moves``: the longest move over the grid, in cells, that :meth:`moves` will be asked for;
        ``check_cancel`` is called between the steps (it may raise, to end the work)."""
        self._ground, self.radius_m = ground, radius_m
        size = np.maximum(area.high_m - area.low_m, 1e-3)
        self.base_cell_m = max(SPACE.finest_base_m, math.sqrt(float(size[0] * size[1]) / SPACE.base_cells))
        self._low = area.low_m
        self._shape = (int(size[0] / self.base_cell_m) + 1, int(size[1] / self.base_cell_m) + 1)
        self._deepest = max(0, math.ceil(math.log2(self.base_cell_m / SPACE.tight_m) - 1e-9))
        self._reach_m = math.hypot(radius_m, 0.5 * long_moves * self.base_cell_m) + 1e-6
        self._cells = _Cells.none()
        self._pairs = np.zeros((0, 2), dtype=np.intp)
        self._clear = np.zeros(0, dtype=bool)
        self._build(check_cancel)
        self._number()

    # What there is.

    def _number(self) -> None:
        """Store the free cells in the order of discovery."""
        kept = np.flatnonzero(self._cells.alive)
        number = np.full(len(self._cells.alive), -1)
        number[kept] = np.arange(len(kept))
        cells = self._cells
        self.places_ned_m: FloatArray = cells.place[kept]
        """(n, 2)"""
        self.clearance_m: FloatArray = cells.clearance[kept]
        """(n,) of the places, cut off where it is more than matters"""
        self.cell_m: FloatArray = np.ldexp(self.base_cell_m, -cells.level[kept])
        """(n,) sizes of their cells"""
        self.links: IntArray = number[self._pairs[self._clear]]
        """(m, 2) places that see each other, each pair once"""
        self._lattice = np.full(self._shape, -1)
        first = kept[(cells.level[kept] == 0) & ~cells.moved[kept]]
        self._lattice[cells.row[first], cells.column[first]] = number[first]

    def moves(self, offsets: tuple[tuple[int, int], ...]) -> IntArray:
        """(m, 2) pairs of places ``offsets`` apart on the grid with which it began, where the line between is free."""
        node, found = self._lattice, [np.zeros((0, 2), dtype=np.intp)]
        reach = max(max(abs(di), abs(dj)) for di, dj in offsets)
        padded = np.pad(node, reach, constant_values=-1)
        height, width = node.shape
        for di, dj in offsets:
            other = padded[reach + di : reach + di + height, reach + dj : reach + dj + width]
            both = (node >= 0) & (other >= 0)
            a, b = node[both], other[both]
            need = math.hypot(self.radius_m, 0.5 * math.hypot(di, dj) * self.base_cell_m)
            free = np.minimum(self.clearance_m[a], self.clearance_m[b]) >= need
            found.append(np.stack([a[free], b[free]], axis=1))
        return np.concatenate(found)

    def lengths_m(self, pairs: IntArray) -> FloatArray:
        """(m,) between the places of pairs (m, 2)."""
        offset = self.places_ned_m[pairs[:, 1]] - self.places_ned_m[pairs[:, 0]]
        return np.hypot(offset[:, 0], offset[:, 1])

    def regions(self) -> IntArray:
        """(n,) number of the connected region of every place."""
        from scipy.sparse import csr_matrix
        from scipy.sparse.csgraph import connected_components

        count, a, b = len(self.places_ned_m), self.links[:, 0], self.links[:, 1]
        graph = csr_matrix((np.ones(len(a)), (a, b)), shape=(count, count))
        return connected_components(graph, directed=False)[1].astype(np.intp)

    def place_near(self, point_ned_m: FloatArray) -> tuple[int, float] | None:
        """The nearest position with a free line to a point (2,), else the nearest one, and its distance [m].

        For a point nearer to a boundary than the radius the line may run along the boundary. None if no cell is free.
        """
        if not len(self.places_ned_m):
            return None
        away = np.hypot(*(self.places_ned_m - point_ned_m).T)
        count = min(SPACE.attach, len(away))
        near = np.argpartition(away, count - 1)[:count]
        near = near[np.lexsort((near, away[near]))]
        for some in (near[: SPACE.first_attach], near):
            sees = self.in_sight(point_ned_m, some)
            if sees.any():
                break
        best = int(near[int(sees.argmax())])
        return best, float(away[best])

    def places_near(self, points_ned_m: FloatArray) -> IntArray:
        """(n,) the place of :meth:`place_near` of many points (n, 2) at once, which is much quicker; -1 if nothing is
        free."""
        from scipy.spatial import cKDTree

        best: IntArray = np.full(len(points_ned_m), -1)
        most = min(SPACE.attach, len(self.places_ned_m))
        if not most or not len(points_ned_m):
            return best
        tree = cKDTree(self.places_ned_m)
        here, _ = self._ground.near(points_ned_m, self._reach_m)
        best[:] = tree.query(points_ned_m)[1]
        blind = np.flatnonzero(here > 0.0)
        for count in (min(SPACE.first_attach, most), most):
            if not len(blind):
                break
            near = np.asarray(tree.query(points_ned_m[blind], k=np.arange(1, count + 1))[1])
            start, at, nodes = (
                np.repeat(points_ned_m[blind], count, axis=0),
                np.repeat(here[blind], count),
                near.ravel(),
            )
            keep = np.minimum(self.radius_m, at)
            sees = self._sees(start, self.places_ned_m[nodes], at, self.clearance_m[nodes], keep).reshape(near.shape)
            seen = sees.any(axis=1)
            best[blind[seen]] = near[seen, sees[seen].argmax(axis=1)]
            blind = blind[~seen]
        return best

    def in_sight(self, point_ned_m: FloatArray, nodes: IntArray) -> BoolArray:
        """(k,) which of the places ``nodes`` a point (2,) sees; from forbidden ground none."""
        here, _ = self._ground.near(point_ned_m[None], self._reach_m)
        count = len(nodes)
        if here[0] <= 0.0:
            return np.zeros(count, dtype=bool)
        start = np.repeat(point_ned_m[None], count, axis=0)
        keep = min(self.radius_m, float(here[0]))
        return self._sees(start, self.places_ned_m[nodes], np.repeat(here, count), self.clearance_m[nodes], keep)

    # How it is found.

    def _build(self, check_cancel: Callable[[], None]) -> None:
        row, column = (a.ravel() for a in np.indices(self._shape))
        fresh = self._settle(np.zeros(len(row), dtype=np.intp), row, column, check_cancel)
        self._cells = fresh
        touched = np.flatnonzero(fresh.alive)
        for _ in range(SPACE.max_rounds):
            self._join(touched)
            split = self._barred()
            free_cells = (SPACE.max_cells - int(self._cells.alive.sum())) // 3
            if not len(split) or free_cells <= 0:
                break
            touched = self._halve(split[:free_cells], check_cancel)

    def _centers(self, level: IntArray, row: IntArray, column: IntArray) -> tuple[FloatArray, FloatArray]:
        """Middles (n, 2) and sizes (n,) of cells."""
        size: FloatArray = np.ldexp(self.base_cell_m, -level)
        return self._low + size[:, None] * (np.stack([row, column], axis=1) + 0.5), size

    def _settle(self, level: IntArray, row: IntArray, column: IntArray, check_cancel: Callable[[], None]) -> "_Cells":
        """The cells that are free somewhere; those of which that is not sure are halved."""
        found = []
        while len(level):
            check_cancel()
            cells, doubtful = self._classify(level, row, column)
            found.append(cells)
            again = np.flatnonzero(doubtful & (level < self._deepest))[: SPACE.max_doubtful]
            level, row, column = _quarters(level[again], row[again], column[again])
        return _Cells.joined(found)

    def _classify(self, level: IntArray, row: IntArray, column: IntArray) -> tuple["_Cells", BoolArray]:
        """Cells with a place, and which of all others (n,) may have one all the same."""
        center, size = self._centers(level, row, column)
        half = math.sqrt(0.5) * size
        reach = max(self._reach_m, self.radius_m + 2.0 * float(half.max()))
        clearance, slope = self._ground.near(center, reach)
        place, have = center.copy(), clearance.copy()
        wanted = np.hypot(self.radius_m, half)
        maybe = np.flatnonzero((clearance < wanted) & (clearance >= self.radius_m - half))
        one_sided = np.ones(len(maybe), dtype=bool)
        at, uphill, here = center[maybe], slope[maybe], clearance[maybe]
        low, high = center[maybe] - 0.5 * size[maybe, None], center[maybe] + 0.5 * size[maybe, None]
        for step in range(SPACE.settle_steps + SPACE.comfort_steps if len(maybe) else 0):
            if step == SPACE.settle_steps:
                at = place[maybe]
                here, uphill = self._ground.near(at, reach)
            target = self.radius_m + SPACE.beyond_m if step < SPACE.settle_steps else wanted[maybe]
            at = np.clip(at + uphill * np.maximum(target - here, 0.0)[:, None], low, high)
            here, uphill = self._ground.near(at, reach)
            better = here > have[maybe]
            place[maybe[better]], have[maybe[better]] = at[better], here[better]
            one_sided &= (uphill * slope[maybe]).sum(axis=1) > SPACE.one_boundary
        enough = self.radius_m - SPACE.settled_m
        unsettled = np.flatnonzero(have[maybe] < enough)
        for corner in ((-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)) if len(unsettled) else ():
            there = center[maybe[unsettled]] + size[maybe[unsettled], None] * np.array(corner)
            here, uphill = self._ground.near(there, reach)
            better = here > have[maybe[unsettled]]
            place[maybe[unsettled[better]]], have[maybe[unsettled[better]]] = there[better], here[better]
            one_sided[unsettled] &= (uphill * slope[maybe[unsettled]]).sum(axis=1) > SPACE.one_boundary
        free = have >= enough
        doubtful = np.zeros(len(level), dtype=bool)
        doubtful[maybe] = ~one_sided
        doubtful &= ~free
        moved = np.zeros(len(level), dtype=bool)
        moved[maybe] = (place[maybe] != center[maybe]).any(axis=1)
        return _Cells(
            level=level[free],
            row=row[free],
            column=column[free],
            place=place[free],
            clearance=have[free],
            moved=moved[free],
            alive=np.ones(int(free.sum()), dtype=bool),
        ), doubtful

    def _join(self, touched: IntArray) -> None:
        """Link the neighbours of cells (indices) that have free lines to each other."""
        pairs = self._neighbours(touched)
        cells = self._cells
        a, b = pairs[:, 0], pairs[:, 1]
        place, clearance = cells.place, cells.clearance
        clear = self._sees(place[a], place[b], clearance[a], clearance[b], self.radius_m)
        self._pairs, self._clear = np.concatenate([self._pairs, pairs]), np.concatenate([self._clear, clear])

    def _neighbours(self, touched: IntArray) -> IntArray:
        """(m, 2) pairs of cells with a common side or corner, one of them at least ``touched`` and new; each pair
        once.
        """
        cells, fresh = self._cells, self._fresh
        alive = np.flatnonzero(cells.alive)
        codes = _code(cells.level[alive], cells.row[alive], cells.column[alive])
        order = np.argsort(codes)
        codes, alive = codes[order], alive[order]
        level, row, column = cells.level[touched], cells.row[touched], cells.column[touched]
        found = []
        for di, dj in KING:
            r, c = row + di, column + dj
            inside = (r >= 0) & (c >= 0)
            for up in range(int(level.max(initial=0)) + 1):
                queried = np.flatnonzero(inside & (level >= up))
                code = _code(level[queried] - up, r[queried] >> up, c[queried] >> up)
                at = np.minimum(np.searchsorted(codes, code), len(codes) - 1)
                hit = codes[at] == code
                found.append(np.stack([touched[queried[hit]], alive[at[hit]]], axis=1))
        pairs = np.sort(np.concatenate(found), axis=1) if found else np.zeros((0, 2), dtype=np.intp)
        pairs = pairs[(pairs[:, 0] != pairs[:, 1]) & (pairs >= fresh).any(axis=1)]
        return np.unique(pairs, axis=0)

    _fresh = 0
    """Cells from this number on are new in this round."""

    def _sees(
        self, a: FloatArray, b: FloatArray, at_a: FloatArray, at_b: FloatArray, keep_m: float | FloatArray
    ) -> BoolArray:
        """(m,) whether straight lines from ``a`` to ``b`` (m, 2), whose clearances are given, keep a distance (scalar
        or m).

        The distance of a line of length l to a boundary is at least sqrt(d^2 - l^2 / 4) if both ends have clearance d.
        """
        free = np.ones(len(a), dtype=bool)
        edge = np.arange(len(a))
        need = np.broadcast_to(np.asarray(keep_m, dtype=float) - CHORD_LOSS_M, len(a))
        for _ in range(SPACE.bisections):
            step = b - a
            least = np.minimum(at_a, at_b)
            free[edge[least < need[edge]]] = False
            surely = np.maximum(need[edge], 0.0)
            open_ = (least**2 - 0.25 * (step**2).sum(axis=1) < surely**2) & free[edge]
            if not open_.any():
                return free
            a, b, at_a, at_b, edge = a[open_], b[open_], at_a[open_], at_b[open_], edge[open_]
            middle = 0.5 * (a + b)
            at_middle, _ = self._ground.near(middle, self._reach_m + float(np.abs(step[open_]).max()))
            a, b = np.concatenate([a, middle]), np.concatenate([middle, b])
            at_a, at_b = np.concatenate([at_a, at_middle]), np.concatenate([at_middle, at_b])
            edge = np.concatenate([edge, edge])
        free[edge[np.minimum(at_a, at_b) < need[edge]]] = False
        return free

    def _barred(self) -> IntArray:
        """Cells to halve: the larger ones of neighbours that neither see each other nor have a neighbour in common
        that sees both; coarse ones first."""
        from scipy.sparse import csr_matrix

        cells, count = self._cells, len(self._cells.alive)
        level = cells.level
        barred = self._pairs[~self._clear]
        barred = barred[np.minimum(level[barred[:, 0]], level[barred[:, 1]]) < self._deepest]
        if not len(barred):
            return np.zeros(0, dtype=np.intp)
        a, b = self._pairs[self._clear].T
        sees = csr_matrix((np.ones(2 * len(a)), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(count, count))
        common = np.asarray(sees[barred[:, 0]].multiply(sees[barred[:, 1]]).sum(axis=1)).ravel()
        barred = barred[common == 0]
        low, high = level[barred[:, 0]], level[barred[:, 1]]
        chosen = np.unique(np.concatenate([barred[low <= high, 0], barred[high <= low, 1]]))
        return chosen[np.argsort(level[chosen], kind="stable")]

    def _halve(self, split: IntArray, check_cancel: Callable[[], None]) -> IntArray:
        """Replace cells by their quarters; the cells whose neighbours are other ones now."""
        cells = self._cells
        removed = np.zeros(len(cells.alive), dtype=bool)
        removed[split] = True
        beside = removed[self._pairs].any(axis=1)
        around = np.unique(self._pairs[beside])
        self._pairs, self._clear = self._pairs[~beside], self._clear[~beside]
        cells.alive[split] = False
        self._fresh = len(cells.alive)
        fresh = self._settle(*_quarters(cells.level[split], cells.row[split], cells.column[split]), check_cancel)
        self._cells = _Cells.joined([cells, fresh])
        around = around[self._cells.alive[around]]
        return np.concatenate([around, np.arange(self._fresh, len(self._cells.alive))])


@dataclass(slots=True, eq=False, kw_only=True)
class _Cells:
    """Cells that have a place; (n,) each."""

    level: IntArray
    """Level of subdivision."""
    row: IntArray
    column: IntArray
    """In a grid of that level."""
    place: FloatArray
    """(n, 2)"""
    clearance: FloatArray
    moved: BoolArray
    """The place is not the middle."""
    alive: BoolArray
    """Not halved."""

    @classmethod
    def none(cls) -> "_Cells":
        whole, no = np.zeros(0, dtype=np.intp), np.zeros(0, dtype=bool)
        return cls(
            level=whole, row=whole, column=whole, place=np.zeros((0, 2)), clearance=np.zeros(0), moved=no, alive=no
        )

    @classmethod
    def joined(cls, parts: "list[_Cells]") -> "_Cells":
        if not parts:
            return cls.none()
        names = ("level", "row", "column", "place", "clearance", "moved", "alive")
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def _quarters(level: IntArray, row: IntArray, column: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """The four parts of every cell."""
    rows = np.concatenate([2 * row + i for i in (0, 0, 1, 1)])
    columns = np.concatenate([2 * column + j for j in (0, 1, 0, 1)])
    return np.tile(level + 1, 4), rows, columns


def _code(level: IntArray, row: IntArray, column: IntArray) -> NDArray[np.int64]:
    return (level.astype(np.int64) << 56) | (row.astype(np.int64) << 28) | column.astype(np.int64)
