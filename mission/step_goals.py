"""Goals of a mission's steps: positions within the depth band, headings, speeds, and the path beyond."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np

from autopilot.core.acceptance import sure_limit
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import Goal, NavHealth, NavState, ProgressState
from autopilot.mission.circling import LoiterCircle
from autopilot.mission.items import (
    ChangeSpeed,
    Gate,
    GoTo,
    Jump,
    LoiterTurns,
    Near,
    NoOp,
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
from autopilot.mission.mission_tuning import STEP_GOALS

LONGEST_WALK = 64
"""Maximum number of steps examined: bounds plans of empty jumps."""


PASSED = (ChangeSpeed, SetHome, Order, NoOp, *get_args(Passage))
"""Steps without effect on the path to the next waypoint."""


def passes_on(step: Step) -> bool:
    """Whether the mission continues from a step as soon as its region is entered."""
    return isinstance(step, GoTo) and step.hold_s == 0.0 and step.autocontinue


def walk(steps: Sequence[Step], cursor: int, jumps_done: Mapping[int, int]) -> Iterator[int]:
    """Steps in the order of execution after step ``cursor``, with the remaining jumps. Bounded, because a mission
    may loop for ever.
    """
    done = dict(jumps_done)
    cursor += 1
    for _ in range(LONGEST_WALK):
        if cursor >= len(steps):
            return
        step = steps[cursor]
        if isinstance(step, Jump):
            taken = done.get(cursor, 0)
            go = step.count is None or taken < step.count
            done[cursor] = taken + 1
            cursor = step.target_seq if go else cursor + 1
        else:
            yield cursor
            cursor += 1


def next_waypoint(
    steps: Sequence[Step],
    cursor: int,
    jumps_done: Mapping[int, int],
    default_yaw_rad: float | None,
    visit: Callable[[GoTo, float | None], None],
    count: int,
) -> None:
    """Call ``visit`` with the next ``count`` waypoints (and the heading of those that leave it free) after step
    ``cursor``. The walk ends at a waypoint that is not passed without a stop (it is still visited) and before any other
    step that takes time or whose effect is not known yet."""
    if not passes_on(steps[cursor]):
        return
    for index in walk(steps, cursor, jumps_done):
        step = steps[index]
        if isinstance(step, SetHeading) and not step.relative:
            default_yaw_rad = step.yaw_rad
        elif isinstance(step, GoTo) and step.pos_ned_m is not None:
            visit(step, default_yaw_rad)
            count -= 1
            if count == 0 or not passes_on(step):
                return
        elif not isinstance(step, PASSED):
            return


def next_place(steps: Sequence[Step], cursor: int, jumps_done: Mapping[int, int]) -> int | None:
    """The next step after ``cursor`` with a position, None without one (or not within the longest walk)."""
    for index in walk(steps, cursor, jumps_done):
        step = steps[index]
        if isinstance(step, GoTo | Surface) and step.pos_ned_m is not None:
            return index
        if isinstance(step, LoiterTurns) and step.centre_ned_m is not None:
            return index
    return None


@dataclass(slots=True, eq=False, kw_only=True)
class RunMemory:
    """State of one run of the mission."""

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
    """(2,) point that the vehicle faces, None = none."""
    circle: LoiterCircle | None = None
    """Of NAV_LOITER_TURNS, while it runs."""
    leg_from_ned_m: FloatArray | None = None
    """(3,) start of the path to the present goal."""
    given_up_seq: int = -1
    """An item to skip: it was abandoned on the way, before its turn."""
    inside_since_us: int | None = None
    waited_us: int = 0
    """How long the present wait has run, pauses left out."""
    clock_us: int | None = None
    """The last tick of that wait, None = it (or its pause) has just begun or ended."""
    rising: bool = False
    """NAV_LAND: above its position and ascending."""
    jumps_done: dict[int, int] = field(default_factory=dict)
    flown: int = 0
    """Steps that took time so far."""
    counted: int = 0
    """Jumps with a count made so far."""
    flown_at_jump: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Both numbers when a jump (by its step) was last made."""
    standing: dict[str, int] = field(default_factory=dict)
    """Payload orders in force (by their step) of each kind: what has been started and not stopped."""
    reached_seq: int = -1
    lap: int = 0
    skipped: int = 0
    """Items given up."""
    ending: bool = False
    """The last item has been given up: complete with the next tick."""


