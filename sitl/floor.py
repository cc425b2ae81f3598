"""The tank floor as a texture: white boards with ArUco markers under a layer of sand, at several resolutions.

Grey, seen from above: columns run to the east, rows to the south, so that it is not mirrored.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from autopilot.core.dictionaries import dictionary_label, opencv_dictionary
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.map_errors import Laid, MapErrors, map_errors
from autopilot.core.marker_files import load_marker_map, placed_markers
from autopilot.core.markers import ID_SPAN, MarkerMap, grid_floor
from autopilot.core.toml_table import Vec2
from autopilot.sitl.scenario_tables import LaidByHand, Scenario
from autopilot.sitl.sitl_tuning import FLOOR

Image: TypeAlias = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Floor:
    """A flat, level floor with its picture."""

    depth_m: float
    markers: MarkerMap
    north_m: float
    """North edge of the picture."""
    east_m: float
    """West edge of the picture (its least east)."""
    px_per_m: float
    """Resolution of the finest picture."""
    levels: tuple[Image, ...]
    """Pictures, the finest first."""

    def level_for(self, px_per_m: float) -> int:
        """The level that shows ``px_per_m`` without leaving out pixels (at most by a factor of 1.5)."""
        level = 0
        while level + 1 < len(self.levels) and self.px_per_m / 2**level > 1.5 * px_per_m:
            level += 1
        return level

    def pixel_map(self, north_m: FloatArray, east_m: FloatArray, level: int) -> NDArray[np.float32]:
        """Pixels of floor points (rows, columns) in the texture of a level: (rows, columns, 2) column, row."""
        scale = self.px_per_m / 2**level
        result = np.empty((*north_m.shape, 2), dtype=np.float32)
        result[..., 0] = (east_m - self.east_m) * scale - 0.5
        result[..., 1] = (self.north_m - north_m) * scale - 0.5
        return result


def build_markers(scenario: Scenario) -> MarkerMap | None:
    """Marker map of a scenario's floor; None in open water."""
    planned, laid = _planned(scenario), scenario.markers.laid
    if planned is None or laid is None:
        return planned
    rng = np.random.default_rng((scenario.scenario.seed if laid.seed is None else laid.seed, 2))
    sheet_of = sheets_of(planned, laid.sheet_m)
    count = int(sheet_of.max()) + 1
    shift_m = np.zeros((count, 3))
    shift_m[:, :2] = rng.normal(0.0, laid.sigma_m, (count, 2))
    turn_rad = rng.normal(0.0, laid.sigma_rad, count)
    off_m = np.zeros((len(planned.ids), 1, 3))
    off_m[:, 0, :2] = rng.normal(0.0, laid.print_sigma_m, (len(planned.ids), 2))
    printed = replace(planned, corners_ned_m=planned.corners_ned_m + off_m)
    return sheets_moved(printed, sheet_of, shift_m, turn_rad, laid.print_scale)


def sheets_moved(
    planned: MarkerMap, sheet_of: NDArray[np.int64], shift_m: FloatArray, turn_rad: FloatArray, scale: float = 1.0
) -> MarkerMap:
    """The markers after each sheet has been moved (k, 3), turned about its middle (k,) and printed in another size."""
    corners = planned.corners_ned_m.copy()
    for k in range(len(turn_rad)):
        mine = sheet_of == k
        middle = planned.centers_ned_m[mine].mean(axis=0)
        turn = r_ned_from_frd(np.array([0.0, 0.0, turn_rad[k]]))
        corners[mine] = middle + scale * (corners[mine] - middle) @ turn.T + shift_m[k]
    return replace(planned, corners_ned_m=corners, errors=None)


def given_markers(scenario: Scenario) -> MarkerMap | None:
    """The map that the vehicle has: where the markers were meant to lie, and how well they were laid."""
    planned, laid = _planned(scenario), scenario.markers.laid
    if planned is None:
        return None
    known = planned if laid is None else replace(planned, errors=_errors(planned, laid))
    deeper_m = scenario.markers.told_deeper_m
    return known if deeper_m == 0.0 else deeper(known, deeper_m)


def given_floor_m(scenario: Scenario) -> float | None:
    """Depth of the floor that the vehicle assumes, None in open water."""
    return None if scenario.tank is None else scenario.tank.depth_m + scenario.markers.told_deeper_m


