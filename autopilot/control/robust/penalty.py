"""Monitor of the exactness of the soft constraints' penalties.

An L1 penalty reproduces the solution of the hard problem as long as its slope exceeds the multipliers (Kerrigan and
Maciejowski 2000). A multiplier at the slope means a violated constraint: either it is infeasible (pushed out of the
workspace, an obstacle directly ahead) or the weight is too small. Both are reported.
"""

from autopilot.core import operator_messages as notices
from autopilot.core.notice_queue import NoticeQueue

EXHAUSTED = 0.99
"""Share of the slope that counts as all of it (the solver's residual)."""

PATIENCE_STEPS = 20
"""A second of it: less happens whenever an obstacle comes up."""


class PenaltyWatch(NoticeQueue):
    def __init__(self) -> None:
        super().__init__()
        self.reset()

    def reset(self) -> None:
        self._steps = 0
        self._notices = []

    def watch(self, use: float) -> None:
        """One step's largest multiplier over slope."""
        if use < EXHAUSTED:
            self._steps = 0
            return
        self._steps += 1
        if self._steps == PATIENCE_STEPS:
            self._notices.append(notices.LIMITS_GIVEN_UP())
