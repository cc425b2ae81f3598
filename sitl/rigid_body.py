"""Equations of motion of the hull in 6 degrees of freedom (Fossen 2011, ch. 6 to 8), in plain floats for speed.

    M_RB v' + C_RB(v) v + M_A v_r' + C_A(v_r) v_r + D(v_r) v_r + g(eta) = tau

Body frame FRD at the centre of gravity, diagonal added mass. State, 13 floats: position NED, quaternion w x y z (body
to world), velocity over ground FRD, angular rate FRD.

The current c(x, t) is taken at the centre of gravity and does not turn with the hull: v_r = v - R^T c, and the drag on
rotation sees the absolute rate. Where the current varies, v_r' holds the change of c along the path of the *hull*,
dc/dt + (v . grad) c. On top comes the Froude-Krylov force, displaced mass times the acceleration of the *water*,
dc/dt + (c . grad) c: the pressure gradient that turns the water turns the hull as well. With it a neutral hull at
v_r = 0 drifts along a streamline exactly; without it (``froude_krylov=False``) it would be thrown out of every vortex.

In a mismatch the mass is that of hull and trapped water, so the displaced mass is mass * buoyancy / weight.
"""

from collections.abc import Callable, Sequence
from typing import TypeAlias

from autopilot.core.vehicle import Body, Vec3
from sitl.currents import CurrentField, Gradient

State: TypeAlias = list[float]
Wrench: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]
"""Force FRD [N], moment FRD [N m], further force NED [N]."""
Flow: TypeAlias = tuple[Gradient, Vec3]
"""Gradient of the current [1/s] and its rate at a fixed place [m/s^2], held within a step."""
ForceNed: TypeAlias = Callable[[Vec3, Vec3, Vec3], Vec3]
"""Force NED [N] (tether, contact) from position, velocity over ground and velocity relative to the water, all NED."""
Derivative: TypeAlias = Callable[[Sequence[float], float, Wrench, Flow | None, ForceNed | None], State]


