"""A floor whose sheets were laid by hand, and what a camera that moves over it sees."""

import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.marker_files import PlacedMarker, make_map, placed_markers
from autopilot.core.markers import MarkerMap, grid_floor
from autopilot.core.vehicle import load_vehicle
from autopilot.markermaps.sightings import SheetView

VEHICLE = load_vehicle("lbv150")
CAMERA = CameraModel.of_vehicle(VEHICLE)


def laid_by_hand(
    nominal: MarkerMap,
    rng: np.random.Generator,
    *,
    sheet_m: float,
    place_m: float,
    turn_rad: float,
    lean_rad: float = 0.0,
) -> MarkerMap:
    """The map after every sheet of ``sheet_m`` has been laid with errors of place and heading (and lean)."""
    moved = []
    errors: dict[tuple[int, int], tuple[FloatArray, FloatArray]] = {}
    for marker in placed_markers(nominal):
        cell = (int(marker.center_ned_m[0] // sheet_m), int(marker.center_ned_m[1] // sheet_m))
        if cell not in errors:
            rpy = np.array([*rng.normal(0.0, lean_rad, 2), rng.normal(0.0, turn_rad)])
            errors[cell] = (np.append(rng.normal(0.0, place_m, 2), 0.0), r_ned_from_frd(rpy))
        shift, turn = errors[cell]
        middle = np.array([(cell[0] + 0.5) * sheet_m, (cell[1] + 0.5) * sheet_m, marker.center_ned_m[2]])
        moved.append(
            PlacedMarker(
                place="",
                dictionary=marker.dictionary,
                id=marker.id,
                size_m=marker.size_m,
                center_ned_m=middle + turn @ (marker.center_ned_m - middle) + shift,
                r_ned_from_marker=turn @ marker.r_ned_from_marker,
            )
        )
    return make_map(moved, "test")


def look_around(
    markers: MarkerMap,
    rng: np.random.Generator,
    *,
    count: int,
    half_m: tuple[float, float],
    heights_m: tuple[float, float] = (0.7, 1.1),
    camera: CameraModel = CAMERA,
    sigma_px: float = 0.12,
    shrink_px: float = 0.28,
    wrong: float = 0.0,
) -> list[SheetView]:
    """Views in rows to and fro, with noise, corners drawn inwards, and a share of markers seen wrongly."""
    views = []
    for k in range(count):
        row, column = divmod(k / count * 6.0, 1.0)
        along = column if int(row) % 2 == 0 else 1.0 - column
        pos = np.array([half_m[0] * (2.0 * along - 1.0), half_m[1] * (2.0 * row / 5.0 - 1.0), 0.0])
        pos[2] = 1.5 - 0.1 - rng.uniform(*heights_m)
        r = r_ned_from_frd(np.array([*rng.normal(0.0, 0.03, 2), rng.uniform(-3.0, 3.0)]))
        seen = markers.visible(camera, pos, r)
        corners = camera.project(camera.cam_from_ned(markers.corners_ned_m[seen], pos, r))
        away = corners.mean(axis=1, keepdims=True) - corners
        corners = corners + shrink_px * away / np.linalg.norm(away, axis=2, keepdims=True)
        corners = corners + rng.normal(0.0, sigma_px, corners.shape)
        bad = rng.random(len(seen)) < wrong
        corners[bad] += rng.normal(0.0, 8.0, (int(bad.sum()), 4, 2))
        _, first = np.unique(markers.ids[seen], return_index=True)
        views.append(SheetView(name=str(k), ids=markers.ids[seen][first], corners_px=corners[first]))
    return views


def small_floor(rng: np.random.Generator, lean_rad: float = 0.0) -> tuple[MarkerMap, MarkerMap]:
    """Nominal and true map of a floor of 1.2 m x 0.8 m."""
    polygon = np.array([[-0.6, -0.4], [0.6, -0.4], [0.6, 0.4], [-0.6, 0.4]])
    nominal = grid_floor(polygon_m=polygon, depth_m=1.5, pitch_m=0.1, size_m=0.07, seed=3)
    return nominal, laid_by_hand(nominal, rng, sheet_m=0.2, place_m=0.004, turn_rad=0.01, lean_rad=lean_rad)
