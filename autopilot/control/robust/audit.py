"""Counts how often the vehicle is where its plan said, give or take the printed tube.

A plan that begins at ``t`` (``ControlOutput.nominal``, its times ``nominal_t_s`` after ``t``) promises where the centre
will be a look-ahead later; the tube there is ``ControlOutput.tube_m``: the distance that the plan keeps from every
boundary beyond the body. A sample is inside when the true centre is no farther from the promise, in the plane, than
that. Promises that another goal, fence or restart has overtaken are dropped.
"""

from collections import deque

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import ControlOutput, Fallback

LOOK_AHEAD_S = 0.5
"""Ten optimiser steps: long enough for disturbances to act, short against changes of a plan that nothing disturbs."""


class TubeAudit:
    """Fed with every control output and with every true position."""

    def __init__(self, look_ahead_s: float = LOOK_AHEAD_S) -> None:
        self._look_ahead_us = round(look_ahead_s * 1e6)
        self._promises: deque[tuple[int, FloatArray, float]] = deque()
        self._goal: object = None
        self.samples = 0
        self.inside = 0
        self.worst_m = 0.0
        """Largest distance from a promise."""
        self.worst_share = 0.0
        """Largest distance as a share of the tube."""

    def plan(self, output: ControlOutput, goal: object) -> None:
        """A plan has been made; ``goal`` is anything that changes when plans are no longer comparable."""
        if goal != self._goal or output.restarted:
            self._promises.clear()
            self._goal = goal
        if output.status.fallback is not Fallback.NONE:
            return
        due_s = self._look_ahead_us * 1e-6
        t_s = output.nominal_t_s
        place = np.array([np.interp(due_s, t_s, output.nominal[:, i]) for i in range(2)])
        tube = float(np.interp(due_s, t_s, output.tube_m))
        self._promises.append((output.status.t_us + self._look_ahead_us, place, tube))

    def truth(self, t_us: int, pos_ned_m: FloatArray) -> None:
        """Where the centre (3,) really is."""
        while self._promises and self._promises[0][0] <= t_us:
            due_us, place, tube = self._promises.popleft()
            if due_us != t_us:
                continue
            away = float(np.hypot(*(pos_ned_m[:2] - place)))
            self.samples += 1
            self.inside += away <= tube
            self.worst_m = max(self.worst_m, away)
            self.worst_share = max(self.worst_share, away / tube) if tube > 0.0 else self.worst_share

    @property
    def share(self) -> float:
        """Share of samples inside; 1 when there are none."""
        return self.inside / self.samples if self.samples else 1.0
