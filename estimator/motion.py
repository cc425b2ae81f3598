"""State propagation over one step, shared by both estimators, with its Jacobian."""

import ctypes
import math
import struct

import numpy as np

from autopilot.core.compiled import Mirror, library
from autopilot.core.frames import FloatArray
from autopilot.estimator.inertial import InertialStep
from autopilot.estimator.states import (
    ACCEL_BIAS,
    BIAS_AHEAD,
    BIAS_DOWN,
    BIAS_RIGHT,
    CURRENT_EAST,
    CURRENT_NORTH,
    CURRENT_RATE_EAST,
    CURRENT_RATE_NORTH,
    DOWN,
    EAST,
    GYRO_BIAS,
    NORTH,
    NX,
    POS,
    VEL,
    VEL_DOWN,
    VEL_EAST,
    VEL_NORTH,
    YAW,
)
from autopilot.estimator.tuning import CURRENT_RATE_TIME_S

_ENTRIES = (
    (NORTH, VEL_NORTH), (NORTH, YAW), (NORTH, BIAS_AHEAD), (NORTH, BIAS_RIGHT),
    (EAST, VEL_EAST), (EAST, YAW), (EAST, BIAS_AHEAD), (EAST, BIAS_RIGHT),
    (DOWN, VEL_DOWN), (DOWN, BIAS_DOWN),
    (YAW, GYRO_BIAS),
    (VEL_NORTH, YAW), (VEL_NORTH, BIAS_AHEAD), (VEL_NORTH, BIAS_RIGHT),
    (VEL_EAST, YAW), (VEL_EAST, BIAS_AHEAD), (VEL_EAST, BIAS_RIGHT),
    (VEL_DOWN, BIAS_DOWN),
    (CURRENT_NORTH, CURRENT_RATE_NORTH), (CURRENT_EAST, CURRENT_RATE_EAST),
    (CURRENT_RATE_NORTH, CURRENT_RATE_NORTH), (CURRENT_RATE_EAST, CURRENT_RATE_EAST),
)  # fmt: skip
_PLACES = np.array([NX * row + column for row, column in _ENTRIES])
"""Where the Jacobian differs from the identity: one call that fills them all is four times faster than one by one."""


class _Motion(Mirror):
    """ctypes layout of the struct in estimator.c."""

    _fields_ = (
        ("x", ctypes.c_double * NX),
        ("dt_s", ctypes.c_double),
        ("yaw_rate", ctypes.c_double),
        ("accel", ctypes.c_double * 3),
        ("fade_s", ctypes.c_double),
        ("moved", ctypes.c_double * NX),
        ("jacobian", ctypes.c_double * (NX * NX)),
    )


_INPUTS = struct.Struct("6d")
_MOVED_AT, _JACOBIAN_AT = _Motion.moved.offset // 8, _Motion.jacobian.offset // 8
"""In doubles."""


class MotionModel:
    """:func:`moved` and :func:`fill_jacobian` in one call, compiled where there is the library."""

    def __init__(self) -> None:
        self._work = np.zeros(_JACOBIAN_AT + NX * NX)
        self.jacobian = self._work[_JACOBIAN_AT:].reshape(NX, NX)
        """(21, 21) of the last step; the same array every time."""
        self._x, self._moved = self._work[:NX], self._work[_MOVED_AT:_JACOBIAN_AT]
        self._driven = False
        reset_model(self.jacobian)
        compiled = library(_Motion)
        self._compiled = None if compiled is None else compiled.motion_step
        self._address, self._buffer = self._work.ctypes.data, self._work.data

    def step(self, x: FloatArray, step: InertialStep) -> FloatArray:
        """State (21,) after the step, a new array; :attr:`jacobian` holds its derivative by ``x``."""
        if self._driven:
            reset_model(self.jacobian)
            self._driven = False
        if self._compiled is None:
            fill_jacobian(self.jacobian, x, step)
            after = np.array(moved(x, step))
        else:
            self._x[:] = x
            dt_s, rate, accel, mode, *_ = step
            _INPUTS.pack_into(self._buffer, _Motion.dt_s.offset, dt_s, rate, *accel, CURRENT_RATE_TIME_S[mode])
            self._compiled(self._address)
            after = self._moved.copy()
        if step.slope is not None:
            add_model(self.jacobian, x, step, step.slope)
            self._driven = True
        return after


def moved(x: FloatArray, step: InertialStep) -> list[float]:
    """State (21) after the step: the accelerometer moves the velocity, the gyro the heading."""
    n, e, d, yaw, vn, ve, vd, bg, bx, by, bz, cn, ce, gn, ge, off, laser, drag, cd, depth, thrust = x.tolist()
    dt = step.dt_s
    ax, ay, az = step.accel_level_m_s2
    c, s = math.cos(yaw), math.sin(yaw)
    fx, fy = ax - bx, ay - by
    an, ae, ad = c * fx - s * fy, s * fx + c * fy, az - bz
    half = 0.5 * dt * dt
    fade = math.exp(-dt / CURRENT_RATE_TIME_S[step.mode])
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
        cd,
        depth,
        thrust,
    ]


def fill_jacobian(jac: FloatArray, x: FloatArray, step: InertialStep) -> None:
    """Write d moved / dx into ``jac`` (21, 21), which must be the identity or a matrix filled by this function."""
    dt = step.dt_s
    yaw = x.item(YAW)
    c, s = math.cos(yaw), math.sin(yaw)
    ax, ay, _ = step.accel_level_m_s2
    fx, fy = ax - x.item(BIAS_AHEAD), ay - x.item(BIAS_RIGHT)
    an, ae = c * fx - s * fy, s * fx + c * fy
    half = 0.5 * dt * dt
    cdt, sdt, chalf, shalf = c * dt, s * dt, c * half, s * half
    fade = math.exp(-dt / CURRENT_RATE_TIME_S[step.mode])
    jac.put(_PLACES, (
        dt, -half * ae, -chalf, shalf,
        dt, half * an, -shalf, -chalf,
        dt, -half,
        -dt,
        -dt * ae, -cdt, sdt,
        dt * an, -sdt, -cdt,
        -dt,
        dt, dt, fade, fade,
    ))  # fmt: skip


def add_model(jac: FloatArray, x: FloatArray, step: InertialStep, slope: FloatArray) -> None:
    """Turn a Jacobian of :func:`fill_jacobian` into that of a step that the vehicle model drives.

    ``slope`` (3, 21) is d acceleration / d state in the level frame. The offset of the accelerometer plays no part.
    Call :func:`reset_model` before the matrix is filled for another step."""
    yaw, dt = x.item(YAW), step.dt_s
    c, s = math.cos(yaw), math.sin(yaw)
    jac[: VEL.stop, ACCEL_BIAS] = 0.0
    turned = np.vstack((c * slope[0] - s * slope[1], s * slope[0] + c * slope[1], slope[2]))
    jac[VEL] += dt * turned
    jac[POS] += 0.5 * dt * dt * turned


def reset_model(jac: FloatArray) -> None:
    """Undo :func:`add_model`: the identity again."""
    jac[:] = 0.0
    jac.flat[:: NX + 1] = 1.0
