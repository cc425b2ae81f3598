"""How much of its thrust each thruster still gives: a Kalman filter on what the 4-DoF model leaves unexplained.

With e the effectiveness of the thrusters (1 = as the vehicle file says), the model reads, per axis (Fossen 2011, eq.
6.113 with the thrust split by thruster),

    nu' = M^-1 T_A diag(F) e + f(nu) + d ,

F the thrust that the pulses would give, lag included, f drag, Coriolis and buoyancy, d whatever else pushes. Both sides
pass the same first-order filter of time constant T, so that nothing is differentiated: the filtered nu' is
(nu - filtered nu) / T. The filter's states are e (nearly constant) and d (forgets itself within seconds): a
steady force may be a current, a tether or a lost thruster, and only what follows the thrust is charged to the thruster.

A loss is declared when e stays below a share of what the other thrusters seem to have (errors of mass, drag and thrust
constant concern all of them), and revoked with hysteresis. Told values (THR1_HEALTH to THR4_HEALTH) hold at once; what
is told and what is found are combined by the smaller.
"""

import math
import statistics
from collections import deque
from dataclasses import dataclass

import numpy as np

from autopilot.control.unexplained import push_sigma, thrustless_motion
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.model4 import NU, Model4, steady_force
from autopilot.core.params import ParamSet

HEALTH_PARAMS = ("THR1_HEALTH", "THR2_HEALTH", "THR3_HEALTH", "THR4_HEALTH")
"""What an operator or a speed controller's telemetry tells, in the order of the vehicle file."""

LATERAL = 3
"""Index of the lateral thruster."""

HEADINGS = 72
"""Headings tried for a hover; a multiple of four, so that abeam is exactly among them."""

SHORT_N = 0.3
"""So much may lack: short pushes of the others make up for it."""

DEAD = 0.2
"""Below this a thruster is not used at all: five times the pulse for what little it gives, and that uncertain."""


UNLEARNED_LOOKS = 10
"""So many looks (1 s) are taken back when the estimate ceases to be good."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuning:
    """What the filter believes; axes surge, sway, heave [m/s^2] and yaw [rad/s^2]."""

    filter_s: float = 0.5
    """T: slow enough to quieten gyro and velocity, quick against a manoeuvre."""
    interval_s: float = 0.1
    """Between two looks."""
    noise: tuple[float, float, float, float] = (0.035, 0.035, 0.035, 0.1)
    """Standard deviation of one look: estimate and model, looks T apart being independent."""
    push: tuple[float, float, float, float] = (0.06, 0.05, 0.06, 0.1)
    """Standard deviation of d at rest: 1 N of tether, a moment of 0.03 N m."""
    flow_m_s: float = 0.1
    """Standard deviation of the water's velocity: it makes d grow by what drag and Munk moment make of it."""
    push_time_s: float = 4.0
    """Time within which d forgets itself."""
    current_s: float = 20.0
    """The estimated current is believed this slowly: it moves to explain what a lost thruster no longer does."""
    arm: float = 0.1
    """Standard deviation of what the lateral thruster turns [rad/s^2 per N]: its arm of some cm is not in T_A."""
    prior: float = 0.15
    """Standard deviation of e before anything is known: errors of thrust constant and mass."""
    wander: float = 0.03
    """Of e per square root of a second, so that a loss late in a mission is found as well."""
    known: float = 0.14
    """A thruster whose e is known that well serves as a measure for the others."""
    scale: tuple[float, float] = (0.6, 1.4)
    """What errors of mass (20 %), drag (30 %) and thrust constant (10 %) make of sound thrusters."""
    lost_below: float = 0.75
    """A thruster with less than this share of what the others have is lossy."""
    sound_above: float = 0.85
    doubt: float = 1.0
    """Standard deviations that count as doubt."""
    confirm_s: float = 1.5
    """A loss must be beyond doubt for so long."""
    follow: float = 0.05
    """A declared value changes when the estimate is further away than this: bounds do not flutter."""


