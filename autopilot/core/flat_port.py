"""A camera behind a flat port: refraction at water-glass and glass-air (Snell), optical axis normal to the pane.

With u the tangent of the ray's angle to the axis in air, a ray from the lens meets the depth z at the radius (Treibitz
et al., "Flat refractive geometry", PAMI 2012; n relative to air)

    r(u, z) = d u + t u / sqrt(g^2 + (g^2 - 1) u^2) + (z - d - t) u / sqrt(n^2 + (n^2 - 1) u^2)

since sin(air) = g sin(glass) = n sin(water). There is no single centre of projection: rays of larger angles appear to
start farther behind the pane. r is increasing and concave in u, so Newton's method from below always converges.
"""

from typing import Annotated

import msgspec
import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.toml_table import NonNegative, Table

STEPS = 10
"""Of Newton's method; quadratic, at rounding after 5 or 6 inside of 60 degrees in the air."""


class FlatPort(Table, frozen=True, kw_only=True):
    """``[camera.port]``: a flat pane before the camera's lens."""

    distance_m: NonNegative
    """From the lens's centre of projection to the pane's inner side."""
    thickness_m: NonNegative = 0.0
    glass_index: Annotated[float, msgspec.Meta(ge=1.0, le=2.5)] = 1.49
    """Of refraction, relative to air; default acrylic, BK7 1.52."""
    water_index: Annotated[float, msgspec.Meta(ge=1.0, le=2.0)] = 1.333
    """Relative to air; default fresh water at 20 degC in green light, sea water 1.340."""

    @property
    def outside_m(self) -> float:
        """Distance of the pane's water side from the projection centre [m]."""
        return self.distance_m + self.thickness_m

    def exit_radius(self, slope_air: FloatArray) -> FloatArray:
        """Radius [m] at which rays (...) of that tangent in the air enter the water."""
        return self.distance_m * slope_air + self.thickness_m * _refracted(slope_air, self.glass_index)

    def water_slope(self, slope_air: FloatArray) -> FloatArray:
        """Tangent in the water of rays (...) with that tangent in the air."""
        return _refracted(slope_air, self.water_index)

    def air_slope(self, slope_water: FloatArray) -> FloatArray:
        """The inverse of :meth:`water_slope`; NaN where light from that direction does not get into the air."""
        n2 = self.water_index**2
        sine2 = n2 * slope_water**2 / (1.0 + slope_water**2)
        sine2 = np.where(sine2 < 1.0, sine2, np.nan)
        return np.sqrt(sine2 / (1.0 - sine2))

    def solve(self, radius_m: FloatArray, depth_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Tangent u (...) in the air of the ray to points at that radius and depth, and du/d radius, du/d depth."""
        water_m = depth_m - self.outside_m
        u = radius_m / (self.distance_m + self.thickness_m / self.glass_index + water_m / self.water_index)
        growth = np.ones_like(u)
        for _ in range(STEPS):
            in_glass, glass_growth = _refracted_growth(u, self.glass_index)
            in_water, water_growth = _refracted_growth(u, self.water_index)
            growth = self.distance_m + self.thickness_m * glass_growth + water_m * water_growth
            u = u + (radius_m - self.distance_m * u - self.thickness_m * in_glass - water_m * in_water) / growth
        return u, 1.0 / growth, -_refracted(u, self.water_index) / growth


def _refracted(slope: FloatArray, index: float) -> FloatArray:
    """Tangent behind a surface to a medium of ``index`` of rays with tangent ``slope`` before it."""
    return slope / np.sqrt(index * index + (index * index - 1.0) * slope * slope)


def _refracted_growth(slope: FloatArray, index: float) -> tuple[FloatArray, FloatArray]:
    """:func:`_refracted` and its derivative with respect to ``slope``."""
    root2 = index * index + (index * index - 1.0) * slope * slope
    root = np.sqrt(root2)
    return slope / root, index * index / (root2 * root)


def lens_in_air(
    distortion: tuple[float, float, float, float, float], water_index: float
) -> tuple[float, float, float, float, float]:
    """Brown's coefficients of the bare lens from those of a calibration in water through a flat port (k3 is not used).

    A distant point at the tangent w in water appears at u = n w (1 + a w^2 + b w^4 + ...) in air with a = (n^2 - 1) /
    2 and b = 3/2 a^2; the remaining distortion of the calibration is the lens's. To fourth order.
    """
    k1, k2, p1, p2, _ = distortion
    n = water_index
    a = 0.5 * (n * n - 1.0)
    b = 1.5 * a * a
    return (k1 - a) / n**2, (k2 - b - 3.0 * a * (k1 - a)) / n**4, p1 / n, p2 / n, 0.0
