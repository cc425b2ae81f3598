"""A gridded current as the simulator's truth: multilinear in space and time, constant beyond the border.

The plant evaluates one position at a time, so the arithmetic is in plain floats. Velocity, gradient and time
derivative belong to the same interpolant. A change with depth acts through the velocity, not as acceleration of the
water.
"""

import zipfile
from array import array
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.core.toml_table import Vec3

COMPONENTS = ("current_north_m_s", "current_east_m_s", "current_down_m_s")
AXES = ("time_s", "depth_m", "north_m", "east_m")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Grid:
    """Nodes of the field. Axes ascend strictly; a missing one has the length 1."""

    axes: tuple[tuple[float, ...], ...]
    """time [s since the start of the run], depth, north, east [m]"""
    values: "tuple[array[float], ...]"
    """north, east, down [m/s], each flat in the order of the axes"""


def read_grid(path: str) -> Grid:
    """Read a truth: ``.npz`` or NetCDF-3 with the variables of COMPONENTS (down may be missing) over AXES (time and
    depth may be missing). ConfigError names file, variable and remedy."""
    arrays = _arrays(path)
    axes = []
    for name in AXES:
        axis = np.atleast_1d(arrays.get(name, np.zeros(1)))
        if name not in arrays and name in AXES[2:]:
            raise ConfigError(f"current grid {path}: variable `{name}` is missing; add the axis in local metres")
        if axis.ndim != 1 or not np.isfinite(axis).all() or not (np.diff(axis) > 0.0).all():
            raise ConfigError(f"current grid {path}: `{name}` must ascend strictly in one dimension; sort it")
        if name in AXES[2:] and len(axis) < 2:
            raise ConfigError(f"current grid {path}: `{name}` has one value, needs two or more")
        axes.append(tuple(axis.tolist()))
    shape = tuple(len(axis) for axis, name in zip(axes, AXES, strict=True) if name in arrays)
    return Grid(axes=tuple(axes), values=tuple(_flat(arrays, name, shape, path) for name in COMPONENTS))


def _flat(arrays: dict[str, Any], name: str, shape: tuple[int, ...], path: str) -> "array[float]":
    if name not in arrays and name == COMPONENTS[2]:
        return array("d", bytes(8 * int(np.prod(shape))))
    if name not in arrays:
        raise ConfigError(f"current grid {path}: variable `{name}` is missing; add it in m/s")
    values = arrays[name]
    if values.shape != shape:
        raise ConfigError(
            f"current grid {path}: `{name}` has the shape {values.shape}, its axes ask for {shape}; correct it"
        )
    if not np.isfinite(values).all():
        raise ConfigError(f"current grid {path}: `{name}` holds NaN; the truth must be known everywhere")
    return array("d", np.ascontiguousarray(values).tobytes())


def _arrays(path: str) -> dict[str, Any]:
    """Arrays of a file as native doubles."""
    wanted = (*AXES, *COMPONENTS)
    try:
        if Path(path).suffix == ".npz":
            with np.load(path, allow_pickle=False) as archive:
                found = {name: archive[name] for name in archive.files if name in wanted}
        else:
            from scipy.io import netcdf_file

            with netcdf_file(path, "r", mmap=False) as file:
                found = {name: np.array(v.data) for name, v in file.variables.items() if name in wanted}
        return {name: np.asarray(values).astype(np.float64) for name, values in found.items()}
    except FileNotFoundError as error:
        raise ConfigError(f"current grid {path}: not found; correct current.file") from error
    except (OSError, ValueError, TypeError, EOFError, KeyError, IndexError, zipfile.BadZipFile) as error:
        text = " ".join(str(error).split())
        raise ConfigError(f"current grid {path}: neither .npz nor NetCDF-3 ({text}); convert it") from error