class ThrusterHealth:
    """Estimate of the effectiveness of four thrusters. :meth:`step` at every tick, deterministic."""

    def __init__(self, model: Model4, lag_s: float, tuning: Tuning | None = None) -> None:
        self._model = model
        self._lag_s = lag_s
        self._tuning = tuning or Tuning()
        self._effect = np.array(model.allocation) / np.array(model.mass_kg)[:, None]
        self._t_us: int | None = None
        self._looked_us = 0
        self._reset_count = -1
        self._moving_s = 0.0
        self._acting: FloatArray = np.zeros(NU)
        self._thrust: FloatArray = np.zeros(NU)
        self._nu: FloatArray = np.zeros(4)
        self._drift: FloatArray = np.zeros(4)
        self.reset()

    def reset(self) -> None:
        """All thrusters are sound, nothing is known."""
        tuning = self._tuning
        self._x = np.concatenate([np.ones(NU), np.zeros(5)])
        self._p = np.diag([tuning.prior**2] * NU + [s * s for s in tuning.push] + [tuning.arm**2])
        self._current: FloatArray | None = None
        self._known: deque[tuple[FloatArray, FloatArray, FloatArray, FloatArray, tuple[bool, ...]]] = deque(
            maxlen=UNLEARNED_LOOKS
        )
        self._below_s = np.zeros(NU)
        self.found = np.ones(NU)
        """(4,) effectiveness as declared: 1 while a thruster is not beyond doubt lossy."""
        self.lost: tuple[bool, ...] = (False,) * NU
        self._forget_motion()

    @property
    def effectiveness(self) -> FloatArray:
        """(4,) the running estimate."""
        return self._x[:NU].copy()

    @property
    def sigma(self) -> FloatArray:
        """(4,) its standard deviation."""
        sigma: FloatArray = np.sqrt(np.diag(self._p)[:NU])
        return sigma

    def pause(self) -> None:
        """Disarmed, or without an estimate: what was learned stays, the motion is forgotten."""
        self._forget_motion()

    def step(self, t_us: int, nav: NavState, thrust_n: FloatArray) -> bool:
        """``thrust_n`` (4,) is what sound thrusters would settle at with the pulses since the last call [N].

        True when the declared effectiveness has changed.
        """
        if nav.health is not NavHealth.GOOD or nav.reset_count != self._reset_count:
            self._unlearn()
            self._forget_motion()
            self._reset_count = nav.reset_count
            return False
        if self._current is None:
            self._current = nav.current_ned_m_s.copy()
        nu, drift = thrustless_motion(self._model, nav, self._current)
        if self._t_us is None:
            self._t_us = self._looked_us = t_us
            self._acting[:] = self._thrust[:] = thrust_n
            self._nu, self._drift = nu, drift
            return False
        dt_s = (t_us - self._t_us) * 1e-6
        self._t_us = t_us
        share = 1.0 - math.exp(-dt_s / self._tuning.filter_s)
        slow = dt_s / self._tuning.current_s
        self._current += slow * (nav.current_ned_m_s - self._current)
        self._acting += (1.0 - math.exp(-dt_s / self._lag_s)) * (thrust_n - self._acting)
        self._thrust += share * (self._acting - self._thrust)
        self._drift += share * (drift - self._drift)
        self._nu += share * (nu - self._nu)
        self._moving_s += dt_s
        look_s = (t_us - self._looked_us) * 1e-6
        if look_s < self._tuning.interval_s - 1e-9 or self._moving_s < 4.0 * self._tuning.filter_s:
            return False
        self._looked_us = t_us
        self._known.append((self._x.copy(), self._p.copy(), self._below_s, self.found.copy(), self.lost))
        self._look(
            min(look_s, 1.0),
            push_sigma(self._model, nav, self._tuning.push, self._tuning.flow_m_s),
            (nu - self._nu) / self._tuning.filter_s - self._drift,
        )
        return self._declare(min(look_s, 1.0))

    def _unlearn(self) -> None:
        """Back to what was known before the last looks: an estimate is bad for a moment before it is called bad."""
        if self._known:
            self._x, self._p, self._below_s, self.found, self.lost = self._known[0]

    def _forget_motion(self) -> None:
        self._known.clear()
        self._t_us = None
        self._looked_us = 0
        self._reset_count = -1
        self._moving_s = 0.0
        self._acting, self._thrust = np.zeros(NU), np.zeros(NU)
        self._nu, self._drift = np.zeros(4), np.zeros(4)

    def _look(self, dt_s: float, push: FloatArray, residual: FloatArray) -> None:
        """Predict and update: ``residual`` (4,) is the filtered acceleration that thrust and d have to explain."""
        tuning, x, p = self._tuning, self._x, self._p
        keep = math.exp(-dt_s / tuning.push_time_s)
        fade = np.concatenate([np.ones(NU), np.full(4, keep), np.ones(1)])
        x *= fade
        p *= fade[:, None] * fade[None, :]
        p[np.diag_indices(9)] += np.concatenate(
            [np.full(NU, tuning.wander**2 * dt_s), (1.0 - keep * keep) * np.square(push), np.zeros(1)]
        )
        h = np.zeros((4, 9))
        h[:, :NU], h[:, NU : NU + 4] = self._effect * self._thrust, np.eye(4)
        h[3, 8] = self._thrust[LATERAL]
        # Looks closer together than T share their noise: each counts for its part.
        noise = np.diag(np.square(tuning.noise)) * (2.0 * tuning.filter_s / dt_s)
        gain = np.linalg.solve(h @ p @ h.T + noise, h @ p).T
        x += gain @ (residual - h @ x)
        x[:NU] = np.clip(x[:NU], 0.0, 1.5)
        rest = np.eye(9) - gain @ h
        self._p = rest @ p @ rest.T + gain @ noise @ gain.T

    def _scale(self, thruster: int) -> float:
        """What the other thrusters, as far as they are known and sound, seem to have: an error of the model."""
        tuning, sigma = self._tuning, self.sigma
        others = [
            float(self._x[i]) for i in range(NU) if i != thruster and sigma[i] < tuning.known and not self.lost[i]
        ]
        if not others:
            return 1.0
        return min(max(statistics.median(others), tuning.scale[0]), tuning.scale[1])

    def _declare(self, dt_s: float) -> bool:
        tuning = self._tuning
        scale = np.array([self._scale(i) for i in range(NU)])
        e, doubt = self._x[:NU] / scale, tuning.doubt * self.sigma / scale
        self._below_s = np.where(e + doubt < tuning.lost_below, self._below_s + dt_s, 0.0)
        lost = tuple(
            (was and float(e[i] - doubt[i]) <= tuning.sound_above) or bool(self._below_s[i] >= tuning.confirm_s - 1e-9)
            for i, was in enumerate(self.lost)
        )
        before = self.found.copy()
        for i in range(NU):
            if not lost[i]:
                self.found[i] = 1.0
            elif not self.lost[i] or abs(e[i] - self.found[i]) > tuning.follow:
                self.found[i] = min(float(e[i]), 1.0)
        self.lost = lost
        return bool((before != self.found).any())


