"""Markers on a floor, a wall and a box, and pictures of them from all around: no level floor, no vehicle."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from autopilot.core.camera import CameraModel
from autopilot.core.frames import FloatArray
from autopilot.core.marker_files import PlacedMarker, make_map
from autopilot.core.markers import MarkerMap
from autopilot.estimator.marker_image import patterns_of
from autopilot.markermaps.sightings import SheetView


def camera(*, fisheye: bool = False) -> CameraModel:
    """Of 1280 x 960 pixels in the hand of somebody."""
    return CameraModel(
        width_px=1280,
        height_px=960,
        focal_px=(700.0, 702.0) if fisheye else (1050.0, 1052.0),
        center_px=(642.0, 478.0),
        distortion=(0.05, -0.02, 0.004, -0.001, 0.0) if fisheye else (-0.1, 0.05, 0.0005, -0.0005, 0.0),
        position_frd_m=np.zeros(3),
        laser_offset_cam_m=np.array([0.1, 0.0, 0.0]),
        r_frd_from_cam=np.eye(3),
        fisheye=fisheye,
    )


def plane(normal_out: FloatArray, up: FloatArray) -> FloatArray:
    """(3, 3) of a marker's frame: x to its top, z into the surface whose outer normal is given."""
    z = -normal_out / np.linalg.norm(normal_out)
    x = up - (up @ z) * z
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(z, x), z))


def room(size_m: float = 0.08, dictionary: str = "DICT_5X5_250") -> MarkerMap:
    """A floor (down = 0), a wall to the north and a box of 0.4 m with five faces, 40 markers."""
    placed: list[PlacedMarker] = []

    def put(center: FloatArray, r: FloatArray) -> None:
        placed.append(
            PlacedMarker(
                place="",
                dictionary=dictionary,
                id=len(placed),
                size_m=size_m,
                center_ned_m=center,
                r_ned_from_marker=r,
            )
        )

    north, east, up = np.eye(3) * [[1.0], [1.0], [-1.0]]
    for n in (-0.6, -0.2, 0.45, 0.7):
        for e in (-0.6, -0.3, 0.35, 0.6):
            put(np.array([n, e, 0.0]), plane(up, north))
    for e in (-0.6, -0.2, 0.2, 0.6):
        for d in (-0.3, -0.6):
            put(np.array([1.0, e, d]), plane(-north, up))
    for outward, top in ((north, up), (-north, up), (east, up), (-east, up), (up, north)):
        side = np.cross(outward, top)
        middle = np.array([0.0, 0.0, -0.2]) + 0.2 * outward
        for a in (-0.1, 0.1):
            put(middle + a * side, plane(outward, top))
    return make_map(placed, "test")


def walk_round(
    markers: MarkerMap, model: CameraModel, rng: np.random.Generator, count: int = 40, sigma_px: float = 0.2
) -> list[SheetView]:
    """Views from places all round the box, with noise."""
    views = []
    for k, (eye, r) in enumerate(places(rng, count)):
        seen = markers.visible(model, eye, r, 3.0)
        corners = model.project(model.cam_from_ned(markers.corners_ned_m[seen], eye, r))
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)
        seen, corners = seen[sides > 15.0], corners[sides > 15.0]
        corners = corners + rng.normal(0.0, sigma_px, corners.shape)
        if len(seen):
            views.append(SheetView(name=str(k), ids=markers.ids[seen], corners_px=corners))
    return views


def looking(eye: FloatArray, at: FloatArray, roll_rad: float) -> FloatArray:
    """(3, 3) of a camera there that looks at a point."""
    z = (at - eye) / np.linalg.norm(at - eye)
    x = np.cross(np.array([0.0, 0.0, 1.0]), z)
    x /= np.linalg.norm(x)
    r = np.column_stack((x, np.cross(z, x), z))
    c, s = math.cos(roll_rad), math.sin(roll_rad)
    return r @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def fitted(found: FloatArray, true: FloatArray) -> tuple[FloatArray, float]:
    """Points (n, 3) turned and shifted to lie on the true ones as well as they can, and rms of what is left [m]."""
    a, b = found - found.mean(axis=0), true - true.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    r = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt).T
    moved = a @ r.T + true.mean(axis=0)
    return moved, float(np.sqrt(np.square(moved - true).sum(axis=1).mean()))


