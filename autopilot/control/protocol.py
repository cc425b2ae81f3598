"""What a controller is to the rest of the vehicle, and how one is made (docs/extend.md).

The service gives it an estimate, a goal and the fence twenty times a second and takes thrust. Everything else has a
default: whoever inherits from :class:`Controller` writes ``step`` and nothing more.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from autopilot.control.current.currents import CurrentForecast
from autopilot.control.energy.request import TrajectoryPlanner
from autopilot.control.path.workers import BackgroundWorkers
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import ControlOutput, Fallback, Goal, NavState, NmpcStatus, Severity, SolveStatus
from autopilot.core.model4 import Model4
from autopilot.core.params import ParamSet
from autopilot.core.plugins import Plugin, find_plugin
from autopilot.core.samples import ObstacleTrack
from autopilot.core.vehicle import Vehicle

CONTROLLERS = {"nmpc": "autopilot.control.controller:of_context"}
"""Shipped controllers: name -> what makes one."""

STEP_S = 0.05
"""Time from one step to the next; a new goal asks for one at once."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ControllerContext:
    """What a controller is made of."""

    vehicle: Vehicle
    """The vehicle file."""
    model: Model4
    """Its 4-DoF model: masses, drags, and the allocation (4 x N): surge, sway, heave [N], yaw [N m] per N of thrust."""
    currents: CurrentForecast
    """What is known of the water beside the estimate's current."""
    desks: BackgroundWorkers
    """Lanes for work that does not fit into a step. Whoever composes the service closes them."""
    trajectories: TrajectoryPlanner | None = None
    """Who plans by energy; None = the shipped planner."""


class Controller(Protocol):
    """Estimate, goal and fence in, thrust out.

    World NED, body FRD, SI, radians; N thrusters in the order of the vehicle file. Deterministic: the same calls give
    the same thrust bit for bit (no clock, no random number that is not seeded, no thread but a desk's). All calls come
    from one thread. What raises is a fault: the service holds the place by a law of its own, says so, calls
    :meth:`reset`, and asks again after the operator's next order; the same fault a second time within one arming
    disarms.
    """

    @abstractmethod
    def step(
        self,
        t_us: int,
        nav: NavState,
        goal: Goal,
        fence: Fence,
        params: ParamSet,
        thruster_limit_n: FloatArray,
        tracks: Sequence[ObstacleTrack],
        *,
        delay_s: float | None,
    ) -> ControlOutput:
        """Thrust from now on until the next step, ``STEP_S`` later (:func:`simple_output` makes the answer).

        ``t_us`` grows. ``nav`` may be DEAD_RECKONING or INVALID. ``goal`` is where to be, and how fast to go there;
        equal content in another object is no new goal. ``fence`` is the workspace of the vehicle's centre, which keeps
        ``vehicle.radius_m`` from every boundary; the same object until plan or depth band change. ``params`` are the
        live parameters (SPD_PLANAR_MAX, THR_LIMIT, ...). ``thruster_limit_n`` (N,) is what each thruster can give now,
        either way: THR_LIMIT, the supply, lost thrusters. ``tracks`` are sensed obstacles that the fence does not
        have. ``delay_s``: commands reach the thrusters so late; None = it is in doubt whether they do at all.

        The answer's ``thrust_n`` must be (N,) and finite, else it is a fault; what is beyond the limits is cut.
        A ``status`` other than OK, or a fallback, counts as a step without a solution (parameter FS_SOLVER_N).
        """
        ...

    def tick(self, t_us: int, nav: NavState) -> FloatArray | None:
        """Every 10 ms between two steps: thrust (N,) of an inner loop, None = what was commanded stays."""
        return None

    def reset(self) -> None:
        """Forget the flight so far: disarmed, without a goal, or after a fault of the controller."""

    def warm(self, params: ParamSet) -> None:
        """Once, a second after the start: have prepared beside the loop what first answers need."""

    def take_news(self) -> list[tuple[Severity, str]]:
        """Severity and text of what the operator should know since the last call (DEBUG: for the log); every tick."""
        return []

    @property
    def solver(self) -> str:
        """What makes its plans, in words, for the log and the report; empty = nothing to say."""
        return ""

    @property
    def unreachable(self) -> bool:
        """Whether no way to the goal is found; mission and operator are told, WP_STUCK_ACT says what then."""
        return False

    def planar_speed_m_s(self, nav: NavState, params: ParamSet) -> float:
        """Speed through the water that it asks for at most: what legs against the current are judged by."""
        return params["SPD_PLANAR_MAX"]

    def refusals(
        self, nav: NavState, goals: Sequence[tuple[str, float]], fence_half_m: float, params: ParamSet
    ) -> tuple[str, ...]:
        """What it has against arming with this estimate, one reason each with what to do; asked twice per second.

        ``goals``: name and clearance [m] beyond the body radius of every place of the mission; ``fence_half_m``:
        largest clearance anywhere (inf = open water).
        """
        return ()