class StepGoals:
    """Of one mission. Parameters are read live."""

    def __init__(self, params: Mapping[str, float]) -> None:
        self._params = params
        self.home_ned_m: FloatArray = np.zeros(3)
        self.steps: tuple[Step, ...] = ()
        self.run = RunMemory(cursor=0, state=ProgressState.NO_MISSION)

    def first(self, step: Timed, nav: NavState) -> Goal | None:
        """The goal that a step begins with, None while that is unknown."""
        run = self.run
        if isinstance(step, LoiterTurns):
            run.circle = self.circle_of(step, nav)
            return None if run.circle is None else self.round(run.circle, nav)
        if isinstance(step, Passage):
            return self._goal_beyond(step, nav)
        target = self._target_ned_m(step, nav)
        if target is None or (isinstance(step, Wait) and run.goal is not None):
            return None if target is None else run.goal
        return self._leading_on(self.of(step, target), run.cursor)

    def circle_of(self, step: LoiterTurns, nav: NavState) -> LoiterCircle | None:
        """Around its centre, or around the mission's present position; None while that is unknown."""
        run = self.run
        here = nav.pos_ned_m if bool(np.all(np.isfinite(nav.pos_ned_m))) else None
        last = here if run.goal is None else run.goal.pos_ned_m
        centre = last if step.centre_ned_m is None else step.centre_ned_m
        if centre is None or here is None:
            return None
        params, speed = self._params, self._circle_speed_m_s
        circle = LoiterCircle(
            params,
            (float(centre[0]), float(centre[1])),
            params["CIRCLE_RADIUS"] if step.radius_m is None else step.radius_m,
            speed if step.clockwise else -speed,
            depth_m=self._in_band(float(centre[2])),
            turns=step.turns,
            seq=step.seq,
        )
        circle.approach_m_s = run.speed_m_s
        return circle

    def round(self, circle: LoiterCircle, nav: NavState) -> Goal:
        """The circle's goal of this tick."""
        facing = self.run.facing_ned_m
        circle.facing_m = None if facing is None else (float(facing[0]), float(facing[1]))
        return circle.goal(nav)

    def _goal_beyond(self, step: Near | Gate, nav: NavState) -> Goal | None:
        """Goal of the next step with a position, to which the vehicle continues meanwhile. Without one, a gate
        itself; else the vehicle holds.
        """
        run = self.run
        if not bool(np.all(np.isfinite(nav.pos_ned_m))):
            return None
        found = next_place(self.steps, run.cursor, run.jumps_done)
        last = nav.pos_ned_m if run.goal is None else run.goal.pos_ned_m
        if found is not None:
            later = self.steps[found]
            if isinstance(later, GoTo | Surface):
                target = self._target_ned_m(later, nav)
                if target is not None:
                    return self._leading_on(self.of(later, target), found)
            if isinstance(later, LoiterTurns) and later.centre_ned_m is not None:
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
        return run.goal or self.here(nav)

    def _target_ned_m(self, step: Travel | Wait, nav: NavState) -> FloatArray | None:
        """(3,) first position of a step, None while unknown."""
        here = nav.pos_ned_m if bool(np.all(np.isfinite(nav.pos_ned_m))) else None
        last = here if self.run.goal is None else self.run.goal.pos_ned_m
        if isinstance(step, ReturnHome):
            return None if last is None else np.array([*self.home_ned_m[:2], last[2]])
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

    def is_passed(self, step: Near | Gate, nav: NavState) -> bool:
        """Whether a condition on the path to the present goal is met; always at the goal itself."""
        goal, here = self.run.goal, nav.pos_ned_m
        if goal is None or nav.health is NavHealth.INVALID:
            return False
        if isinstance(step, Near):
            reached = math.dist(here.tolist(), goal.pos_ned_m.tolist()) <= step.distance_m
        else:
            begin = here if self.run.leg_from_ned_m is None else self.run.leg_from_ned_m
            axes = 2 if step.upright else 3
            leg = (goal.pos_ned_m - begin)[:axes]
            reached = float(leg @ leg) > 0.0 and float(leg @ (here - step.pos_ned_m)[:axes]) >= 0.0
        return reached or is_inside(goal, nav)

    def of(self, step: Travel | Wait, pos_ned_m: FloatArray) -> Goal:
        """Goal of a step at a position (3,), clipped to the depth band."""
        yaw = step.yaw_rad if isinstance(step, GoTo | Surface) else None
        radius = step.accept_radius_m if isinstance(step, GoTo) else None
        return self._goal_at(pos_ned_m, self.run.default_yaw_rad if yaw is None else yaw, radius, step.seq)

    def _goal_at(self, pos_ned_m: FloatArray, yaw_rad: float | None, radius_m: float | None, seq: int) -> Goal:
        facing = self.run.facing_ned_m
        return Goal(
            pos_ned_m=np.array([pos_ned_m[0], pos_ned_m[1], self._in_band(float(pos_ned_m[2]))], dtype=np.float64),
            yaw_rad=yaw_rad if facing is None else None,
            speed_m_s=self._speed_m_s,
            accept_radius_m=self._params["WP_ACCEPT_RADIUS"] if radius_m is None else radius_m,
            accept_yaw_rad=self._params["WP_ACCEPT_YAW"],
            seq=seq,
            speed_asked=self.run.speed_m_s is not None,
            facing_ned_m=facing,
        )

    def _in_band(self, depth_m: float) -> float:
        return min(max(depth_m, self._params["DEPTH_MIN"]), self._params["DEPTH_MAX"])

    @property
    def _speed_m_s(self) -> float:
        """Speed set by the mission, else the cruise speed."""
        commanded = self.run.speed_m_s
        return self._params["SPD_CRUISE"] if commanded is None else commanded

    @property
    def _circle_speed_m_s(self) -> float:
        """The same on a circle."""
        commanded = self.run.speed_m_s
        return (abs(self._params["CIRCLE_SPEED"]) or self._params["SPD_CRUISE"]) if commanded is None else commanded

    def _leading_on(self, goal: Goal, cursor: int) -> Goal:
        """The goal of a step with those that follow it without a stop."""
        ahead: list[Goal] = []

        def visit(step: GoTo, yaw_rad: float | None) -> None:
            if step.pos_ned_m is not None:
                yaw = yaw_rad if step.yaw_rad is None else step.yaw_rad
                ahead.append(self._goal_at(step.pos_ned_m, yaw, step.accept_radius_m, step.seq))

        run = self.run
        next_waypoint(self.steps, cursor, run.jumps_done, run.default_yaw_rad, visit, STEP_GOALS.goals_ahead)
        following = None
        for later in reversed(ahead):
            following = replace(later, following=following)
        return replace(goal, following=following)

    def here(self, nav: NavState) -> Goal | None:
        """Hold the present position and heading, None while the estimate is not finite."""
        yaw = float(nav.rpy_rad[2])
        if not bool(np.all(np.isfinite(nav.pos_ned_m))) or not math.isfinite(yaw):
            return None
        return self._goal_at(nav.pos_ned_m, yaw, None, -1)

    def refresh(self) -> None:
        """The running goal with a new speed."""
        if self.run.circle is not None:
            self.run.circle.go(self._circle_speed_m_s)
            self.run.circle.approach_m_s = self.run.speed_m_s
        elif self.run.goal is not None:
            commanded = self.run.speed_m_s is not None
            self.run.goal = replace(self.run.goal, speed_m_s=self._speed_m_s, speed_asked=commanded)


def is_inside(goal: Goal, nav: NavState) -> bool:
    """Whether the vehicle is surely in the goal's acceptance ball and, if it has a heading, in its band."""
    if nav.health is NavHealth.INVALID:
        return False
    away_m = math.dist(nav.pos_ned_m.tolist(), goal.pos_ned_m.tolist())
    if not away_m <= goal.accept_radius_m:  # nearly always
        return False
    variance = nav.variance.tolist()
    if not away_m <= sure_limit(goal.accept_radius_m, sum(variance[:3])):
        return False
    band_rad = sure_limit(goal.accept_yaw_rad, variance[STEP_GOALS.yaw_variance])
    return goal.yaw_rad is None or abs(wrap_pi(float(nav.rpy_rad[2]) - goal.yaw_rad)) <= band_rad
