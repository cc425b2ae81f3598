"""Where the laser beam starts and where it goes, from dots whose depth is known.

A dot at depth Z (along the optical axis) on the beam is seen at the ideal image point v = s + b / Z: s is the beam's
slope (its vanishing point) and b where it passes the lens, both in the camera frame. Both components of v are straight
lines over 1/Z. Z is the depth at which the pixel's own ray meets the floor, so nothing about the beam is assumed; what
may be assumed neither is that a dot is the laser's: markers' print and caustics look alike, and pairs of dots vote.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from autopilot.calibrate.calibrate_tuning import LASER_FIT
from autopilot.calibrate.least_squares import covariance, huber_weights, robust_sigma, solve_weighted
from autopilot.core.camera import CameraModel
from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.core.vehicle import Vehicle


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Dots:
    """Green dots, several may be of one picture."""

    picture: np.ndarray
    """(n,) number of the picture."""
    ideal: FloatArray
    """(n, 2) x/z and y/z of the ray in the camera frame."""
    depth_m: FloatArray
    """(n,) where that ray meets the floor, along the optical axis."""

    @property
    def pictures(self) -> int:
        """Pictures with at least one dot."""
        return len(np.unique(self.picture))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Beam:
    """A calibrated beam in the camera frame."""

    slope: FloatArray
    """(2,) x/z and y/z of its direction."""
    base_m: FloatArray
    """(2,) x and y where it passes z = 0."""
    sigma_slope: FloatArray
    sigma_base_m: FloatArray
    correlation: FloatArray
    """(2,) of slope and base, x and y."""
    rms_px: float
    used: int
    dots: int
    depth_m: tuple[float, float]
    """Least and largest depth of the dots that were used."""
    residual_px: FloatArray
    """(used, 2)"""

    def sigma_range_m(self, depth_m: float) -> float:
        """Standard deviation that this calibration leaves in a range at this depth (dh = h^2 dv / b)."""
        across = self.base_m / max(float(np.hypot(*self.base_m)), 1e-9)
        by_base = self.sigma_base_m / depth_m
        variance = self.sigma_slope**2 + by_base**2 + 2.0 * self.correlation * self.sigma_slope * by_base
        sigma = math.sqrt(float((across**2) @ np.maximum(variance, 0.0)))
        return depth_m**2 * sigma / max(float(np.hypot(*self.base_m)), 1e-9)


def floor_depths(
    camera: CameraModel, pixels: FloatArray, r_ned_from_cam: FloatArray, eye_ned_m: FloatArray, floor_m: float
) -> FloatArray:
    """(n,) depth along the optical axis at which the rays of pixels (n, 2) meet a level floor."""
    starts, rays = camera.rays(pixels)
    down = r_ned_from_cam[2]
    reach = (floor_m - eye_ned_m[2] - starts @ down) / np.maximum(rays @ down, 0.05)
    result: FloatArray = starts[:, 2] + reach
    return result


def fit_beam(dots: Dots, camera: CameraModel) -> Beam:
    """The beam that most dots agree on. LogError if there are too few, or they lie at one height."""
    if dots.pictures < LASER_FIT.min_dots:
        raise LogError(
            f"a green dot was found in {dots.pictures} pictures, at least {LASER_FIT.min_dots} are"
            " needed; check that the laser"
            " is on, dim the light, or come closer"
        )
    focal = camera.focal_water_px
    inverse_depth = 1.0 / dots.depth_m
    chosen = _agreed(dots, inverse_depth, LASER_FIT.inlier_px / focal)
    if len(np.unique(dots.picture[chosen])) < LASER_FIT.min_dots:
        raise LogError(
            f"{dots.pictures} pictures with green dots, but only {len(chosen)} lie on one beam; check that the laser is"
            " on and the camera's calibration"
        )
    w = inverse_depth[chosen]
    if float(np.ptp(w)) < LASER_FIT.min_spread * float(w.mean()):
        low, high = 1.0 / w.max(), 1.0 / w.min()
        raise LogError(
            f"all dots lie between {low:.2f} and {high:.2f} m from the camera; change the height by a quarter at least,"
            " or place and direction of the beam cannot be told apart"
        )
    v = dots.ideal[chosen]
    jacobian = np.zeros((len(w), 2, 4))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
    jacobian[:, 0, 2] = jacobian[:, 1, 3] = w
    x = np.zeros(4)
    residual = v - jacobian @ x
    weights = np.ones_like(v)
    for _ in range(LASER_FIT.rounds):
        step, inverse = solve_weighted(jacobian, residual, weights, np.zeros(4))
        x = x + step
        residual = v - jacobian @ x
        weights = huber_weights(residual, robust_sigma(residual))
    _, inverse = solve_weighted(jacobian, residual, weights, np.zeros(4))
    spread = covariance(jacobian, residual, weights, inverse, LASER_FIT.lags)
    sigma = np.sqrt(np.diag(spread))
    if float(sigma[:2].max()) > LASER_FIT.max_sigma_slope:
        raise LogError(
            f"the beam's direction is known to {math.degrees(float(sigma[:2].max())):.2f} deg only; more pictures from"
            " more different heights are needed"
        )
    return Beam(
        slope=x[:2],
        base_m=x[2:],
        sigma_slope=LASER_FIT.sigma_factor * sigma[:2],
        sigma_base_m=LASER_FIT.sigma_factor * sigma[2:],
        correlation=np.array([spread[k, k + 2] / (sigma[k] * sigma[k + 2]) for k in (0, 1)]),
        rms_px=focal * math.sqrt(float((residual**2).sum(axis=1).mean())),
        used=len(w),
        dots=len(dots.depth_m),
        depth_m=(float(1.0 / w.max()), float(1.0 / w.min())),
        residual_px=focal * residual,
    )


def _agreed(dots: Dots, w: FloatArray, inlier: float) -> np.ndarray:
    """Indices of the dots that lie on the beam through the best of many pairs; one per picture."""
    rng = np.random.default_rng(0)
    pairs = rng.integers(0, len(w), (LASER_FIT.tries, 2))
    apart = np.abs(w[pairs[:, 0]] - w[pairs[:, 1]])
    pairs = pairs[apart > 0.05 * float(w.mean())]
    if not len(pairs):
        pairs = np.column_stack((np.arange(len(w)), np.roll(np.arange(len(w)), 1)))
        pairs = pairs[w[pairs[:, 0]] != w[pairs[:, 1]]]
    best, most = np.empty(0, dtype=np.int64), 0
    for i, j in pairs.tolist():
        base = (dots.ideal[i] - dots.ideal[j]) / (w[i] - w[j])
        slope = dots.ideal[i] - base * w[i]
        if float(np.abs(slope).max()) > LASER_FIT.max_slope or float(np.abs(base).max()) > LASER_FIT.max_base_m:
            continue
        off = np.hypot(*(dots.ideal - slope - base * w[:, None]).T)
        near = np.flatnonzero(off < inlier)
        order = near[np.argsort(off[near], kind="stable")]
        _, once = np.unique(dots.picture[order], return_index=True)
        if len(once) > most:
            most, best = len(once), np.sort(order[once])
    return best


def beam_values(beam: Beam, camera: CameraModel, vehicle: Vehicle) -> dict[str, Any]:
    """The keys of ``[laser]``. Where on the beam it starts does not matter; the depth of the file is kept."""
    r = camera.r_frd_from_cam
    direction = r @ np.append(beam.slope, 1.0)
    point = camera.position_frd_m + r @ np.append(beam.base_m, 0.0)
    depth_m = 0.0 if vehicle.laser is None else vehicle.laser.position_frd_m[2]
    start = point + direction * (depth_m - point[2]) / direction[2]
    unit = direction / direction[2]
    # The dot's direction as the camera sees it, where it is known worst: at the ends of the heights flown.
    sigma_rad = max(beam.sigma_range_m(m) * float(np.linalg.norm(beam.base_m)) / m**2 for m in beam.depth_m)
    return {
        "laser.position_frd_m": [round(v, 5) for v in start.tolist()],
        "laser.direction_frd": [round(v, 6) for v in unit.tolist()],
        "laser.direction_sigma_rad": round(sigma_rad, 6),
    }
