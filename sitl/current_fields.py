"""Current fields in the local NED frame: analytic ones, all divergence-free, and gridded ones.

The analytic ones are the tables of ``[current]`` themselves. Every field gives its velocity, its gradient and its local
time derivative, because a hull that moves through a non-uniform field experiences the acceleration of the water
(:mod:`.sitl.rigid_body`). Analytic fields do not depend on depth; vertical velocity is zero except in the uniform field
and in a grid that has one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Protocol, TypeAlias

import msgspec

from autopilot.core.toml_table import Positive, Table, Vec2, Vec3
from autopilot.sitl.sitl_tuning import CURRENTS

Gradient: TypeAlias = tuple[float, float, float, float]
"""d c_i / d x_j [1/s], row by row: (c_n,n c_n,e c_e,n c_e,e); the other five are zero in every analytic field."""


class CurrentField(Protocol):
    @property
    def steady_uniform(self) -> bool:
        """True if gradient and time derivative are zero everywhere, which saves their evaluation."""
        ...

    def velocity(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        """(3,) NED [m/s] at a place and time."""
        ...

    def gradient(self, pos_ned_m: Sequence[float], t_s: float) -> Gradient:
        """d c_i / d x_j [1/s], four numbers row by row."""
        ...

    def rate(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        """d c / d t at a fixed place [m/s^2]."""
        ...


class Uniform(Table, frozen=True, kw_only=True, tag_field="kind", tag="uniform"):
    """Velocity + tide * sin(2 pi t / period), the same everywhere."""

    velocity_m_s: Vec3
    tide_m_s: Vec3 = CURRENTS.zero
    tide_period_s: Positive = 44712.0
    """Default: the M2 tide, 12.42 h."""

    @property
    def steady_uniform(self) -> bool:
        return self.tide_m_s == CURRENTS.zero

    def velocity(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        s = math.sin(2.0 * math.pi * t_s / self.tide_period_s)
        c, a = self.velocity_m_s, self.tide_m_s
        return (c[0] + s * a[0], c[1] + s * a[1], c[2] + s * a[2])

    def gradient(self, pos_ned_m: Sequence[float], t_s: float) -> Gradient:
        return CURRENTS.zero_gradient

    def rate(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        omega = 2.0 * math.pi / self.tide_period_s
        s = omega * math.cos(omega * t_s)
        return (s * self.tide_m_s[0], s * self.tide_m_s[1], s * self.tide_m_s[2])


@dataclass(frozen=True, slots=True, kw_only=True)
class WithFlow:
    """Another field and a flow that is added to it everywhere."""

    field: CurrentField
    added_m_s: Vec2
    """North, east."""

    @property
    def steady_uniform(self) -> bool:
        return self.field.steady_uniform

    def velocity(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        north, east, down = self.field.velocity(pos_ned_m, t_s)
        return (north + self.added_m_s[0], east + self.added_m_s[1], down)

    def gradient(self, pos_ned_m: Sequence[float], t_s: float) -> Gradient:
        return self.field.gradient(pos_ned_m, t_s)

    def rate(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        return self.field.rate(pos_ned_m, t_s)


class _Steady(Table, frozen=True, kw_only=True):
    """A planar field that does not change with time."""

    @property
    def steady_uniform(self) -> bool:
        return False

    def rate(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        return CURRENTS.zero


class TankJet(_Steady, frozen=True, kw_only=True, tag_field="kind", tag="jet"):
    """Jet along +x in the middle of a rectangular tank with return flow along the walls y = +-width / 2.

    Streamfunction psi = -(U / k) sin(k (y + W/2)) h(xi), k = 2 pi / W, xi = x / L + 1/2, h = 6.75 xi (1 - xi)^2; so
    u = d psi / d y, v = -d psi / d x. No flow through the four walls; the largest velocity U lies at xi = 1/3, y = 0.
    Places outside the tank see the nearest place inside (the field is not free of divergence there).
    """

    speed_m_s: float = 0.25
    center_m: Vec2 = (0.0, 0.0)
    length_m: Positive = 5.0
    width_m: Positive = 3.0
    direction_rad: float = 0.0
    """The whole field turned about its centre, clockwise seen from above, by :class:`Turned`; then it does not follow
    the walls."""

    def _local(self, pos_ned_m: Sequence[float]) -> tuple[float, float, float]:
        """xi in [0, 1], sine and cosine of the phase across the tank."""
        xi = (pos_ned_m[0] - self.center_m[0]) / self.length_m + 0.5
        eta = (pos_ned_m[1] - self.center_m[1]) / self.width_m + 0.5
        phase = 2.0 * math.pi * min(max(eta, 0.0), 1.0)
        return min(max(xi, 0.0), 1.0), math.sin(phase), math.cos(phase)

    def velocity(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        xi, s, c = self._local(pos_ned_m)
        rest = 1.0 - xi
        scale = CURRENTS.jet_profile * self.speed_m_s * rest
        aspect = self.width_m / (2.0 * math.pi * self.length_m)
        return (-scale * c * xi * rest, scale * s * (1.0 - 3.0 * xi) * aspect, 0.0)

    def gradient(self, pos_ned_m: Sequence[float], t_s: float) -> Gradient:
        xi, s, c = self._local(pos_ned_m)
        k = 2.0 * math.pi / self.width_m
        rest = 1.0 - xi
        h = CURRENTS.jet_profile * xi * rest * rest
        h_x = CURRENTS.jet_profile * rest * (1.0 - 3.0 * xi) / self.length_m
        h_xx = CURRENTS.jet_profile * (6.0 * xi - 4.0) / (self.length_m * self.length_m)
        # Outside the tank nothing changes along the direction in which the nearest place inside stays the same.
        u_x = self.speed_m_s if abs(pos_ned_m[0] - self.center_m[0]) <= 0.5 * self.length_m else 0.0
        u_y = self.speed_m_s if abs(pos_ned_m[1] - self.center_m[1]) <= 0.5 * self.width_m else 0.0
        return (-u_x * c * h_x, u_y * k * s * h, u_x / k * s * h_xx, u_y * c * h_x)


@dataclass(frozen=True, slots=True, kw_only=True)
class Turned:
    """Another field turned about a place by an angle, clockwise seen from above (from north to east)."""

    field: CurrentField
    center_m: Vec2
    cosine: float
    sine: float

    @property
    def steady_uniform(self) -> bool:
        return self.field.steady_uniform

    def _back(self, pos_ned_m: Sequence[float]) -> Vec3:
        """The place in the field before it was turned."""
        dx, dy = pos_ned_m[0] - self.center_m[0], pos_ned_m[1] - self.center_m[1]
        c, s = self.cosine, self.sine
        return (self.center_m[0] + c * dx + s * dy, self.center_m[1] - s * dx + c * dy, pos_ned_m[2])

    def _turn(self, vector: Vec3) -> Vec3:
        c, s = self.cosine, self.sine
        return (c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2])

    def velocity(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        return self._turn(self.field.velocity(self._back(pos_ned_m), t_s))

    def gradient(self, pos_ned_m: Sequence[float], t_s: float) -> Gradient:
        """See :class:`CurrentField`: R G R'."""
        nn, ne, en, ee = self.field.gradient(self._back(pos_ned_m), t_s)
        c, s = self.cosine, self.sine
        # R G, then times R'.
        a, b, d, e = c * nn - s * en, c * ne - s * ee, s * nn + c * en, s * ne + c * ee
        return (a * c - b * s, a * s + b * c, d * c - e * s, d * s + e * c)

    def rate(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        return self._turn(self.field.rate(self._back(pos_ned_m), t_s))


class Vortex(_Steady, frozen=True, kw_only=True, tag_field="kind", tag="vortex"):
    """Lamb-Oseen vortex: v_theta = G / (2 pi r) (1 - exp(-r^2 / core^2)), positive from north to east."""

    center_m: Vec2 = (0.0, 0.0)
    circulation_m2_s: float
    core_m: Annotated[float, msgspec.Meta(ge=0.001)]

    def _profile(self, r2: float) -> tuple[float, float]:
        """Angular velocity [1/s] at radius^2 and its derivative by radius^2 [1/(s m^2)]."""
        a = self.core_m * self.core_m
        scale = self.circulation_m2_s / (2.0 * math.pi * a)
        q = r2 / a
        if q < CURRENTS.vortex_series_limit:
            return scale * (1.0 - q / 2.0 + q * q / 6.0), scale / a * (-0.5 + q / 3.0 - q * q / 8.0)
        grown = -math.expm1(-q)
        return scale * grown / q, scale / a * ((1.0 - grown) / q - grown / (q * q))

    def velocity(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        dx, dy = pos_ned_m[0] - self.center_m[0], pos_ned_m[1] - self.center_m[1]
        omega, _ = self._profile(dx * dx + dy * dy)
        return (-omega * dy, omega * dx, 0.0)

    def gradient(self, pos_ned_m: Sequence[float], t_s: float) -> Gradient:
        dx, dy = pos_ned_m[0] - self.center_m[0], pos_ned_m[1] - self.center_m[1]
        omega, slope = self._profile(dx * dx + dy * dy)
        cross = 2.0 * slope * dx * dy
        return (-cross, -omega - 2.0 * slope * dy * dy, omega + 2.0 * slope * dx * dx, cross)


class Shear(_Steady, frozen=True, kw_only=True, tag_field="kind", tag="shear"):
    """u = speed + shear * (y - center_y)."""

    speed_m_s: float = 0.0
    shear_1_s: float
    center_y_m: float = 0.0

    def velocity(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        return (self.speed_m_s + self.shear_1_s * (pos_ned_m[1] - self.center_y_m), 0.0, 0.0)

    def gradient(self, pos_ned_m: Sequence[float], t_s: float) -> Gradient:
        return (0.0, self.shear_1_s, 0.0, 0.0)


class Bickley(_Steady, frozen=True, kw_only=True, tag_field="kind", tag="bickley"):
    """u = speed * sech^2((y - center_y) / width)."""

    speed_m_s: float
    width_m: Positive
    center_y_m: float = 0.0

    def _tanh(self, pos_ned_m: Sequence[float]) -> float:
        return math.tanh((pos_ned_m[1] - self.center_y_m) / self.width_m)

    def velocity(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        th = self._tanh(pos_ned_m)
        return (self.speed_m_s * (1.0 - th * th), 0.0, 0.0)

    def gradient(self, pos_ned_m: Sequence[float], t_s: float) -> Gradient:
        th = self._tanh(pos_ned_m)
        return (0.0, -2.0 * self.speed_m_s * th * (1.0 - th * th) / self.width_m, 0.0, 0.0)


class Gyre(_Steady, frozen=True, kw_only=True, tag_field="kind", tag="gyre"):
    """Taylor-Green: u = U sin(pi x / L) cos(pi y / L), v = -U cos(pi x / L) sin(pi y / L)."""

    speed_m_s: float
    cell_m: Positive

    def velocity(self, pos_ned_m: Sequence[float], t_s: float) -> Vec3:
        a, b = math.pi * pos_ned_m[0] / self.cell_m, math.pi * pos_ned_m[1] / self.cell_m
        u = self.speed_m_s
        return (u * math.sin(a) * math.cos(b), -u * math.cos(a) * math.sin(b), 0.0)

    def gradient(self, pos_ned_m: Sequence[float], t_s: float) -> Gradient:
        a, b = math.pi * pos_ned_m[0] / self.cell_m, math.pi * pos_ned_m[1] / self.cell_m
        k = self.speed_m_s * math.pi / self.cell_m
        even, odd = k * math.cos(a) * math.cos(b), k * math.sin(a) * math.sin(b)
        return (even, -odd, odd, -even)


class NoCurrentTable(Table, frozen=True, kw_only=True, tag_field="kind", tag="none"):
    """Still water."""


class GridCurrent(Table, frozen=True, kw_only=True, tag_field="kind", tag="grid"):
    """Gridded, linear between the nodes in space and time (:mod:`autopilot.sitl.grid_current`)."""

    file: str
    """``.npz`` or NetCDF-3, relative to the scenario file."""


Current: TypeAlias = NoCurrentTable | Uniform | TankJet | Vortex | Shear | Bickley | Gyre | GridCurrent
"""``[current]``"""
STILL = Uniform(velocity_m_s=CURRENTS.zero)


def current_field(table: Current) -> CurrentField:
    """The field that a scenario's ``[current]`` describes."""
    match table:
        case NoCurrentTable():
            return STILL
        case GridCurrent():
            from autopilot.sitl.grid_current import GridField, read_grid  # numpy

            return GridField(read_grid(table.file))
        case TankJet(direction_rad=angle, center_m=center) if angle != 0.0:
            return Turned(field=table, center_m=center, cosine=math.cos(angle), sine=math.sin(angle))
    return table