def deeper(markers: MarkerMap, by_m: float) -> MarkerMap:
    """The map with everything on it so much deeper."""
    down = np.array([0.0, 0.0, by_m])
    errors = markers.errors
    if errors is not None:
        errors = replace(errors, pivot_ned_m=errors.pivot_ned_m + down)
    return replace(markers, corners_ned_m=markers.corners_ned_m + down, errors=errors)


def _errors(planned: MarkerMap, laid: LaidByHand) -> MapErrors | None:
    sigma_m = laid.sigma_m if laid.told_sigma_m is None else laid.told_sigma_m
    sigma_rad = laid.sigma_rad if laid.told_sigma_rad is None else laid.told_sigma_rad
    sheets = [
        Laid(sheet=f"{k + 1}", sigma_m=sigma_m, sigma_rad=sigma_rad) for k in sheets_of(planned, laid.sheet_m).tolist()
    ]
    return map_errors(planned.centers_ned_m, np.zeros(len(sheets)), sheets)


def sheets_of(planned: MarkerMap, sheet_m: float) -> NDArray[np.int64]:
    """(n,) number of each marker's sheet, in rows from the south-west."""
    cell = np.floor((planned.centers_ned_m[:, :2] - planned.corners_ned_m.min(axis=(0, 1))[:2]) / sheet_m).astype(int)
    _, numbers = np.unique(cell, axis=0, return_inverse=True)
    return np.asarray(numbers, dtype=np.int64).reshape(-1)


def _planned(scenario: Scenario) -> MarkerMap | None:
    """The floor as it was meant to be."""
    if scenario.tank is None:
        return None
    layout = scenario.markers
    if layout.file is not None:
        return _of_file(layout.file, np.array(scenario.tank.polygon_m), scenario.tank.depth_m)
    return _grid(
        tuple(scenario.tank.polygon_m),
        scenario.tank.depth_m,
        layout.pitch_m,
        layout.size_m,
        layout.seed,
        layout.dictionary,
    )


@lru_cache(maxsize=4)
def _grid(
    polygon_m: tuple[Vec2, ...], depth_m: float, pitch_m: float, size_m: float, seed: int, dictionary: str
) -> MarkerMap:
    """The floor of these numbers, kept: a run asks twice, a campaign for every run."""
    return grid_floor(
        polygon_m=np.array(polygon_m),
        depth_m=depth_m,
        pitch_m=pitch_m,
        size_m=size_m,
        seed=seed,
        dictionary=dictionary,
    )


def _of_file(file: str, polygon_m: FloatArray, depth_m: float) -> MarkerMap:
    """The part of a map file that the simulated floor can show. ConfigError for other markers."""
    markers = load_marker_map(Path(file))
    low, high = polygon_m.min(axis=0), polygon_m.max(axis=0)
    off_m = np.abs(markers.corners_ned_m[..., 2] - depth_m).max(axis=1)
    outside = ((markers.corners_ned_m[..., :2] < low) | (markers.corners_ned_m[..., :2] > high)).any(axis=(1, 2))
    for wrong, what in (
        (off_m > FLOOR.off_floor_m, f"is not flat on the floor, which lies at {depth_m:g} m"),
        (outside, "lies outside of the tank"),
    ):
        if wrong.any():
            marker = placed_markers(markers)[int(wrong.argmax())]
            north, east, down = marker.center_ned_m
            raise ConfigError(
                f"{file}: {marker.label} of {dictionary_label(marker.dictionary)} at [{north:.3f}, {east:.3f},"
                f" {down:.3f}] {what}; the simulated floor cannot show it: move or remove it"
            )
    return markers


def build_floor(scenario: Scenario) -> Floor | None:
    """The floor of a scenario's tank; None in open water."""
    markers, tank = build_markers(scenario), scenario.tank
    if markers is None or tank is None:
        return None
    return _printed(markers, tuple(tank.polygon_m), tank.depth_m, scenario.markers.seed)


