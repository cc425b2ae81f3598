"""How much of the planar speed margin is needed, by what has been seen at the limit.

The margin is what bounds and the estimator's own spread add up to; mostly the vehicle keeps its speed far better than
that, and in a current that is nearly too fast the difference decides whether it makes any way. So the margin shrinks
slowly while the vehicle flies at its cap and its speed through the water stays there, and comes back quickly when it
does not. For what cannot be seen (a vehicle that is faster than it believes, because the current is believed wrongly)
half of the tube and MPC_SPEED_MARGIN are kept in any case.
"""

import math

from autopilot.core.messages import NavHealth, NavState

NEAR_SHARE = 0.8
"""Speeds above this share of the cap say something about keeping it."""

FOLLOW_S = 3.0
"""What the speed does faster than this is no change of plan but a disturbance."""

QUICK_S, SLOW_S, FORGET_S = 2.0, 6.0, 60.0
"""Time constants of losing credit, of gaining it, and of forgetting what was seen while nothing is seen."""

LEAST_SHARE = 0.5
"""Of the margin, whatever has been seen."""

STRONG_SHARE, STRONGEST_SHARE = 0.55, 0.7
"""Credit is used in currents from such a share of the speed limit on, in full at the second: elsewhere there is speed
enough."""

SHRINK_M_S2, GROW_M_S2 = 0.005, 0.05
"""The margin moves by no more than this: 0.25 and 2.5 mm/s from one step to the next."""

LARGEST_NEED = 4.0
"""Square of how often the margin one look may ask for: what has passed is forgotten within seconds."""

SIGMAS = 3.29
"""A margin holds what exceeds it once in a thousand times."""

LONGEST_S = 0.2


class SpeedEvidence:
    """One per vehicle; looked at once per control step."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen."""
        self._t_us: int | None = None
        self._reset_count = -1
        self._needed = 1.0
        self._slow_m_s = 0.0
        self.share = 1.0
        """Of the margin that is kept."""

    def look(self, nav: NavState, limit_m_s: float, tube_m_s: float, least_m_s: float) -> None:
        """``tube_m_s``: margin at the end of the prediction without any credit; ``least_m_s``: what is kept of it."""
        speed = math.hypot(float(nav.vel_water_frd_m_s[0]), float(nav.vel_water_frd_m_s[1]))
        good = nav.health is NavHealth.GOOD and math.isfinite(speed) and nav.reset_count == self._reset_count
        if not good or self._t_us is None or tube_m_s <= 0.0 or limit_m_s <= tube_m_s:
            self.reset()
            self._t_us, self._reset_count, self._slow_m_s = nav.t_us, nav.reset_count, speed
            return
        elapsed_s = min(max((nav.t_us - self._t_us) * 1e-6, 0.0), LONGEST_S)
        self._t_us = nav.t_us
        self._slow_m_s += (speed - self._slow_m_s) * elapsed_s / FOLLOW_S
        cap_m_s = limit_m_s - max(self.share * tube_m_s, min(tube_m_s, least_m_s))
        seen, time_s = 1.0, FORGET_S
        if speed > NEAR_SHARE * cap_m_s:
            seen = (SIGMAS * max(abs(speed - self._slow_m_s), speed - cap_m_s) / tube_m_s) ** 2
            time_s = QUICK_S if seen > self._needed else SLOW_S
        self._needed += (min(seen, LARGEST_NEED) - self._needed) * min(1.0, elapsed_s / time_s)
        self._move(math.hypot(*nav.current_ned_m_s[:2].tolist()) / limit_m_s, elapsed_s / tube_m_s)

    def _move(self, current_share: float, per_m_s2: float) -> None:
        """Towards what is needed, as far as the current asks for it."""
        needed = min(1.0, max(LEAST_SHARE, math.sqrt(self._needed)))
        asked = min(max((current_share - STRONG_SHARE) / (STRONGEST_SHARE - STRONG_SHARE), 0.0), 1.0)
        step = 1.0 - asked * (1.0 - needed) - self.share
        self.share += min(max(step, -SHRINK_M_S2 * per_m_s2), GROW_M_S2 * per_m_s2)
