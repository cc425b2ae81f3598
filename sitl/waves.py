"""Surface waves by linear (Airy) theory: velocity of the water, and pressure at a depth sensor.

Dean & Dalrymple 1991, *Water Wave Mechanics for Engineers and Scientists*, chapters 3 and 4 (also Fossen 2011, ch. 8).
A wave of amplitude a, circular frequency w and wave number k in direction d, in water of depth h (z down from the mean
surface, s = distance along d, theta = w t - k s + phase):

    w^2 = g k tanh(k h)                                    dispersion
    eta = a cos(theta)                                     elevation of the surface, up
    u   = a w cosh(k (h - z)) / sinh(k h) cos(theta)       velocity along d
    v   = a w sinh(k (h - z)) / sinh(k h) sin(theta)       velocity down
    K   = cosh(k (h - z)) / cosh(k h)                      pressure response factor: part of eta in the pressure

The velocity and K decay with depth, exp(-k z) in deep water. Above the mean surface they have their value at it. Waves
of several frequencies are superposed. There are no reflections: walls and obstacles do not affect waves. The hull
experiences the time derivative at its position and the horizontal gradient; a change with depth acts through the
velocity, not as acceleration of the water. The hull emerges from the mean surface.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from autopilot.core.toml_table import Vec3
from autopilot.sitl.current_fields import CurrentField, Gradient
from autopilot.sitl.scenario_tables import Waves
from autopilot.sitl.sitl_tuning import PLANT, WAVES


def wave_number(omega_rad_s: float, depth_m: float) -> float:
    """k [1/m] of the dispersion relation, by Newton's method; ``depth_m`` may be infinite."""
    deep = omega_rad_s * omega_rad_s / PLANT.gravity_m_s2
    if deep * depth_m > WAVES.deep:
        return deep
    kh, target = max(deep * depth_m, math.sqrt(deep * depth_m)), deep * depth_m
    for _ in range(WAVES.newton_steps):
        th = math.tanh(kh)
        step = (kh * th - target) / (th + kh * (1.0 - th * th))
        kh -= step
        if abs(step) < 1e-14 * kh:
            break
    return kh / depth_m


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    amplitude_m: float
    omega_rad_s: float
    phase_rad: float
    k_1_m: float
    north: float
    """Direction in which it runs."""
    east: float
    depth_m: float
    """Depth of the floor; infinite = deep water."""

    def _depth_factors(self, z: float) -> tuple[float, float, float]:
        """cosh(k (h - z)) / sinh(k h), sinh(k (h - z)) / sinh(k h), cosh(k (h - z)) / cosh(k h)."""
        kh = self.k_1_m * self.depth_m
        if kh > WAVES.deep:
            decayed = math.exp(-self.k_1_m * max(z, 0.0))
            return decayed, decayed, decayed
        up = self.k_1_m * (self.depth_m - min(max(z, 0.0), self.depth_m))
        return math.cosh(up) / math.sinh(kh), math.sinh(up) / math.sinh(kh), math.cosh(up) / math.cosh(kh)

    def _theta(self, pos_ned_m: Sequence[float], t_s: float) -> float:
        along = self.north * pos_ned_m[0] + self.east * pos_ned_m[1]
        return self.omega_rad_s * t_s - self.k_1_m * along + self.phase_rad

    def velocity(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        ahead, down, _ = self._depth_factors(pos_ned_m[2])
        theta, scale = self._theta(pos_ned_m, t_s), self.amplitude_m * self.omega_rad_s
        u = scale * ahead * math.cos(theta)
        return (self.north * u, self.east * u, scale * down * math.sin(theta))

    def gradient(self, pos_ned_m: Sequence[float], t_s: float) -> Gradient:
        ahead, _, _ = self._depth_factors(pos_ned_m[2])
        slope = self.amplitude_m * self.omega_rad_s * self.k_1_m * ahead * math.sin(self._theta(pos_ned_m, t_s))
        cross = slope * self.north * self.east
        return (slope * self.north * self.north, cross, cross, slope * self.east * self.east)

    def rate(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        """d c / d t at a fixed place [m/s^2]."""
        ahead, down, _ = self._depth_factors(pos_ned_m[2])
        theta, scale = self._theta(pos_ned_m, t_s), self.amplitude_m * self.omega_rad_s * self.omega_rad_s
        u = -scale * ahead * math.sin(theta)
        return (self.north * u, self.east * u, scale * down * math.cos(theta))

    def pressed_m(self, pos_ned_m: Sequence[float], t_s: float) -> float:
        """Error of a pressure sensor's depth there, positive deeper [m]."""
        return self.amplitude_m * self._depth_factors(pos_ned_m[2])[2] * math.cos(self._theta(pos_ned_m, t_s))

    def elevation_m(self, pos_ned_m: Sequence[float], t_s: float) -> float:
        """Elevation of the surface, positive up [m]."""
        return self.amplitude_m * math.cos(self._theta(pos_ned_m, t_s))


@dataclass(frozen=True, slots=True, kw_only=True)
class WaveTrain:
    components: tuple[Component, ...]

    def pressed_m(self, pos_ned_m: Sequence[float], t_s: float) -> float:
        """Error of a pressure sensor's depth there, positive deeper [m]."""
        return sum(each.pressed_m(pos_ned_m, t_s) for each in self.components)

    def elevation_m(self, pos_ned_m: Sequence[float], t_s: float) -> float:
        """Elevation of the surface, positive up [m]."""
        return sum(each.elevation_m(pos_ned_m, t_s) for each in self.components)


@dataclass(frozen=True, slots=True, kw_only=True)
class WithWaves:
    """A current with waves on it: a :class:`autopilot.sitl.current_fields.CurrentField`."""

    field: CurrentField
    waves: WaveTrain

    @property
    def steady_uniform(self) -> bool:
        return False

    def velocity(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        n, e, d = self.field.velocity(pos_ned_m, t_s)
        for each in self.waves.components:
            vn, ve, vd = each.velocity(pos_ned_m, t_s)
            n, e, d = n + vn, e + ve, d + vd
        return (n, e, d)

    def gradient(self, pos_ned_m: Sequence[float], t_s: float) -> Gradient:
        nn, ne, en, ee = self.field.gradient(pos_ned_m, t_s)
        for each in self.waves.components:
            a, b, c, d = each.gradient(pos_ned_m, t_s)
            nn, ne, en, ee = nn + a, ne + b, en + c, ee + d
        return (nn, ne, en, ee)

    def rate(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        n, e, d = self.field.rate(pos_ned_m, t_s)
        for each in self.waves.components:
            vn, ve, vd = each.rate(pos_ned_m, t_s)
            n, e, d = n + vn, e + ve, d + vd
        return (n, e, d)


def wave_train(table: Waves | None, depth_m: float | None) -> WaveTrain | None:
    """The waves of a scenario over a floor at that depth (None = deep water), None without any."""
    if table is None or table.height_m == 0.0:
        return None
    peak = 2.0 * math.pi / table.period_s
    floor_m = math.inf if depth_m is None else depth_m
    if table.spectrum == "regular":
        return WaveTrain(components=(_component(table, 0.5 * table.height_m, peak, table.phase_rad, floor_m),))
    edges = np.linspace(WAVES.band[0] * peak, WAVES.band[1] * peak, WAVES.components + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])
    energy = np.array([_jonswap(float(omega), peak) for omega in middles])
    # Significant height = 4 sqrt(m0), and a regular wave of amplitude a has m0 = a^2 / 2.
    amplitudes = np.sqrt(2.0 * energy / energy.sum()) * table.height_m / 4.0
    phases = np.random.default_rng((table.seed, 60)).uniform(0.0, 2.0 * math.pi, WAVES.components)
    return WaveTrain(
        components=tuple(
            _component(table, float(a), float(omega), float(phase) + table.phase_rad, floor_m)
            for a, omega, phase in zip(amplitudes, middles, phases, strict=True)
        )
    )


def _component(table: Waves, amplitude_m: float, omega: float, phase: float, depth_m: float) -> Component:
    return Component(
        amplitude_m=amplitude_m,
        omega_rad_s=omega,
        phase_rad=phase,
        k_1_m=wave_number(omega, depth_m),
        north=math.cos(table.direction_rad),
        east=math.sin(table.direction_rad),
        depth_m=depth_m,
    )


def _jonswap(omega: float, peak: float) -> float:
    """Shape of the spectrum (Hasselmann et al. 1973), without its scale."""
    width = 0.07 if omega <= peak else 0.09
    bump = math.exp(-((omega - peak) ** 2) / (2.0 * (width * peak) ** 2))
    return float(omega**-5.0 * math.exp(-1.25 * (peak / omega) ** 4) * WAVES.jonswap_peak**bump)


def breaking_height_m(table: Waves, depth_m: float | None) -> float:
    """Height at which regular waves of that period break over that floor (Miche 1944)."""
    floor_m = math.inf if depth_m is None else depth_m
    k = wave_number(2.0 * math.pi / table.period_s, floor_m)
    return WAVES.breaking * 2.0 * math.pi / k * (1.0 if math.isinf(floor_m) else math.tanh(k * floor_m))
