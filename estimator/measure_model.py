"""The vehicle model as a measurement: acceleration by thrust and drag against the accelerometer.

This makes the current observable: drag depends on the velocity relative to the water, and the velocity over ground is
known from vision. With M = m + M_A (rigid body and added mass) and a current that changes at the rate c' along the
vehicle's path, the surge and sway equations are (Fossen 2011, ch. 6 and 8, neutral body)

    M dnu_r/dt = f(nu_r, thrust) - m R' c'   so that   R' a_ground = a_model(nu_r, thrust) + (M_A / M) R' c' .

Roll and pitch are neglected: the level frame stands for the body's planar axes. If the vertical current is a state
(``EstimatorOptions.current_3d``) the heave equation is added; its buoyancy is taken as known.
"""

import ctypes
import math
import operator
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from autopilot.core.compiled import Mirror, library
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import ABS_SMOOTHING_M2_S2, Model4, body_acceleration
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.aiding import ScalarAid
from autopilot.estimator.inertial import Inertial
from autopilot.estimator.measurement import Measurement, Moment
from autopilot.estimator.options import EstimatorOptions
from autopilot.estimator.states import (
    ACCEL_BIAS,
    BIAS_AHEAD,
    BIAS_DOWN,
    BIAS_RIGHT,
    CURRENT_DOWN,
    CURRENT_EAST,
    CURRENT_NORTH,
    CURRENT_RATE_EAST,
    CURRENT_RATE_NORTH,
    DRAG_EXCESS,
    GYRO_BIAS,
    NX,
    THRUST_EXCESS,
    VEL_DOWN,
    VEL_EAST,
    VEL_NORTH,
    YAW,
)

MODEL_EVERY = 2
"""AHRS samples per update by the vehicle model: 50 Hz."""
IDLE_THRUST_N = 0.3
IDLE_SPEED_M_S = 0.03
"""Below both the vehicle may be moored, held or aground: the model is not used."""

SIGMA_M_S2 = 0.06
"""Error of the modelled acceleration: tether, drag and thrust coefficients. For 50 updates per second that share it."""

LEAST_EXCESS, MOST_EXCESS = -0.8, 4.0
"""Of drag and thrust, as the model uses them: drag below -1 would drive the vehicle, and a blind step run away."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModelAcceleration(Measurement):
    """z = (2,) or (3,) acceleration of the AHRS in the level frame, forward, right (and down) [m/s^2]."""

    vehicle: "VehicleAcceleration"

    def predicted(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """Acceleration of the model plus the bias of the AHRS."""
        ahead, right, down, _ = self.vehicle.at(x, moment)
        if len(self.z) == 2:
            return np.array((ahead + x.item(BIAS_AHEAD), right + x.item(BIAS_RIGHT)))
        return np.array((ahead + x.item(BIAS_AHEAD), right + x.item(BIAS_RIGHT), down + x.item(BIAS_DOWN)))

    def jacobian(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        return self.vehicle.jacobian(x, moment)[: len(self.z)].copy()


_INPUTS = struct.Struct("9d")
_THRUSTERS = 8


class _ModelStruct(Mirror):
    """ctypes layout of the struct in estimator.c."""

    _fields_ = (
        ("x", ctypes.c_double * NX),
        ("yaw_rate", ctypes.c_double),
        ("thrust", ctypes.c_double * _THRUSTERS),
        *((name, ctypes.c_double * 4) for name in ("mass", "linear", "quadratic")),
        ("buoyancy_excess", ctypes.c_double),
        ("follow", ctypes.c_double * 2),
        ("smoothing", ctypes.c_double),
        ("allocation", ctypes.c_double * (4 * _THRUSTERS)),
        ("acceleration", ctypes.c_double * 4),
        ("jacobian", ctypes.c_double * (3 * NX)),
    )


_VEHICLE_AT, _ACCELERATION_AT = _ModelStruct.mass.offset // 8, _ModelStruct.acceleration.offset // 8
_JACOBIAN_AT = _ModelStruct.jacobian.offset // 8
"""In doubles."""


class VehicleAcceleration:
    """:func:`expected_acceleration` of one vehicle and its Jacobian, compiled where the library is available.

    The last result is cached by the identity of its arguments: states and moments are never changed in place.
    """

    def __init__(self, model: Model4, follow: tuple[float, float]) -> None:
        """``follow``: :func:`planar_mass_ratios` of the vehicle."""
        self._model, self._follow = model, follow
        self._work = np.zeros(_JACOBIAN_AT + 3 * NX)
        self._address, self._buffer = self._work.ctypes.data, self._work.data
        self._compiled_jacobian = self._work[_JACOBIAN_AT:].reshape(3, NX)
        self._jacobian: FloatArray | None = None
        self._acceleration = (0.0, 0.0, 0.0, 0.0)
        self._evaluated: tuple[FloatArray | None, Moment | None] = (None, None)
        fits = model.thrusters <= _THRUSTERS
        compiled = library(_ModelStruct) if fits else None
        self._compiled = None if compiled is None else compiled.model_look
        allocation = np.zeros((4, _THRUSTERS))
        if fits:
            allocation[:, : model.thrusters] = model.allocation
        constants = (*model.mass_kg, *model.linear_drag, *model.quadratic_drag, model.buoyancy_excess_n, *follow)
        self._work[_VEHICLE_AT:_ACCELERATION_AT] = [*constants, ABS_SMOOTHING_M2_S2, *allocation.flat]
        self._none = (0.0,) * (_THRUSTERS - model.thrusters)

    def at(self, x: FloatArray, moment: Moment) -> tuple[float, float, float, float]:
        self._evaluate(x, moment)
        return self._acceleration

    def jacobian(self, x: FloatArray, moment: Moment) -> FloatArray:
        self._evaluate(x, moment)
        if self._jacobian is None:
            self._jacobian = acceleration_jacobian(self._model, self._follow, x, moment)
        return self._jacobian

    def slope(self, x: FloatArray, moment: Moment) -> FloatArray:
        """The Jacobian without the accelerometer's offset; a new array."""
        slope = self.jacobian(x, moment).copy()
        slope[:, ACCEL_BIAS] = 0.0
        return slope

    def _evaluate(self, x: FloatArray, moment: Moment) -> None:
        if x is self._evaluated[0] and moment is self._evaluated[1]:
            return
        self._evaluated = x, moment
        if self._compiled is None:
            self._acceleration = expected_acceleration(self._model, self._follow, x, moment)
            self._jacobian = None
            return
        self._work[:NX] = x
        _INPUTS.pack_into(
            self._buffer, _ModelStruct.yaw_rate.offset, moment.inertial.yaw_rate_rad_s, *moment.thrust_n, *self._none
        )
        self._compiled(self._address)
        ahead, right, down, turn = self._work[_ACCELERATION_AT:_JACOBIAN_AT].tolist()
        self._acceleration = ahead, right, down, turn
        self._jacobian = self._compiled_jacobian


