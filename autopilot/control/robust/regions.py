"""The terminal region of the goal in force: made when the goal or its water changes, verified a slice per control step.

The law (steady input, gain, cost) is there at once and costs a millisecond; the 20,000 samples of its certificate are
looked at in the pauses between steps, 250 at a time, four seconds long: no step is held up, every run counts the same.
"""

import math

import numpy as np

from autopilot.control.robust.terminal import (
    Certificate,
    CertificateJob,
    Terminal,
    TerminalLimits,
    terminal_law,
    unit_samples,
)
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Goal, Severity
from autopilot.core.model4 import Model4

SAMPLES_PER_STEP = 250
CURRENT_STEP_M_S = 0.06
"""A goal is certified anew when the current there has changed by this."""

AT_GOAL_M = 0.02
AT_GOAL_RAD = 0.05
"""The end of a reference counts as the goal within these."""


class TerminalRegions:
    """Law and certificate of the present goal."""

    def __init__(self, model: Model4) -> None:
        self._model = model
        self._samples = unit_samples()
        self.reset()

    def reset(self) -> None:
        """There is no goal."""
        self._key: tuple[float, ...] = ()
        self._goal: Goal | None = None
        self._told = ""
        self._current = np.zeros(3)
        self._job: CertificateJob | None = None
        self._owed = False
        self._cost: FloatArray | None = None
        self._news: list[tuple[Severity, str]] = []
        self.law: Terminal | None = None
        self.certificate: Certificate | None = None
        """Of the present goal, None while it is being made."""

    def take_news(self) -> list[tuple[Severity, str]]:
        """What has been certified since the last call."""
        news, self._news = self._news, []
        return news

    def follow(
        self,
        goal: Goal,
        yaw_rad: float,
        current_ned_m_s: FloatArray,
        limits: TerminalLimits,
        q: FloatArray,
        r: FloatArray,
    ) -> None:
        """One control step with this goal; ``yaw_rad`` is the heading in which the vehicle will stay there."""
        yaw = goal.yaw_rad if goal.yaw_rad is not None else round(yaw_rad, 1)
        key = (*goal.pos_ned_m.tolist(), yaw, goal.accept_radius_m, limits.clearance_m, *q.tolist(), *r.tolist())
        moved = float(np.abs(current_ned_m_s - self._current).max()) > CURRENT_STEP_M_S
        if key != self._key or (moved and self._job is None):
            self._key, self._goal, self._current = key, goal, current_ned_m_s.copy()
            self.law = terminal_law(self._model, yaw, current_ned_m_s, q, r)
            self._cost = self.law.cost_ned()
            self.certificate = None
            self._job = CertificateJob(self._model, self.law, goal, limits, self._samples)
        elif self._owed:
            self.advance()
        self._owed = self._job is not None

    def advance(self) -> None:
        """Look at the next slice of samples, if the last step left one: between two steps, or else in the next one."""
        if self._job is None or self._goal is None or not self._owed:
            return
        self._owed = False
        self.certificate = self._job.advance(SAMPLES_PER_STEP)
        if self.certificate is not None:
            self._job = None
            self._tell(self._goal, self.certificate)

    def cost_at(self, x_end: FloatArray, goal: Goal) -> FloatArray | None:
        """(8, 8) terminal Hessian for a reference that ends in ``x_end`` (8,): that of the goal if it ends there."""
        law, place = self.law, goal.pos_ned_m
        if law is None or self._goal is None:
            return None
        off = math.dist(x_end[:3].tolist(), place.tolist())
        turn = math.remainder(float(x_end[3]) - law.yaw_rad, 2.0 * math.pi)
        still = float(np.abs(x_end[4:] - law.nu).max())
        at_goal = off < AT_GOAL_M and abs(turn) < AT_GOAL_RAD and still < CURRENT_STEP_M_S
        return self._cost if at_goal else None

    def _tell(self, goal: Goal, certificate: Certificate) -> None:
        name = f"Item {goal.seq}" if goal.seq >= 0 else "Goal"
        text = f"{name}: {certificate.text}"
        severity = Severity.INFO if certificate.fits else Severity.NOTICE
        severity = Severity.WARNING if certificate.alpha <= 0.0 else severity
        # A current that changes a little makes another certificate; what it says is only news when it is another story.
        story = f"{name} {certificate.binding} {certificate.fits} {goal.pos_ned_m.tolist()}"
        if story != self._told:
            self._told = story
            self._news.append((severity, text))
