"""Adaptation of the planar speed margin to the observed overshoot of the speed limit.

The margin is the sum of disturbance bounds and the covariance of the estimate. Mostly the vehicle keeps its speed far
better, and in a current close to the speed limit the difference decides whether it advances at all. The margin is
therefore reduced slowly while the vehicle moves at its limit without exceeding it, and restored quickly when it
exceeds it. Half of the tube and MPC_SPEED_MARGIN are always kept, for errors that are not observable (a wrong current
estimate).
"""

import math

from autopilot.control.robust.robust_tuning import EVIDENCE
from autopilot.core.messages import NavHealth, NavState


class SpeedEvidence:
    """One per vehicle; updated once per control step."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self._t_us: int | None = None
        self._reset_count = -1
        self._needed = 1.0
        self._slow_m_s = 0.0
        self.margin_fraction = 1.0
        """Of the margin that is kept."""

    def update(self, nav: NavState, limit_m_s: float, tube_m_s: float, least_m_s: float) -> None:
        """``tube_m_s``: full margin at the end of the prediction; ``least_m_s``: the part that is always kept."""
        speed = math.hypot(float(nav.vel_water_frd_m_s[0]), float(nav.vel_water_frd_m_s[1]))
        good = nav.health is NavHealth.GOOD and math.isfinite(speed) and nav.reset_count == self._reset_count
        if not good or self._t_us is None or tube_m_s <= 0.0 or limit_m_s <= tube_m_s:
            self.reset()
            self._t_us, self._reset_count, self._slow_m_s = nav.t_us, nav.reset_count, speed
            return
        elapsed_s = min(max((nav.t_us - self._t_us) * 1e-6, 0.0), EVIDENCE.longest_s)
        self._t_us = nav.t_us
        self._slow_m_s += (speed - self._slow_m_s) * elapsed_s / EVIDENCE.follow_s
        cap_m_s = limit_m_s - max(self.margin_fraction * tube_m_s, min(tube_m_s, least_m_s))
        seen, time_s = 1.0, EVIDENCE.forget_s
        if speed > EVIDENCE.near_fraction * cap_m_s:
            seen = (EVIDENCE.sigmas * max(abs(speed - self._slow_m_s), speed - cap_m_s) / tube_m_s) ** 2
            time_s = EVIDENCE.quick_s if seen > self._needed else EVIDENCE.slow_s
        self._needed += (min(seen, EVIDENCE.largest_need) - self._needed) * min(1.0, elapsed_s / time_s)
        self._move(math.hypot(*nav.current_ned_m_s[:2].tolist()) / limit_m_s, elapsed_s / tube_m_s)

    def _move(self, current_ratio: float, per_m_s2: float) -> None:
        """Move the margin towards the required one, as far as the current demands it."""
        needed = min(1.0, max(EVIDENCE.least_fraction, math.sqrt(self._needed)))
        demand = min(
            max(
                (current_ratio - EVIDENCE.strong_ratio) / (EVIDENCE.strongest_ratio - EVIDENCE.strong_ratio),
                0.0,
            ),
            1.0,
        )
        step = 1.0 - demand * (1.0 - needed) - self.margin_fraction
        self.margin_fraction += min(max(step, -EVIDENCE.shrink_m_s2 * per_m_s2), EVIDENCE.grow_m_s2 * per_m_s2)
