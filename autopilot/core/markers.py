"""The marker map: poses of ArUco markers on the floor, generation of layouts, and visibility.

A floor needs more markers than the largest dictionary has ids, so ids repeat. The layout keeps this unambiguous:
markers of one id are at least :data:`SAME_ID_DISTANCE_M` apart, more than one image covers, and no two positions of
the floor have the same pair of neighbours, so that any two adjacent markers determine the position.
"""

import math
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from autopilot.core.camera import CameraModel
from autopilot.core.dictionaries import DICTIONARY_SIZES, dictionary_size
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.map_errors import DEPTH_SIGMA_M, SCALE_SIGMA, MapErrors
from autopilot.core.shapes import inside_polygon

IntArray: TypeAlias = NDArray[np.int64]

ID_SPAN = 4096
"""More than any dictionary has ids. The id by which a marker goes everywhere is its dictionary's number in the map
times this plus its id in that dictionary; where all markers are of one dictionary, it is simply that id."""

SAME_ID_DISTANCE_M = 1.0
"""Least distance of two markers with the same id, where the dictionary is large enough."""

FLATTEST_RAD = math.radians(80.0)
"""A view that reaches farther from the vertical than this is taken as unlimited."""

LEVEL_M = 1e-4
"""Corners that differ by less in depth lie on one level floor."""

CORNER_SIGNS = np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
"""(4, 2) north, east of the corners in OpenCV's order for a marker whose top points north, seen from above."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MarkerMap:
    """Surveyed markers: any poses, sizes and dictionaries."""

    dictionary: str
    """Name of the dictionary (:mod:`autopilot.core.dictionaries`), e.g. DICT_4X4_1000; of markers with ids below
    :data:`ID_SPAN`."""
    size_m: float
    """Side of the black square, of most markers."""
    ids: IntArray
    """(n,) ids, see :data:`ID_SPAN`; may repeat."""
    corners_ned_m: FloatArray
    """(n, 4, 3) in OpenCV's corner order."""
    more_dictionaries: tuple[str, ...] = ()
    """Dictionaries number 1 and on."""
    errors: MapErrors | None = None
    """How its sheets were laid; None = exactly, or it defines the frame."""
    depth_sigma_m: float = DEPTH_SIGMA_M
    """Standard deviation of the depth of the whole map."""
    scale_sigma: float = SCALE_SIGMA
    """The same of the printed size, as a share of it."""
    centers_ned_m: FloatArray = field(init=False)
    """(n, 3)"""
    sizes_m: FloatArray = field(init=False)
    """(n,) sides of the black squares."""
    level: bool = field(init=False)
    """Whether all lie face up on one level floor."""
    floor_m: float = field(init=False)
    """Mean depth of all corners, 0 without markers."""
    _north_m: FloatArray = field(init=False, repr=False)
    _east_m: FloatArray = field(init=False, repr=False)
    _depth_m: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        corners = self.corners_ned_m
        centers = corners.mean(axis=1)
        some = len(centers) > 0
        object.__setattr__(self, "centers_ned_m", centers)
        sides = corners - np.roll(corners, -1, axis=1)
        object.__setattr__(self, "sizes_m", np.sqrt((sides * sides).sum(axis=2)).mean(axis=1))
        depth = corners[..., 2]
        up = _cross_2d(corners[..., 1], -corners[..., 0]) >= 0.0
        object.__setattr__(self, "level", bool(some and np.ptp(depth) < LEVEL_M and up.all()))
        object.__setattr__(self, "floor_m", float(depth.mean()) if some else 0.0)
        object.__setattr__(self, "_north_m", centers[:, 0].copy())
        object.__setattr__(self, "_east_m", centers[:, 1].copy())
        object.__setattr__(self, "_depth_m", float(depth.max()) if some else 0.0)

    @property
    def dictionaries(self) -> tuple[str, ...]:
        """All dictionaries by number."""
        return (self.dictionary, *self.more_dictionaries)

    def visible(
        self, camera: CameraModel, pos_ned_m: FloatArray, r_ned_from_frd: FloatArray, margin_px: float = 0.0
    ) -> IntArray:
        """Indices (m,) of the markers whose face shows with all four corners in the image of a vehicle at that pose.

        ``margin_px`` > 0 asks for that distance from the image border, < 0 adds markers that far outside of it (for
        an uncertain pose).
        """
        return self.in_view(camera, pos_ned_m, r_ned_from_frd, margin_px)[0]

    def in_view(
        self, camera: CameraModel, pos_ned_m: FloatArray, r_ned_from_frd: FloatArray, margin_px: float = 0.0
    ) -> tuple[IntArray, FloatArray]:
        """As :meth:`visible`, and the pixels (m, 4, 2) of their corners."""
        north, east, radius = self._footprint(camera, pos_ned_m, r_ned_from_frd, margin_px)
        dn, de = self._north_m - north, self._east_m - east
        near = np.flatnonzero(dn * dn + de * de < radius * radius)
        pixels = camera.project(camera.cam_from_ned(self.corners_ned_m[near], pos_ned_m, r_ned_from_frd))
        shown = camera.inside(pixels, margin_px).all(axis=1)
        if not self.level:
            shown &= _cross_2d(pixels[..., 0], pixels[..., 1]) > 0.0
        return near[shown], pixels[shown]

    def _footprint(
        self, camera: CameraModel, pos_ned_m: FloatArray, r_ned_from_frd: FloatArray, margin_px: float
    ) -> tuple[float, float, float]:
        """North, east and radius [m] of a circle that holds the centres of all markers that the image can show."""
        eye_ned_m = pos_ned_m + r_ned_from_frd @ camera.position_frd_m
        axis_ned = r_ned_from_frd @ camera.r_frd_from_cam[:, 2]
        height_m = max(0.0, self._depth_m - float(eye_ned_m[2]))
        slope = camera.view_slope + 1.5 * max(0.0, -margin_px) / min(camera.focal_px)
        tilt_rad = math.acos(max(-1.0, min(1.0, float(axis_ned[2]))))
        far_rad = tilt_rad + math.atan(slope)
        if far_rad > FLATTEST_RAD:
            return float(eye_ned_m[0]), float(eye_ned_m[1]), math.inf
        aside_m = camera.view_offset_m * (1.0 + math.tan(far_rad))
        if not self.level:  # higher markers appear closer to the nadir
            return float(eye_ned_m[0]), float(eye_ned_m[1]), height_m * math.tan(far_rad) + aside_m
        reach_m = height_m / float(axis_ned[2])
        radius_m = height_m * (math.tan(far_rad) - math.tan(tilt_rad)) + aside_m
        return float(eye_ned_m[0] + reach_m * axis_ned[0]), float(eye_ned_m[1] + reach_m * axis_ned[1]), radius_m


