"""Terminal region of the current goal: computed when goal or current change, verified in the background.

The terminal law (steady input, gain, cost) takes half a millisecond and is available at once. Its 20,000-sample
verification runs on a worker, and only where the law is the terminal cost: minimum-energy plans end otherwise. The
result is logged; the operator is notified only if there is no region at all.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from autopilot.control.robust.robust_tuning import REGIONS, TERMINAL
from autopilot.control.robust.terminal import Certificate, Terminal, TerminalLimits, certify, terminal_law, unit_samples
from autopilot.core import operator_messages as notices
from autopilot.core.background import BackgroundTask, BackgroundWorker, Cancel
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Goal
from autopilot.core.model4 import YAW, Model4, U
from autopilot.core.notice_queue import NoticeQueue

AT_PLACE = ("clearance", "acceptance radius", "acceptance heading", "depth", "decrease")
"""Limits by the goal's position, independent of the current; all others depend on it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _RegionRequest:
    model: Model4
    law: Terminal
    goal: Goal
    limits: TerminalLimits
    sampled: bool


def _certified(request: _RegionRequest, cancel: Cancel) -> Certificate:
    """The full certificate, or the level by the limits alone."""
    samples = unit_samples(TERMINAL.samples if request.sampled else 0)
    return certify(request.model, request.law, request.goal, request.limits, samples, check=cancel.check)


class TerminalRegions(NoticeQueue):
    """Law and certificate of the present goal."""

    def __init__(self, allocator: ControlAllocator, worker: BackgroundWorker) -> None:
        super().__init__()
        self._allocator, self._worker = allocator, worker
        self._task: BackgroundTask[Certificate] | None = None
        self.reset()

    def reset(self) -> None:
        self._withdraw()
        self._step = 0
        self._key: tuple[object, ...] = ()
        self._goal: Goal | None = None
        self._reported = ""
        self._warned = ""
        self._current: list[float] = [0.0, 0.0, 0.0]
        self._buoyancy_n = 0.0
        self._cost: FloatArray | None = None
        self._notices = []
        self._nu: list[float] = []
        self.law: Terminal | None = None
        self.certificate: Certificate | None = None
        """Of the present goal, None while it is being made."""

    def follow(
        self,
        goal: Goal,
        yaw_rad: float,
        current_ned_m_s: FloatArray,
        clearance_m: float,
        limits: Callable[[], TerminalLimits],
        q: FloatArray,
        r: FloatArray,
        away_m: float = 0.0,
        *,
        sampled: bool = True,
    ) -> None:
        """One control step with this goal at the planar distance ``away_m``; ``yaw_rad``: heading at the goal.
        ``clearance_m``: that of ``limits``, which are evaluated only for a certificate. ``sampled``: whether the
        decrease is also verified.
        """
        self._step += 1
        yaw = goal.yaw_rad if goal.yaw_rad is not None else round(yaw_rad, 1)
        place, current = goal.pos_ned_m.tolist(), current_ned_m_s.tolist()
        key = (place, yaw, goal.accept_radius_m, clearance_m, q.tobytes(), r.tobytes(), sampled)
        moved = (
            max(abs(now - then) for now, then in zip(current, self._current, strict=True)) > REGIONS.current_step_m_s
        )
        buoyancy_n = self._allocator.buoyancy_excess_n
        moved |= abs(buoyancy_n - self._buoyancy_n) > REGIONS.buoyancy_step_n
        if key != self._key or (moved and self._task is None):
            self._key, self._goal, self._current, self._buoyancy_n = key, goal, current, buoyancy_n
            terminal_limits = limits()
            self.law = terminal_law(self._allocator, yaw, current_ned_m_s, q, r, terminal_limits.thrust_n)
            self._cost, self._nu = self.law.cost_ned(), self.law.nu.tolist()
            self.certificate = None
            self._withdraw()
            request = _RegionRequest(
                model=self._allocator.model, law=self.law, goal=goal, limits=terminal_limits, sampled=sampled
            )
            self._task = self._worker.submit(self._step + REGIONS.answer_steps, _certified, request)
        if self.certificate is not None and self.certificate.alpha <= 0.0:
            self._warn(goal, self.certificate, away_m)
        answer = None if self._task is None else self._task.poll(self._step)
        if answer is None:
            return
        self._task, self.certificate = None, answer.value
        if answer.value is not None:
            self._tell(goal, answer.value)
        else:
            self._notices.append(notices.NO_CERTIFICATE(name=_name(goal), error=answer.error))

    def _withdraw(self) -> None:
        if self._task is not None:
            self._task.cancel()
        self._task = None

    def cost_at(self, x_end: FloatArray, goal: Goal) -> FloatArray | None:
        """(8, 8) terminal Hessian for a reference that ends in ``x_end`` (8,): that of the goal if it ends there."""
        law, end = self.law, x_end.tolist()
        if law is None or self._goal is None or math.dist(end[:3], goal.pos_ned_m.tolist()) >= REGIONS.at_goal_m:
            return None
        turn = math.remainder(end[YAW] - law.yaw_rad, 2.0 * math.pi)
        still = max(abs(a - b) for a, b in zip(end[U:], self._nu, strict=True))
        return self._cost if abs(turn) < REGIONS.at_goal_rad and still < REGIONS.current_step_m_s else None

    def _tell(self, goal: Goal, certificate: Certificate) -> None:
        """Report to the log, and to the operator if there is a remedy."""
        name = _name(goal)
        # A small change of the current gives a new certificate; it is reported only if its result differs.
        summary = f"{name} {certificate.binding} {certificate.fits} {goal.pos_ned_m.tolist()}"
        if summary == self._reported:
            return
        self._reported = summary
        self._notices.append(notices.CERTIFICATE(name=name, text=certificate.text))

    def _warn(self, goal: Goal, certificate: Certificate, away_m: float) -> None:
        """One notice with a remedy for a goal without a region. A current too fast to hold matters only where the
        vehicle is to stay: it may well be carried through a goal.
        """
        name, limit = _name(goal), certificate.binding
        if limit not in AT_PLACE and (goal.following is not None or away_m > REGIONS.here_m):
            return
        summary = f"{name} {limit} {goal.pos_ned_m.tolist()}"
        if summary == self._warned:
            return
        self._warned = summary
        if limit in AT_PLACE:
            text = notices.GOAL_BEYOND_LIMIT(name=name, limit=limit)
        elif limit.endswith("thrust"):
            text = notices.GOAL_LACKS_THRUST(name=name, limit=limit)
        elif limit == "yaw rate":
            text = notices.GOAL_LACKS_YAW_RATE(name=name)
        else:
            text = notices.GOAL_IN_CURRENT(name=name, current_m_s=float(np.linalg.norm(self._current)))
        self._notices.append(text)


def _name(goal: Goal) -> str:
    return f"Item {goal.seq}" if goal.seq >= 0 else "Goal"
