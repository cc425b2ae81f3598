"""Missions made by a machine, of all item types, sound and not: refused by name, or flown to their end."""

import math
from dataclasses import replace

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from autopilot.core.frames import wrap_pi
from autopilot.core.messages import Goal, ProgressState
from autopilot.core.params import ParamSet
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.mission.item_types import ITEM_TYPES
from autopilot.mission.items import Gate, GoTo, Jump, LoiterTurns, Near, Surface, Wait
from autopilot.mission.sequencer import Action, Sequencer
from autopilot.mission.store import Plans
from tests.plan_items import ORIGIN, RADIUS_M, local, nav, plain, tank, waypoint

STEP_S = 0.1
TICKS = 4000

numbers = st.one_of(
    st.sampled_from([0.0, 1.0, -1.0, 2.0, 3.0, 0.3, -0.4, 45.0, 400.0, math.nan, math.inf, 1e38]),
    st.floats(-2.0, 8.0, width=32),
)


@st.composite
def any_item(draw: st.DrawFn, seq: int) -> PlanItem:
    """Anything that a wire can carry."""
    return PlanItem(
        seq=seq,
        frame=draw(st.sampled_from([0, 1, 1, 1, 2, 3, 5, 6, 10, 99])),
        command=draw(st.one_of(st.sampled_from(sorted(ITEM_TYPES)), st.sampled_from([0, 82, 189, 206, 5100, 65535]))),
        param1=draw(numbers),
        param2=draw(numbers),
        param3=draw(numbers),
        param4=draw(numbers),
        x=draw(st.one_of(st.integers(-30_000, 30_000), st.sampled_from([0, 2**31 - 1, -(2**31), 379_755_000]))),
        y=draw(st.one_of(st.integers(-15_000, 15_000), st.sampled_from([0, 2**31 - 1, 237_790_000]))),
        z=draw(st.one_of(st.floats(-1.0, 1.5, width=32), st.sampled_from([math.nan, math.inf, 0.0]))),
        autocontinue=draw(st.sampled_from([1, 1, 1, 0])),
    )


@st.composite
def sound_item(draw: st.DrawFn, seq: int, count: int) -> PlanItem:
    """Something that can be flown in the tank."""
    x, y, depth = draw(st.floats(-1.8, 1.8)), draw(st.floats(-0.9, 0.9)), draw(st.floats(0.2, 1.0))
    yaw = draw(st.sampled_from([math.nan, 0.0, 90.0, -135.0]))
    some, ring = draw(st.floats(0.0, 2.0)), draw(st.floats(0.1, 0.6)) * draw(st.sampled_from([1, -1]))
    return draw(
        st.sampled_from(
            [
                waypoint(seq, x, y, depth, yaw, hold_s=draw(st.sampled_from([0.0, 0.0, 0.5]))),
                local(seq, 18, 0.3 * x, 0.3 * y, depth, (draw(st.floats(0.1, 1.5)), 0, ring, 0)),
                local(seq, 19, x, y, depth, (some, 0, 0, 0)),
                plain(seq, 93, some),
                plain(seq, 112, some),
                plain(seq, 114, some),
                local(seq, 4501, x, y, depth, (0, draw(st.sampled_from([0.0, 1.0])), 0, 0)),
                plain(seq, 115, draw(st.floats(-180, 180)), 0, 1, draw(st.sampled_from([0.0, 1.0]))),
                plain(seq, 177, draw(st.integers(0, count - 1)), draw(st.integers(0, 3))),
                plain(seq, 178, 1, draw(st.floats(0.05, 0.5))),
                plain(seq, 179, 1),
                local(seq, 195, x, y, 0.0, (0, 0, 0, 0)),
                plain(seq, 197),
                plain(seq, 207, 1),
                local(seq, 22, 0, 0, depth, (0, 0, 0, yaw)),
            ]
        )
    )


@st.composite
def missions(draw: st.DrawFn, sound: bool) -> tuple[PlanItem, ...]:
    count = draw(st.integers(1, 12))
    items = (draw(sound_item(k, count) if sound else any_item(k)) for k in range(count))
    return tuple(items)


