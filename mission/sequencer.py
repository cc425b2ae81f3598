"""The mission in execution: which goal holds now, what has been reached, what comes next.

A pure state machine, stepped once per tick with the estimate. A waypoint is reached when the vehicle has stayed inside
the acceptance ball (3-D) and, if a heading is asked for, inside the heading band, for the hold time without a break.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from autopilot.core.errors import PlanError
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import Goal, MissionProgress, NavHealth, NavState, ProgressState
from mission.circling import Circle
from mission.items import (
    ChangeSpeed,
    Circuit,
    Gate,
    GoTo,
    Instant,
    Jump,
    LookAt,
    Near,
    Order,
    Passage,
    ReturnHome,
    SetHeading,
    SetHome,
    Step,
    Surface,
    Timed,
    Travel,
    Wait,
)
from mission.lookahead import next_place, next_waypoint

GOALS_AHEAD = 2
"""A leg is planned with the next one's beginning in view, and the next leg while this one is flown."""

MAX_INSTANT_STEPS = 64
"""Steps without duration that one tick may run; a plan of thousands of empty jumps is spread over ticks."""


class Action(StrEnum):
    """What the mission asks of the vehicle's mode logic, on the one tick on which it does."""

    SURFACE = "surface"
    """NAV_LAND has come up to the top of the depth band: surface and disarm."""
    HOLD = "hold"
    """The mission is complete; the goal stays where it is."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SequencerOutput:
    """Result of one tick."""

    goal: Goal | None
    """None while no mission runs and while the estimate is not finite."""
    progress: MissionProgress
    reached: tuple[int, ...] = ()
    """Items reached on this tick (NAV commands only)."""
    action: Action | None = None
    home_ned_m: FloatArray | None = None
    """(3,) new home, on the tick on which a DO_SET_HOME ran."""
    orders: tuple[Order, ...] = ()
    """For the equipment, in the order in which the mission came by them on this tick."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Position:
    """Where a mission stands: all that it takes to go on with it after a restart."""

    cursor: int
    """Step that runs next."""
    reached_seq: int
    lap: int
    jumps_done: tuple[tuple[int, int], ...]
    """(step of a jump, how often it was made)."""
    speed_m_s: float | None
    default_yaw_rad: float | None
    facing_ned_m: tuple[float, float] | None = None


@dataclass(slots=True, eq=False, kw_only=True)
class _Run:
    """What is remembered of one run of the mission."""

    cursor: int
    """Step that runs now."""
    state: ProgressState
    entered: bool = False
    """Whether the goal of the present step has been set."""
    goal: Goal | None = None
    pause_goal: Goal | None = None
    default_yaw_rad: float | None = None
    """Heading of goals that leave it free (CONDITION_YAW)."""
    speed_m_s: float | None = None
    """None = SPD_CRUISE."""
    facing_ned_m: FloatArray | None = None
    """(2,) what the vehicle looks at, None = nothing."""
    circle: Circle | None = None
    """Of NAV_LOITER_TURNS, while it runs."""
    leg_from_ned_m: FloatArray | None = None
    """(3,) where the way to the present goal begins."""
    given_up_seq: int = -1
    """An item to pass over: it was given up on the way, before its turn."""
    inside_since_us: int | None = None
    waited_us: int = 0
    """How long the present wait has run, pauses left out."""
    clock_us: int | None = None
    """The last tick of that wait, None = it (or its pause) has just begun or ended."""
    rising: bool = False
    """NAV_LAND: above its place and on the way up."""
    jumps_done: dict[int, int] = field(default_factory=dict)
    flown: int = 0
    """Steps that took time so far."""
    flown_at_jump: dict[int, int] = field(default_factory=dict)
    """That number when a jump (by its step) was last made."""
    reached_seq: int = -1
    lap: int = 0
    skipped: int = 0
    """Items given up."""
    ending: bool = False
    """The last item has been given up: complete with the next tick."""


