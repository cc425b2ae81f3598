"""The interface between a controller and the service, and how a controller is made (docs/extend.md).

The service calls the controller every 50 ms with estimate, goal and fence, and takes thrust. A class that inherits
from :class:`Controller` has to define ``step`` only.
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
from autopilot.core.plugins import find_plugin
from autopilot.core.samples import ObstacleTrack
from autopilot.core.vehicle import Vehicle

STEP_S = 0.05
"""Time from one step to the next; a new goal asks for one at once."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ControllerContext:
    """Everything that a controller is constructed from."""

    vehicle: Vehicle
    """The vehicle file."""
    model: Model4
    """4-DoF model: masses, drag, and allocation (4, N): surge, sway, heave [N], yaw [N m] per N of thrust."""
    currents: CurrentForecast
    """Current forecast in addition to the estimated current."""
    desks: BackgroundWorkers
    """Workers for tasks that do not fit into a step; closed by the service."""
    trajectories: TrajectoryPlanner | None = None
    """Minimum-energy planner; None = the shipped one."""


class Controller(Protocol):
    """Estimate, goal and fence in, thrust out. World frame NED, body frame FRD, SI units, radians.

    N thrusters in the order of the vehicle file. Deterministic: the same calls give the same thrust bit for bit (no
    clock, seeded random numbers only, no threads beside the background workers). All calls come from one thread. An
    exception is a fault: the service keeps the station by its own law, notifies the operator, calls :meth:`reset`, and
    calls again after the operator's next order; the same fault a second time within one arming disarms.
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
        """Thrust from now until the next step, ``STEP_S`` later. :func:`simple_output` builds the result.

        Parameters
        ----------
        t_us
            Time of the step [us], growing.
        nav
            The estimate; its health may be DEAD_RECKONING or INVALID.
        goal
            Terminal region and speed. Equal content in another object is the same goal.
        fence
            The workspace of the vehicle's centre, which keeps ``vehicle.radius_m`` from every boundary; the same
            object until plan or depth band change.
        params
            The live parameters (SPD_PLANAR_MAX, THR_LIMIT, ...).
        thruster_limit_n
            (N,) bound on the magnitude of each thruster's thrust [N]: THR_LIMIT, supply voltage, lost thrusters.
        tracks
            Detected obstacles that the fence does not contain.
        delay_s
            Latency from command to thruster [s]; None if it is uncertain whether commands act at all.

        Returns
        -------
        ControlOutput
            ``thrust_n`` (N,) [N] has to be finite, otherwise it is a fault; it is clipped to the bounds. A ``status``
            other than OK, or a fallback, counts as a step without a solution (parameter FS_SOLVER_N).
        """
        ...

    def tick(self, t_us: int, nav: NavState) -> FloatArray | None:
        """Thrust (N,) [N] of an inner loop, every 10 ms between two steps; None keeps the last command."""
        return None

    def reset(self) -> None:
        """Discard the state of the flight: after disarming, without a goal, after a fault of the controller."""

    def warm(self, params: ParamSet) -> None:
        """Called once, a second after the start: prepare in the background what the first steps need."""

    def take_news(self) -> list[tuple[Severity, str]]:
        """Messages to the operator since the last call (severity, text); DEBUG goes to the log only. Called every
        tick.
        """
        return []

    @property
    def solver(self) -> str:
        """Name of the solver for log and report; empty if there is none."""
        return ""

    @property
    def unreachable(self) -> bool:
        """Whether no path to the goal exists. Reported to mission and operator; WP_STUCK_ACT sets the reaction."""
        return False

    @property
    def shortfall(self) -> str:
        """What is missing to reach the goal in the present current, "" = nothing. Missions then wait for progress only
        10 s.
        """
        return ""

    def planar_speed_m_s(self, nav: NavState, params: ParamSet) -> float:
        """Largest commanded speed through the water [m/s]; used to judge legs against the current."""
        return params["SPD_PLANAR_MAX"]

    def goal_margin_m(self, params: ParamSet) -> float:
        """Clearance beyond the body radius [m] that is kept where the vehicle stays: positions of a mission need it,
        less what their acceptance radius allows. A function of the parameters alone.
        """
        return params["MPC_MARGIN"]

    def refusals(
        self, nav: NavState, goals: Sequence[tuple[str, float]], fence_half_m: float, params: ParamSet
    ) -> tuple[str, ...]:
        """Reasons against arming, called twice per second.

        Parameters
        ----------
        nav
            The estimate.
        goals
            Name and clearance beyond the body radius [m] of every position of the mission.
        fence_half_m
            Largest clearance anywhere in the fence [m]; inf in open water.
        params
            The live parameters.

        Returns
        -------
        tuple of str
            One line per reason with its remedy; empty = the controller is ready.
        """
        return ()


def create_controller(name: str, context: ControllerContext, asked_by: str | None = None) -> Controller:
    """Construct the controller of that name: a shipped one, one of an installed package, or ``package:Class``.

    ConfigError names ``asked_by`` (default ``--controller``), value and remedy if there is none, or it is none by
    :class:`Controller`.
    """
    made: Controller = find_plugin("controller", name, asked_by).make(context, Controller)
    return made


def simple_output(
    t_us: int, nav: NavState, thrust_n: FloatArray, *, route_ned_m: FloatArray | None = None, solved: bool = True
) -> ControlOutput:
    """The output of a controller without a prediction.

    Parameters
    ----------
    t_us
        Time of the step [us].
    nav
        The estimate; its position is the only row of the horizon.
    thrust_n
        (N,) commanded thrust [N].
    route_ned_m
        (m, 2) north, east of the path [m], for the log; None = the present position.
    solved
        False counts as a step without a solution.
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


def checked_output(control: ControlOutput, limit_n: FloatArray) -> ControlOutput:
    """The output with its thrust clipped to ``limit_n`` (N,) [N].

    Raises
    ------
    TypeError
        It is not a ControlOutput.
    ValueError
        Thrust of another shape or not finite, or a limit that is NaN.
    """
    if not isinstance(control, ControlOutput):
        raise TypeError(f"step() must return a ControlOutput, not {type(control).__name__} (see simple_output)")
    thrust_n = checked_thrust_n(control.thrust_n, limit_n)
    return control if thrust_n is control.thrust_n else replace(control, thrust_n=thrust_n)


def checked_thrust_n(thrust_n: FloatArray, limit_n: FloatArray) -> FloatArray:
    """Thrust (N,) clipped to ``limit_n`` (N,) [N]. ValueError: another shape, not finite, or a limit that is NaN."""
    if np.shape(thrust_n) != limit_n.shape:
        raise ValueError(f"thrust_n has shape {np.shape(thrust_n)}, this vehicle needs {limit_n.shape}")
    thrust_n = np.asarray(thrust_n, dtype=np.float64)
    # Four to eight numbers, at every tick: a list is quicker than three small arrays.
    wanted = thrust_n.tolist()
    if not all(map(math.isfinite, wanted)):
        raise ValueError(f"thrust_n is not finite: {wanted}")
    limits = limit_n.tolist()
    if all(abs(thrust) <= limit for thrust, limit in zip(wanted, limits, strict=True)):
        return thrust_n
    if any(map(math.isnan, limits)):
        raise ValueError(f"limit_n is not a number: {limits}")
    return np.clip(thrust_n, -limit_n, limit_n)