def acceleration_jacobian(model: Model4, follow: tuple[float, float], x: FloatArray, moment: Moment) -> FloatArray:
    """(3, 21) Jacobian of the AHRS's measurement, :func:`expected_acceleration` plus its offset."""
    u, v, r, c, s = _relative(x, moment)
    m11, m22 = model.mass_kg[:2]
    lin, quad = model.linear_drag, model.quadratic_drag
    more = 1.0 + _share(x.item(DRAG_EXCESS))
    fu, fv = -more * (lin[0] + quad[0] * _slope(u)) / m11, -more * (lin[1] + quad[1] * _slope(v)) / m22
    cross_v, cross_u = (m22 / m11 - 1.0) * r, (1.0 - m11 / m22) * r
    jac = np.zeros((3, NX))
    # Through u_r = c rn + s re and v_r = c re - s rn, with d u_r/d yaw = v_r and d v_r/d yaw = -u_r.
    jac[0, VEL_NORTH] = fu * c - cross_v * s
    jac[0, VEL_EAST] = fu * s + cross_v * c
    jac[1, VEL_NORTH] = cross_u * c - fv * s
    jac[1, VEL_EAST] = cross_u * s + fv * c
    jac[:2, CURRENT_NORTH] = -jac[:2, VEL_NORTH]
    jac[:2, CURRENT_EAST] = -jac[:2, VEL_EAST]
    k0, k1 = follow
    gn, ge = float(x[CURRENT_RATE_NORTH]), float(x[CURRENT_RATE_EAST])
    jac[0, YAW] = fu * v - cross_v * u + k0 * (c * ge - s * gn)
    jac[1, YAW] = cross_u * v - fv * u - k1 * (c * gn + s * ge)
    jac[0, GYRO_BIAS] = -(m22 / m11 - 1.0) * v
    jac[1, GYRO_BIAS] = -(1.0 - m11 / m22) * u
    jac[0, BIAS_AHEAD] = jac[1, BIAS_RIGHT] = 1.0
    drag_u, drag_v = _drag(model, u, v)
    jac[0, DRAG_EXCESS], jac[1, DRAG_EXCESS] = -drag_u, -drag_v
    jac[0, THRUST_EXCESS], jac[1, THRUST_EXCESS] = _push(model, moment.thrust_n)
    jac[0, CURRENT_RATE_NORTH], jac[0, CURRENT_RATE_EAST] = k0 * c, k0 * s
    jac[1, CURRENT_RATE_NORTH], jac[1, CURRENT_RATE_EAST] = -k1 * s, k1 * c
    heave = x.item(VEL_DOWN) - x.item(CURRENT_DOWN)
    jac[2, VEL_DOWN] = -(lin[2] + quad[2] * _slope(heave)) / model.mass_kg[2]
    jac[2, CURRENT_DOWN] = -jac[2, VEL_DOWN]
    jac[2, BIAS_DOWN] = 1.0
    return jac