def _cross_2d(x: FloatArray, y: FloatArray) -> FloatArray:
    """(n,) twice the area of quadrilaterals (n, 4), positive where they run clockwise with y to below."""
    return np.asarray((x[:, 2] - x[:, 0]) * (y[:, 3] - y[:, 1]) - (y[:, 2] - y[:, 0]) * (x[:, 3] - x[:, 1]))


def grid_floor(
    *,
    polygon_m: FloatArray,
    depth_m: float,
    pitch_m: float,
    size_m: float,
    seed: int,
    dictionary: str = "DICT_4X4_1000",
) -> MarkerMap:
    """A square grid of markers, tops to the north, that fills the polygon (k, 2) north, east at ``depth_m``.

    The grid is centred on the polygon's bounding box. The same arguments give the same floor. ConfigError if the
    numbers make no sense or no marker fits.
    """
    n_ids = dictionary_size(dictionary)
    if n_ids is None:
        raise ConfigError(f"markers.dictionary {dictionary!r} is not known; use one of {', '.join(DICTIONARY_SIZES)}")
    if not 0.0 < size_m < pitch_m:
        raise ConfigError(
            f"markers.size_m = {size_m:g} must lie between 0 and markers.pitch_m = {pitch_m:g}; leave a white edge"
        )
    polygon = np.asarray(polygon_m, dtype=float)
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    count = np.floor((high - low) / pitch_m + 1e-9).astype(int)
    start = 0.5 * (low + high) - 0.5 * pitch_m * (count - 1)
    cells = np.array([(i, j) for i in range(count[0]) for j in range(count[1])], dtype=np.int64).reshape(-1, 2)
    centers = start + pitch_m * cells
    squares = centers[:, None, :] + 0.5 * pitch_m * CORNER_SIGNS * (1.0 - 1e-9)
    fits = inside_polygon(polygon, squares.reshape(-1, 2)).reshape(-1, 4).all(axis=1)
    cells, centers = cells[fits], centers[fits]
    if len(cells) == 0:
        raise ConfigError(
            f"markers.pitch_m = {pitch_m:g} leaves no room for a marker in the polygon; use a finer pitch"
        )
    corners = np.empty((len(cells), 4, 3))
    corners[:, :, :2] = centers[:, None, :] + 0.5 * size_m * CORNER_SIGNS
    corners[:, :, 2] = depth_m
    ids = _assign_ids(cells, pitch_m, n_ids, np.random.default_rng(seed))
    return MarkerMap(dictionary=dictionary, size_m=size_m, ids=ids, corners_ned_m=corners)


def _assign_ids(cells: IntArray, pitch_m: float, n_ids: int, rng: np.random.Generator) -> IntArray:
    """One id per cell (n, 2): the least used ids first, at random among those that keep the promises of this module."""
    reach = int(SAME_ID_DISTANCE_M / pitch_m)
    steps = [(-1, -1), (-1, 0), (-1, 1), (0, -1)]  # neighbours that come earlier in the order of the cells
    low = cells.min(axis=0)
    shape = cells.max(axis=0) - low + 1
    grid = np.full((shape[0] + reach, shape[1] + 2 * reach), -1, dtype=np.int64)
    used = np.zeros(n_ids, dtype=np.int64)
    followers: dict[tuple[int, int], list[int]] = {}
    ids = np.empty(len(cells), dtype=np.int64)
    for n, (i, j) in enumerate(cells - low):
        row, column = i + reach, j + reach
        cost = used + rng.random(n_ids)
        around = grid[row - reach : row + 1, column - reach : column + reach + 1].ravel()
        cost[around[around >= 0]] += 1e6
        neighbours = [(k, int(grid[row + di, column + dj])) for k, (di, dj) in enumerate(steps)] if reach else []
        for key in neighbours:
            cost[followers.get(key, [])] += 1e3
        chosen = int(cost.argmin())
        for key in neighbours:
            followers.setdefault(key, []).append(chosen)
        grid[row, column] = ids[n] = chosen
        used[chosen] += 1
    return ids
