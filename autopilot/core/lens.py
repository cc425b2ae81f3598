"""Lens distortion on ideal image points (x/z, y/z): Brown's model and the fisheye polynomial, both as in OpenCV.

Each model has the distortion, its Jacobian, and the inverse. Arrays are (..., 2); plain numpy, tens of microseconds
for a few hundred points.
"""

from typing import Protocol

import numpy as np

from autopilot.core.frames import FloatArray

NEWTON_STEPS = 4
"""Of the way back: the error is at rounding after 4 anywhere in the LBV150's image."""
FISHEYE_STEPS = 8
"""The same for the fisheye polynomial, out to 80 degrees."""


class LensDistortion(Protocol):
    def bend(self, ideal: FloatArray) -> FloatArray:
        """Bent image points (..., 2) of ideal ones (..., 2)."""
        ...

    def slopes(self, ideal: FloatArray) -> FloatArray:
        """(..., 2, 2) derivatives of :meth:`bend`."""
        ...

    def unbend(self, bent: FloatArray) -> FloatArray: ...


class BrownLens:
    """Radial and tangential distortion with k1 k2 p1 p2 k3 (OpenCV calib3d, Brown 1966)."""

    __slots__ = ("_k",)

    def __init__(self, coefficients: tuple[float, float, float, float, float]) -> None:
        self._k = coefficients

    def bend(self, ideal: FloatArray) -> FloatArray:
        """Bent image points (..., 2) of ideal ones (..., 2)."""
        k1, k2, p1, p2, k3 = self._k
        x, y = ideal[..., 0], ideal[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xy = 2.0 * x * y
        result = np.empty_like(ideal)
        result[..., 0] = x * radial + p1 * xy + p2 * (r2 + 2.0 * x * x)
        result[..., 1] = y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy
        return result

    def slopes(self, ideal: FloatArray) -> FloatArray:
        """(..., 2, 2) derivatives of :meth:`bend`."""
        k1, k2, p1, p2, k3 = self._k
        x, y = ideal[..., 0], ideal[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2))
        result = np.empty((*ideal.shape, 2))
        result[..., 0, 0] = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        result[..., 1, 1] = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        result[..., 0, 1] = result[..., 1, 0] = slope * x * y + 2.0 * (p1 * x + p2 * y)
        return result

    def unbend(self, bent: FloatArray) -> FloatArray:
        """The inverse of :meth:`bend`, by Newton's method."""
        k1, k2, p1, p2, k3 = self._k
        # A single point as floats: numpy takes ten times as long for it.
        target_x, target_y = bent.tolist() if bent.ndim == 1 else (bent[..., 0], bent[..., 1])
        x, y = target_x, target_y
        for _ in range(NEWTON_STEPS):
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2))
            xy = x * y
            error_x = x * radial + 2.0 * p1 * xy + p2 * (r2 + 2.0 * x * x) - target_x
            error_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * xy - target_y
            dxx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
            dyy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
            dxy = slope * xy + 2.0 * (p1 * x + p2 * y)
            determinant = dxx * dyy - dxy * dxy
            x, y = (
                x - (dyy * error_x - dxy * error_y) / determinant,
                y - (dxx * error_y - dxy * error_x) / determinant,
            )
        return np.array((x, y)) if bent.ndim == 1 else np.stack([x, y], axis=-1)


class FisheyeLens:
    """Equidistant projection with a polynomial, k1 k2 k3 k4 (OpenCV fisheye, Kannala and Brandt 2006).

    A ray at the angle t off the axis lands at the radius t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8).
    """

    __slots__ = ("_k",)

    def __init__(self, coefficients: tuple[float, float, float, float]) -> None:
        self._k = coefficients

    def _radius(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radius of rays at these angles [rad], and its derivative."""
        k1, k2, k3, k4 = self._k
        t2 = angle * angle
        radius = angle * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        slope = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))
        return radius, slope

    def bend(self, ideal: FloatArray) -> FloatArray:
        """Bent image points (..., 2) of ideal ones (..., 2)."""
        r = np.hypot(ideal[..., 0], ideal[..., 1])
        radius, _ = self._radius(np.arctan(r))
        scale = np.where(r > 1e-9, radius / np.maximum(r, 1e-9), 1.0)
        return ideal * scale[..., None]

    def slopes(self, ideal: FloatArray) -> FloatArray:
        """(..., 2, 2) derivatives of :meth:`bend`."""
        r = np.hypot(ideal[..., 0], ideal[..., 1])
        radius, slope = self._radius(np.arctan(r))
        near = r <= 1e-9
        scale = np.where(near, 1.0, radius / np.maximum(r, 1e-9))
        growth = slope / (1.0 + r * r)
        return _radial_slopes(ideal, r, scale, growth)

    def unbend(self, bent: FloatArray) -> FloatArray:
        """The inverse of :meth:`bend`, by Newton's method; NaN beyond 90 degrees."""
        target = np.hypot(bent[..., 0], bent[..., 1])
        angle = np.minimum(target, 1.5)
        for _ in range(FISHEYE_STEPS):
            radius, slope = self._radius(angle)
            angle = np.clip(angle - (radius - target) / np.maximum(slope, 1e-3), 0.0, 1.6)
        angle = np.where(angle < 1.57, angle, np.nan)
        scale = np.where(target > 1e-9, np.tan(angle) / np.maximum(target, 1e-9), 1.0)
        return bent * scale[..., None]


def _radial_slopes(point: FloatArray, r: FloatArray, scale: FloatArray, growth: FloatArray) -> FloatArray:
    """(..., 2, 2) derivatives of ``point * scale`` where the radius r * scale grows by ``growth`` per r."""
    unit = point / np.maximum(r, 1e-12)[..., None]
    result: FloatArray = (growth - scale)[..., None, None] * unit[..., :, None] * unit[..., None, :]
    result[..., 0, 0] += scale
    result[..., 1, 1] += scale
    return result
