"""A current on a grid: multilinear in space and time between the nodes, constant beyond the border.

The nodes lie on axes time, depth, north and east of any spacing; time and depth are optional. Where a file has no data
(land, fill values) the grid holds still water and a flag (:meth:`CurrentMap.unknown_cells`), so that the control loop
never gets a NaN and a workspace over such cells can be refused in advance.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autopilot.control.current.current_tuning import CURRENT_MAP
from autopilot.core.frames import FloatArray

AXES = ("time_s", "depth_m", "north_m", "east_m")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MapNodes:
    """Nodes and values of a map. Axes are strictly increasing; a missing one has length 1."""

    name: str
    """For messages and the log: the file's name."""
    digest: str
    """SHA-256 of the file, "" when it was not a file."""
    time_s: FloatArray
    """(k,) of the service's clock."""
    depth_m: FloatArray
    """(d,)"""
    north_m: FloatArray
    """(a,)"""
    east_m: FloatArray
    """(b,)"""
    current_ned_m_s: FloatArray
    """(k, d, a, b, 3), NaN = not known."""
    geodetic: bool = False
    """The axes were latitude and longitude: the map lies where the origin was when it was read."""


class CurrentMap:
    """Current at any place and time, for some tens of points within a control step. Immutable."""

    steady: bool
    """It has one frame only."""

    def __init__(self, nodes: MapNodes) -> None:
        self.nodes = nodes
        self._axes = (nodes.time_s, nodes.depth_m, nodes.north_m, nodes.east_m)
        shape = tuple(len(axis) for axis in self._axes)
        known: NDArray[np.bool_] = np.asarray(np.isfinite(nodes.current_ned_m_s).all(axis=-1))
        self._unknown: NDArray[np.bool_] = ~known
        filled = np.where(known[..., None], nodes.current_ned_m_s, 0.0)
        self._flat: FloatArray = np.ascontiguousarray(filled.reshape(-1, 3))
        strides = [int(np.prod(shape[i + 1 :])) for i in range(len(shape))]
        # An axis of one node takes no part in the interpolation.
        self._active = [i for i in range(len(shape)) if shape[i] > 1]
        self._strides = strides
        corners = itertools.product(*[(0, strides[i]) for i in self._active])
        self._corners = np.array([sum(c) for c in corners], dtype=np.intp)
        self.steady = shape[0] == 1
        steps = np.abs(np.diff(filled, axis=0)).max(axis=(1, 2, 3, 4)) if shape[0] > 1 else np.zeros(0)
        self._drift_m_s = np.concatenate(([0.0], np.cumsum(steps)))

    @property
    def name(self) -> str:
        return self.nodes.name

    @property
    def scale_m(self) -> float:
        """Length scale of the field and of its error: two cells, at least a metre."""
        nodes = self.nodes
        return max(1.0, float(np.diff(nodes.north_m).max() + np.diff(nodes.east_m).max()))

    def velocity(self, pos_ned_m: FloatArray, t_s: FloatArray) -> FloatArray:
        """(m, 3) NED [m/s] at places (m, 3) and times (m,) of the service's clock."""
        values, fractions, _ = self._cell(pos_ned_m, t_s)
        for fraction in fractions:
            values = _between(values, fraction)
        return values[:, 0]

    def gradient(self, pos_ned_m: FloatArray, t_s: FloatArray) -> FloatArray:
        """(m, 3, 3) d c_i / d x_j [1/s]: constant along an axis within a cell, zero beyond the border."""
        values, fractions, spacings = self._cell(pos_ned_m, t_s)
        out = np.zeros((len(values), 3, 3))
        for slot, axis in enumerate(self._active):
            if axis == 0:
                continue
            along = values
            for k, (fraction, spacing) in enumerate(zip(fractions, spacings, strict=True)):
                half = along.shape[1] // 2
                if k == slot:
                    # Beyond the border the share is cut off and nothing changes.
                    inside = np.where((fraction > 0.0) & (fraction < 1.0), 1.0 / spacing, 0.0)
                    along = (along[:, half:] - along[:, :half]) * inside[:, None, None]
                else:
                    along = _between(along, fraction)
            # Axes are depth, north, east; components are north, east, down.
            out[:, :, (2, 0, 1)[axis - 1]] = along[:, 0]
        return out

    def drift_m_s(self, before_s: float, after_s: float) -> float:
        """Upper bound of the change of any node between two times [m/s]."""
        if self.steady:
            return 0.0
        low, high = np.interp([before_s, after_s], self.nodes.time_s, self._drift_m_s)
        return abs(float(high - low))

    def beyond(self, places_ned_m: FloatArray) -> NDArray[np.bool_]:
        """Which places (n, 2) lie farther outside than half a cell: nodes may stand in the middle of cells."""
        out = np.zeros(len(places_ned_m), dtype=bool)
        for axis, x in zip(self._axes[CURRENT_MAP.north :], places_ned_m.T, strict=True):
            first, last = 0.5 * (axis[1] - axis[0]), 0.5 * (axis[-1] - axis[-2])
            out |= (x < axis[0] - first) | (x > axis[-1] + last)
        return out

    def unknown(self, depth_min_m: float, depth_max_m: float) -> NDArray[np.bool_]:
        """(a - 1, b - 1) cells with a corner without data at some time, at the levels about a depth band."""
        levels = self.nodes.depth_m
        first = max(int(np.searchsorted(levels, depth_min_m, side="right")) - 1, 0)
        last = min(int(np.searchsorted(levels, depth_max_m, side="left")), len(levels) - 1)
        node: NDArray[np.bool_] = np.asarray(self._unknown[:, first : max(first, last) + 1].any(axis=(0, 1)))
        return node[:-1, :-1] | node[1:, :-1] | node[:-1, 1:] | node[1:, 1:]

    def cells(self, places_ned_m: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Row and column of the cell that holds each place (n, 2), of the nearest one outside."""
        rows, columns = (
            np.clip(np.searchsorted(axis, x, side="right") - 1, 0, len(axis) - 2)
            for axis, x in zip(self._axes[CURRENT_MAP.north :], places_ned_m.T, strict=True)
        )
        return rows, columns

    def _cell(self, pos_ned_m: FloatArray, t_s: FloatArray) -> tuple[FloatArray, list[FloatArray], list[FloatArray]]:
        """Values at the corners (m, 2^active, 3); place in the cell (0..1) and its length along each active axis."""
        coordinates = (t_s, pos_ned_m[:, 2], pos_ned_m[:, 0], pos_ned_m[:, 1])
        base = np.zeros(len(pos_ned_m), dtype=np.intp)
        fractions, spacings = [], []
        for i in self._active:
            axis, x = self._axes[i], coordinates[i]
            at = np.minimum(np.maximum(axis.searchsorted(x, side="right") - 1, 0), len(axis) - 2)
            spacing = axis[at + 1] - axis[at]
            fractions.append(np.minimum(np.maximum((x - axis[at]) / spacing, 0.0), 1.0))
            spacings.append(spacing)
            base += at * self._strides[i]
        return self._flat[base[:, None] + self._corners], fractions, spacings


def _between(values: FloatArray, fraction: FloatArray) -> FloatArray:
    """Halve the corners (m, 2k, 3) along the first axis that is left: exact at both ends."""
    half = values.shape[1] // 2
    weight = fraction[:, None, None]
    return values[:, :half] * (1.0 - weight) + values[:, half:] * weight
