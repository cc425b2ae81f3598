"""From goal to thrust: the optimiser on its ticks, the inner loop in between, and the fallback control laws."""

import math
from collections.abc import Callable

import numpy as np

from autopilot.command.decision import Decision, Pose
from autopilot.command.modes.mode_table import STEERED
from autopilot.control.constraints.tracks import Tracks
from autopilot.control.protocol import Controller, checked_output, checked_thrust_n
from autopilot.control.robust.fallback import station_keeping_thrust
from autopilot.control.thrust.actuation import Actuation
from autopilot.control.thrust.by_hand import HandLaw, PositionlessState
from autopilot.control.thrust.slew import slewed
from autopilot.core.clock import TICK_US
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.messages import ControlOutput, Fallback, Goal, NavHealth, NavState, NmpcStatus, SolveStatus
from autopilot.core.model4 import NX, YAW
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle
from autopilot.mavlink.api import FlightMode

BLIND_ASCENT_SHARE = 0.35
"""Share of the thrust limit that lifts a vehicle without a position: about 0.2 m/s for the LBV150."""


class ControlStep:
    """Runs the controller on its ticks and holds its result in between."""

    def __init__(
        self, vehicle: Vehicle, controller: Controller, actuation: Actuation, params: ParamSet, tracks: Tracks
    ) -> None:
        self._controller = controller
        self._actuation = actuation
        self._params = params
        self._tracks = tracks
        self._allocator = ControlAllocator.of(vehicle)
        self._hand = HandLaw(self._allocator)
        self._soft: tuple[int, FloatArray] | None = None
        """Time and thrust of the last tick before a pilot without a position released the sticks, or before a
        piloted mode was entered or left."""
        self._last: tuple[int, FlightMode] | None = None
        """Time and mode of the last tick that had a goal."""
        self._switched = False
        """The controller has not answered since such a mode began or ended."""
        self.measured: Callable[[int], PositionlessState] = lambda _: PositionlessState()
        """State known without a position, called only then."""
        self.thrust_n: FloatArray = actuation.nothing()
        """(n,) wanted now."""
        self._wanted_n: FloatArray = actuation.nothing()
        """(n,) thrust requested by the controller [N]."""
        self._limit_n: FloatArray = actuation.nothing()
        """(n,) of the last control step."""
        self.status: NmpcStatus | None = None
        """Of the last control step, None while nothing is controlled."""
        self.ahead: FloatArray | None = None
        """(n, 8) the prediction of the last control step, None while nothing is controlled."""
        self.solver_failures = 0
        """Control steps in a row without a solution."""
        self.path_left_m: float | None = None
        """Length of the controller's path to the goal, None without one."""

    def reset(self) -> None:
        self.solver_failures, self.status, self.path_left_m, self.ahead = 0, None, None, None
        self._controller.reset()

    def step(
        self, t_us: int, nav: NavState | None, decision: Decision, last_goal: Goal | None, fence: Fence, *, due: bool
    ) -> ControlOutput | None:
        """One tick. ``due``: a tick of the controller; a goal that appears does not wait for one. ValueError: thrust
        that is not finite, of which nothing is left behind."""
        control = self._step(t_us, nav, decision, last_goal, fence, due=due)
        if not all(map(math.isfinite, self.thrust_n.tolist())):
            wrong, self.thrust_n, self._soft = self.thrust_n, self._actuation.nothing(), None
            self._hand.release()
            raise ValueError(f"thrust is not finite: {wrong.tolist()}")
        return control

    def _step(
        self, t_us: int, nav: NavState | None, decision: Decision, last_goal: Goal | None, fence: Fence, *, due: bool
    ) -> ControlOutput | None:
        goal, before_n = decision.goal, self.thrust_n
        if goal is None or nav is None:
            lift_n = BLIND_ASCENT_SHARE * self._params["THR_LIMIT"]
            actuation = self._actuation
            self.thrust_n = actuation.lift_n(lift_n) if decision.blind_ascent else actuation.nothing()
            if decision.ascent is not None and nav is not None and nav.health is not NavHealth.INVALID:
                self.thrust_n = self._ascend(nav, decision.ascent)
            if decision.motor_test is not None:
                self.thrust_n = self._tested(t_us, decision.motor_test, before_n)
                self._soft = (t_us, self.thrust_n)
                self._hand.release()
            elif decision.by_hand is not None:
                limit_n = actuation.command_limit_n
                self.thrust_n = self._hand.thrust_n(t_us, decision.by_hand, self.measured(t_us), limit_n, before_n)
                self._soft = (t_us, self.thrust_n)
            else:
                self._hand.release()
                self._soft = None
            self._last = None
            if last_goal is not None:
                self.reset()
            return None
        self._hand.release()
        self._note_mode(t_us, decision.mode)
        nav = self._actuation.delay.nav_for_control(t_us, nav)
        control = None
        if due or last_goal is None:
            control = self._control(t_us, nav, goal, fence)
            self._switched = False
        else:
            between = self._controller.tick(t_us, nav)
            kept_n = self.thrust_n if self._soft is None else self._wanted_n
            self._wanted_n = kept_n if between is None else checked_thrust_n(between, self._limit_n)
        self.thrust_n = self._softened(t_us, self._wanted_n)
        return control

    def _tested(self, t_us: int, test: tuple[int, int], before_n: FloatArray) -> FloatArray:
        """Thrust of one thruster from the pulse of a motor test, within its limit and a pilot's slew rate."""
        place, pulse_us = test
        actuation = self._actuation
        wanted_n = actuation.nothing()
        wanted_n[place] = actuation.allocation.thrust_n(place, pulse_us, actuation.supply_v)
        last_us = t_us - TICK_US if self._soft is None else self._soft[0]
        return slewed(wanted_n, before_n, actuation.command_limit_n, (t_us - last_us) * 1e-6)

    def _note_mode(self, t_us: int, mode: FlightMode) -> None:
        """A switch between modes, at least one of them piloted, is bumpless."""
        last, self._last = self._last, (t_us, mode)
        if last is not None and last[1] is not mode and (mode in STEERED or last[1] in STEERED):
            self._soft, self._switched = (last[0], self.thrust_n), True

    def _softened(self, t_us: int, wanted_n: FloatArray) -> FloatArray:
        """The commanded thrust, slew-rate limited after piloted control."""
        if self._soft is None:
            return wanted_n
        last_us, last_n = self._soft
        thrust_n = slewed(wanted_n, last_n, self._limit_n, (t_us - last_us) * 1e-6)
        done = not self._switched and np.array_equal(thrust_n, wanted_n)
        self._soft = None if done else (t_us, thrust_n)
        return thrust_n

    def _ascend(self, nav: NavState, place: Pose) -> FloatArray:
        """Up without the optimiser: the station-keeping law, whose station is at the surface."""
        wanted = np.zeros(NX)
        wanted[:3], wanted[YAW] = place[:3], place[3]
        limit_n = self._actuation.command_limit_n
        thrust_n = station_keeping_thrust(
            self._allocator, nav.in_level_frame().model4_state(), wanted, nav.current_ned_m_s, limit_n
        )
        return thrust_n if np.isfinite(thrust_n).all() else self._actuation.nothing()

    def _control(self, t_us: int, nav: NavState, goal: Goal, fence: Fence) -> ControlOutput:
        actuation = self._actuation
        self._limit_n = limit_n = actuation.command_limit_n
        control = self._controller.step(
            t_us,
            nav,
            goal,
            fence,
            self._params,
            limit_n,
            self._tracks.round(t_us, nav.pos_ned_m),
            delay_s=None if actuation.delay.doubtful else actuation.delay.delay_s,
        )
        control = checked_output(control, limit_n)
        solved = control.status.status is SolveStatus.OK and control.status.fallback is Fallback.NONE
        self.solver_failures = 0 if solved or actuation.delay.doubtful else self.solver_failures + 1
        self._wanted_n, self.status = control.thrust_n, control.status
        self.ahead = control.nominal if len(control.nominal) else None
        self.path_left_m = _length_m(control.route_ned_m)
        return control


def _length_m(route: FloatArray) -> float | None:
    """Length of a polyline (m, 2), None without one."""
    step = route[1:] - route[:-1]
    return float(np.hypot(step[:, 0], step[:, 1]).sum()) if len(step) else None
