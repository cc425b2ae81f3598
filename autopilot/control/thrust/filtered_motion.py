"""Filtered equations of motion, ten times per second: the regressors for thruster faults and model errors.

Each term of the 4-DoF model and each of its possible errors passes the same first-order filter of time constant T,
which avoids differentiation: the filtered acceleration is (nu - filtered nu) / T. An update holds the filtered
acceleration that the model without thrust does not explain, the filtered thrust, and the filtered derivatives of the
model with respect to its uncertain parameters: drag, Coriolis and Munk terms, the current.
"""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.control.thrust.thrust_tuning import WAVES
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState
from autopilot.core.model4 import Model4
from autopilot.core.response import Response
from autopilot.core.to_and_fro import ToAndFro


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FilteredMotion:
    """Filtered accelerations, axes surge, sway, heave [m/s^2] and yaw [rad/s^2]."""

    dt_s: float
    """Time since the last update."""
    residual: FloatArray
    """(4,) residual of the model without thrust."""
    thrust_n: FloatArray
    """(n,) of sound thrusters, lag included."""
    thrust_rate_n_s: FloatArray
    """(n,) its rate of change."""
    drag: FloatArray
    """(4,) acceleration by drag."""
    coriolis: FloatArray
    """(3,) Coriolis terms of added mass (surge, sway) and Munk moment (yaw)."""
    flow: FloatArray
    """(4, 2) derivative with respect to the water's velocity north and east [1/s, 1/(m s)]."""
    north: FloatArray
    """(2,) cosine and sine of the heading."""
    moved_ned_m_s: FloatArray
    """(2,) change of the model's current since the last update."""
    tilt: FloatArray
    """(2, 3) roll and pitch: their acceleration [rad/s^2], the sine of the angle and its rate [rad/s]."""
    swing: FloatArray
    """(4,) change of the velocity by roll and pitch, absent in the 4-DoF model."""
    waves_m_s2: float
    """Horizontal acceleration of the water to and fro, root mean square."""


class Waves:
    """Acceleration of the water to and fro, from the estimated current."""

    def __init__(self) -> None:
        self._mean_m_s: FloatArray | None = None
        self._over_s = 0.0
        self._accel = ToAndFro()
        self.rms_m_s2 = 0.0

    def update(self, dt_s: float, current_ned_m_s: FloatArray) -> None:
        now_m_s = current_ned_m_s[:2]
        behind_m_s = now_m_s - (now_m_s if self._mean_m_s is None else self._mean_m_s)
        self._mean_m_s = now_m_s - math.exp(-dt_s / WAVES.rate_s) * behind_m_s
        self._over_s = min(self._over_s + dt_s, WAVES.mean_s)
        self.rms_m_s2 = math.sqrt(self._accel.update(dt_s / self._over_s, behind_m_s / WAVES.rate_s))