class Puppet:
    """A vehicle that goes where it is told."""

    def __init__(self) -> None:
        self.pos, self.yaw = np.array([-1.5, 0.3, 0.5]), 0.0

    def follow(self, goal: Goal) -> None:
        if goal.drive is not None:
            self.pos[:2] += STEP_S * np.array([goal.drive.north_m_s, goal.drive.east_m_s])
            self.pos[2] = goal.pos_ned_m[2]
        else:
            off = goal.pos_ned_m - self.pos
            self.pos = self.pos + off * min(1.0, 0.05 / max(float(np.linalg.norm(off)), 1e-9))
        if goal.yaw_rad is not None:
            self.yaw = wrap_pi(self.yaw + max(-0.2, min(0.2, wrap_pi(goal.yaw_rad - self.yaw))))


def fly(plans: Plans, params: ParamSet) -> tuple[ProgressState, list[int], bool]:
    """To the end, to a pause, or for TICKS: state, what was reached, whether it surfaced."""
    sequencer, puppet, reached, surfaced = Sequencer(params), Puppet(), [], False
    steps = plans.steps()
    sequencer.load(steps)
    sequencer.start()
    for tick in range(TICKS):
        t_us = round(tick * STEP_S * 1e6)
        out = sequencer.step(t_us, replace(nav(*puppet.pos, yaw=puppet.yaw), t_us=t_us))
        reached += out.reached
        surfaced |= out.action is Action.SURFACE
        if out.goal is not None:  # a mission of orders alone has none: the vehicle holds
            assert np.isfinite(out.goal.pos_ned_m).all()
            assert params["DEPTH_MIN"] <= out.goal.pos_ned_m[2] <= params["DEPTH_MAX"]
        if sequencer.state is ProgressState.PAUSED:
            sequencer.start()
        if sequencer.state is ProgressState.COMPLETE:
            assert out.goal is None or out.goal.drive is None, "it holds, and does not go on round"
            break
        if out.goal is not None:
            puppet.follow(out.goal)
    return sequencer.state, reached, surfaced


def stored(items: tuple[PlanItem, ...]) -> tuple[Plans, ParamSet, str]:
    """Plans with the mission, or why it is refused."""
    params = ParamSet({})
    plans = Plans(params, RADIUS_M, ORIGIN)
    assert plans.replace(PlanKind.FENCE, tuple(tank())) is None
    rejection = plans.replace(PlanKind.MISSION, items)
    if rejection is None:
        return plans, params, ""
    assert rejection.result.value not in (0, 1)
    assert f"item {rejection.seq}" in rejection.reason and "\n" not in rejection.reason
    assert plans.items(PlanKind.MISSION) == ()
    return plans, params, rejection.reason


def ends(plans: Plans) -> bool:
    """Whether nothing in it lasts for ever, or longer than is looked at."""
    return not any(
        (isinstance(s, Jump) and (s.count is None or s.count > 3))
        or (isinstance(s, GoTo) and (s.hold_s is None or s.hold_s > 5.0))
        or (isinstance(s, Wait) and s.duration_s > 5.0)
        or (isinstance(s, LoiterTurns) and (s.turns > 2.0 or (s.radius_m or 1.0) > 1.0))
        for s in plans.steps()
    )


@settings(max_examples=100, deadline=None, derandomize=True)
@given(missions(sound=False))
def test_whatever_comes_is_refused_by_name_or_can_be_flown(items: tuple[PlanItem, ...]) -> None:
    plans, params, reason = stored(items)
    if not reason and plans.steps() and ends(plans) and not plans.problem:
        state, _, surfaced = fly(plans, params)
        assert state is ProgressState.COMPLETE or surfaced


@settings(max_examples=40, deadline=None, derandomize=True)
@given(missions(sound=True))
@example((local(0, 18, 0.0, 0.0, 0.5, (1.0, 0, 0.5, 0)), local(1, 4501, 0.0, 0.0, 0.5, (0, 0, 0, 0))))
@example((waypoint(0, 0, 0), plain(1, 114, 1.0), plain(2, 177, 0, 3), plain(3, 177, 1, 3), waypoint(4, 1, 0)))
def test_what_is_sound_is_flown_to_its_end(items: tuple[PlanItem, ...]) -> None:
    plans, params, reason = stored(items)
    if reason:
        assert "no place comes after" in reason or "jumps to itself" in reason
        return
    state, reached, _ = fly(plans, params)
    assert state is ProgressState.COMPLETE
    flown = {
        s.seq
        for s in plans.steps()
        if isinstance(s, GoTo | LoiterTurns | Surface) or (isinstance(s, Wait) and s.reported)
    }
    jumps = any(isinstance(s, Jump) for s in plans.steps())
    assert set(reached) == flown or (jumps and set(reached) <= flown)
    assert not any(isinstance(plans.steps()[seq], Near | Gate) for seq in reached)