def expected_acceleration(
    model: Model4, follow: tuple[float, float], x: FloatArray, moment: Moment
) -> tuple[float, float, float, float]:
    """Acceleration over ground forward, right, down in the level frame [m/s^2], and of the yaw rate [rad/s^2]."""
    u, v, r, c, s = _relative(x, moment)
    du, dv, dw, dr = body_acceleration(model, (u, v, x.item(VEL_DOWN) - x.item(CURRENT_DOWN), r), moment.thrust_n, math)
    gn, ge = x.item(CURRENT_RATE_NORTH), x.item(CURRENT_RATE_EAST)
    excess, more = _share(x.item(DRAG_EXCESS)), _share(x.item(THRUST_EXCESS))
    drag_u, drag_v = _drag(model, u, v)
    push_u, push_v = _push(model, moment.thrust_n)
    return (
        du - r * v - excess * drag_u + more * push_u + follow[0] * (c * gn + s * ge),
        dv + r * u - excess * drag_v + more * push_v + follow[1] * (c * ge - s * gn),
        dw,
        dr,
    )


def idle(moment: Moment, x: FloatArray) -> bool:
    if max(map(abs, moment.thrust_n)) > IDLE_THRUST_N:
        return False
    return math.hypot(x.item(VEL_NORTH), x.item(VEL_EAST)) < IDLE_SPEED_M_S


def _share(excess: float) -> float:
    """As the model uses a share of drag or thrust."""
    return min(max(excess, LEAST_EXCESS), MOST_EXCESS)


def _drag(model: Model4, u: float, v: float) -> tuple[float, float]:
    """Deceleration by the model's drag in surge and sway [m/s^2]."""
    lin, quad = model.linear_drag, model.quadratic_drag
    return (
        (lin[0] + quad[0] * math.sqrt(u * u + ABS_SMOOTHING_M2_S2)) * u / model.mass_kg[0],
        (lin[1] + quad[1] * math.sqrt(v * v + ABS_SMOOTHING_M2_S2)) * v / model.mass_kg[1],
    )


def _push(model: Model4, thrust_n: Sequence[float]) -> tuple[float, float]:
    """Acceleration by the model's thrust in surge and sway [m/s^2]."""
    surge, sway = model.allocation[:2]
    return (
        sum(map(operator.mul, surge, thrust_n)) / model.mass_kg[0],
        sum(map(operator.mul, sway, thrust_n)) / model.mass_kg[1],
    )


_NOISE: FloatArray = np.eye(3) * SIGMA_M_S2**2
_NOISE.flags.writeable = False
_PLANAR_NOISE: FloatArray = _NOISE[:2, :2]


def model_aid_of(inertial: Inertial, vehicle: VehicleAcceleration, *, vertical: bool = False) -> ModelAcceleration:
    """The measurement that one AHRS sample makes with the model, in the plane or with the ``vertical`` as well."""
    accel, noise = (inertial.accel_level_m_s2, _NOISE) if vertical else (inertial.accel_level_m_s2[:2], _PLANAR_NOISE)
    return ModelAcceleration(sensor="model", t_us=inertial.t_us, z=np.array(accel), noise=noise, vehicle=vehicle)


def planar_mass_ratios(vehicle: Vehicle) -> tuple[float, float]:
    """Share of a change of current that the vehicle follows at once, surge and sway: added mass over whole mass."""
    m11, m22 = vehicle.model4.mass_kg[:2]
    mass = min(vehicle.model4.dry_mass_kg, m11, m22)
    return 1.0 - mass / m11, 1.0 - mass / m22


def _relative(x: FloatArray, moment: Moment) -> tuple[float, float, float, float, float]:
    """u_r, v_r [m/s], yaw rate [rad/s], cos and sin of the heading."""
    yaw = float(x[YAW])
    c, s = math.cos(yaw), math.sin(yaw)
    rn, re = float(x[VEL_NORTH] - x[CURRENT_NORTH]), float(x[VEL_EAST] - x[CURRENT_EAST])
    return c * rn + s * re, c * re - s * rn, moment.inertial.yaw_rate_rad_s - float(x[GYRO_BIAS]), c, s


def _slope(a: float) -> float:
    """d(|a| a)/da with the model's smoothing."""
    a2 = a * a
    return (2.0 * a2 + ABS_SMOOTHING_M2_S2) / math.sqrt(a2 + ABS_SMOOTHING_M2_S2)


class ModelAid(ScalarAid[Inertial]):
    """The vehicle model: every so many samples of the accelerometer are held against it."""

    sensor = "model"

    def __init__(self, vehicle: Vehicle, options: EstimatorOptions) -> None:
        super().__init__()
        self.vehicle = VehicleAcceleration(vehicle.to_model(), planar_mass_ratios(vehicle))
        self._options = options

    def due(self, count: int) -> bool:
        """Whether the AHRS's sample of that number is held against the model."""
        return count % MODEL_EVERY == 0

    def is_informative(self, moment: Moment, x: FloatArray) -> bool:
        """Whether the vehicle is driven, and may move."""
        return self._options.model_aid and not idle(moment, x)

    def measured(self, sample: Inertial) -> ModelAcceleration:
        return model_aid_of(sample, self.vehicle, vertical=self._options.current_3d)
