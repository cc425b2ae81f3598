"""Estimator of the yaw moment that the model does not know.

Errors of drag, thrust and mass, and thrusters that sit elsewhere than the vehicle file says, act as a moment that the
prediction does not know. Of all motions yaw answers first: within one lag of the thrusters, before a new command acts,
0.2 N m turn the LBV150 faster by 0.1 rad/s; under way the Munk moment of a hull whose masses are 10 % off makes twice
as much. The residual of the yaw equation, m44 r' - (N - D r + Munk moment), shows it however it comes about
(disturbance observer: Chen et al. 2016). As with the buoyancy (:mod:`autopilot.control.current.buoyancy`) the
prediction counts on it: the plan starts at the yaw rate that it will have made when commands act, and is offset-free.
With a model that is right there is none.
"""

import math

import numpy as np

from autopilot.control.current.current_tuning import MOMENT_ESTIMATOR
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.model4 import Model4, forced_acceleration


class MomentEstimator:
    """:meth:`push` with every thrust, :meth:`update` once per control step; deterministic."""

    def __init__(self, model: Model4) -> None:
        self._model, self._row = model, np.array(model.allocation[3])
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen."""
        self._last: tuple[int, int, list[float]] | None = None
        self._impulse_nms = self._pushed_s = 0.0
        self.moment_nm = 0.0
        """Beside that of the thrusters [N m]."""

    def push(self, acting_n: FloatArray, elapsed_s: float) -> None:
        """Thrust (n,) that acts ``elapsed_s`` after the last call."""
        self._impulse_nms += elapsed_s * self._row.dot(acting_n).item()
        self._pushed_s += elapsed_s

    def update(self, nav: NavState, limit_n: FloatArray) -> None:
        """From the motion since the last call; ``nav`` in the level frame. ``limit_n`` (n,): thrust limits [N]."""
        last, impulse_nms, pushed_s = self._last, self._impulse_nms, self._pushed_s
        u, v, _ = nav.vel_water_frd_m_s.tolist()
        motion = [u, v, 0.0, nav.rate_frd_rad_s.item(2)]
        if nav.health is NavHealth.INVALID or not math.isfinite(sum(motion) + impulse_nms):
            self.reset()
            return
        self._last, self._impulse_nms, self._pushed_s = (nav.t_us, nav.reset_count, motion), 0.0, 0.0
        elapsed_s = 0.0 if last is None else (nav.t_us - last[0]) * 1e-6
        usable = pushed_s > 0.0 and 0.0 < elapsed_s <= MOMENT_ESTIMATOR.longest_s
        if last is None or last[1] != nav.reset_count or not usable:
            self.moment_nm = 0.0
            return
        between = [0.5 * (before + now) for before, now in zip(last[2], motion, strict=True)]
        predicted = forced_acceleration(self._model, between, (0.0, 0.0, 0.0, impulse_nms / pushed_s), math)[3]
        residual_nm = self._model.mass_kg[3] * ((motion[3] - last[2][3]) / elapsed_s - predicted)
        share = 1.0 - math.exp(-elapsed_s / MOMENT_ESTIMATOR.follow_s)
        most_nm = MOMENT_ESTIMATOR.most_share * np.abs(self._row).dot(limit_n).item()
        self.moment_nm = min(max(self.moment_nm + share * (residual_nm - self.moment_nm), -most_nm), most_nm)
