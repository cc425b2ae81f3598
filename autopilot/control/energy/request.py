"""Request and result of minimum-energy planning."""

import math
from dataclasses import dataclass
from typing import Protocol

from autopilot.control.energy.flow import FlowField, FlowSamples
from autopilot.control.energy.patience import Kind
from autopilot.control.energy.trajectory import Trajectory
from autopilot.core.background import Cancel
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import Goal

EXTRA_M, EXTRA_S = 0.02, 0.5
"""Largest clearance beyond the radius, and time for which a current of one standard deviation is covered by it: an
estimate fluctuates, and every millimetre inside the margin causes a strong reaction."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TrajectoryRequest:
    """Everything a plan depends on. Pure data: the answer is the same whenever it is computed."""

    x0: FloatArray
    """(8,) state at which the plan begins."""
    goal: Goal
    fence: Fence
    radius_m: float
    """Kept from every boundary."""
    extra_m: float = EXTRA_M
    """Additional clearance where there is space."""
    flow: FlowSamples
    limits: FloatArray
    """(5,) planar speed, heave, yaw rate, depth minimum, depth maximum."""
    thrust_limit_n: FloatArray
    """(4,)"""
    buoyancy_excess_n: float
    """Buoyancy minus weight, as it has proved to be."""
    uncertainty: float = 0.0
    """Share of the goal's acceptance that the estimate's uncertainty takes."""
    leg_depth_m: float | None = None
    """Depth at which the leg to the goal was begun, None = here."""
    cruise_m_s: float = math.inf
    """See :func:`autopilot.control.energy.power.planar_limit_m_s`."""
    warm: Trajectory | None = None
    """Remaining part of the active plan, if it may be continued."""
    kind: Kind = Kind.COLD
    """What is looked at."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Plan:
    goal: Goal
    trajectory: Trajectory | None
    """None if there is no way."""
    energy_j: float
    """To the goal region, including the part beyond the end of the trajectory."""
    eta_s: float
    complete: bool
    """The trajectory ends in the goal's region."""
    flow: FlowField | None = None
    """The water that it was made for."""
    why: str = ""
    """Without a trajectory: the reason."""
    stay: bool = False
    """A full search has found nothing that is clearly cheaper than the plan in force."""


class TrajectoryPlanner(Protocol):
    """Makes plans beside the loop; an exception means that there is none."""

    def plan(self, request: TrajectoryRequest, cancel: Cancel) -> Plan:
        """Answer one request; once ``cancel`` is requested anything will do."""
        ...

    def warm(self) -> None:
        """Import and build everything that the first plan needs."""
        ...


def no_plan(goal: Goal, why: str) -> Plan:
    """The answer that there is none."""
    return Plan(goal=goal, trajectory=None, energy_j=math.inf, eta_s=math.inf, complete=False, why=why)