def create_controller(name: str, context: ControllerContext, asked_by: str | None = None) -> Controller:
    """The controller of that name (shipped, of an installed package, or package:Class).

    ConfigError names ``asked_by`` (default ``--controller``), the value and what to do.
    """
    made: Controller = find_controller(name, asked_by).make(context, Controller)
    return made


def find_controller(name: str, asked_by: str | None = None) -> Plugin:
    """Where the controller of that name comes from. ConfigError if there is none."""
    return find_plugin("controller", name, CONTROLLERS, asked_by)


def simple_output(
    t_us: int, nav: NavState, thrust_n: FloatArray, *, route_ned_m: FloatArray | None = None, solved: bool = True
) -> ControlOutput:
    """The answer of a controller that plans nothing: thrust (N,), and its route (m, 2) for the log if it has one.

    ``solved`` False: it had no good answer this time.
    """
    here = np.array(nav.pos_ned_m, dtype=float)[None]
    return ControlOutput(
        thrust_n=thrust_n,
        status=NmpcStatus(
            t_us=t_us,
            status=SolveStatus.OK if solved else SolveStatus.EXCEPTION,
            fallback=Fallback.NONE,
            iterations=0,
            solve_s=0.0,
            cost=0.0,
            slack_max=0.0,
            margin_m=0.0,
        ),
        horizon_ned_m=here,
        route_ned_m=here[:, :2].copy() if route_ned_m is None else route_ned_m,
    )


def sound(control: ControlOutput, limit_n: FloatArray) -> ControlOutput:
    """A controller's answer within the limits (N,). TypeError, ValueError if it is none."""
    if not isinstance(control, ControlOutput):
        raise TypeError(f"step() must return a ControlOutput, not {type(control).__name__} (see simple_output)")
    thrust_n = sound_thrust_n(control.thrust_n, limit_n)
    return control if thrust_n is control.thrust_n else replace(control, thrust_n=thrust_n)


def sound_thrust_n(thrust_n: FloatArray, limit_n: FloatArray) -> FloatArray:
    """Thrust (N,) within the limits (N,). ValueError: of another shape, not finite, a limit that is NaN."""
    if np.shape(thrust_n) != limit_n.shape:
        raise ValueError(f"thrust_n has shape {np.shape(thrust_n)}, this vehicle needs {limit_n.shape}")
    # Four to eight numbers, at every tick: a list is quicker than three small arrays.
    wanted = np.asarray(thrust_n).tolist()
    if not all(map(math.isfinite, wanted)):
        raise ValueError(f"thrust_n is not finite: {wanted}")
    limits = limit_n.tolist()
    if all(abs(thrust) <= limit for thrust, limit in zip(wanted, limits, strict=True)):
        return thrust_n
    if any(map(math.isnan, limits)):
        raise ValueError(f"limit_n is not a number: {limits}")
    return np.clip(thrust_n, -limit_n, limit_n)
