"""The vehicle model as a measurement: acceleration by thrust and drag against the accelerometer.

This makes the current observable: drag depends on the velocity relative to the water, and the velocity over ground is
known from vision. With M = m + M_A (rigid body and added mass) and a current that changes at the rate c' along the
vehicle's path, the surge and sway equations are (Fossen 2011, ch. 6 and 8, neutral body)

    M dnu_r/dt = f(nu_r, thrust) - m R' c'   so that   R' a_ground = a_model(nu_r, thrust) + (M_A / M) R' c' .

Thrust, drag and added mass are turned by the AHRS's roll and pitch: a BlueROV2 ahead with 10 N is 20 degrees nose up or
down. If the vertical current is a state (``EstimatorOptions.current_3d``) the heave equation is added; its buoyancy is
taken as known.

Straight on, drag and current are not told apart, and the filter must not believe that they are. Its Jacobian is taken
about the mean velocity through the water (:class:`MeanFlow`), not about the estimate: that goes to and fro with the
current's own uncertainty, the direction in which nothing is known would turn with it, and as each step of the estimate
is paid back by the next innovations, drag would slide down by 0.05 a minute, with a variance that denies it
(inconsistency of the EKF: Huang, Mourikis and Roumeliotis 2010). What is further off the mean than noise is a
manoeuvre, by which drag, thrust and current are told apart.
"""

import ctypes
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from autopilot.core.compiled import Mirror, library
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.model4 import ABS_SMOOTHING_M2_S2, Model4
from autopilot.core.to_and_fro import ToAndFro
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.aiding import REJECT_COUNT, InertialAid
from autopilot.estimator.estimator_tuning import MEAN_FLOW, SWELL
from autopilot.estimator.history import Node
from autopilot.estimator.inertial import Inertial
from autopilot.estimator.measurement import Measurement, Moment
from autopilot.estimator.options import EstimatorOptions
from autopilot.estimator.states import (
    ACCEL_BIAS,
    BIAS_AHEAD,
    BIAS_DOWN,
    BIAS_RIGHT,
    CURRENT,
    CURRENT_DOWN,
    CURRENT_EAST,
    CURRENT_NORTH,
    CURRENT_RATE,
    DRAG_EXCESS,
    GYRO_BIAS,
    NX,
    THRUST_EXCESS,
    VEL,
    VEL_EAST,
    VEL_NORTH,
    YAW,
)

MODEL_EVERY_S = 0.02
"""Updates by the vehicle model: 50 Hz."""
IDLE_THRUST_N = 0.3
IDLE_SPEED_M_S = 0.03
"""Below both the vehicle may be moored, held or aground: the model is not used."""

SIGMA_M_S2 = 0.06
"""Error of the modelled acceleration: tether, drag and thrust coefficients. For 50 updates per second that share it."""

LET_GO_WITHIN_US = 3_000_000
"""A hand or a rope lets the vehicle go within that after thrusters begin to drive it."""

LEAST_EXCESS, MOST_EXCESS = -0.8, 4.0
"""Of drag and thrust, as the model uses them: drag below -1 would drive the vehicle, and a blind step run away."""


class MeanFlow:
    """Velocity through the water in the mean, at one look. What is computed again when a late fix comes is computed
    again in order, so the mean of the look before is the one of that."""

    def __init__(self, before: "MeanFlow | None", node: Node) -> None:
        self.t_us: int = node.t_us
        dt_s = 0.0 if before is None else min((node.t_us - before.t_us) * 1e-6, MEAN_FLOW.longest_s)
        self._age_s: float = 0.0 if before is None else before._age_s + dt_s
        self._share = dt_s / MEAN_FLOW.mean_s
        self._before = _through_water(node.state.x) if before is None else before.mean_ned_m_s
        self.mean_ned_m_s: FloatArray = np.zeros(2)
        """(2,) changed in place."""

    def about_ned_m_s(self, x: FloatArray) -> FloatArray:
        """(2,) velocity through the water about which the model is linear, with the estimate ``x`` (21,) of this look:
        the mean, or the estimate where that is further off than noise, and at first."""
        now = _through_water(x)
        self.mean_ned_m_s[:] = self._before + self._share * (now - self._before)
        if self._age_s < MEAN_FLOW.mean_s:
            return now
        off = now - self.mean_ned_m_s
        square = float(off @ off)
        return self.mean_ned_m_s + square / (square + MEAN_FLOW.noise_m_s**2) * off


