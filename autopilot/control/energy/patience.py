"""Timing of plan requests: expected duration, and retries after a failure."""

import enum
from dataclasses import dataclass

import numpy as np

from autopilot.control.energy.energy_tuning import PATIENCE
from autopilot.control.path.guidance import GuidanceInputs
from autopilot.control.path.planner import Planner


class Kind(enum.Enum):
    QUICK = "first plan of a leg"
    """From nothing: the cheapest way with either turn, to set out with."""
    COLD = "full search"
    """All paths, all turns, the next leg; and the rest of the active plan, if there is one."""
    WARM = "plan brought up to date"
    """From the plan in force."""
    NEXT = "plan of the leg after"
    """A full search ahead."""


ANSWER_STEPS = {Kind.QUICK: 8, Kind.COLD: 40, Kind.WARM: 16, Kind.NEXT: 40}
"""Control steps (of 50 ms) from request to use of an answer, on a vehicle more if it is late: about the 90 % quantile
of (``autopilot bench energy-latency``, seconds of CPU on two shared cores: full searches 1.8, updates 0.1 in the tank
and up to 1.8 elsewhere; quick plans with two turns 0.3 to 0.4 in the tank)."""


class NoPlanError(Exception):
    """Why there is no plan of least energy, for the log."""


@dataclass(frozen=True, slots=True, eq=False)
class _RequestConditions:
    planner: Planner
    bounds: tuple[float, ...]
    """Speed cap and thrust limits."""
    flow: np.ndarray
    """(4,) north, east of the vehicle, current north, east."""

    @classmethod
    def of(cls, now: GuidanceInputs) -> "_RequestConditions":
        flow = np.concatenate([now.x0[:2], now.nav.current_ned_m_s[:2]])
        return cls(now.planner, (now.speed_cap_m_s, *now.thrust_limit_n.tolist()), flow)

    def differs(self, then: "_RequestConditions") -> bool:
        """Whether another answer is to be expected."""
        moved, changed = np.hypot(*(self.flow - then.flow).reshape(2, 2).T)
        known = self.planner is then.planner and self.bounds == then.bounds
        return not known or moved > PATIENCE.other_place_m or changed > PATIENCE.other_current_m_s


class Patience:
    """When to ask again after failures: later and later, at once when something has changed."""

    def __init__(self) -> None:
        self._failures = 0
        self._requested: _RequestConditions | None = None

    def note_request(self, now: GuidanceInputs) -> None:
        self._requested = _RequestConditions.of(now)

    def failed(self) -> None:
        self._failures += 1

    def succeeded(self) -> None:
        """It was answered with a plan."""
        self._failures = 0

    def over(self, now: GuidanceInputs, since_steps: int) -> bool:
        """Whether it is time, so many steps after the last request."""
        if not self._failures:
            return True
        if since_steps < PATIENCE.retry_steps:
            return False
        if since_steps >= min(PATIENCE.retry_steps * 2 ** (self._failures - 1), PATIENCE.longest_retry_steps):
            return True
        return self._requested is not None and _RequestConditions.of(now).differs(self._requested)
