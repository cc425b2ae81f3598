"""How far the yaw rate runs ahead of its prediction.

Errors of drag, thrust and mass, and thrusters that sit elsewhere than the vehicle file says, act as a moment that the
prediction does not know. Of all motions yaw answers first: within one lag of the thrusters, before a new command acts,
0.2 N m turn the LBV150 faster by 0.1 rad/s. The residual of the yaw equation, r' - (N - D r + Munk moment) / m44,
shows this moment however it comes about (disturbance observer: Chen et al. 2016). Times the delay of a command it is
what the yaw rate gains before anything can be done about it: the back-off of the limit, in the direction of the turn.
With a model that is right there is none.
"""

import math

import numpy as np

from autopilot.control.robust.robust_tuning import YAW_RATE
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.model4 import Model4, forced_acceleration


class YawRateExcess:
    """One per vehicle. :meth:`push` with every thrust, :meth:`update` once per control step; deterministic."""

    def __init__(self, model: Model4, lag_s: float) -> None:
        """``lag_s``: mean lag of the thrusters."""
        self._model, self._row = model, np.array(model.allocation[3])
        self._lead_s = lag_s + YAW_RATE.step_s
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen."""
        self._last: tuple[int, int, list[float]] | None = None
        self._impulse_nms = self._pushed_s = 0.0
        self._unknown_rad_s2 = 0.0

    def push(self, acting_n: FloatArray, elapsed_s: float) -> None:
        """Thrust (n,) that acts ``elapsed_s`` after the last call."""
        self._impulse_nms += elapsed_s * self._row.dot(acting_n).item()
        self._pushed_s += elapsed_s

    def update(self, nav: NavState) -> None:
        """From the motion since the last call; ``nav`` in the level frame."""
        last, impulse_nms, pushed_s = self._last, self._impulse_nms, self._pushed_s
        u, v, _ = nav.vel_water_frd_m_s.tolist()
        motion = [u, v, 0.0, nav.rate_frd_rad_s.item(2)]
        if nav.health is NavHealth.INVALID or not math.isfinite(sum(motion) + impulse_nms):
            self.reset()
            return
        self._last, self._impulse_nms, self._pushed_s = (nav.t_us, nav.reset_count, motion), 0.0, 0.0
        elapsed_s = 0.0 if last is None else (nav.t_us - last[0]) * 1e-6
        if last is None or last[1] != nav.reset_count or not 0.0 < elapsed_s <= YAW_RATE.longest_s or not pushed_s:
            self._unknown_rad_s2 = 0.0
            return
        between = [0.5 * (before + now) for before, now in zip(last[2], motion, strict=True)]
        predicted = forced_acceleration(self._model, between, (0.0, 0.0, 0.0, impulse_nms / pushed_s), math)[3]
        residual = (motion[3] - last[2][3]) / elapsed_s - predicted
        self._unknown_rad_s2 += (1.0 - math.exp(-elapsed_s / YAW_RATE.follow_s)) * (residual - self._unknown_rad_s2)

    def back_off_rad_s(self, planned_rad_s: float) -> float:
        """Back-off of the limit for a plan that turns like this; 0 where the vehicle turns no faster than predicted."""
        return max(0.0, math.copysign(self._lead_s, planned_rad_s) * self._unknown_rad_s2)