class Sequencer:
    """Runs the steps of one mission. Parameters are read live: WP_ACCEPT_RADIUS, WP_ACCEPT_YAW, SPD_CRUISE, DEPTH_*."""

    def __init__(self, params: Mapping[str, float]) -> None:
        self._params = params
        self._home_ned_m: FloatArray = np.zeros(3)
        self._reached_now: list[int] = []
        self._action: Action | None = None
        self._new_home: FloatArray | None = None
        self._orders: list[Order] = []
        self._steps: tuple[Step, ...] = ()
        self._lap_marker = -1
        self._run = _Run(cursor=0, state=ProgressState.NO_MISSION)

    @property
    def state(self) -> ProgressState:
        """Where the mission stands."""
        return self._run.state

    def load(self, steps: Sequence[Step]) -> None:
        """Take a new mission and stand at its beginning, not started. An empty one = no mission."""
        self._steps = tuple(steps)
        jumps = [i for i, s in enumerate(self._steps) if isinstance(s, Jump)]
        placed = [i for i, s in enumerate(self._steps) if isinstance(s, GoTo)]
        self._lap_marker = (jumps or placed or [-1])[0]
        self._clear(0)

    def start(self, first_seq: int | None = None) -> None:
        """Run. ``first_seq`` = anew from that item; None = go on, or anew when the mission was complete.

        PlanError when there is no mission or no such item; nothing has changed then.
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
        """Hold where the vehicle is on the next tick; the mission stays where it is."""
        if self._run.state is ProgressState.ACTIVE:
            self._run.state = ProgressState.PAUSED
            self._run.pause_goal = None

    def set_current(self, seq: int) -> None:
        """Choose the item that runs next (at once when active). PlanError when there is no such item."""
        self._check_seq(seq)
        if self._run.state is ProgressState.COMPLETE:
            self._clear(seq)
        self._run.cursor = seq
        self._run.entered = False

    @property
    def position(self) -> Position | None:
        """Where the mission stands, None when there is nothing to go on with."""
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
        )

    def stand_at(self, position: Position) -> None:
        """Stand where this mission stood once, not started. PlanError when it has no such item."""
        self._check_seq(position.cursor)
        self._clear(position.cursor)
        run = self._run
        run.reached_seq, run.lap, run.jumps_done = position.reached_seq, position.lap, dict(position.jumps_done)
        run.speed_m_s, run.default_yaw_rad = position.speed_m_s, position.default_yaw_rad
        run.facing_ned_m = None if position.facing_ned_m is None else np.array(position.facing_ned_m)

    @property
    def travelling(self) -> bool:
        """Whether the vehicle is on its way to the goal of an item, and not there (or waiting)."""
        run = self._run
        if run.state is not ProgressState.ACTIVE or not run.entered or run.inside_since_us is not None:
            return False
        return isinstance(self._steps[run.cursor], Travel | Circuit | Passage)

    @property
    def circle_left_m(self) -> float | None:
        """Way that is left of the circle that is flown, None when none is."""
        return None if self._run.circle is None else self._run.circle.left_m

    def skip(self, nav: NavState) -> None:
        """Give the present item up: go on with the next as if it were over. It does not count as reached. NAV_LAND
        comes up where the vehicle is, a mission that ends with the item is complete on the next tick."""
        run = self._run
        if not self.travelling:
            return
        step = self._steps[run.cursor]
        run.skipped += 1
        if isinstance(step, Surface):
            here = self._goal_here(nav)
            if here is None or run.rising:
                return
            run.rising = True
            place = np.array([*here.pos_ned_m[:2], self._params["DEPTH_MIN"]])
            run.goal = self._make_goal(replace(step, yaw_rad=None), place)
        elif isinstance(step, ReturnHome):
            run.ending = True
        else:
            if run.goal is not None:
                run.given_up_seq = run.goal.seq if isinstance(step, Passage) else -1
                run.goal = replace(run.goal, drive=None)
            self._pass_over()

    def _pass_over(self) -> None:
        """Go on behind the present item, which is given up; at the end with what a mission ends with."""
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

    def set_home(self, pos_ned_m: FloatArray) -> None:
        """Where NAV_RETURN_TO_LAUNCH goes (3,), at the depth of the goal before it."""
        self._home_ned_m = np.array(pos_ned_m, dtype=np.float64)

    def set_speed(self, speed_m_s: float | None) -> None:
        """Cruise speed from now on, None = SPD_CRUISE. A DO_CHANGE_SPEED later in the plan replaces it."""
        self._run.speed_m_s = speed_m_s
        self._refresh_goal()

    def step(self, t_us: int, nav: NavState) -> SequencerOutput:
        """One tick. Same calls, same outputs."""
        self._reached_now, self._action, self._new_home, self._orders = [], None, None, []
        if self._run.state is ProgressState.ACTIVE:
            self._run_steps(t_us, nav)
        goal = self._run.goal
        if self._run.state is ProgressState.PAUSED:
            if self._run.pause_goal is None:
                self._run.pause_goal = self._goal_here(nav)
            goal = self._run.pause_goal
        elif self._run.state in (ProgressState.NO_MISSION, ProgressState.NOT_STARTED):
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
        return MissionProgress(
            t_us=t_us,
            current_seq=self._run.cursor,
            reached_seq=self._run.reached_seq,
            lap=self._run.lap,
            state=self._run.state,
        )

    # Inside one tick.

    def _clear(self, cursor: int) -> None:
        """Before the first tick of a run from ``cursor``."""
        self._run = _Run(cursor=cursor, state=ProgressState.NOT_STARTED if self._steps else ProgressState.NO_MISSION)

    def _check_seq(self, seq: int) -> None:
        if not 0 <= seq < len(self._steps):
            has = f"the mission has items 0 to {len(self._steps) - 1}" if self._steps else "there is no mission"
            raise PlanError(f"mission item {seq} does not exist; {has}")

    def _run_steps(self, t_us: int, nav: NavState) -> None:
        """Run steps until one needs time. At most one step that needs time ends per tick."""
        if self._run.ending:
            self._run.ending = False
            self._run.goal = self._goal_here(nav) or self._run.goal
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
            self._refresh_goal()
        elif isinstance(step, SetHeading):
            self._set_heading(step, float(nav.rpy_rad[2]))
        elif isinstance(step, Order):
            self._orders.append(step)
        elif isinstance(step, LookAt):
            self._look_at(step.place_ned_m)
        elif isinstance(step, SetHome):
            place = nav.pos_ned_m if step.pos_ned_m is None else step.pos_ned_m
            if bool(np.all(np.isfinite(place))):
                self._home_ned_m = np.array(place, dtype=np.float64)
                self._new_home = self._home_ned_m
        self._advance(self._run.cursor + 1)

    def _set_heading(self, step: SetHeading, yaw_rad: float) -> None:
        """The heading of later goals and, for a wait that follows, of the present one."""
        if step.relative and not math.isfinite(yaw_rad):
            return
        heading = wrap_pi(yaw_rad + step.yaw_rad) if step.relative else step.yaw_rad
        self._run.default_yaw_rad = heading
        if self._run.goal is not None:
            self._run.goal = replace(self._run.goal, yaw_rad=heading)

    def _look_at(self, place_ned_m: FloatArray | None) -> None:
        """Now, and wherever the mission goes from here on."""
        run = self._run
        run.facing_ned_m = place_ned_m
        if run.goal is not None:
            yaw = run.goal.yaw_rad if place_ned_m is None else None
            run.goal = replace(run.goal, facing_ned_m=place_ned_m, yaw_rad=yaw)

    def _jump(self, step: Jump) -> None:
        if self._run.cursor == self._lap_marker:
            self._run.lap += 1
        done = self._run.jumps_done.get(self._run.cursor, 0)
        if self._run.flown_at_jump.get(self._run.cursor) == self._run.flown:
            # Nothing was flown since: its other turns would be as empty, be they ever so many.
            done = 0 if step.count is None else step.count
            self._run.jumps_done[self._run.cursor] = done
            self._advance(self._run.cursor + 1)
            return
        if step.count is not None and done >= step.count:
            self._advance(self._run.cursor + 1)
            return
        self._run.flown_at_jump[self._run.cursor] = self._run.flown
        if step.count is not None:
            self._run.jumps_done[self._run.cursor] = done + 1
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
        goal = self._first_goal(step, nav)
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

    def _first_goal(self, step: Timed, nav: NavState) -> Goal | None:
        """The goal that a step begins with, None while that is unknown."""
        run = self._run
        if isinstance(step, Circuit):
            return self._begin_circle(step, nav)
        if isinstance(step, Passage):
            return self._goal_beyond(step, nav)
        target = self._target_ned_m(step, nav)
        if target is None or (isinstance(step, Wait) and run.goal is not None):
            return None if target is None else run.goal
        return self._leading_on(self._make_goal(step, target), run.cursor)

    def _begin_circle(self, step: Circuit, nav: NavState) -> Goal | None:
        """Round its centre, or round where the mission stands."""
        run = self._run
        here = nav.pos_ned_m if bool(np.all(np.isfinite(nav.pos_ned_m))) else None
        last = here if run.goal is None else run.goal.pos_ned_m
        centre = last if step.centre_ned_m is None else step.centre_ned_m
        if centre is None or here is None:
            return None
        params, asked = self._params, run.speed_m_s
        speed = (abs(params["CIRCLE_SPEED"]) or params["SPD_CRUISE"]) if asked is None else asked
        run.circle = Circle(
            params,
            (float(centre[0]), float(centre[1])),
            params["CIRCLE_RADIUS"] if step.radius_m is None else step.radius_m,
            speed if step.clockwise else -speed,
            depth_m=self._in_band(float(centre[2])),
            turns=step.turns,
            seq=step.seq,
        )
        return self._round(run.circle, nav)

    def _round(self, circle: Circle, nav: NavState) -> Goal:
        """The circle's goal of this tick."""
        facing = self._run.facing_ned_m
        circle.facing_m = None if facing is None else (float(facing[0]), float(facing[1]))
        return circle.goal(nav)

    def _goal_beyond(self, step: Near | Gate, nav: NavState) -> Goal | None:
        """The goal of the next step that has a place: the vehicle goes on to it meanwhile. Without one, a gate itself;
        else the vehicle stays."""
        run = self._run
        if not bool(np.all(np.isfinite(nav.pos_ned_m))):
            return None
        found = next_place(self._steps, run.cursor, run.jumps_done)
        last = nav.pos_ned_m if run.goal is None else run.goal.pos_ned_m
        if found is not None:
            later = self._steps[found]
            if isinstance(later, GoTo | Surface):
                target = self._target_ned_m(later, nav)
                if target is not None:
                    return self._leading_on(self._make_goal(later, target), found)
            if isinstance(later, Circuit) and later.centre_ned_m is not None:
                radius_m = self._params["CIRCLE_RADIUS"] if later.radius_m is None else later.radius_m
                away = nav.pos_ned_m[:2] - later.centre_ned_m[:2]
                out = away / max(float(np.hypot(*away)), 1e-6)
                place = np.array([*(later.centre_ned_m[:2] + radius_m * out), later.centre_ned_m[2]])
                return self._goal_at(place, run.default_yaw_rad, None, later.seq)
        if isinstance(step, Gate):
            return self._goal_at(
                np.array([*step.pos_ned_m[:2], last[2] if step.upright else step.pos_ned_m[2]]),
                run.default_yaw_rad,
                None,
                step.seq,
            )
        return run.goal or self._goal_here(nav)

    def _target_ned_m(self, step: Travel | Wait, nav: NavState) -> FloatArray | None:
        """(3,) where a step goes first, None while that is unknown."""
        here = nav.pos_ned_m if bool(np.all(np.isfinite(nav.pos_ned_m))) else None
        last = here if self._run.goal is None else self._run.goal.pos_ned_m
        if isinstance(step, ReturnHome):
            return None if last is None else np.array([*self._home_ned_m[:2], last[2]])
        if isinstance(step, GoTo) and step.dives and here is not None:
            depth_m = self._params["TKOFF_DEPTH"] if step.dive_m is None else step.dive_m
            return np.array([here[0], here[1], depth_m])
        if isinstance(step, GoTo):
            return here if step.pos_ned_m is None else step.pos_ned_m
        if isinstance(step, Wait) or last is None:
            return last
        if step.pos_ned_m is None:
            return np.array([last[0], last[1], self._params["DEPTH_MIN"]])
        return np.array([step.pos_ned_m[0], step.pos_ned_m[1], last[2]])

    def _is_done(self, step: Timed, t_us: int, nav: NavState) -> bool:
        """Whether a step that takes time has ended."""
        if isinstance(step, Wait):
            since_us = t_us if self._run.clock_us is None else self._run.clock_us
            self._run.waited_us += t_us - since_us
            self._run.clock_us = t_us
            return self._run.waited_us >= step.duration_s * 1e6
        if isinstance(step, Circuit):
            circle = self._run.circle
            if circle is None:
                return True
            self._run.goal = self._round(circle, nav)
            if circle.over:
                self._run.goal = circle.rest(nav)
            return circle.over
        if isinstance(step, Passage):
            return self._is_passed(step, nav)
        if self._run.goal is None or not is_inside(self._run.goal, nav):
            self._run.inside_since_us = None
            return False
        if self._run.inside_since_us is None:
            self._run.inside_since_us = t_us
        if isinstance(step, GoTo):
            return step.hold_s is not None and t_us - self._run.inside_since_us >= step.hold_s * 1e6
        if isinstance(step, Surface) and not self._run.rising:
            self._run.rising = True
            place = self._run.goal.pos_ned_m
            self._run.goal = self._make_goal(step, np.array([place[0], place[1], self._params["DEPTH_MIN"]]))
            self._run.inside_since_us = None
            return False
        return True

    def _is_passed(self, step: Near | Gate, nav: NavState) -> bool:
        """Whether a condition of the way to the present goal has come true; at the goal itself it has."""
        goal, here = self._run.goal, nav.pos_ned_m
        if goal is None or nav.health is NavHealth.INVALID:
            return False
        if isinstance(step, Near):
            reached = math.dist(here.tolist(), goal.pos_ned_m.tolist()) <= step.distance_m
        else:
            begin = here if self._run.leg_from_ned_m is None else self._run.leg_from_ned_m
            axes = 2 if step.upright else 3
            way = (goal.pos_ned_m - begin)[:axes]
            reached = float(way @ way) > 0.0 and float(way @ (here - step.pos_ned_m)[:axes]) >= 0.0
        return reached or is_inside(goal, nav)

    def _leave(self, step: Timed) -> None:
        """Report the end of a step and go on."""
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
            if isinstance(step, GoTo | Circuit) and not step.autocontinue and self._run.state is ProgressState.ACTIVE:
                self._run.state = ProgressState.PAUSED
                self._run.pause_goal = self._run.goal

    # Goals.

    def _make_goal(self, step: Travel | Wait, pos_ned_m: FloatArray) -> Goal:
        """The goal of a step at a place (3,), which is brought into the depth band."""
        yaw = step.yaw_rad if isinstance(step, GoTo | Surface) else None
        radius = step.accept_radius_m if isinstance(step, GoTo) else None
        return self._goal_at(pos_ned_m, self._run.default_yaw_rad if yaw is None else yaw, radius, step.seq)

    def _goal_at(self, pos_ned_m: FloatArray, yaw_rad: float | None, radius_m: float | None, seq: int) -> Goal:
        facing = self._run.facing_ned_m
        return Goal(
            pos_ned_m=np.array([pos_ned_m[0], pos_ned_m[1], self._in_band(float(pos_ned_m[2]))], dtype=np.float64),
            yaw_rad=yaw_rad if facing is None else None,
            speed_m_s=self._speed_m_s,
            accept_radius_m=self._params["WP_ACCEPT_RADIUS"] if radius_m is None else radius_m,
            accept_yaw_rad=self._params["WP_ACCEPT_YAW"],
            seq=seq,
            speed_asked=self._run.speed_m_s is not None,
            facing_ned_m=facing,
        )

    def _in_band(self, depth_m: float) -> float:
        return min(max(depth_m, self._params["DEPTH_MIN"]), self._params["DEPTH_MAX"])

    @property
    def _speed_m_s(self) -> float:
        """That was asked for, else the cruise speed."""
        asked = self._run.speed_m_s
        return self._params["SPD_CRUISE"] if asked is None else asked

    def _leading_on(self, goal: Goal, cursor: int) -> Goal:
        """The goal of a step with those that follow it without a stop."""
        ahead: list[Goal] = []

        def visit(step: GoTo, yaw_rad: float | None) -> None:
            if step.pos_ned_m is not None:
                yaw = yaw_rad if step.yaw_rad is None else step.yaw_rad
                ahead.append(self._goal_at(step.pos_ned_m, yaw, step.accept_radius_m, step.seq))

        run = self._run
        next_waypoint(self._steps, cursor, run.jumps_done, run.default_yaw_rad, visit, GOALS_AHEAD)
        following = None
        for later in reversed(ahead):
            following = replace(later, following=following)
        return replace(goal, following=following)

    def _goal_here(self, nav: NavState) -> Goal | None:
        """Hold the present position and heading, None while the estimate is not finite."""
        yaw = float(nav.rpy_rad[2])
        if not bool(np.all(np.isfinite(nav.pos_ned_m))) or not math.isfinite(yaw):
            return None
        return self._goal_at(nav.pos_ned_m, yaw, None, -1)

    def _refresh_goal(self) -> None:
        """The running goal with a new speed."""
        if self._run.circle is not None and self._run.speed_m_s is not None:
            self._run.circle.go(self._run.speed_m_s)
        elif self._run.goal is not None:
            asked = self._run.speed_m_s is not None
            self._run.goal = replace(self._run.goal, speed_m_s=self._speed_m_s, speed_asked=asked)


SURE_SIGMAS = 3.0
DOUBT_SHARE = 0.1
"""Reached means surely reached: acceptance shrinks by so many standard deviations, but by this share at most."""

_YAW_VARIANCE = 5
"""Index in NavState.variance."""


def is_inside(goal: Goal, nav: NavState) -> bool:
    """Whether the vehicle is surely in the goal's acceptance ball and, if it has a heading, in its band."""
    if nav.health is NavHealth.INVALID:
        return False
    variance = nav.variance.tolist()
    radius_m = _shrunk(goal.accept_radius_m, sum(variance[:3]))
    if not math.dist(nav.pos_ned_m.tolist(), goal.pos_ned_m.tolist()) <= radius_m:
        return False
    band_rad = _shrunk(goal.accept_yaw_rad, variance[_YAW_VARIANCE])
    return goal.yaw_rad is None or abs(wrap_pi(float(nav.rpy_rad[2]) - goal.yaw_rad)) <= band_rad


def _shrunk(limit: float, variance: float) -> float:
    """An acceptance limit less what the estimate may be wrong by."""
    doubt = SURE_SIGMAS * math.sqrt(variance) if variance >= 0.0 else math.inf
    return limit - min(doubt, DOUBT_SHARE * limit)
