"""How the state moves in one step, shared by both estimators, with its Jacobian."""

import math

import numpy as np

from autopilot.core.frames import FloatArray
from estimator.inertial import Step
from estimator.states import NX
from estimator.tuning import CURRENT_RATE_TIME_S


def moved(x: FloatArray, step: Step) -> list[float]:
    """State (18) after the step: the accelerometer moves the velocity, the gyro the heading."""
    n, e, d, yaw, vn, ve, vd, bg, bx, by, bz, cn, ce, gn, ge, off, laser, drag = x.tolist()
    dt = step.dt_s
    ax, ay, az = step.accel_level_m_s2
    c, s = math.cos(yaw), math.sin(yaw)
    fx, fy = ax - bx, ay - by
    an, ae, ad = c * fx - s * fy, s * fx + c * fy, az - bz
    half = 0.5 * dt * dt
    fade = math.exp(-dt / CURRENT_RATE_TIME_S)
    return [
        n + vn * dt + half * an,
        e + ve * dt + half * ae,
        d + vd * dt + half * ad,
        yaw + (step.yaw_rate_rad_s - bg) * dt,
        vn + an * dt,
        ve + ae * dt,
        vd + ad * dt,
        bg,
        bx,
        by,
        bz,
        cn + gn * dt,
        ce + ge * dt,
        fade * gn,
        fade * ge,
        off,
        laser,
        drag,
    ]


def fill_jacobian(jac: FloatArray, x: FloatArray, step: Step) -> None:
    """Write d moved / dx into ``jac`` (18, 18), which must be the identity or a matrix filled by this function."""
    dt = step.dt_s
    yaw = float(x[3])
    c, s = math.cos(yaw), math.sin(yaw)
    fx, fy = step.accel_level_m_s2[0] - float(x[8]), step.accel_level_m_s2[1] - float(x[9])
    an, ae = c * fx - s * fy, s * fx + c * fy
    half = 0.5 * dt * dt
    cdt, sdt, chalf, shalf = c * dt, s * dt, c * half, s * half
    jac[0, 4] = jac[1, 5] = jac[2, 6] = jac[11, 13] = jac[12, 14] = dt
    jac[3, 7] = jac[6, 10] = -dt
    jac[0, 3], jac[1, 3] = -half * ae, half * an
    jac[4, 3], jac[5, 3] = -dt * ae, dt * an
    jac[4, 8] = jac[5, 9] = -cdt
    jac[4, 9], jac[5, 8] = sdt, -sdt
    jac[0, 8] = jac[1, 9] = -chalf
    jac[0, 9], jac[1, 8] = shalf, -shalf
    jac[2, 10] = -half
    jac[13, 13] = jac[14, 14] = math.exp(-dt / CURRENT_RATE_TIME_S)


def new_jacobian() -> FloatArray:
    """An identity for :func:`fill_jacobian`."""
    return np.eye(NX)