class MotionFilter:
    """Updates from estimates and thrust. :meth:`step` at every tick."""

    def __init__(
        self, model: Model4, response: Response, *, filter_s: float, interval_s: float, current_s: float
    ) -> None:
        """``current_s``: the estimated current is followed within this time."""
        self._model = model
        self._response = response
        self._filter_s = filter_s
        self._interval_s = interval_s
        self._current_s = current_s
        m11, m22, _, m44 = model.mass_kg
        self._ratios = m22 / m11, m11 / m22, (m11 - m22) / m44
        self.forget()
        self._current = (0.0, 0.0)
        self._known = False
        self._waves = Waves()

    def forget(self) -> None:
        """Reset the filters of the motion; the current is kept."""
        self._t_us: int | None = None
        self._acting = [0.0] * self._model.thrusters
        self._filtered: FloatArray = np.zeros(0)
        self._since_s = self._moving_s = 0.0
        self._moved = (0.0, 0.0)

    def step(self, t_us: int, nav: NavState, thrust_n: FloatArray) -> FilteredMotion | None:
        """``thrust_n`` (n,): steady thrust of healthy thrusters for the pulses since the last call [N]."""
        if not self._known:
            self._current = (float(nav.current_ned_m_s[0]), float(nav.current_ned_m_s[1]))
            self._known = True
        if self._t_us is None:
            self._t_us = t_us
            self._acting = thrust_n.tolist()
            self._filtered = self._terms(nav)
            return None
        dt_s = (t_us - self._t_us) * 1e-6
        self._t_us = t_us
        self._follow_current(nav, dt_s)
        self._acting = self._response.after(dt_s, self._acting, thrust_n.tolist())
        terms = self._terms(nav)
        self._filtered = self._filtered + (1.0 - math.exp(-dt_s / self._filter_s)) * (terms - self._filtered)
        self._since_s += dt_s
        self._moving_s += dt_s
        if self._since_s < self._interval_s - 1e-9 or self._moving_s < 4.0 * self._filter_s:
            return None
        self._waves.update(self._since_s, nav.current_ned_m_s)
        return self._motion_of(terms)

    def _follow_current(self, nav: NavState, dt_s: float) -> None:
        fraction = 1.0 - math.exp(-dt_s / self._current_s)
        north, east = self._current
        dn, de = fraction * (nav.current_ned_m_s.item(0) - north), fraction * (nav.current_ned_m_s.item(1) - east)
        self._current = (north + dn, east + de)
        self._moved = (self._moved[0] + dn, self._moved[1] + de)

    def _terms(self, nav: NavState) -> FloatArray:
        """(27 + n,) everything that is filtered."""
        model, (m22_m11, m11_m22, munk) = self._model, self._ratios
        ground_u, ground_v, ground_w = nav.vel_frd_m_s.tolist()
        roll, pitch, heading = nav.rpy_rad.tolist()
        roll_rate, pitch_rate, r = nav.rate_frd_rad_s.tolist()
        c, s = math.cos(heading), math.sin(heading)
        north, east = self._current
        flow_u, flow_v = c * north + s * east, c * east - s * north
        u, v = ground_u - flow_u, ground_v - flow_v
        drag, slope = [], []
        for axis, speed in enumerate((u, v, ground_w, r)):
            linear, quadratic, mass = model.linear_drag[axis], model.quadratic_drag[axis], model.mass_kg[axis]
            drag.append(-(linear + quadratic * abs(speed)) * speed / mass)
            slope.append((linear + 2.0 * quadratic * abs(speed)) / mass)
        turn_u, turn_v, turn_r = m22_m11 * v * r, -m11_m22 * u * r, munk * u * v
        # By the water's velocity forward and to starboard: more of it is less speed through it.
        surge = slope[0], (1.0 - m22_m11) * r
        sway = (m11_m22 - 1.0) * r, slope[1]
        yaw = -munk * v, -munk * u
        return np.array(
            [
                *(ground_u, ground_v, ground_w, r),
                # A steady current turns in the body frame.
                drag[0] + turn_u + r * flow_v,
                drag[1] + turn_v - r * flow_u,
                drag[2] - model.buoyancy_excess_n / model.mass_kg[2],
                drag[3] + turn_r,
                *drag,
                *(turn_u, turn_v, turn_r),
                *(c * surge[0] - s * surge[1], s * surge[0] + c * surge[1]),
                *(c * sway[0] - s * sway[1], s * sway[0] + c * sway[1]),
                *(c * yaw[0] - s * yaw[1], s * yaw[0] + c * yaw[1]),
                *(c, s),
                *(math.sin(roll), roll_rate, math.sin(pitch), pitch_rate),
                *self._acting,
            ]
        )

    def _motion_of(self, terms: FloatArray) -> FilteredMotion:
        past, rate = self._filtered, (terms - self._filtered) / self._filter_s
        u, v, w = past[:3].tolist()
        p, q = past.item(24), past.item(26)
        flow = np.zeros((4, 2))
        flow[[0, 1, 3]] = past[15:21].reshape(3, 2)
        motion = FilteredMotion(
            dt_s=min(self._since_s, 1.0),
            residual=rate[0:4] - past[4:8],
            thrust_n=past[27:],
            thrust_rate_n_s=rate[27:],
            drag=past[8:12],
            coriolis=past[12:15],
            flow=flow,
            north=past[21:23],
            moved_ned_m_s=np.array(self._moved),
            tilt=np.array([[rate[24], *past[23:25]], [rate[26], *past[25:27]]]),
            swing=np.array([q * w, p * w, math.hypot(p * v, q * u), 0.0]),
            waves_m_s2=self._waves.rms_m_s2,
        )
        self._since_s, self._moved = 0.0, (0.0, 0.0)
        return motion
