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
from mission.items import (
    ChangeSpeed,
    GoTo,
    Jump,
    Order,
    ReturnHome,
    SetHeading,
    SetHome,
    Step,
    Surface,
    Timed,
    Travel,
    Wait,
)
from mission.lookahead import next_waypoint

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
    inside_since_us: int | None = None
    waited_us: int = 0
    """How long the present wait has run, pauses left out."""
    clock_us: int | None = None
    """The last tick of that wait, None = it (or its pause) has just begun or ended."""
    rising: bool = False
    """NAV_LAND: above its place and on the way up."""
    jumps_done: dict[int, int] = field(default_factory=dict)
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
        )

    def stand_at(self, position: Position) -> None:
        """Stand where this mission stood once, not started. PlanError when it has no such item."""
        self._check_seq(position.cursor)
        self._clear(position.cursor)
        run = self._run
        run.reached_seq, run.lap, run.jumps_done = position.reached_seq, position.lap, dict(position.jumps_done)
        run.speed_m_s, run.default_yaw_rad = position.speed_m_s, position.default_yaw_rad

    @property
    def travelling(self) -> bool:
        """Whether the vehicle is on its way to the goal of an item, and not there (or waiting)."""
        run = self._run
        if run.state is not ProgressState.ACTIVE or not run.entered or run.inside_since_us is not None:
            return False
        return isinstance(self._steps[run.cursor], Travel)

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

    def _execute(self, step: Jump | ChangeSpeed | SetHeading | SetHome | Order, nav: NavState) -> None:
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
        else:
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

    def _jump(self, step: Jump) -> None:
        if self._run.cursor == self._lap_marker:
            self._run.lap += 1
        done = self._run.jumps_done.get(self._run.cursor, 0)
        if step.count is not None and done >= step.count:
            self._advance(self._run.cursor + 1)
            return
        if step.count is not None:
            self._run.jumps_done[self._run.cursor] = done + 1
        self._advance(step.target_seq)

    def _advance(self, cursor: int) -> None:
        """Go to another step, or complete the mission behind the last one."""
        self._run.entered = False
        self._run.rising = False
        if cursor >= len(self._steps):
            self._complete(Action.HOLD)
        else:
            self._run.cursor = cursor

    def _complete(self, action: Action) -> None:
        self._run.state = ProgressState.COMPLETE
        self._action = action

    def _enter(self, step: Timed, nav: NavState) -> bool:
        """Set the goal of a step. False (try again on the next tick) while it needs an estimate that is not finite."""
        target = self._target_ned_m(step, nav)
        if target is None:
            return False
        if not isinstance(step, Wait) or self._run.goal is None:
            self._run.goal = self._leading_on(self._make_goal(step, target))
        self._run.entered = True
        self._run.rising = isinstance(step, Surface) and step.pos_ned_m is None
        self._run.inside_since_us = self._run.clock_us = None
        self._run.waited_us = 0
        return True

    def _target_ned_m(self, step: Timed, nav: NavState) -> FloatArray | None:
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

    def _leave(self, step: Timed) -> None:
        """Report the end of a step and go on."""
        if not isinstance(step, Wait) or step.reported:
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
            if isinstance(step, GoTo) and not step.autocontinue and self._run.state is ProgressState.ACTIVE:
                self._run.state = ProgressState.PAUSED
                self._run.pause_goal = self._run.goal

    # Goals.

    def _make_goal(self, step: Timed, pos_ned_m: FloatArray) -> Goal:
        """The goal of a step at a place (3,), which is brought into the depth band."""
        yaw = step.yaw_rad if isinstance(step, GoTo | Surface) else None
        radius = step.accept_radius_m if isinstance(step, GoTo) else None
        return self._goal_at(pos_ned_m, self._run.default_yaw_rad if yaw is None else yaw, radius, step.seq)

    def _goal_at(self, pos_ned_m: FloatArray, yaw_rad: float | None, radius_m: float | None, seq: int) -> Goal:
        depth = min(max(float(pos_ned_m[2]), self._params["DEPTH_MIN"]), self._params["DEPTH_MAX"])
        return Goal(
            pos_ned_m=np.array([pos_ned_m[0], pos_ned_m[1], depth], dtype=np.float64),
            yaw_rad=yaw_rad,
            speed_m_s=self._speed_m_s,
            accept_radius_m=self._params["WP_ACCEPT_RADIUS"] if radius_m is None else radius_m,
            accept_yaw_rad=self._params["WP_ACCEPT_YAW"],
            seq=seq,
            speed_asked=self._run.speed_m_s is not None,
        )

    @property
    def _speed_m_s(self) -> float:
        """That was asked for, else the cruise speed."""
        asked = self._run.speed_m_s
        return self._params["SPD_CRUISE"] if asked is None else asked

    def _leading_on(self, goal: Goal) -> Goal:
        """The goal of the present step with those that follow it without a stop."""
        ahead: list[Goal] = []

        def visit(step: GoTo, yaw_rad: float | None) -> None:
            if step.pos_ned_m is not None:
                yaw = yaw_rad if step.yaw_rad is None else step.yaw_rad
                ahead.append(self._goal_at(step.pos_ned_m, yaw, step.accept_radius_m, step.seq))

        run = self._run
        next_waypoint(self._steps, run.cursor, run.jumps_done, run.default_yaw_rad, visit, GOALS_AHEAD)
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
        if self._run.goal is not None:
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
