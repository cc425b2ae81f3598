"""Equations of motion of the hull in 6 degrees of freedom (Fossen 2011, ch. 3, 4, 6 and 8), in plain floats for speed.

    M_RB v' + C_RB(v) v + M_A v_r' + C_A(v_r) v_r + D(v_r) v_r + g(eta) = tau

Body frame FRD at the centre of gravity, diagonal added mass. State, 13 floats: position NED, quaternion w x y z (body
to world), velocity over ground FRD, angular rate FRD.

The current c(x, t) is evaluated at the centre of gravity and does not rotate with the hull: v_r = v - R^T c, and the
drag on rotation uses the absolute rate. In a non-uniform current, v_r' contains the change of c along the path of the
*hull*, dc/dt + (v . grad) c. The Froude-Krylov force is added, displaced mass times the acceleration of the *water*,
dc/dt + (c . grad) c: the pressure gradient that accelerates the water also acts on the hull. With it a neutral hull at
v_r = 0 follows a streamline exactly; without it (``froude_krylov=False``) it would leave every vortex.

Within a step the current is its first-order expansion in position and time about the start of the step, so that
velocity, gradient and time derivative belong to the same field.

In a mismatch the mass is that of hull and trapped water, so the displaced mass is mass * buoyancy / weight.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

from autopilot.core.toml_table import Vec3
from autopilot.core.vehicle import Body
from autopilot.sitl.current_fields import Gradient

State: TypeAlias = list[float]
Wrench: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]
"""Force FRD [N], moment FRD [N m], further force NED [N]."""
ForceNed: TypeAlias = Callable[[Vec3, Vec3, Vec3], Vec3]
"""Force NED [N] (tether, contact) from position, velocity over ground and velocity relative to the water, all NED."""


class Water(NamedTuple):
    """The current about one place and one time."""

    current_ned_m_s: Vec3
    """There and then."""
    place_ned_m: Vec3
    change: tuple[Gradient, Vec3] | None
    """Gradient [1/s] and rate at a fixed place [m/s^2]; None where the current is steady and uniform."""


def displaced_mass_kg(body: Body) -> float:
    """Mass of the displaced water [kg]."""
    return body.mass_kg * (body.weight_n + body.buoyancy_excess_n) / body.weight_n


Derivative: TypeAlias = Callable[[Sequence[float], float, Wrench, Water, ForceNed | None], State]


def make_derivative(  # one function on purpose: it runs 500 times per simulated second
    body: Body, *, hull_half_height_m: float, froude_krylov: bool = True
) -> Derivative:
    """The time derivative of the state as a function of state, time since ``Water`` held [s], wrench, water, force."""
    m, (ax, ay, az) = body.mass_kg, body.added_mass_kg
    mx, my, mz = m + ax, m + ay, m + az
    ix, iy, iz = (rigid + added for rigid, added in zip(body.inertia_kg_m2, body.added_inertia_kg_m2, strict=True))
    (lu, lv, lw), (qu, qv, qw) = body.linear_drag_n_s_m, body.quadratic_drag_n_s2_m2
    (lp, lq, lr), (qp, qq, qr) = body.angular_linear_drag_n_m_s, body.angular_quadratic_drag_n_m_s2
    weight, (bx, by, bz) = body.weight_n, body.center_of_buoyancy_frd_m
    buoyancy = weight + body.buoyancy_excess_n
    displaced = displaced_mass_kg(body) if froude_krylov else 0.0

    def derivative(
        state: Sequence[float], elapsed_s: float, wrench: Wrench, water: Water, force: ForceNed | None
    ) -> State:
        x, y, z, ew, ex, ey, ez, u, v, w, p, q, r = state
        fx, fy, fz, kx, ky, kz, fn, fe, fd = wrench

        x2, y2, z2 = ex + ex, ey + ey, ez + ez
        wx, wy, wz = x2 * ew, y2 * ew, z2 * ew
        xx, xy, xz, yy, yz, zz = x2 * ex, x2 * ey, x2 * ez, y2 * ey, y2 * ez, z2 * ez
        r11, r12, r13 = 1.0 - yy - zz, xy - wz, xz + wy
        r21, r22, r23 = xy + wz, 1.0 - xx - zz, yz - wx
        r31, r32, r33 = xz - wy, yz + wx, 1.0 - xx - yy
        vn = r11 * u + r12 * v + r13 * w
        ve = r21 * u + r22 * v + r23 * w
        vd = r31 * u + r32 * v + r33 * w

        # Water velocity in the body frame, and forces from its acceleration.
        (cn, ce, cd), (x0, y0, _), change = water
        if change is not None:
            (nn, ne, en, ee), (tn, te, td) = change
            dx, dy = x - x0, y - y0
            cn += nn * dx + ne * dy + tn * elapsed_s
            ce += en * dx + ee * dy + te * elapsed_s
            cd += td * elapsed_s
            hn, he = nn * vn + ne * ve + tn, en * vn + ee * ve + te  # change along the path of the hull
            wn, we = nn * cn + ne * ce + tn, en * cn + ee * ce + te  # acceleration of the water itself
            fx += ax * (r11 * hn + r21 * he + r31 * td) + displaced * (r11 * wn + r21 * we + r31 * td)
            fy += ay * (r12 * hn + r22 * he + r32 * td) + displaced * (r12 * wn + r22 * we + r32 * td)
            fz += az * (r13 * hn + r23 * he + r33 * td) + displaced * (r13 * wn + r23 * we + r33 * td)
        cu = r11 * cn + r21 * ce + r31 * cd
        cv = r12 * cn + r22 * ce + r32 * cd
        cw = r13 * cn + r23 * ce + r33 * cd
        ur, vr, wr = u - cu, v - cv, w - cw

        # Weight, buoyancy of the part that is under water, tether and contact: forces given in NED.
        lift = buoyancy
        if z < hull_half_height_m:
            lift *= max(0.0, 0.5 + 0.5 * z / hull_half_height_m)
        fd += weight - lift
        if force is not None:
            kn, ke, kd = force((x, y, z), (vn, ve, vd), (vn - cn, ve - ce, vd - cd))
            fn, fe, fd = fn + kn, fe + ke, fd + kd
        fx += r11 * fn + r21 * fe + r31 * fd
        fy += r12 * fn + r22 * fe + r32 * fd
        fz += r13 * fn + r23 * fe + r33 * fd

        # Momentum of hull and water that moves along, Coriolis terms, drag.
        mu, mv, mw = ax * ur, ay * vr, az * wr
        gu, gv, gw = m * u + mu, m * v + mv, m * w + mw
        fx -= q * (gw + ax * cw) - r * (gv + ax * cv) + (lu + qu * abs(ur)) * ur
        fy -= r * (gu + ay * cu) - p * (gw + ay * cw) + (lv + qv * abs(vr)) * vr
        fz -= p * (gv + az * cv) - q * (gu + az * cu) + (lw + qw * abs(wr)) * wr
        hp, hq, hr = ix * p, iy * q, iz * r
        kx -= q * hr - r * hq + vr * mw - wr * mv + (lp + qp * abs(p)) * p + lift * (by * r33 - bz * r32)
        ky -= r * hp - p * hr + wr * mu - ur * mw + (lq + qq * abs(q)) * q + lift * (bz * r31 - bx * r33)
        kz -= p * hq - q * hp + ur * mv - vr * mu + (lr + qr * abs(r)) * r + lift * (bx * r32 - by * r31)

        hp, hq, hr = 0.5 * p, 0.5 * q, 0.5 * r
        return [
            vn, ve, vd,
            -ex * hp - ey * hq - ez * hr, ew * hp + ey * hr - ez * hq,
            ew * hq + ez * hp - ex * hr, ew * hr + ex * hq - ey * hp,
            fx / mx, fy / my, fz / mz, kx / ix, ky / iy, kz / iz,
        ]  # fmt: skip

    return derivative


def rk4_step(
    derivative: Derivative,
    state: State,
    first: State,
    dt_s: float,
    wrench: Wrench,
    water: Water,
    force: ForceNed | None,
) -> State:
    """One classical Runge-Kutta step with the wrench held; the quaternion is renormalised.

    ``first`` is the derivative at the start, where ``water`` was taken: the caller has it already.
    """
    half = 0.5 * dt_s
    k2 = derivative([s + half * k for s, k in zip(state, first, strict=True)], half, wrench, water, force)
    k3 = derivative([s + half * k for s, k in zip(state, k2, strict=True)], half, wrench, water, force)
    k4 = derivative([s + dt_s * k for s, k in zip(state, k3, strict=True)], dt_s, wrench, water, force)
    sixth = dt_s / 6.0
    new = [s + sixth * (a + 2.0 * (b + c) + d) for s, a, b, c, d in zip(state, first, k2, k3, k4, strict=True)]
    w, x, y, z = new[3:7]
    scale = (w * w + x * x + y * y + z * z) ** -0.5
    new[3:7] = [w * scale, x * scale, y * scale, z * scale]
    return new