@lru_cache(maxsize=1)
def _printed(markers: MarkerMap, polygon_m: tuple[Vec2, ...], depth_m: float, seed: int) -> Floor:
    """A floor with its picture, the last one kept: runs of one scenario print it once (maps are equal by identity)."""
    polygon = np.array(polygon_m)
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    extent_m = high - low
    px_per_m = min(FLOOR.px_per_m, float(np.sqrt(FLOOR.max_px / (extent_m[0] * extent_m[1]))))
    rows, columns = (int(np.ceil(extent * px_per_m)) for extent in extent_m)
    ink = np.zeros((rows, columns), dtype=np.uint8)
    _print_markers(ink, markers, float(high[0]), float(low[1]), px_per_m)
    shades = np.linspace(FLOOR.white, FLOOR.black, 256).round().astype(np.uint8)
    picture = cv2.LUT(ink, shades)
    _scatter_sand(picture, np.random.default_rng((seed, 1)))
    levels = [picture]
    for _ in range(1, FLOOR.levels):
        size = (max(1, levels[-1].shape[1] // 2), max(1, levels[-1].shape[0] // 2))
        levels.append(cv2.resize(levels[-1], size, interpolation=cv2.INTER_AREA))
    return Floor(
        depth_m=depth_m,
        markers=markers,
        north_m=float(high[0]),
        east_m=float(low[1]),
        px_per_m=px_per_m,
        levels=tuple(levels),
    )


def _print_markers(ink: Image, markers: MarkerMap, north_m: float, east_m: float, px_per_m: float) -> None:
    """Print the markers, every pixel inked by the share of it that is black."""
    dictionaries = [opencv_dictionary(name) for name in markers.dictionaries]
    for code, corners in zip(markers.ids.tolist(), markers.corners_ned_m, strict=True):
        kind, marker_id = divmod(code, ID_SPAN)
        cells = dictionaries[kind].markerSize + 2
        picture = cv2.aruco.generateImageMarker(dictionaries[kind], marker_id, cells)
        corners_px = np.column_stack(((corners[:, 1] - east_m) * px_per_m, (north_m - corners[:, 0]) * px_per_m))
        across_px = corners_px[1] - corners_px[0]
        if abs(across_px[1]) > 1e-6 or across_px[0] < 0.0:
            _print_turned(ink, picture, corners_px)
            continue
        cell_px = float(across_px[0]) / cells
        left, across = _coverage(float(corners_px[0, 0]), cell_px, cells, ink.shape[1])
        top, down = _coverage(float(corners_px[0, 1]), cell_px, cells, ink.shape[0])
        black = down @ (picture == 0).astype(float) @ across.T
        ink[top : top + len(down), left : left + len(across)] = np.rint(255.0 * black).astype(np.uint8)


def _print_turned(ink: Image, picture: Image, corners_px: FloatArray) -> None:
    """Print one marker, one pixel per cell, whose corners (4, 2) column, row lie anyhow."""
    left, top = (max(0, int(np.floor(v))) for v in corners_px.min(axis=0))
    right = min(ink.shape[1], int(np.ceil(corners_px[:, 0].max())))
    bottom = min(ink.shape[0], int(np.ceil(corners_px[:, 1].max())))
    # Pixel centres lie at whole numbers for warpAffine, at halves in corners_px.
    source = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], dtype=np.float32) * len(picture) - 0.5
    target = (corners_px[[0, 1, 3]] - [left, top]) * FLOOR.oversampling - 0.5
    affine = cv2.getAffineTransform(source.astype(np.float32), target.astype(np.float32))
    size = ((right - left) * FLOOR.oversampling, (bottom - top) * FLOOR.oversampling)
    fine = cv2.warpAffine(255 - picture, affine, size, flags=cv2.INTER_NEAREST, borderValue=(0,))
    patch = cv2.resize(fine, (right - left, bottom - top), interpolation=cv2.INTER_AREA)
    place = ink[top:bottom, left:right]
    np.maximum(place, patch, out=place)


def _coverage(start_px: float, cell_px: float, cells: int, limit: int) -> tuple[int, FloatArray]:
    """First pixel, and share (pixels, cells) of each pixel that each of a marker's cells covers along one axis."""
    start_px = round(start_px, 6)
    first = max(0, int(np.floor(start_px)))
    last = min(limit, int(np.ceil(round(start_px + cells * cell_px, 6))))
    pixels = np.arange(first, last)[:, None]
    edges = start_px + cell_px * np.arange(cells + 1)
    coverage = np.minimum(pixels + 1, edges[1:]) - np.maximum(pixels, edges[:-1])
    return first, np.clip(coverage, 0.0, 1.0)


def _scatter_sand(picture: Image, rng: np.random.Generator) -> None:
    """Vary the brightness at several grain sizes, in place."""
    rows, columns = picture.shape
    for grain_px, sigma in FLOOR.sand_octaves:
        small = rng.normal(128.0, sigma, (rows // grain_px + 2, columns // grain_px + 2))
        grains = np.clip(np.rint(small), 0, 255).astype(np.uint8)
        sand = cv2.resize(grains, (columns, rows), interpolation=cv2.INTER_CUBIC)
        cv2.addWeighted(picture, 1.0, sand, 1.0, -128.0, dst=picture)
