"""Watches whether the penalties of the soft limits are still exact.

An L1 penalty gives the solution of the hard problem as long as its slope is larger than the multipliers (Kerrigan and
Maciejowski 2000). A multiplier at the slope means that a limit is being given up: either nothing keeps it (pushed out
of the workspace, an obstacle on the nose) or the weight is too small. Either is worth a word.
"""

from autopilot.core import operator_messages as notices
from autopilot.core.messages import Severity

EXHAUSTED = 0.99
"""Share of the slope that counts as all of it (the solver's residual)."""

PATIENCE_STEPS = 20
"""A second of it: less happens whenever an obstacle comes up."""


class PenaltyWatch:
    """One per controller."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget."""
        self._steps = 0
        self._news: list[tuple[Severity, str]] = []
        self.largest = 0.0
        """Largest multiplier over slope since the last reset."""

    def watch(self, use: float) -> None:
        """One step's largest multiplier over slope."""
        self.largest = max(self.largest, use)
        if use < EXHAUSTED:
            self._steps = 0
            return
        self._steps += 1
        if self._steps == PATIENCE_STEPS:
            self._news.append(notices.LIMITS_GIVEN_UP())

    def take_news(self) -> list[tuple[Severity, str]]:
        """What has been noticed since the last call."""
        news, self._news = self._news, []
        return news
