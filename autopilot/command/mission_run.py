"""Execution of the mission in force: progress, speed made good on its legs, and detection of a stuck vehicle."""

import math
from collections.abc import Callable
from enum import IntEnum

import numpy as np

from autopilot.command.announcements import Announcements
from autopilot.command.command_tuning import MISSION_RUN
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.core import operator_messages as notices
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Goal, NavState, ProgressState
from autopilot.core.params import ParamSet
from autopilot.mission.circling import LoiterCircle
from autopilot.mission.goals import Goals
from autopilot.mission.items import Passage, ReturnHome, SetHome, Step, Timed
from autopilot.mission.mission_tuning import UPSTREAM, VALIDATION
from autopilot.mission.plan_check import PlanVerdict
from autopilot.mission.sequencer import Position, Sequencer, SequencerOutput
from autopilot.mission.store import Plans
from autopilot.mission.upstream import MadeGood, SlowLeg, slowest_leg


class StuckAction(IntEnum):
    """Values of WP_STUCK_ACT."""

    WARN = 0
    HOLD = 1
    SKIP = 2
    REFUSE = 3
    """Refuses the start if the current requires it; in flight as HOLD."""


class MissionRun:
    """Steps through the plan in force."""

    def __init__(
        self,
        params: ParamSet,
        plans: Plans,
        goals: Goals,
        operator: Announcements,
        speed_m_s: Callable[[NavState], float],
    ) -> None:
        """``speed_m_s``: planar speed left by the controller's margins."""
        self._params = params
        self._plans = plans
        self._goals = goals
        self._operator = operator
        self._speed_m_s = speed_m_s
        self._steps: tuple[Step, ...] = ()
        self._made_good, self._made_lately = MadeGood(), MadeGood()
        """By WP_STUCK_TIME, and by the shorter patience with a goal that the current puts out of reach."""
        self._path_judged: tuple[PlanVerdict, int, tuple[float, float], str] | None = None
        """By which plans, from which item and place, the path to the next place was judged; and what was found."""
        self._circle: LoiterCircle | None = None
        """The circle that was judged last."""
        self._given_up = False
        """The present goal has been reported as unreachable."""
        self._reported_upstream: set[tuple[int, bool]] = set()
        """Reports about the current on legs since the start of the mission."""
        self._upstream_us = 0
        self._unreported: tuple[int, ...] = ()
        """Items reached since the last report."""
        self._reached_reported_us = -MISSION_RUN.reached_us
        self.sequencer = Sequencer(params)

    def load(self) -> bool:
        """Bring the sequencer in line with the plan in force; True if the plan was another one."""
        steps = self._plans.steps()
        if steps is self._steps:
            return False
        self._steps = steps
        self.sequencer.load(steps)
        return True

    @property
    def position(self) -> Position | None:
        """Progress in the plan in force, None when there is nothing to resume or that plan is not loaded yet."""
        return self.sequencer.position if self._plans.steps() is self._steps else None

    def start(self, t_us: int, nav: NavState | None) -> None:
        self.load()
        self.sequencer.start()
        self._reported_upstream, self._upstream_us = set(), t_us
        self._report_upstream(nav)

    def set_home(self, pos_ned_m: FloatArray) -> str:
        """Set home, a point on the surface, the reference of relative altitudes. Returns the reason of a refusal,
        else "".
        """
        home_ned_m = np.array([pos_ned_m[0], pos_ned_m[1], 0.0])
        refusal = self._plans.set_home(home_ned_m)
        if not refusal:
            self.sequencer.set_home(home_ned_m)
        return refusal

    def move_home(self, pos_ned_m: FloatArray) -> None:
        """Set home to here unless it was set explicitly."""
        refusal = self.set_home(pos_ned_m)
        if refusal:
            self._operator.say(notices.HOME_KEPT(reason=refusal))

    def step(self, t_us: int, nav: NavState) -> SequencerOutput:
        out = self.sequencer.step(t_us, nav)
        self._unreported += out.reached
        if out.progress.state is ProgressState.COMPLETE:
            self._report_reached(t_us)
        return out

    def tell(self, t_us: int) -> None:
        """Report the items reached, rate-limited; also after the mission has ended."""
        if self._unreported and t_us - self._reached_reported_us >= MISSION_RUN.reached_us:
            self._report_reached(t_us)

    def _report_reached(self, t_us: int) -> None:
        """Report the items reached since the last message."""
        count = len(self._unreported)
        if not count:
            return
        if count == 1:
            text = notices.REACHED(seq=self._unreported[0])
        elif count <= MISSION_RUN.reached_named:
            text = notices.REACHED_SEVERAL(seqs=", ".join(map(str, self._unreported)))
        else:
            text = notices.REACHED_MANY(count=count, seq=self._unreported[-1])
        self._operator.say(text)
        self._unreported, self._reached_reported_us = (), t_us

    def completed(self, t_us: int, laps: int, reached: tuple[int, ...]) -> tuple[int, ...]:
        """Say that the mission is over. The result is ``reached`` with the last item: a plan that ends with DO_ items
        or a gate is over with the last of them, and MAVSDK's progress waits for its number."""
        skipped = self.sequencer.skipped
        more = f", items skipped: {skipped}" if skipped else ""
        self._operator.say(notices.MISSION_COMPLETE(laps=laps, skipped=more))
        steps = self._plans.steps()
        last = len(steps) - 1
        flown = max((*reached, self.sequencer.progress(t_us).reached_seq))
        rest, given_up = steps[flown + 1 :], self.sequencer.gave_up_end
        passed = not given_up and not any(isinstance(step, Timed) and not isinstance(step, Passage) for step in rest)
        return (*reached, last) if flown < last and passed else reached

    # Goals that are not reached

    def path_problem(self, nav: NavState) -> str:
        """Why there is no path from the vehicle to the next place of the mission, or no room for its circle there; ""
        if there is."""
        verdict, position = self._plans.verdict, self.sequencer.position
        first_seq, known = 0 if position is None else position.cursor, self._path_judged
        moved_m = math.inf if known is None else math.dist(known[2], nav.pos_ned_m[:2])
        if known is None or known[:2] != (verdict, first_seq) or moved_m > MISSION_RUN.path_moved_m:
            place = (float(nav.pos_ned_m[0]), float(nav.pos_ned_m[1]))
            self._path_judged = known = verdict, first_seq, place, verdict.path_problem(nav.pos_ned_m, first_seq)
        return known[3] or self._circle_problem(self.sequencer.first_circle(nav))

    def _circle_problem(self, circle: LoiterCircle | None) -> str:
        """Why a circle cannot be flown, "" if it can (or there is none)."""
        return "" if circle is None else self._goals.refuse_circle(circle, VALIDATION.place_tolerance_m)

    def refusal(self, nav: NavState | None) -> str:
        """Why it must not be started: no path to the next place or home, or WP_STUCK_ACT in the current of now."""
        reason, position = "" if nav is None else self.path_problem(nav), self.sequencer.position
        ahead = self._plans.steps()[0 if position is None else position.cursor :]
        if isinstance(next((step for step in ahead if isinstance(step, SetHome | ReturnHome)), None), ReturnHome):
            reason = reason or self._goals.refuse_home()
        if reason:
            return reason
        if int(self._params["WP_STUCK_ACT"]) != StuckAction.REFUSE:
            return ""
        leg, least_m_s = self._slowest_leg(nav), self._params["SPD_GROUND_MIN"]
        return leg.text(least_m_s) if leg is not None and leg.out_of_reach(least_m_s) else ""

    def forget_progress(self) -> None:
        """Reset the detection of a stuck vehicle: there is no goal to travel to."""
        self._made_good.forget()
        self._made_lately.forget()
        self._given_up = False

    def watch_progress(self, status: VehicleStatus, goal: Goal, nav: NavState, *, flies: bool) -> bool:
        """Detect a goal that the vehicle does not approach; WP_STUCK_ACT gives the action. ``flies``: a mission item,
        else home. True when the vehicle is to hold.
        """
        circle = self.sequencer.circle if flies else None
        if circle is not self._circle:
            why = self._circle_problem(circle)
            if why:
                holds = self._give_up(goal, nav, flies, why)
                self._circle = None if holds else circle
                return holds
            self._circle = circle
        t_us, patience_s, least_m_s = status.t_us, self._params["WP_STUCK_TIME"], self._params["SPD_GROUND_MIN"]
        short_s = min(patience_s, MISSION_RUN.shortfall_s)
        path_left_m = self.sequencer.circle_left_m if flies else None
        path_left_m = status.path_left_m if path_left_m is None else path_left_m
        idle_s = self._made_good.idle_s(t_us, goal, nav, path_left_m, patience_s * least_m_s)
        short_idle_s = self._made_lately.idle_s(t_us, goal, nav, path_left_m, short_s * least_m_s)
        if flies and t_us - self._upstream_us >= MISSION_RUN.upstream_us:
            self._upstream_us = t_us
            self._report_upstream(nav, only_this=True)
        if idle_s < patience_s and not (status.shortfall and short_idle_s >= short_s):
            self._given_up = False
            return False
        if self._given_up:
            return False
        self._given_up = True
        current = math.hypot(*nav.current_ned_m_s[:2].tolist())
        why = "no free way" if status.unreachable else status.shortfall or f"current {current:.2f} m/s"
        return self._give_up(goal, nav, flies, why)

    def _give_up(self, goal: Goal, nav: NavState, flies: bool, why: str) -> bool:
        """Report it and act; True when the vehicle is to hold."""
        action = int(self._params["WP_STUCK_ACT"]) if flies else StuckAction.WARN
        if action == StuckAction.WARN:
            name = f"Item {goal.seq}" if flies else "Home"
            self._operator.say(notices.OUT_OF_REACH(name=name, reason=why))
            return False
        if action == StuckAction.SKIP:
            self._operator.say(notices.ITEM_SKIPPED(seq=goal.seq, reason=why))
            self.sequencer.skip(nav)
            self.forget_progress()
            return False
        self._operator.say(notices.ITEM_HELD(seq=goal.seq, reason=why))
        return True

    # Speed made good

    def _slowest_leg(self, nav: NavState | None, *, only_this: bool = False) -> SlowLeg | None:
        """Slowest of the remaining legs (or of this item) in the current as estimated now."""
        if nav is None:
            return None
        position, current = self.sequencer.position, nav.current_ned_m_s[:2]
        first_seq = 0 if position is None else position.cursor
        return slowest_leg(
            self._steps[first_seq : first_seq + 1] if only_this else self._steps,
            nav.pos_ned_m[:2],
            first_seq,
            self._speed_m_s(nav),
            lambda places: np.broadcast_to(current, places.shape),
        )

    def _detours_upstream(self, nav: NavState) -> bool:
        """Whether the way to the goal, which is not straight, leads against the current for minutes."""
        made_m_s, current_m_s = self._made_good.made_m_s, math.hypot(*nav.current_ned_m_s[:2].tolist())
        slow = 0.0 < made_m_s < UPSTREAM.detour_fraction * self._speed_m_s(nav)
        return slow and current_m_s >= UPSTREAM.reported_m_s and self._made_good.left_m > UPSTREAM.detour_s * made_m_s

    def _report_upstream(self, nav: NavState | None, *, only_this: bool = False) -> None:
        """Warn of a low speed over ground on the slowest remaining leg (or this one); once per item and result."""
        leg, least_m_s = self._slowest_leg(nav, only_this=only_this), self._params["SPD_GROUND_MIN"]
        if leg is None or nav is None:
            return
        detour = only_this and self._detours_upstream(nav)
        if only_this:
            leg = leg.made(self._made_good.made_m_s, self._made_good.left_m, anyway=detour)
        if leg.left_m_s >= UPSTREAM.reported_m_s and not detour:
            return
        found = (leg.seq, leg.out_of_reach(least_m_s))
        if found not in self._reported_upstream:
            self._reported_upstream.add(found)
            self._operator.say(notices.UPSTREAM(leg=leg.text(least_m_s)))
