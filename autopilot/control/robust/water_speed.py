"""How far the true speed through the water may exceed the estimated one.

An error of thrust over drag makes the estimated speed through the water and the estimated current wrong, and no sensor
shows either. With the same error at every speed they can be told apart while the current stays the same: the thrust
that holds the vehicle and the thrust that moves it have to agree on one current. A bank of extended Kalman filters with
the states

    u, v    velocity through the water, body frame [m/s]
    cN, cE  current [m/s]
    kappa   logarithm of the factor on the drag that thrust and file leave open [1]

follows the surge and sway equations of the vehicle model from the thrust that acts, and is corrected by the velocity
over ground of the navigation estimate. The filters differ in how much the current changes per root metre of way and how
large unmodelled accelerations are; each has the weight of its likelihood (multiple-model estimation, Bar-Shalom et al.
2001, ch. 11). Only where filters of uniform water explain the motion the result is used: in a current that changes
along the way an error of the drag and a change of the current look alike. Filters that have failed begin anew.
"""

import math

import numpy as np

from autopilot.control.robust.robust_tuning import WATER_SPEED
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.model4 import ABS_SMOOTHING_M2_S2, Model4

_STATES = 5
_WATER, _CURRENT, KAPPA = slice(0, 2), slice(2, 4), 4