def make_derivative(  # one function on purpose: it runs 800 times per simulated second
    body: Body, field: CurrentField, *, hull_half_height_m: float, froude_krylov: bool = True
) -> Derivative:
    """The time derivative of the state as a function of state, time [s], wrench, flow (None = uniform) and force."""
    m, (ax, ay, az) = body.mass_kg, body.added_mass_kg
    (ix, iy, iz), (jx, jy, jz) = body.inertia_kg_m2, body.added_inertia_kg_m2
    (lu, lv, lw), (qu, qv, qw_) = body.linear_drag_n_s_m, body.quadratic_drag_n_s2_m2
    (lp, lq, lr), (qp, qq, qr) = body.angular_linear_drag_n_m_s, body.angular_quadratic_drag_n_m_s2
    weight, (bx, by, bz) = body.weight_n, body.center_of_buoyancy_frd_m
    buoyancy = weight + body.buoyancy_excess_n
    displaced = m * buoyancy / weight if froude_krylov else 0.0
    velocity = field.velocity

    def derivative(
        state: Sequence[float], t_s: float, wrench: Wrench, flow: Flow | None, force: ForceNed | None
    ) -> State:
        x, y, z, ew, ex, ey, ez, u, v, w, p, q, r = state
        fx, fy, fz, kx, ky, kz, fn, fe, fd = wrench

        r11, r12, r13 = 1.0 - 2.0 * (ey * ey + ez * ez), 2.0 * (ex * ey - ez * ew), 2.0 * (ex * ez + ey * ew)
        r21, r22, r23 = 2.0 * (ex * ey + ez * ew), 1.0 - 2.0 * (ex * ex + ez * ez), 2.0 * (ey * ez - ex * ew)
        r31, r32, r33 = 2.0 * (ex * ez - ey * ew), 2.0 * (ey * ez + ex * ew), 1.0 - 2.0 * (ex * ex + ey * ey)
        vn = r11 * u + r12 * v + r13 * w
        ve = r21 * u + r22 * v + r23 * w
        vd = r31 * u + r32 * v + r33 * w

        # Water velocity in the body frame, and forces from its acceleration.
        place = (x, y, z)
        cn, ce, cd = velocity(place, t_s)
        cu = r11 * cn + r21 * ce + r31 * cd
        cv = r12 * cn + r22 * ce + r32 * cd
        cw = r13 * cn + r23 * ce + r33 * cd
        ur, vr, wr = u - cu, v - cv, w - cw
        if flow is not None:
            (nn, ne, nd, en, ee, ed, dn, de, dd), (tn, te, td) = flow
            hn = nn * vn + ne * ve + nd * vd + tn  # change along the path of the hull
            he = en * vn + ee * ve + ed * vd + te
            hd = dn * vn + de * ve + dd * vd + td
            wn = nn * cn + ne * ce + nd * cd + tn  # acceleration of the water itself
            we = en * cn + ee * ce + ed * cd + te
            wd = dn * cn + de * ce + dd * cd + td
            fx += ax * (r11 * hn + r21 * he + r31 * hd) + displaced * (r11 * wn + r21 * we + r31 * wd)
            fy += ay * (r12 * hn + r22 * he + r32 * hd) + displaced * (r12 * wn + r22 * we + r32 * wd)
            fz += az * (r13 * hn + r23 * he + r33 * hd) + displaced * (r13 * wn + r23 * we + r33 * wd)

        # Weight, buoyancy of the part that is under water, tether and contact: forces given in NED.
        emerged = hull_half_height_m - z
        wet = 1.0 if emerged <= 0.0 else max(0.0, 1.0 - emerged / (2.0 * hull_half_height_m))
        lift = buoyancy * wet
        fd += weight - lift
        if force is not None:
            kn, ke, kd = force(place, (vn, ve, vd), (vn - cn, ve - ce, vd - cd))
            fn, fe, fd = fn + kn, fe + ke, fd + kd
        fx += r11 * fn + r21 * fe + r31 * fd
        fy += r12 * fn + r22 * fe + r32 * fd
        fz += r13 * fn + r23 * fe + r33 * fd

        # Momentum of the water that moves along, Coriolis terms, drag.
        mu, mv, mw = ax * ur, ay * vr, az * wr
        fx -= m * (q * w - r * v) + (q * mw - r * mv) + ax * (q * cw - r * cv) + (lu + qu * abs(ur)) * ur
        fy -= m * (r * u - p * w) + (r * mu - p * mw) + ay * (r * cu - p * cw) + (lv + qv * abs(vr)) * vr
        fz -= m * (p * v - q * u) + (p * mv - q * mu) + az * (p * cv - q * cu) + (lw + qw_ * abs(wr)) * wr
        hp, hq, hr = (ix + jx) * p, (iy + jy) * q, (iz + jz) * r
        kx -= (q * hr - r * hq) + (vr * mw - wr * mv) + (lp + qp * abs(p)) * p + lift * (by * r33 - bz * r32)
        ky -= (r * hp - p * hr) + (wr * mu - ur * mw) + (lq + qq * abs(q)) * q + lift * (bz * r31 - bx * r33)
        kz -= (p * hq - q * hp) + (ur * mv - vr * mu) + (lr + qr * abs(r)) * r + lift * (bx * r32 - by * r31)

        return [
            vn, ve, vd,
            -0.5 * (ex * p + ey * q + ez * r),
            0.5 * (ew * p + ey * r - ez * q),
            0.5 * (ew * q + ez * p - ex * r),
            0.5 * (ew * r + ex * q - ey * p),
            fx / (m + ax), fy / (m + ay), fz / (m + az),
            kx / (ix + jx), ky / (iy + jy), kz / (iz + jz),
        ]  # fmt: skip

    return derivative


def rk4_step(
    derivative: Derivative,
    state: State,
    t_s: float,
    dt_s: float,
    wrench: Wrench,
    flow: Flow | None,
    force: ForceNed | None,
) -> State:
    """One classical Runge-Kutta step with wrench and flow held; the quaternion is renormalised."""
    half = 0.5 * dt_s
    k1 = derivative(state, t_s, wrench, flow, force)
    k2 = derivative([s + half * k for s, k in zip(state, k1, strict=True)], t_s + half, wrench, flow, force)
    k3 = derivative([s + half * k for s, k in zip(state, k2, strict=True)], t_s + half, wrench, flow, force)
    k4 = derivative([s + dt_s * k for s, k in zip(state, k3, strict=True)], t_s + dt_s, wrench, flow, force)
    sixth = dt_s / 6.0
    new = [s + sixth * (a + 2.0 * (b + c) + d) for s, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)]
    w, x, y, z = new[3:7]
    scale = (w * w + x * x + y * y + z * z) ** -0.5
    new[3:7] = [w * scale, x * scale, y * scale, z * scale]
    return new