class GridField:
    """A :class:`autopilot.sitl.current_fields.CurrentField`."""

    def __init__(self, grid: Grid) -> None:
        self._axes = grid.axes
        self._values = grid.values
        _, d, a, b = (len(axis) for axis in grid.axes)
        self._strides = (d * a * b, a * b, b, 1)

    @property
    def steady_uniform(self) -> bool:
        return False

    def velocity(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        f, g = self._cell_fractions(pos_ned_m)
        c = [
            (c00 * (1.0 - g) + c01 * g) * (1.0 - f) + (c10 * (1.0 - g) + c11 * g) * f
            for c00, c01, c10, c11 in self._corners(pos_ned_m, t_s)
        ]
        return (c[0], c[1], c[2])

    def gradient(self, pos_ned_m: Sequence[float], t_s: float) -> tuple[float, float, float, float]:
        """See :class:`autopilot.sitl.current_fields.CurrentField`; zero across a border that lies behind."""
        f, g = self._cell_fractions(pos_ned_m)
        spacing = [self._spacing(axis, pos_ned_m[axis - 2]) for axis in (2, 3)]
        rows = [
            (
                ((c10 - c00) * (1.0 - g) + (c11 - c01) * g) * spacing[0],
                ((c01 - c00) * (1.0 - f) + (c11 - c10) * f) * spacing[1],
            )
            for c00, c01, c10, c11 in self._corners(pos_ned_m, t_s)[:2]
        ]
        return (*rows[0], *rows[1])

    def rate(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        per_s = self._spacing(0, t_s)
        if per_s == 0.0:
            return (0.0, 0.0, 0.0)
        k, _ = self._place(0, t_s)
        before, after = (self.velocity(pos_ned_m, time_s) for time_s in self._axes[0][k : k + 2])
        n, e, d = ((b - a) * per_s for a, b in zip(before, after, strict=True))
        return (n, e, d)

    def _place(self, axis: int, x: float) -> tuple[int, float]:
        """Cell along an axis and share of it that lies behind (0..1)."""
        nodes = self._axes[axis]
        k = min(max(bisect_right(nodes, x) - 1, 0), max(len(nodes) - 2, 0))
        if len(nodes) == 1:
            return 0, 0.0
        return k, min(max((x - nodes[k]) / (nodes[k + 1] - nodes[k]), 0.0), 1.0)

    def _spacing(self, axis: int, x: float) -> float:
        """1 / length of the cell, 0 beyond the border: nothing changes there."""
        nodes = self._axes[axis]
        if len(nodes) == 1 or not nodes[0] <= x < nodes[-1]:
            return 0.0
        k, _ = self._place(axis, x)
        return 1.0 / (nodes[k + 1] - nodes[k])

    def _cell_fractions(self, pos_ned_m: Sequence[float]) -> tuple[float, float]:
        return self._place(2, pos_ned_m[0])[1], self._place(3, pos_ned_m[1])[1]

    def _corners(self, pos_ned_m: Sequence[float], t_s: float) -> list[tuple[float, float, float, float]]:
        """Per component the four corners of the horizontal cell, interpolated in time and depth."""
        (k, s), (i, h) = self._place(0, t_s), self._place(1, pos_ned_m[2])
        (m, _), (n, _) = self._place(2, pos_ned_m[0]), self._place(3, pos_ned_m[1])
        of_time, of_depth, of_north, _ = self._strides
        at = k * of_time + i * of_depth + m * of_north + n
        # Nodes of weight zero are left out: there are none where an axis has one node.
        layers = [
            (offset, weight)
            for offset, weight in (
                (0, (1.0 - s) * (1.0 - h)),
                (of_depth, (1.0 - s) * h),
                (of_time, s * (1.0 - h)),
                (of_time + of_depth, s * h),
            )
            if weight
        ]
        corners = (at, at + 1, at + of_north, at + of_north + 1)
        result = []
        for values in self._values:
            c = [sum(values[corner + offset] * weight for offset, weight in layers) for corner in corners]
            result.append((c[0], c[1], c[2], c[3]))
        return result
