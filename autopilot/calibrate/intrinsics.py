"""Intrinsics of a camera from views of a board: least squares with views that do not fit left out, and how well the
views covered the image and the angles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from autopilot.calibrate.calibrate_tuning import INTRINSICS
from autopilot.calibrate.views import BoardView, Views
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.vehicle import Camera

GOOD_TILT_RAD = math.radians(15.0)

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Intrinsics:
    width_px: int
    height_px: int
    values: FloatArray
    """(9,) in the order of :data:`NAMES`."""
    sigma: FloatArray
    """(9,) standard deviations."""
    rms_px: float
    views: tuple[BoardView, ...]
    """Those that were used."""
    residual_px: tuple[FloatArray, ...]
    """Per view (n, 2): found minus projected."""
    normals_cam: FloatArray
    """(v, 3) the board's normal in each view, camera frame, pointing away from the camera."""
    left_out: tuple[tuple[str, str], ...]
    """Image and why."""

    @property
    def view_rms_px(self) -> FloatArray:
        """(v,) per view."""
        return np.array([math.sqrt(float((r**2).sum(axis=1).mean())) for r in self.residual_px])

    @property
    def field_of_view_deg(self) -> tuple[float, float]:
        """Horizontal and vertical, distortion left out."""
        fx, fy = self.values[:2].tolist()
        across, down = 2.0 * math.atan(0.5 * self.width_px / fx), 2.0 * math.atan(0.5 * self.height_px / fy)
        return math.degrees(across), math.degrees(down)


def calibrate(found: Views, *, fix_k3: bool = False) -> Intrinsics:
    """Pinhole model with k1 k2 p1 p2 k3. ConfigError if there are too few views, if they do not determine the
    camera, or if another focal length fits as well (its sigma would then be meaningless).
    """
    views: list[BoardView] = []
    left_out = list(found.left_out)
    for view in found.views:
        twin = next((other for other in views if _same(view, other)), None)
        if twin is None:
            views.append(view)
        else:
            left_out.append((view.name, f"shows the board where {twin.name} does"))
    most = round(INTRINSICS.reject_fraction * len(views))
    while True:
        if len(views) < INTRINSICS.min_views:
            raise ConfigError(
                f"{len(views)} usable views of the board, at least {INTRINSICS.min_views} are needed"
                f" ({len(left_out)} images left"
                " out); take 20 or more from different places and angles"
            )
        result = _fit(found, views, tuple(left_out), fix_k3)
        rms = result.view_rms_px
        worst = int(rms.argmax())
        if most == 0 or rms[worst] <= max(INTRINSICS.reject_floor_px, INTRINSICS.reject_factor * float(np.median(rms))):
            if result.rms_px > INTRINSICS.most_rms_px:
                raise ConfigError(
                    f"the views do not fit one camera: {result.rms_px:.1f} px rms; check --board, --shape and"
                    " --dictionary against the print"
                )
            _refuse_any_focal(found, result, fix_k3)
            return result
        # One at a time: an outlier view degrades others, which fit without it.
        left_out.append((views[worst].name, f"does not fit: {rms[worst]:.2f} px rms"))
        del views[worst]
        most -= 1


def _same(view: BoardView, other: BoardView) -> bool:
    """Whether the corners that both show are at the same pixels."""
    mine, theirs = np.nonzero((view.points_m[:, None] == other.points_m[None]).all(axis=2))
    apart = view.pixels[mine] - other.pixels[theirs]
    return len(apart) > 0 and float(np.hypot(*apart.T).max()) < INTRINSICS.same_px


def _refuse_any_focal(found: Views, result: Intrinsics, fix_k3: bool) -> None:
    """ConfigError if the views do not separate focal length from distance."""
    count = sum(2 * len(view.pixels) for view in result.views)
    square = sum(float((residual**2).sum()) for residual in result.residual_px)
    variance = max(square / max(count - 9 - 6 * len(result.views), 1), INTRINSICS.least_sigma_px**2)
    worse = []
    for factor in (1.0 - INTRINSICS.other_focal, 1.0 + INTRINSICS.other_focal):
        other = _fit_with_focal(found, result, factor, fix_k3)
        worse.append(np.inf if other is None else (other - square) / variance)
    sigma = INTRINSICS.other_focal / math.sqrt(max(min(worse), 1e-6))
    if sigma > INTRINSICS.focal_sigma:
        fx = float(result.values[0])
        raise ConfigError(
            f"the views do not tell focal length from distance: fx {(1.0 - INTRINSICS.other_focal) * fx:.0f},"
            f" {fx:.0f} or {(1.0 + INTRINSICS.other_focal) * fx:.0f} px fit alike; add views with the"
            " board tilted by 20 to 40 deg"
            " about both axes"
        )