class WaterSpeed:
    """One per vehicle. :meth:`push` with every thrust, :meth:`update` once per control step; deterministic."""

    def __init__(self, model: Model4) -> None:
        tuning = WATER_SPEED
        self._rows = np.array(model.allocation)[:2]
        self._mass, self._linear, self._square = (
            np.array(each[:2]) for each in (model.mass_kg, model.linear_drag, model.quadratic_drag)
        )
        self._cross = float(self._mass[1] / self._mass[0]), float(self._mass[0] / self._mass[1])
        water, noise = np.array(tuning.models).T
        self._current_walk, self._noise = np.square(water), np.square(noise)
        self._uniform = water <= tuning.uniform_per_root_m
        self._mild = water <= tuning.mild_per_root_m
        self._identity = np.tile(np.eye(_STATES), (len(water), 1, 1))
        self.reset()

    def reset(self) -> None:
        """Nothing is known: after disarming, a jump of the estimate, a loss of fixes, or a change of the thrusters."""
        self._log_weight = np.zeros(len(self._noise))
        self._forget()

    def _forget(self) -> None:
        """Filters begin anew; what is known of the water stays."""
        self._t_us: int | None = None
        self._reset_count = -1
        self._x = np.zeros((len(self._noise), _STATES))
        self._p = np.zeros((len(self._noise), _STATES, _STATES))
        self._impulse, self._pushed_s = np.zeros(2), 0.0
        self._age_s = self._since_s = 0.0
        self._ratios: tuple[float, float] | None = None
        self.excess, self.excess_sigma = 0.0, WATER_SPEED.excess_sigma
        """kappa and its standard deviation."""
        self.likely: float | None = None
        self.bound: float | None = None
        """True over estimated speed through the water: with one standard deviation, and at most. None = not known."""

    def push(self, acting_n: FloatArray, elapsed_s: float) -> None:
        """Thrust (n,) that acts ``elapsed_s`` after the last call."""
        self._impulse += elapsed_s * (self._rows @ acting_n)
        self._pushed_s += elapsed_s

    def update(self, nav: NavState) -> None:
        tuning = WATER_SPEED
        impulse, pushed_s = self._impulse, self._pushed_s
        yaw = float(nav.rpy_rad[2])
        c, s = math.cos(yaw), math.sin(yaw)
        surge, sway, _ = nav.vel_frd_m_s.tolist()
        ground = np.array((c * surge - s * sway, s * surge + c * sway))
        estimated_m_s = math.hypot(*nav.vel_water_frd_m_s[:2].tolist())
        turn = float(nav.rate_frd_rad_s[2])
        finite = math.isfinite(surge + sway + yaw + turn + estimated_m_s + float(impulse.sum()))
        if nav.health is not NavHealth.GOOD or not finite:
            self.reset()
            return
        elapsed_s = 0.0 if self._t_us is None else (nav.t_us - self._t_us) * 1e-6
        if self._t_us is None or nav.reset_count != self._reset_count or not 0.0 <= elapsed_s <= tuning.longest_s:
            if self._t_us is not None:
                self.reset()
            if impulse.any():
                self._begin(nav.t_us, nav.reset_count, ground, c, s)
            self._impulse, self._pushed_s = np.zeros(2), 0.0
            return
        if elapsed_s < tuning.step_s or pushed_s <= 0.0:
            return
        self._t_us, self._impulse, self._pushed_s = nav.t_us, np.zeros(2), 0.0
        self._predict(elapsed_s, impulse / pushed_s, turn, math.hypot(*ground.tolist()))
        self._age_s += elapsed_s
        self._since_s += elapsed_s
        if self._since_s >= tuning.every_s:
            self._correct(ground, c, s)
            self._since_s = 0.0
        self._judge(ground, estimated_m_s, elapsed_s)

    def _begin(self, t_us: int, reset_count: int, ground: FloatArray, c: float, s: float) -> None:
        """The current is not known, and the velocity through the water is wrong by just that."""
        tuning = WATER_SPEED
        self._t_us, self._reset_count = t_us, reset_count
        body = np.array(((c, s), (-s, c)))
        spread = np.zeros((_STATES, 2))
        spread[_WATER], spread[_CURRENT] = -tuning.current_sigma_m_s * body, tuning.current_sigma_m_s * np.eye(2)
        p = spread @ spread.T
        p[0, 0] += tuning.velocity_sigma_m_s**2
        p[1, 1] += tuning.velocity_sigma_m_s**2
        p[KAPPA, KAPPA] = tuning.excess_sigma**2
        self._x[:] = 0.0
        self._x[:, _WATER] = body @ ground
        self._p[:] = p

    def _predict(self, dt_s: float, force_n: FloatArray, turn_rad_s: float, ground_m_s: float) -> None:
        tuning, x = WATER_SPEED, self._x
        water, factor = x[:, _WATER], np.exp(x[:, KAPPA, None])
        smooth = np.sqrt(water * water + ABS_SMOOTHING_M2_S2)
        drag = factor * (self._linear + self._square * smooth) * water / self._mass
        slope = np.minimum(factor * (self._linear + 2.0 * self._square * smooth) / self._mass, 1.0 / dt_s)
        surge, sway = self._cross[0] * turn_rad_s, -self._cross[1] * turn_rad_s
        change = force_n / self._mass - drag
        change[:, 0] += surge * water[:, 1]
        change[:, 1] += sway * water[:, 0]
        f = self._identity.copy()
        f[:, 0, 0] -= dt_s * slope[:, 0]
        f[:, 1, 1] -= dt_s * slope[:, 1]
        f[:, 0, 1] += dt_s * surge
        f[:, 1, 0] += dt_s * sway
        f[:, _WATER, KAPPA] = -dt_s * drag
        x[:, _WATER] += dt_s * change
        p = f @ self._p @ f.transpose(0, 2, 1)
        unmodelled = dt_s * (self._noise[:, None] + np.square(tuning.inertia_error * change) * tuning.inertia_s)
        p[:, 0, 0] += unmodelled[:, 0]
        p[:, 1, 1] += unmodelled[:, 1]
        walk = dt_s * (ground_m_s + tuning.at_rest_m_s) * self._current_walk
        p[:, 2, 2] += walk
        p[:, 3, 3] += walk
        p[:, KAPPA, KAPPA] += dt_s * tuning.excess_walk**2
        self._p = p

    def _correct(self, ground: FloatArray, c: float, s: float) -> None:
        tuning = WATER_SPEED
        h = np.array(((c, -s, 1.0, 0.0, 0.0), (s, c, 0.0, 1.0, 0.0)))
        ph = self._p @ h.T
        innovation = h @ ph
        innovation[:, 0, 0] += tuning.velocity_sigma_m_s**2
        innovation[:, 1, 1] += tuning.velocity_sigma_m_s**2
        a, b, d = innovation[:, 0, 0], innovation[:, 0, 1], innovation[:, 1, 1]
        determinant = a * d - b * b
        inverse = np.empty_like(innovation)
        inverse[:, 0, 0], inverse[:, 1, 1] = d / determinant, a / determinant
        inverse[:, 0, 1] = inverse[:, 1, 0] = -b / determinant
        error = ground - self._x @ h.T
        gain = ph @ inverse
        self._x += np.einsum("nij,nj->ni", gain, error)
        p = self._p - gain @ ph.transpose(0, 2, 1)
        self._p = 0.5 * (p + p.transpose(0, 2, 1))
        square = np.minimum(np.einsum("ni,nij,nj->n", error, inverse, error), tuning.largest_square)
        fade = math.exp(-self._since_s / tuning.forget_s)
        log_weight = fade * self._log_weight - 0.5 * tuning.evidence_fraction * (square + np.log(determinant))
        self._log_weight = np.maximum(log_weight - log_weight.max(), -tuning.largest_odds)

    def _judge(self, ground: FloatArray, estimated_m_s: float, elapsed_s: float) -> None:
        """Ratio of the speeds if the water is uniform, else the filters begin anew."""
        tuning = WATER_SPEED
        weight = np.exp(self._log_weight)
        weight /= weight.sum()
        uniform, mild = float(weight[self._uniform].sum()), float(weight[self._mild].sum())
        if uniform < tuning.refuted and self._age_s > tuning.least_age_s:
            self._forget()
            return
        used = np.where(self._mild, weight, 0.0) / max(mild, 1e-12)
        x, p = self._x, self._p
        self.excess = float(used @ x[:, KAPPA])
        self.excess_sigma = math.sqrt(float(used @ (p[:, KAPPA, KAPPA] + np.square(x[:, KAPPA] - self.excess))))
        current = used @ x[:, _CURRENT]
        north, east = (ground - current).tolist()
        speed_m_s = math.hypot(north, east)
        if min(estimated_m_s, speed_m_s) > tuning.least_speed_m_s:
            along = np.array((north, east)) / speed_m_s
            off = (x[:, _CURRENT] - current) @ along
            variance = np.einsum("i,nij,j->n", along, p[:, _CURRENT, _CURRENT], along) + np.square(off)
            sigma_m_s = math.sqrt(float(used @ variance))
            now = tuple((speed_m_s + k * sigma_m_s) / estimated_m_s for k in (tuning.likely_sigmas, tuning.sigmas))
            if self._ratios is None:
                self._ratios = now[0], now[1]
            part = min(1.0, elapsed_s / tuning.follow_s)
            likely, most = self._ratios
            self._ratios = likely + part * (now[0] - likely), most + part * (now[1] - most)
        shown = uniform > tuning.uniform and 1.0 - mild < tuning.varying and self._age_s > tuning.least_age_s
        if shown and self.excess_sigma < tuning.known_sigma and self._ratios is not None:
            self.likely, self.bound = self._ratios
        else:
            self.likely = self.bound = None