def draw(
    markers: MarkerMap,
    model: CameraModel,
    eye: FloatArray,
    r: FloatArray,
    rng: np.random.Generator,
    wrong: Mapping[int, Sequence[tuple[int, int]]] = {},
) -> Any:
    """A picture of the markers on white paper, in whatever lens, with blur and noise; what is near covers the rest.
    ``wrong``: cells (row, column) by id that are printed the wrong way."""
    image = np.full((model.height_px, model.width_px), 130, dtype=np.uint8)
    patterns = patterns_of(markers.dictionary)
    distance = np.linalg.norm(markers.centers_ned_m - eye, axis=1)
    seen = set(markers.visible(model, eye, r, -200.0).tolist())
    for n in sorted(seen, key=lambda n: -distance[n]):
        cells = len(patterns[0])
        edge = np.linspace(0.0, 1.0, cells + 1)
        white = np.array([[-0.16, -0.16], [1.16, -0.16], [1.16, 1.16], [-0.16, 1.16]])
        _fill(image, model, markers.corners_ned_m[n], white, eye, r, 225)
        _fill(image, model, markers.corners_ned_m[n], np.array([[0, 0], [1, 0], [1, 1], [0, 1]]), eye, r, 30)
        pattern = patterns[markers.ids[n]].copy()
        for cell in wrong.get(int(markers.ids[n]), ()):
            pattern[cell] = 1.0 - pattern[cell]
        for row, column in zip(*np.nonzero(pattern), strict=True):
            u, v = edge[[column, column + 1]], edge[[row, row + 1]]
            square = np.array([[u[0], v[0]], [u[1], v[0]], [u[1], v[1]], [u[0], v[1]]])
            _fill(image, model, markers.corners_ned_m[n], square, eye, r, 225)
    grey = cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0.0, 2.0, image.shape)
    return cv2.cvtColor(np.clip(grey, 0.0, 255.0).astype(np.uint8), cv2.COLOR_GRAY2BGR)


def _fill(
    image: Any, model: CameraModel, corners: FloatArray, square: FloatArray, eye: FloatArray, r: FloatArray, level: int
) -> None:
    """A square in the marker's own coordinates (u to the right, v down, 0 to 1)."""
    along = np.linspace(0.0, 1.0, 5)[:-1, None]
    outline = np.concatenate([a + along * (b - a) for a, b in zip(square, np.roll(square, -1, axis=0), strict=True)])
    u, v = outline[:, :1], outline[:, 1:]
    points = corners[0] + u * (corners[1] - corners[0]) + v * (corners[3] - corners[0])
    pixels = model.project(model.cam_from_ned(points, eye, r))
    if np.isfinite(pixels).all() and np.abs(pixels).max() < 5000.0:
        cv2.fillPoly(image, [np.round(16.0 * pixels).astype(np.int32)], (level,), cv2.LINE_AA, 4)


def places(rng: np.random.Generator, count: int) -> list[tuple[FloatArray, FloatArray]]:
    """Places all round the box, 0.4 to 1.1 m high and in front of the wall, and attitudes, towards the box."""
    result = []
    for k in range(count):
        about = 2.0 * math.pi * k / count
        eye = np.array([min(-1.3 * math.cos(about), 0.8), 1.3 * math.sin(about), -rng.uniform(0.4, 1.1)])
        at = rng.uniform([-0.3, -0.3, -0.3], [0.5, 0.3, 0.0])
        result.append((eye, looking(eye, at, float(rng.uniform(-0.5, 0.5)))))
    return result