def _fit_with_focal(found: Views, result: Intrinsics, factor: float, fix_k3: bool) -> float | None:
    """Sum of the squared residuals with that multiple of the focal length, all else free; None if nothing fits."""
    fx, fy, cx, cy, *coefficients = result.values.tolist()
    matrix: Any = np.array([[factor * fx, 0.0, cx], [0.0, factor * fy, cy], [0.0, 0.0, 1.0]])
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_FOCAL_LENGTH | (cv2.CALIB_FIX_K3 if fix_k3 else 0)
    try:
        rms, *_ = cv2.calibrateCamera(*_for_opencv(found, result.views), matrix, np.array(coefficients), flags=flags)
    except cv2.error:
        return None
    return float(rms) ** 2 * sum(len(view.pixels) for view in result.views)


def _for_opencv(found: Views, views: Sequence[BoardView]) -> tuple[Any, Any, tuple[int, int]]:
    """Points on the board and their pixels, both per view, and the size of the images."""
    points = [view.points_m.astype(np.float32).reshape(-1, 1, 3) for view in views]
    pixels = [view.pixels.astype(np.float32).reshape(-1, 1, 2) for view in views]
    return points, pixels, (found.width_px, found.height_px)


def _fit(found: Views, views: list[BoardView], left_out: tuple[tuple[str, str], ...], fix_k3: bool) -> Intrinsics:
    flags = cv2.CALIB_FIX_K3 if fix_k3 else 0
    try:
        rms, matrix, distortion, turns, shifts, sigma, _, _ = cv2.calibrateCameraExtended(
            *_for_opencv(found, views), None, None, flags=flags
        )
    except cv2.error as error:
        raise ConfigError(
            f"the {len(views)} views do not determine the camera ({' '.join(str(error.err).split())}); tilt the board"
            " more and vary its distance"
        ) from error
    coefficients = np.asarray(distortion, dtype=float).ravel()[:5]
    values = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *coefficients])
    residuals, normals = [], []
    for view, turn, shift in zip(views, turns, shifts, strict=True):
        projected, _ = cv2.projectPoints(view.points_m, turn, shift, matrix, distortion)
        residuals.append(view.pixels - np.asarray(projected, dtype=float).reshape(-1, 2))
        normal = np.asarray(cv2.Rodrigues(turn)[0], dtype=float)[:, 2]
        normals.append(normal * math.copysign(1.0, normal[2]))
    if not (np.isfinite(values).all() and values[:2].min() > 0.0):
        raise ConfigError("the views do not determine the camera; tilt the board more and vary its distance")
    return Intrinsics(
        width_px=found.width_px,
        height_px=found.height_px,
        values=values,
        sigma=np.asarray(sigma, dtype=float).ravel()[:9],
        rms_px=float(rms),
        views=tuple(views),
        residual_px=tuple(residuals),
        normals_cam=np.array(normals),
        left_out=left_out,
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Coverage:
    """Coverage of the image by the views."""

    cells: FloatArray
    """(rows, columns) corners found in each cell of the image."""
    radius_fraction: float
    """Distance of the outermost corner from the image centre over half the diagonal (99th percentile)."""
    tilt_rad: FloatArray
    """(v,) angle between the board's normal and the optical axis."""
    tilt_spread_rad: tuple[float, float]
    """Standard deviation of the tilt about the image's x and y axes."""

    @property
    def coverage(self) -> float:
        """Of the cells in which corners were found."""
        return float((self.cells > 0).mean())


def coverage(result: Intrinsics) -> Coverage:
    """How the used views are spread."""
    pixels = np.concatenate([view.pixels for view in result.views])
    size = np.array([result.width_px, result.height_px], dtype=float)
    cells, _, _ = np.histogram2d(
        pixels[:, 1], pixels[:, 0], bins=(INTRINSICS.cells[1], INTRINSICS.cells[0]), range=((0, size[1]), (0, size[0]))
    )
    radius = np.hypot(*(pixels - size / 2).T) / float(np.hypot(*(size / 2)))
    normal = result.normals_cam
    about_x, about_y = np.arctan2(normal[:, 1], normal[:, 2]), np.arctan2(normal[:, 0], normal[:, 2])
    return Coverage(
        cells=cells,
        radius_fraction=float(np.percentile(radius, 99.0)),
        tilt_rad=np.arccos(np.clip(normal[:, 2], -1.0, 1.0)),
        tilt_spread_rad=(float(about_x.std()), float(about_y.std())),
    )


def remarks(result: Intrinsics, spread: Coverage, expected: Camera | None, medium: str) -> list[str]:
    """Notes on the quality of the result; ``medium``: "water" or "air", where the pictures were taken."""
    out = []
    if spread.coverage < INTRINSICS.good_coverage:
        out.append(
            f"corners in {spread.coverage:.0%} of the image's {INTRINSICS.cells[0]} x {INTRINSICS.cells[1]}"
            " cells: fill the empty ones"
        )
    if spread.radius_fraction < INTRINSICS.good_radius:
        out.append(
            f"nothing beyond {spread.radius_fraction:.0%} of the half diagonal: the corners' distortion is a guess"
        )
    tilted = float((spread.tilt_rad > GOOD_TILT_RAD).mean())
    if tilted < INTRINSICS.good_tilted_fraction or min(spread.tilt_spread_rad) < 0.5 * GOOD_TILT_RAD:
        out.append(
            f"{tilted:.0%} of the views tilted by more than {math.degrees(GOOD_TILT_RAD):.0f} deg: tilt the board about"
            " both axes, or focal length and distance cannot be told apart"
        )
    if result.rms_px > INTRINSICS.good_rms_px:
        out.append(f"rms {result.rms_px:.2f} px: blurred views, a board that is not flat, or a wrong --shape or size")
    return out + _medium_remarks(result, expected, medium)


def _medium_remarks(result: Intrinsics, expected: Camera | None, medium: str) -> list[str]:
    """Consistency of the focal length with water or air."""
    out = []
    behind_port = expected is not None and expected.model == "flat_port"
    if medium == "air" and not behind_port:
        out.append(
            f"taken in air: the focal length was multiplied by {INTRINSICS.water_index}, which leaves"
            " errors of 3 to 5 % of the"
            " height (8 to 55 mm at 0.3 to 1.2 m); calibrate in water"
        )
    if medium == "water" and behind_port:
        out.append('the vehicle file has model = "flat_port", which wants a calibration in air: use --medium air')
    if expected is None:
        return out
    if (expected.width_px, expected.height_px) != (result.width_px, result.height_px):
        out.append(
            f"images are {result.width_px} x {result.height_px}, the vehicle's camera {expected.width_px} x"
            f" {expected.height_px}: not the mode it flies with"
        )
    wanted = math.sqrt(expected.focal_px[0] * expected.focal_px[1]) * result.width_px / expected.width_px
    ratio = math.sqrt(float(result.values[0] * result.values[1])) / wanted
    if medium == "air" and not behind_port:
        ratio *= INTRINSICS.water_index
    if abs(ratio * INTRINSICS.water_index - 1.0) < INTRINSICS.focal_band and medium == "water":
        out.append(
            f"focal length {ratio:.3f} of the vehicle file's, which is 1/{INTRINSICS.water_index}: these"
            " look like images taken in"
            " air; calibrate in water, or say --medium air"
        )
    elif abs(ratio - 1.0) > INTRINSICS.focal_band:
        out.append(
            f"focal length {ratio:.3f} of the vehicle file's: another lens or zoom, or a wrong --square? If neither,"
            " the vehicle file is wrong"
        )
    return out


def focal_sigma(result: Intrinsics, *, into_water: bool = False) -> float:
    """Relative standard deviation of the focal length: twice the fit's, because errors of views are correlated."""
    relative_sigma = 2.0 * float((result.sigma[:2] / result.values[:2]).max())
    return math.hypot(
        max(relative_sigma, INTRINSICS.least_focal_sigma), INTRINSICS.air_focal_sigma if into_water else 0.0
    )


def distortion_sigma(result: Intrinsics, *, into_water: bool = False) -> float:
    """The same of the distortion: of the shift of a point at the edge of the view, its terms taken as independent."""
    k1, k2, _, _, k3 = result.values[4:].tolist()
    r2 = math.tan(math.radians(0.5 * max(result.field_of_view_deg))) ** 2
    terms = r2 ** np.arange(1, 4)
    bent = abs(float(terms @ (k1, k2, k3)))
    of_fit = 2.0 * float(np.hypot.reduce(result.sigma[[4, 5, 8]] * terms)) / max(bent, 1e-9)
    usual = INTRINSICS.air_distortion_sigma
    return max(min(of_fit, usual), INTRINSICS.least_distortion_sigma, usual if into_water else 0.0)


def camera_values(result: Intrinsics, *, into_water: bool = False) -> dict[str, Any]:
    """The keys of ``[camera]``; ``into_water`` converts a calibration in air to water for rays near the axis:
    behind a flat port they are n times flatter, so that x becomes n x in the air's formulas.
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = result.values.tolist()
    n = INTRINSICS.water_index if into_water else 1.0
    distortion = [k1 * n**2, k2 * n**4, p1 * n, p2 * n, k3 * n**6]
    return {
        "camera.width_px": result.width_px,
        "camera.height_px": result.height_px,
        "camera.focal_px": [round(n * fx, 3), round(n * fy, 3)],
        "camera.focal_sigma": round(focal_sigma(result, into_water=into_water), 6),
        "camera.distortion_sigma": round(distortion_sigma(result, into_water=into_water), 4),
        "camera.center_px": [round(cx, 3), round(cy, 3)],
        "camera.distortion": [round(k, 6) for k in distortion],
    }
