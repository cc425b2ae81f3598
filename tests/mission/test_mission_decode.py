"""Every way in which an item can be wrong gets its own result code and a line that says what to do."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.core.plan import MissionResult, PlanItem, PlanKind
from autopilot.mission.item_types import parse_step
from autopilot.mission.items import ChangeSpeed, Command, GoTo, Jump, ReturnHome, SetHeading, SetHome, Surface, Wait
from autopilot.mission.validation import check_item
from tests.plan_items import NAN, ORIGIN, circle, local, plain, waypoint

GOOD = PlanItem(seq=3, frame=3, command=16, param4=NAN, x=379755000, y=237790000, z=-0.45)
R = MissionResult


@pytest.mark.parametrize(
    ("item", "result", "words"),
    [
        (replace(GOOD, frame=10), R.UNSUPPORTED_FRAME, "terrain"),
        (replace(GOOD, frame=11), R.UNSUPPORTED_FRAME, "terrain"),
        (replace(GOOD, frame=8), R.UNSUPPORTED_FRAME, "frame 8"),
        (replace(GOOD, frame=2), R.UNSUPPORTED_FRAME, "no position"),
        (replace(GOOD, command=23), R.UNSUPPORTED, "command 23"),
        (replace(GOOD, command=9999), R.UNSUPPORTED, "9999"),
        (replace(GOOD, command=5001), R.UNSUPPORTED, "5001"),
        (replace(GOOD, x=900000001), R.INVALID_PARAM5_X, "latitude"),
        (replace(GOOD, y=-1800000001), R.INVALID_PARAM6_Y, "longitude"),
        (replace(GOOD, x=2147483647), R.INVALID_PARAM5_X, "not a number"),
        (replace(GOOD, y=2147483647), R.INVALID_PARAM6_Y, "not a number"),
        (replace(GOOD, x=0, y=0), R.INVALID_PARAM5_X, "not set"),
        (replace(GOOD, x=389755000), R.INVALID_PARAM5_X, "km from the local origin"),
        (replace(GOOD, y=247790000), R.INVALID_PARAM6_Y, "km from the local origin"),
        (replace(GOOD, x=-379755000, y=-1562210000), R.INVALID_PARAM5_X, "km from"),
        (replace(GOOD, z=NAN), R.INVALID_PARAM7, "altitude"),
        (replace(GOOD, z=-math.inf), R.INVALID_PARAM7, "altitude"),
        (replace(GOOD, z=50.0), R.INVALID_PARAM7, "altitude must be <= 0, -0.4 at 0.4 m"),
        (replace(GOOD, frame=0, z=0.5), R.INVALID_PARAM7, "AMSL"),
        (replace(GOOD, frame=1, x=0, y=0, z=-1.0), R.INVALID_PARAM7, "z in LOCAL_NED is depth"),
        (replace(GOOD, param1=-1.0), R.INVALID_PARAM1, "hold time"),
        (replace(GOOD, param1=math.inf), R.INVALID_PARAM1, "infinite"),
        (replace(GOOD, param2=-0.3), R.INVALID_PARAM2, "acceptance radius"),
        (replace(GOOD, param2=0.001), R.INVALID_PARAM2, "acceptance radius"),
        (replace(GOOD, param3=5.0), R.INVALID_PARAM3, "pass-by"),
        (replace(GOOD, param4=361.0), R.INVALID_PARAM4, "yaw"),
        (replace(GOOD, param4=math.inf), R.INVALID_PARAM4, "infinite"),
        (plain(3, Command.DO_JUMP, 3, 1), R.INVALID_PARAM1, "itself"),
        (plain(3, Command.DO_JUMP, -1, 1), R.INVALID_PARAM1, "target"),
        (plain(3, Command.DO_JUMP, 0.5, 1), R.INVALID_PARAM1, "whole"),
        (plain(3, Command.DO_JUMP, 0, -2), R.INVALID_PARAM2, "count"),
        (plain(3, Command.DO_JUMP, 0, NAN), R.INVALID_PARAM2, "whole"),
        (plain(3, Command.DO_CHANGE_SPEED, 2, 0.3), R.INVALID_PARAM1, "speed type"),
        (plain(3, Command.DO_CHANGE_SPEED, 1, 0.0), R.INVALID_PARAM2, "speed"),
        (plain(3, Command.DO_CHANGE_SPEED, 1, NAN), R.INVALID_PARAM2, "speed"),
        (plain(3, Command.CONDITION_YAW, 400), R.INVALID_PARAM1, "heading"),
        (plain(3, Command.CONDITION_YAW, 90, 0, 0, 2), R.INVALID_PARAM4, "relative"),
        (plain(3, Command.NAV_DELAY, -1, 12, 0, 0), R.INVALID_PARAM1, "delay"),
        (replace(plain(3, Command.DO_JUMP, 0, 1), frame=17), R.UNSUPPORTED_FRAME, "frame 17"),
        (replace(GOOD, seq=2001), R.NO_SPACE, "too many"),
    ],
)
def test_refusals_point_at_the_field(item: PlanItem, result: MissionResult, words: str) -> None:
    rejection = check_item(PlanKind.MISSION, item, ORIGIN)
    assert rejection is not None
    assert rejection.result is result
    assert words in rejection.reason
    assert "\n" not in rejection.reason
    assert str(item.seq) in rejection.reason


@pytest.mark.parametrize("frame", [0, 3, 5, 6])
def test_global_frames_mean_depth_under_the_surface(frame: int) -> None:
    step = parse_step(replace(GOOD, frame=frame), ORIGIN)
    assert isinstance(step, GoTo)
    assert step.pos_ned_m == pytest.approx([0.0, 0.0, 0.45], abs=1e-9)
    assert step.yaw_rad is None
    assert step.accept_radius_m is None


def test_waypoint_parameters() -> None:
    step = parse_step(replace(GOOD, param1=2.5, param2=0.2, param4=270.0, autocontinue=0), ORIGIN)
    assert isinstance(step, GoTo)
    assert (step.hold_s, step.accept_radius_m, step.autocontinue) == (2.5, 0.2, False)
    assert step.yaw_rad == pytest.approx(-math.pi / 2)


def test_nan_means_not_given() -> None:
    step = parse_step(replace(GOOD, param1=NAN, param2=NAN, param3=NAN), ORIGIN)
    assert isinstance(step, GoTo)
    assert (step.hold_s, step.accept_radius_m) == (0.0, None)


def test_the_other_commands() -> None:
    unlim = parse_step(replace(GOOD, command=17, param3=50.0, param4=90.0), ORIGIN)
    assert isinstance(unlim, GoTo)
    assert unlim.hold_s is None
    assert unlim.yaw_rad == pytest.approx(math.pi / 2)
    here = parse_step(replace(GOOD, command=19, param1=7.0, x=0, y=0, z=0.0), ORIGIN)
    assert isinstance(here, GoTo)
    assert (here.hold_s, here.pos_ned_m) == (7.0, None)
    land = parse_step(replace(GOOD, command=21, x=0, y=0, z=0.0), ORIGIN)
    assert isinstance(land, Surface)
    assert land.pos_ned_m is None
    assert isinstance(parse_step(plain(0, 20), ORIGIN), ReturnHome)
    assert parse_step(plain(4, 177, 1, -1), ORIGIN) == Jump(seq=4, target_seq=1, count=None)
    assert parse_step(plain(4, 177, 1, 2), ORIGIN) == Jump(seq=4, target_seq=1, count=2)
    # MAVSDK's Mission plugin: frame 2, z NaN, throttle -1.
    assert parse_step(plain(1, 178, 1, 0.3, -1, 0), ORIGIN) == ChangeSpeed(seq=1, speed_m_s=0.3)
    assert parse_step(plain(1, 178, 0, -2), ORIGIN) == ChangeSpeed(seq=1, speed_m_s=None)
    assert parse_step(plain(1, 93, 3), ORIGIN) == Wait(seq=1, duration_s=3.0, reported=True)
    assert parse_step(plain(1, 112, 3), ORIGIN) == Wait(seq=1, duration_s=3.0, reported=False)
    turn = parse_step(plain(1, 115, 90, 0, -1, 1), ORIGIN)
    assert turn == SetHeading(seq=1, yaw_rad=-math.pi / 2, relative=True)
    home = parse_step(local(2, 179, 1.0, -1.0, 0.0, (0, 0, 0, 0)), ORIGIN)
    assert isinstance(home, SetHome)
    assert home.pos_ned_m is not None
    assert np.array_equal(home.pos_ned_m, [1.0, -1.0, 0.0])
    assert parse_step(plain(2, 179, 1), ORIGIN).pos_ned_m is None  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("kind", "item", "result"),
    [
        (PlanKind.FENCE, waypoint(0, 0, 0), R.UNSUPPORTED),
        (PlanKind.FENCE, circle(0, 0, 0, 0.0), R.INVALID_PARAM1),
        (PlanKind.FENCE, circle(0, 0, 0, NAN), R.INVALID_PARAM1),
        (PlanKind.FENCE, replace(circle(0, 0, 0, 1.0), frame=10), R.UNSUPPORTED_FRAME),
        (PlanKind.FENCE, local(0, 5001, 0, 0, 0, (2, 0, 0, 0)), R.INVALID_PARAM1),
        (PlanKind.FENCE, local(0, 5002, 0, 0, 0, (3.5, 0, 0, 0)), R.INVALID_PARAM1),
        (PlanKind.RALLY, waypoint(0, 0, 0), R.UNSUPPORTED),
        (PlanKind.RALLY, replace(GOOD, command=5100, z=50.0), R.INVALID_PARAM7),
    ],
)
def test_fence_and_rally_items(kind: PlanKind, item: PlanItem, result: MissionResult) -> None:
    rejection = check_item(kind, item, ORIGIN)
    assert rejection is not None
    assert rejection.result is result


def test_the_fence_return_point_is_tolerated() -> None:
    assert check_item(PlanKind.FENCE, replace(GOOD, command=5000, z=20.0), ORIGIN) is None
    assert check_item(PlanKind.RALLY, replace(GOOD, command=5100, z=0.0), ORIGIN) is None


wire_float = st.floats(width=32, allow_nan=True, allow_infinity=True)
wire_items = st.builds(
    PlanItem,
    seq=st.integers(0, 65535),
    frame=st.integers(0, 255) | st.sampled_from([0, 1, 2, 3, 6]),
    command=st.integers(0, 65535) | st.sampled_from([int(c) for c in Command]),
    param1=wire_float,
    param2=wire_float | st.just(0.0),
    param3=wire_float | st.just(0.0),
    param4=wire_float,
    x=st.integers(-(2**31), 2**31 - 1) | st.just(0),
    y=st.integers(-(2**31), 2**31 - 1) | st.just(0),
    z=wire_float,
    autocontinue=st.integers(0, 255),
)


@given(st.sampled_from(PlanKind), wire_items)
def test_any_item_is_judged_and_a_good_one_gives_finite_numbers(kind: PlanKind, item: PlanItem) -> None:
    rejection = check_item(kind, item, ORIGIN)
    if rejection is not None:
        assert rejection.result is not MissionResult.ACCEPTED
        assert "\n" not in rejection.reason
    elif kind is PlanKind.MISSION:
        step = parse_step(item, ORIGIN)
        pos = getattr(step, "pos_ned_m", None)
        assert pos is None or bool(np.all(np.isfinite(pos)))
        assert math.isfinite(getattr(step, "yaw_rad", None) or 0.0)
        assert math.isfinite(getattr(step, "hold_s", None) or 0.0)