def _through_water(x: FloatArray) -> FloatArray:
    """(2,) north and east."""
    result: FloatArray = x[VEL_NORTH : VEL_EAST + 1] - x[CURRENT]
    return result


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModelAcceleration(Measurement):
    """z = (2,) or (3,) acceleration of the AHRS in the level frame, forward, right (and down) [m/s^2]."""

    vehicle: "VehicleAcceleration"
    flow: MeanFlow | None = None
    """About which it is linear; None: about the estimate."""

    def predicted(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """Acceleration of the model plus the bias of the AHRS."""
        ahead, right, down, _ = self.vehicle.at(x, moment)
        if len(self.z) == 2:
            return np.array((ahead + x.item(BIAS_AHEAD), right + x.item(BIAS_RIGHT)))
        return np.array((ahead + x.item(BIAS_AHEAD), right + x.item(BIAS_RIGHT), down + x.item(BIAS_DOWN)))

    def jacobian(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        if self.flow is not None:
            about_m_s = self.flow.about_ned_m_s(x)
            x = x.copy()
            x[CURRENT] = x[VEL_NORTH : VEL_EAST + 1] - about_m_s
        return self.vehicle.jacobian(x, moment)[: len(self.z)].copy()


_INPUTS = struct.Struct("13d")
_THRUSTERS = 8


class _ModelStruct(Mirror):
    """ctypes layout of the struct in estimator.c."""

    _fields_ = (
        ("x", ctypes.c_double * NX),
        ("tilt", ctypes.c_double * 2),
        ("rate", ctypes.c_double * 3),
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
            ahead, right, down, turn = expected_acceleration(self._model, self._follow, x, moment).tolist()
            self._acceleration = ahead, right, down, turn
            self._jacobian = None
            return
        self._work[:NX] = x
        now = moment.inertial
        _INPUTS.pack_into(
            self._buffer,
            _ModelStruct.tilt.offset,
            now.roll_rad,
            now.pitch_rad,
            *now.rate_frd_rad_s.tolist(),
            *moment.thrust_n,
            *self._none,
        )
        self._compiled(self._address)
        ahead, right, down, turn = self._work[_ACCELERATION_AT:_JACOBIAN_AT].tolist()
        self._acceleration = ahead, right, down, turn
        self._jacobian = self._compiled_jacobian


_STEP = 1e-30
"""Of the derivative by a complex step: no difference is taken, so nothing cancels (Squire and Trapp 1998)."""


def acceleration_jacobian(model: Model4, follow: tuple[float, float], x: FloatArray, moment: Moment) -> FloatArray:
    """(3, 21) Jacobian of the AHRS's measurement, :func:`expected_acceleration` plus its offset."""
    jac = np.zeros((3, NX))
    for state in range(YAW, NX):
        stepped = x.astype(complex)
        stepped[state] += 1j * _STEP
        jac[:, state] = expected_acceleration(model, follow, stepped, moment)[:3].imag / _STEP
    jac[:, ACCEL_BIAS] = np.eye(3)
    return jac


def expected_acceleration(model: Model4, follow: tuple[float, float], x: Any, moment: Moment) -> Any:
    """(4,) acceleration over ground forward, right, down in the level frame [m/s^2], of the yaw rate [rad/s^2].

    ``x`` (21,) may be complex, and then the result is."""
    now, mass, one = moment.inertial, np.array(model.mass_kg[:3]), np.array((1.0, 1.0, 0.0))
    c, s = np.cos(x[YAW]), np.sin(x[YAW])
    level_from_ned = np.array(((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)))
    level_from_frd = r_ned_from_frd(np.array((now.roll_rad, now.pitch_rad, 0.0)))
    water = np.array((x[CURRENT_NORTH], x[CURRENT_EAST], x[CURRENT_DOWN]))
    nu = level_from_frd.T @ level_from_ned @ (x[VEL] - water)
    rate = now.rate_frd_rad_s - np.array((0.0, 0.0, x[GYRO_BIAS]))
    moving = np.append(nu, rate[2])
    push = np.array(model.allocation) @ moment.thrust_n
    drag = (model.linear_drag + model.quadratic_drag * np.sqrt(moving**2 + ABS_SMOOTHING_M2_S2)) * moving
    stronger, excess = _share(x[THRUST_EXCESS]), _share(x[DRAG_EXCESS])
    force = (1.0 + one * stronger) * push[:3] - (1.0 + one * excess) * drag[:3]
    force = force - model.buoyancy_excess_n * level_from_frd[2] - np.cross(rate, mass * nu)
    accel = level_from_frd @ (force / mass + np.cross(rate, nu))
    change = level_from_ned[:2, :2] @ x[CURRENT_RATE]
    m11, m22, _, m44 = model.mass_kg
    turn = (push[3] - drag[3] + (m11 - m22) * nu[0] * nu[1]) / m44
    return np.array((accel[0] + follow[0] * change[0], accel[1] + follow[1] * change[1], accel[2], turn))


def idle(moment: Moment, x: FloatArray) -> bool:
    if max(map(abs, moment.thrust_n)) > IDLE_THRUST_N:
        return False
    return math.hypot(x.item(VEL_NORTH), x.item(VEL_EAST)) < IDLE_SPEED_M_S


def _share(excess: Any) -> Any:
    """As the model uses a share of drag or thrust; at its ends the derivative stays, so that it can come back."""
    within = min(max(excess.real, LEAST_EXCESS), MOST_EXCESS)
    return within + 1j * excess.imag if np.iscomplexobj(excess) else within


_NOISE: FloatArray = np.eye(3) * SIGMA_M_S2**2
_NOISE.flags.writeable = False
_PLANAR_NOISE: FloatArray = _NOISE[:2, :2]


def model_aid_of(
    inertial: Inertial,
    vehicle: VehicleAcceleration,
    flow: MeanFlow | None = None,
    *,
    vertical: bool = False,
    noise_factor: float = 1.0,
) -> ModelAcceleration:
    """The measurement that one AHRS sample makes with the model, in the plane or with the ``vertical`` as well."""
    accel, noise = (inertial.accel_level_m_s2, _NOISE) if vertical else (inertial.accel_level_m_s2[:2], _PLANAR_NOISE)
    if noise_factor != 1.0:
        noise = noise_factor * noise
    z = np.array(accel)
    return ModelAcceleration(sensor="model", t_us=inertial.t_us, z=z, noise=noise, vehicle=vehicle, flow=flow)


def planar_mass_ratios(vehicle: Vehicle) -> tuple[float, float]:
    """Share of a change of current that the vehicle follows at once, surge and sway: added mass over whole mass."""
    m11, m22 = vehicle.model4.mass_kg[:2]
    mass = min(vehicle.model4.dry_mass_kg, m11, m22)
    return 1.0 - mass / m11, 1.0 - mass / m22


class Swell:
    """Unmodelled acceleration that goes to and fro, as by waves: unlike a current that begins, it says nothing of the
    mean flow, of drag or of thrust. A vehicle that turns in a stream which is not known yet, or with a tether, feels
    what goes to and fro along its own axes, or north and south: waves do both."""

    def __init__(self, vehicle: VehicleAcceleration) -> None:
        self._vehicle = vehicle
        self._t_us: int | None = None
        self._mean: FloatArray = np.zeros(NX)
        """(21,) states as they are in the mean: waves are not to explain themselves."""
        self._ahead, self._north = ToAndFro(), ToAndFro()
        self.variance = 0.0
        """By which the model's acceleration is less certain, as of one of 50 independent looks a second [m^2/s^4]."""

    def meet(self, node: Node, accel_level_m_s2: Sequence[float]) -> None:
        """``accel_level_m_s2`` (2,) or (3,): what was measured at ``node``."""
        x = node.state.x.copy()
        if self._t_us is None:
            self._t_us, self._mean = node.t_us, x
        dt_s = min(max(node.t_us - self._t_us, 0) * 1e-6, SWELL.longest_s)
        self._t_us = node.t_us
        self._mean = self._mean + dt_s / SWELL.mean_s * (x - self._mean)
        x[BIAS_AHEAD:] = self._mean[BIAS_AHEAD:]
        x[DRAG_EXCESS] = x[THRUST_EXCESS] = 0.0
        residual = np.array(accel_level_m_s2[:2]) - self._vehicle.at(x, node.moment)[:2] - x[ACCEL_BIAS][:2]
        square = self._ahead.update(dt_s / SWELL.follow_s, residual)
        c, s = math.cos(x.item(YAW)), math.sin(x.item(YAW))
        ahead, right = residual.tolist()
        north = self._north.update(dt_s / SWELL.follow_s, np.array((c * ahead - s * right, s * ahead + c * right)))
        square = min(square, north)
        self.variance = SWELL.shared_looks * max(0.0, square - SWELL.usual_m_s2**2)


class ModelAid(InertialAid):
    """The vehicle model: samples of the accelerometer are held against it."""

    sensor = "model"
    every_s = MODEL_EVERY_S

    def __init__(self, vehicle: Vehicle, options: EstimatorOptions) -> None:
        super().__init__()
        self.vehicle = VehicleAcceleration(vehicle.to_model(), planar_mass_ratios(vehicle))
        self._options = options
        self._swell = Swell(VehicleAcceleration(vehicle.to_model(), planar_mass_ratios(vehicle)))
        self._flow: MeanFlow | None = None
        self._undriven = self._carried = False
        self._begun_us = -LET_GO_WITHIN_US
        """When thrusters began to drive it."""

    def is_informative(self, moment: Moment, x: FloatArray) -> bool:
        """Whether the vehicle is driven, and may move."""
        return self._options.model_aid and not idle(moment, x)

    def let_go(self, moment: Moment, *, informs: bool) -> bool:
        """Whether what the model took for water was a hand or a rope: thrusters begin to drive a vehicle that moved
        without them, or the model is denied soon after that."""
        if max(map(abs, moment.thrust_n)) <= 1e-3 * IDLE_THRUST_N:
            self._undriven, self._carried = True, self._carried or informs
            return False
        if self._undriven:
            carried, self._undriven, self._carried = self._carried, False, False
            self._begun_us = moment.inertial.t_us
            return carried
        denied = self.rejected_in_row >= REJECT_COUNT and moment.inertial.t_us - self._begun_us < LET_GO_WITHIN_US
        if denied:
            self.reset(moment.inertial.t_us)
        return denied

    def measured(self, sample: Inertial) -> ModelAcceleration:
        factor = 1.0 + self._swell.variance / SIGMA_M_S2**2
        vertical = self._options.current_3d
        return model_aid_of(sample, self.vehicle, self._flow, vertical=vertical, noise_factor=factor)

    def feel(self, node: Node, raw: Inertial) -> None:
        """Look for swell, and for the mean flow, in a sample that belongs to ``node``."""
        self._swell.meet(node, raw.accel_level_m_s2)
        self._flow = MeanFlow(self._flow, node)
