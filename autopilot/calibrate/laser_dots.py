"""Green dots anywhere in a picture, for a laser of which nothing is known yet.

The detector that flies (:mod:`autopilot.estimator.laser_detector`) looks along the calibrated beam only.
"""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from autopilot.calibrate.boards import CalibrationBoard
from autopilot.calibrate.calibrate_tuning import LASER_DOTS
from autopilot.calibrate.laser_fit import Dots, floor_depths
from autopilot.calibrate.recorded_flight import CameraFlight
from autopilot.calibrate.views import image_files, none_readable, read_images
from autopilot.core.camera import CameraModel
from autopilot.core.errors import ConfigError, LogError
from autopilot.core.frames import FloatArray
from autopilot.core.robust import MAD_TO_SIGMA
from autopilot.log.reader import Log, open_log


def green_dots(image_bgr: Any) -> FloatArray:
    """Pixels (k, 2) of the most conspicuous green dots, at most PER_PICTURE.

    Under one illuminant, print differs in brightness alone: green follows blue along a straight line, which tint
    and haze only shift. Small round spots above that line may be the laser's.
    """
    picture = image_bgr.astype(np.float32)
    blue, green = picture[:, :, 0], picture[:, :, 1]
    blue_off, green_off = blue - blue.mean(), green - green.mean()
    slope = float((blue_off * green_off).sum()) / max(float((blue_off * blue_off).sum()), 1.0)
    excess = green_off - slope * blue_off
    smooth = cv2.GaussianBlur(excess, (0, 0), LASER_DOTS.smooth_px) - cv2.GaussianBlur(
        excess, (0, 0), 6.0 * LASER_DOTS.smooth_px
    )
    spread = max(MAD_TO_SIGMA * float(np.median(np.abs(smooth))), 0.3)
    limit = max(LASER_DOTS.min_excess, LASER_DOTS.min_sigmas * spread)
    work, inside = np.zeros_like(smooth), slice(LASER_DOTS.edge_px, -LASER_DOTS.edge_px)
    work[inside, inside] = smooth[inside, inside]
    out = []
    for _ in range(LASER_DOTS.per_picture):
        row, column = (int(v) for v in np.unravel_index(int(work.argmax()), work.shape))
        peak = float(work[row, column])
        if peak < limit:
            break
        rows = slice(max(row - LASER_DOTS.centroid_px, 0), row + LASER_DOTS.centroid_px + 1)
        columns = slice(max(column - LASER_DOTS.centroid_px, 0), column + LASER_DOTS.centroid_px + 1)
        weight = np.maximum(smooth[rows, columns] - 0.3 * peak, 0.0)
        down, across = np.mgrid[rows.start : rows.start + len(weight), columns.start : columns.start + weight.shape[1]]
        total = float(weight.sum())
        out.append((float((weight * across).sum()) / total, float((weight * down).sum()) / total))
        work[
            max(row - LASER_DOTS.apart_px, 0) : row + LASER_DOTS.apart_px + 1,
            max(column - LASER_DOTS.apart_px, 0) : column + LASER_DOTS.apart_px + 1,
        ] = 0.0
    return np.array(out).reshape(-1, 2)


def logged_dots(flight: CameraFlight) -> Dots:
    """The dots that the flight's own detector found."""
    found = np.flatnonzero(np.isfinite(flight.laser_px[:, 0]))
    found = found[_moved(flight.eye_ned_m[found])]
    depth = [
        floor_depths(
            flight.camera, flight.laser_px[n : n + 1], flight.r_ned_from_cam[n], flight.eye_ned_m[n], flight.floor_m
        )
        for n in found
    ]
    ideal = flight.camera.normalized(flight.laser_px[found])
    return Dots(picture=found, ideal=ideal, depth_m=np.array(depth).reshape(-1))