def told(params: ParamSet) -> FloatArray:
    """(4,) what the parameters say of the thrusters."""
    return np.array([params[name] for name in HEALTH_PARAMS])


def usable(effectiveness: FloatArray) -> FloatArray:
    """(4,) the same with thrusters that are as good as dead set to 0."""
    return np.where(effectiveness < DEAD, 0.0, effectiveness)


def hover_problem(model: Model4, limit_n: FloatArray, current_ned_m_s: FloatArray, yaw_rad: float | None = None) -> str:
    """What a vehicle whose thrusters give up to ``limit_n`` (4,) cannot do any more in that current, "" if it can stay.

    Depth needs heave against the excess buoyancy, heading needs any thruster with an arm, and a place needs a heading
    (``yaw_rad``, None = any) at which the thrusters balance drag and Munk moment.
    """
    allocation = np.array(model.allocation)
    reach = np.abs(allocation) @ limit_n
    if reach[2] <= 1.5 * abs(model.buoyancy_excess_n):
        return "depth cannot be held"
    if reach[3] <= 0.0:
        return "heading cannot be held"
    inverse = np.linalg.inv(allocation)
    speed, course = math.hypot(*current_ned_m_s[:2]), math.atan2(current_ned_m_s[1], current_ned_m_s[0])
    any_heading = np.linspace(0.0, 2.0 * math.pi, HEADINGS, endpoint=False)
    for drift in any_heading if yaw_rad is None else (course - yaw_rad,):
        # Over ground the vehicle stands, so relative to the water it moves against the current.
        nu = (-speed * math.cos(drift), -speed * math.sin(drift), 0.0, 0.0)
        needed = np.abs(inverse @ np.array(steady_force(model, nu, math)))
        if bool((needed <= limit_n + SHORT_N).all()):
            return ""
    return f"hover in {speed:.2f} m/s {'is not possible' if yaw_rad is None else 'at this heading is not possible'}"
