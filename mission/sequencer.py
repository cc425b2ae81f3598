"""Execution of the mission: current goal, items reached, and progress.

A pure state machine, stepped once per tick with the estimate. A waypoint is reached when the vehicle has stayed
inside the acceptance ball (3-D) and, if a heading is given, inside the heading band, for the hold time without
interruption.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from autopilot.core.errors import PlanError
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import Goal, MissionProgress, NavState, ProgressState
from autopilot.mission.circling import LoiterCircle
from autopilot.mission.items import (
    ChangeSpeed,
    GoTo,
    Instant,
    Jump,
    LoiterTurns,
    Order,
    Passage,
    RegionOfInterest,
    ReturnHome,
    SetHeading,
    SetHome,
    Step,
    Surface,
    Timed,
    Travel,
    Wait,
    flown_order,
)
from autopilot.mission.payload_items import stays
from autopilot.mission.step_goals import RunMemory, StepGoals
from autopilot.mission.step_goals import is_inside as is_inside

MAX_INSTANT_STEPS = 64
"""Steps without duration that one tick may run; a plan of thousands of empty jumps is spread over ticks."""


class Action(StrEnum):
    """Request of the mission to the mode logic, for one tick."""

    SURFACE = "surface"
    """NAV_LAND has reached the top of the depth band: surface and disarm."""
    HOLD = "hold"
    """The mission is complete; the goal stays where it is."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SequencerOutput:
    goal: Goal | None
    """None while no mission runs and while the estimate is not finite."""
    progress: MissionProgress
    reached: tuple[int, ...] = ()
    """Items reached on this tick (NAV commands only)."""
    action: Action | None = None
    home_ned_m: FloatArray | None = None
    """(3,) new home, on the tick on which a DO_SET_HOME ran."""
    orders: tuple[Order, ...] = ()
    """Payload orders, in the order in which the mission passed them on this tick."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Position:
    """Mission progress: state needed to resume after a restart."""

    cursor: int
    """Step that runs next."""
    reached_seq: int
    lap: int
    jumps_done: tuple[tuple[int, int], ...]
    """(step of a jump, how often it was made)."""
    speed_m_s: float | None
    default_yaw_rad: float | None
    facing_ned_m: tuple[float, float] | None = None
    standing: tuple[tuple[str, int], ...] = ()
    """Payload orders in force: kind, and step of the order."""


class Sequencer:
    """Runs the steps of one mission. Parameters are read live: WP_ACCEPT_RADIUS, WP_ACCEPT_YAW, SPD_CRUISE, DEPTH_*."""

    def __init__(self, params: Mapping[str, float]) -> None:
        self._params = params
        self._goals = StepGoals(params)
        self._reached_now: list[int] = []
        self._action: Action | None = None
        self._new_home: FloatArray | None = None
        self._orders: list[Order] = []
        self._repeats = False
        """Whether the orders in force are given again."""
        self._lap_marker = -1

    @property
    def _run(self) -> RunMemory:
        return self._goals.run

    @property
    def _steps(self) -> tuple[Step, ...]:
        return self._goals.steps

    @property
    def state(self) -> ProgressState:
        return self._run.state

    def load(self, steps: Sequence[Step]) -> None:
        """Take a new mission and stand at its beginning, not started. An empty one = no mission."""
        self._goals.steps = tuple(steps)
        jumps = [i for i, s in enumerate(self._steps) if isinstance(s, Jump)]
        placed = [i for i, s in enumerate(self._steps) if isinstance(s, GoTo)]
        self._lap_marker = (jumps or placed or [-1])[0]
        self._clear(0)

    def start(self, first_seq: int | None = None) -> None:
        """Run. ``first_seq``: restart from that item; None: resume, or restart when the mission was complete.
        PlanError when there is no mission or no such item, without any change.
        """
        if not self._steps:
            raise PlanError("no mission to start; upload one first")
        if first_seq is not None:
            self._check_seq(first_seq)
            self._clear(first_seq)
        elif self._run.state is ProgressState.COMPLETE:
            self._clear(0)
        self._run.state = ProgressState.ACTIVE
        self._run.inside_since_us = self._run.clock_us = None

    def pause(self) -> None:
        """Hold from the next tick on; the progress is kept."""
        if self._run.state is ProgressState.ACTIVE:
            self._run.state = ProgressState.PAUSED
            self._run.pause_goal = None

    def run_copy(self) -> RunMemory:
        """The state of the run, for :meth:`restore_run` when an order that changes it is refused."""
        run = self._run
        return replace(
            run,
            jumps_done=dict(run.jumps_done),
            flown_at_jump=dict(run.flown_at_jump),
            standing=dict(run.standing),
        )

    def repeat_orders(self) -> None:
        """Give the payload orders in force again when the mission goes on: disarming and restarts end them."""
        self._repeats = True

    def restore_run(self, run: RunMemory) -> None:
        self._goals.run = run

    def set_current(self, seq: int, *, reset: bool = False) -> None:
        """Choose the item that runs next (at once when active). ``reset``: jumps and laps count from 0 again.
        PlanError for an unknown item."""
        self._check_seq(seq)
        if self._run.state is ProgressState.COMPLETE:
            self._clear(seq)
        run = self._run
        if run.goal is not None and run.circle is not None:
            run.goal = replace(run.goal, drive=None)
        run.cursor, run.circle, run.given_up_seq = seq, None, -1
        run.entered = run.rising = run.ending = False
        run.flown_at_jump.clear()  # a jump that the operator chooses is none of a loop
        run.standing = {kind: step for kind, step in run.standing.items() if step < seq}  # the others are to come
        if reset:
            run.jumps_done.clear()
            run.lap = 0

    @property
    def position(self) -> Position | None:
        """Mission progress, None when there is nothing to resume."""
        run = self._run
        if run.state not in (ProgressState.ACTIVE, ProgressState.PAUSED, ProgressState.NOT_STARTED):
            return None
        return Position(
            cursor=run.cursor,
            reached_seq=run.reached_seq,
            lap=run.lap,
            jumps_done=tuple(run.jumps_done.items()),
            speed_m_s=run.speed_m_s,
            default_yaw_rad=run.default_yaw_rad,
            facing_ned_m=None if run.facing_ned_m is None else (float(run.facing_ned_m[0]), float(run.facing_ned_m[1])),
            standing=tuple(run.standing.items()),
        )

    def stand_at(self, position: Position) -> None:
        """Stand where this mission stood once, not started. PlanError when it has no such item."""
        self._check_seq(position.cursor)
        self._clear(position.cursor)
        run = self._run
        run.reached_seq, run.lap, run.jumps_done = position.reached_seq, position.lap, dict(position.jumps_done)
        run.speed_m_s, run.default_yaw_rad = position.speed_m_s, position.default_yaw_rad
        run.facing_ned_m = None if position.facing_ned_m is None else np.array(position.facing_ned_m)
        for kind, step in position.standing:
            self._check_seq(step)
            run.standing[kind] = step

    @property
    def travelling(self) -> bool:
        """Whether the vehicle is on its way to the goal of an item, not there (or waiting)."""
        run = self._run
        if run.state is not ProgressState.ACTIVE or not run.entered or run.inside_since_us is not None:
            return False
        return isinstance(self._steps[run.cursor], Travel | LoiterTurns | Passage)

    @property
    def circle_left_m(self) -> float | None:
        """Path length left of the present circle, None without one."""
        return None if self._run.circle is None else self._run.circle.left_m

    @property
    def circle(self) -> LoiterCircle | None:
        """The present one, None without one."""
        return self._run.circle

    def first_circle(self, nav: NavState) -> LoiterCircle | None:
        """The circle that a mission begins with that has not flown yet, None if it begins with another item."""
        run = self._run
        if run.goal is not None:
            return None
        ahead = flown_order(self._steps, MAX_INSTANT_STEPS, run.cursor, run.jumps_done.items())
        step = next((step for step in ahead if isinstance(step, Timed)), None)
        return self._goals.circle_of(step, nav) if isinstance(step, LoiterTurns) else None

    def skip(self, nav: NavState) -> None:
        """Abandon the present item and continue with the next. It does not count as reached. NAV_LAND surfaces
        where the vehicle is; a mission that ends with the item is complete on the next tick.
        """
        run = self._run
        if not self.travelling:
            return
        step = self._steps[run.cursor]
        run.skipped += 1
        if isinstance(step, Surface):
            here = self._goals.here(nav)
            if here is None or run.rising:
                return
            run.rising = True
            place = np.array([*here.pos_ned_m[:2], self._params["DEPTH_MIN"]])
            run.goal = self._goals.of(replace(step, yaw_rad=None), place)
        elif isinstance(step, ReturnHome):
            run.ending = True
        else:
            if run.goal is not None:
                run.given_up_seq = run.goal.seq if isinstance(step, Passage) else -1
                run.goal = replace(run.goal, drive=None)
            self._pass_over()

    def _pass_over(self) -> None:
        """Continue after the present item, which is abandoned; at the end with the mission's end action."""
        run = self._run
        run.flown += 1
        if run.cursor == self._lap_marker:
            run.lap += 1
        run.ending = run.cursor + 1 >= len(self._steps)
        if not run.ending:
            self._advance(run.cursor + 1)

    @property
    def skipped(self) -> int:
        """Items given up in this run."""
        return self._run.skipped

    @property
    def gave_up_end(self) -> bool:
        """Whether the last item of this run was given up."""
        return self._run.ending

    def set_home(self, pos_ned_m: FloatArray) -> None:
        """Position (3,) of NAV_RETURN_TO_LAUNCH, at the depth of the goal before it."""
        self._goals.home_ned_m = np.array(pos_ned_m, dtype=np.float64)

    def set_speed(self, speed_m_s: float | None) -> None:
        """Cruise speed from now on, None = SPD_CRUISE. A DO_CHANGE_SPEED later in the plan replaces it."""
        self._run.speed_m_s = speed_m_s
        self._goals.refresh()

    def step(self, t_us: int, nav: NavState) -> SequencerOutput:
        """One tick. Same calls, same outputs."""
        self._reached_now, self._action, self._new_home, self._orders = [], None, None, []
        if self._run.state is ProgressState.ACTIVE:
            if self._repeats:
                self._repeats = False
                self._orders += [step for k in self._run.standing.values() if isinstance(step := self._steps[k], Order)]
            self._run_steps(t_us, nav)
        run = self._run
        goal = run.goal
        if run.state is ProgressState.PAUSED:
            if run.pause_goal is None:
                run.pause_goal = self._goals.here(nav)
            goal = run.pause_goal
        elif run.state in (ProgressState.NO_MISSION, ProgressState.NOT_STARTED):
            goal = None
        return SequencerOutput(
            goal=goal,
            progress=self.progress(t_us),
            reached=tuple(self._reached_now),
            action=self._action,
            home_ned_m=self._new_home,
            orders=tuple(self._orders),
        )

    def progress(self, t_us: int) -> MissionProgress:
        """How far the mission is, for telemetry between ticks too."""
        run = self._run
        return MissionProgress(
            t_us=t_us, current_seq=run.cursor, reached_seq=run.reached_seq, lap=run.lap, state=run.state
        )

    # Inside one tick.

    def _clear(self, cursor: int) -> None:
        """Before the first tick of a run from ``cursor``."""
        self._goals.run = RunMemory(
            cursor=cursor, state=ProgressState.NOT_STARTED if self._steps else ProgressState.NO_MISSION
        )

    def _check_seq(self, seq: int) -> None:
        if not 0 <= seq < len(self._steps):
            has = f"the mission has items 0 to {len(self._steps) - 1}" if self._steps else "there is no mission"
            raise PlanError(f"mission item {seq} does not exist; {has}")

    def _run_steps(self, t_us: int, nav: NavState) -> None:
        """Run steps until one needs time. At most one step that needs time ends per tick."""
        if self._run.ending:
            self._run.goal = self._goals.here(nav) or self._run.goal
            self._complete(Action.HOLD)
            return
        ended = False
        for _ in range(MAX_INSTANT_STEPS):
            step = self._steps[self._run.cursor]
            if isinstance(step, Timed):
                if step.seq == self._run.given_up_seq and not isinstance(step, Passage):
                    self._run.given_up_seq = -1
                    self._pass_over()
                    return
                if not self._run.entered and not self._enter(step, nav):
                    return
                if ended or not self._is_done(step, t_us, nav):
                    return
                ended = True
                self._leave(step)
            else:
                self._execute(step, nav)
            if self._run.state is not ProgressState.ACTIVE:
                return

    def _execute(self, step: Instant, nav: NavState) -> None:
        """A step that takes no time."""
        if isinstance(step, Jump):
            self._jump(step)
            return
        if isinstance(step, ChangeSpeed):
            self._run.speed_m_s = step.speed_m_s
            self._goals.refresh()
        elif isinstance(step, SetHeading):
            self._set_heading(step, float(nav.rpy_rad[2]))
        elif isinstance(step, Order):
            self._orders.append(step)
            self._note_standing(step)
        elif isinstance(step, RegionOfInterest):
            self._look_at(step.place_ned_m)
        elif isinstance(step, SetHome):
            place = nav.pos_ned_m if step.pos_ned_m is None else step.pos_ned_m
            if bool(np.all(np.isfinite(place))):
                self._goals.home_ned_m = np.array(place, dtype=np.float64)
                self._new_home = self._goals.home_ned_m
        self._advance(self._run.cursor + 1)

    def _note_standing(self, order: Order) -> None:
        standing = self._run.standing
        for kind, there in stays(order).items():
            if there:
                standing[kind] = self._run.cursor
            else:
                standing.pop(kind, None)

    def _set_heading(self, step: SetHeading, yaw_rad: float) -> None:
        """The heading of later goals and, for a wait that follows, of the present one."""
        if step.relative and not math.isfinite(yaw_rad):
            return
        heading = wrap_pi(yaw_rad + step.yaw_rad) if step.relative else step.yaw_rad
        self._run.default_yaw_rad = heading
        if self._run.goal is not None:
            self._run.goal = replace(self._run.goal, yaw_rad=heading)

    def _look_at(self, place_ned_m: FloatArray | None) -> None:
        """Face a point, now and in the following items."""
        run = self._run
        run.facing_ned_m = place_ned_m
        if run.goal is not None:
            yaw = run.goal.yaw_rad if place_ned_m is None else None
            run.goal = replace(run.goal, facing_ned_m=place_ned_m, yaw_rad=yaw)

    def _jump(self, step: Jump) -> None:
        if self._run.cursor == self._lap_marker:
            self._run.lap += 1
        done = self._run.jumps_done.get(self._run.cursor, 0)
        if self._run.flown_at_jump.get(self._run.cursor) == (self._run.flown, self._run.counted):
            # Nothing was flown or counted since: further repetitions of the jump would be as empty.
            done = 0 if step.count is None else step.count
            self._run.jumps_done[self._run.cursor] = done
            self._advance(self._run.cursor + 1)
            return
        if step.count is not None and done >= step.count:
            self._advance(self._run.cursor + 1)
            return
        if step.count is not None:
            self._run.jumps_done[self._run.cursor] = done + 1
            self._run.counted += 1
        self._run.flown_at_jump[self._run.cursor] = self._run.flown, self._run.counted
        self._advance(step.target_seq)

    def _advance(self, cursor: int) -> None:
        """Go to another step, or complete the mission behind the last one."""
        self._run.entered = False
        self._run.rising = False
        self._run.circle = None
        if cursor >= len(self._steps):
            self._complete(Action.HOLD)
        else:
            self._run.cursor = cursor

    def _complete(self, action: Action) -> None:
        self._run.state = ProgressState.COMPLETE
        self._action = action

    def _enter(self, step: Timed, nav: NavState) -> bool:
        """Set the goal of a step. False (try again on the next tick) while it needs an estimate that is not finite."""
        goal = self._goals.first(step, nav)
        if goal is None:
            return False
        old = self._run.goal
        if old is None or not np.array_equal(old.pos_ned_m, goal.pos_ned_m):
            self._run.leg_from_ned_m = nav.pos_ned_m if old is None else old.pos_ned_m
        self._run.goal = goal
        self._run.entered = True
        self._run.rising = isinstance(step, Surface) and step.pos_ned_m is None
        self._run.inside_since_us = self._run.clock_us = None
        self._run.waited_us = 0
        return True

    def _is_done(self, step: Timed, t_us: int, nav: NavState) -> bool:
        """Whether a step that takes time has ended."""
        if isinstance(step, Wait):
            since_us = t_us if self._run.clock_us is None else self._run.clock_us
            self._run.waited_us += t_us - since_us
            self._run.clock_us = t_us
            return self._run.waited_us >= step.duration_s * 1e6
        if isinstance(step, LoiterTurns):
            circle = self._run.circle
            if circle is None:
                return True
            self._run.goal = self._goals.round(circle, nav)
            if circle.over:
                self._run.goal = circle.rest(nav)
            return circle.over
        if isinstance(step, Passage):
            return self._goals.is_passed(step, nav)
        run = self._run
        if run.goal is None or not is_inside(run.goal, nav):
            run.inside_since_us = None
            return False
        if run.inside_since_us is None:
            run.inside_since_us = t_us
        if isinstance(step, GoTo):
            return step.hold_s is not None and t_us - run.inside_since_us >= step.hold_s * 1e6
        if isinstance(step, Surface) and not run.rising:
            run.rising = True
            place = run.goal.pos_ned_m
            run.goal = self._goals.of(step, np.array([place[0], place[1], self._params["DEPTH_MIN"]]))
            run.inside_since_us = None
            return False
        return True

    def _leave(self, step: Timed) -> None:
        """Report the end of a step and continue."""
        self._run.flown += 1
        if step.reported if isinstance(step, Wait) else not isinstance(step, Passage):
            self._reached_now.append(step.seq)
            self._run.reached_seq = step.seq
        if self._run.cursor == self._lap_marker:
            self._run.lap += 1
        if isinstance(step, Surface):
            self._complete(Action.SURFACE)
        elif isinstance(step, ReturnHome):
            self._complete(Action.HOLD)
        else:
            self._advance(self._run.cursor + 1)
            if (
                isinstance(step, GoTo | LoiterTurns)
                and not step.autocontinue
                and self._run.state is ProgressState.ACTIVE
            ):
                self._run.state = ProgressState.PAUSED
                self._run.pause_goal = self._run.goal