def picture_dots(log: Log, flight: CameraFlight) -> Dots:
    """Dots in the pictures of a log, wherever they are; empty if the log holds no pictures."""
    parts: list[tuple[int, FloatArray, FloatArray]] = []
    if "/in/camera" not in log:
        return _joined(parts)
    before = np.full(3, np.inf)
    offset_s = flight.vehicle.eye.time_offset_s
    for number, message in enumerate(log.messages("/in/camera")):
        t_s = message.t_us * 1e-6 + offset_s
        n = int(np.argmin(np.abs(flight.t_s - t_s)))
        here = flight.eye_ned_m[n]
        if (
            abs(float(flight.t_s[n]) - t_s) > LASER_DOTS.stamp_slack_s
            or float(np.linalg.norm(here - before)) < LASER_DOTS.moved_m
        ):
            continue
        before = here
        image = cv2.imdecode(np.frombuffer(bytes(message.value["data"]), np.uint8), cv2.IMREAD_COLOR)
        if image is None or image.shape[:2] != (flight.camera.height_px, flight.camera.width_px):
            raise LogError(f"{log.path}: a picture on /in/camera is broken or not of the size of the vehicle's camera")
        pixels = green_dots(image)
        depth = floor_depths(flight.camera, pixels, flight.r_ned_from_cam[n], flight.eye_ned_m[n], flight.floor_m)
        parts.append((number, flight.camera.normalized(pixels), depth))
    return _joined(parts)


def board_dots(board: CalibrationBoard, camera: CameraModel, folder: Path) -> Dots:
    """Dots on a calibration board in colour pictures from different distances. ConfigError if the sizes do not fit."""
    if camera.port is not None or camera.fisheye:
        raise ConfigError('calibration from pictures needs camera.model = "pinhole"; use a log instead')
    parts = []
    torn = []
    files = image_files(folder, ", or a log")
    for number, (name, image) in enumerate(read_images(files, cv2.IMREAD_COLOR)):
        if image is None:
            torn.append(name)
            continue
        if image.shape[:2] != (camera.height_px, camera.width_px):
            raise ConfigError(
                f"{folder}: {name} has {image.shape[1]} x {image.shape[0]} pixels, the vehicle's camera"
                f" {camera.width_px} x {camera.height_px}; use images of the mode that it flies with"
            )
        found = board.find(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        if found is None:
            continue
        ok, turn, shift = cv2.solvePnP(
            found[0], found[1], camera.matrix, camera.distortion_coefficients, flags=cv2.SOLVEPNP_ITERATIVE
        )
        pixels = green_dots(image)
        if not ok or not len(pixels):
            continue
        normal = np.asarray(cv2.Rodrigues(turn)[0], dtype=float)[:, 2]
        _, rays = camera.rays(pixels)
        depth = float(normal @ np.asarray(shift, dtype=float).ravel()) / (rays @ normal)
        parts.append((number, camera.normalized(pixels), depth))
    if len(torn) == len(files):
        raise none_readable(folder, torn)
    if not parts:
        raise ConfigError(f"{folder}: no image shows both the board and a green dot; check --board and the laser")
    return _joined(parts)


def _moved(places_m: FloatArray) -> np.ndarray:
    """Indices of points (n, 3) at least MOVED_M from the one chosen before."""
    chosen = []
    before = np.full(3, np.inf)
    for n, place in enumerate(places_m):
        if float(np.linalg.norm(place - before)) >= LASER_DOTS.moved_m:
            chosen.append(n)
            before = place
    return np.array(chosen, dtype=np.int64)


def _joined(parts: list[tuple[int, FloatArray, FloatArray]]) -> Dots:
    picture = np.concatenate([np.full(len(depth), n) for n, _, depth in parts] or [np.empty(0, dtype=np.int64)])
    ideal = np.concatenate([ideal for _, ideal, _ in parts] or [np.empty((0, 2))])
    depth_m = np.concatenate([depth for _, _, depth in parts] or [np.empty(0)])
    good = np.isfinite(depth_m) & (depth_m > 0.05)
    return Dots(picture=picture[good].astype(np.int64), ideal=ideal[good], depth_m=depth_m[good])


def log_dots(path: Path, flight: CameraFlight) -> Dots:
    """The dots of a log: the flight's own if its detector found them most of the time, else those in its pictures."""
    if float(np.isfinite(flight.laser_px[:, 0]).mean()) > LASER_DOTS.own_fraction:
        return logged_dots(flight)
    return picture_dots(open_log(path), flight)
