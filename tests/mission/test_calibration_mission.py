"""The manoeuvre of a calibration flight: inside the fence with its margin, or a reason why not."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from autopilot.core.errors import ConfigError
from autopilot.core.params import ParamSet
from autopilot.core.plan import PlanItem
from autopilot.mission.calibration_mission import calibration_mission
from autopilot.mission.fence import build_fence, fence_clearance_m, read_fence
from autopilot.mission.items import GoTo
from autopilot.mission.local_plan import CircleTable, FenceTable, LocalPlan, OriginTable, PolygonTable, plan_of_local
from autopilot.mission.mission_tuning import CALIBRATION
from autopilot.mission.plan_check import judge_file
from autopilot.mission.plan_model import PlanFile
from autopilot.mission.validation import read_mission
from tests.plan_items import ORIGIN

RADIUS_M = 0.3
ROUNDING_M = 0.02
"""Of a place and of a fence to 1e-7 deg."""

lengths = st.floats(0.5, 30.0)


def fence_of(table: FenceTable) -> tuple[PlanItem, ...]:
    where = OriginTable(lat_deg=ORIGIN.lat_deg, lon_deg=ORIGIN.lon_deg, alt_m=ORIGIN.alt_m)
    return plan_of_local(LocalPlan(origin=where, fence=table)).fence


def tank(north_m: float, east_m: float, *circles: tuple[float, float, float]) -> tuple[PlanItem, ...]:
    x, y = 0.5 * north_m, 0.5 * east_m
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    return fence_of(
        FenceTable(
            polygon=[PolygonTable(points_m=corners, inclusion=True)],
            circle=[CircleTable(x_m=a, y_m=b, radius_m=r) for a, b, r in circles],
        )
    )


@st.composite
def fences(draw: st.DrawFn) -> tuple[PlanItem, ...]:
    """A star-shaped polygon, or a circle, with obstacles of both kinds."""
    size_m, places = draw(lengths), st.floats(-0.5, 0.5)
    obstacles = [
        CircleTable(x_m=draw(places) * size_m, y_m=draw(places) * size_m, radius_m=draw(st.floats(0.05, 1.0)))
        for _ in range(draw(st.integers(0, 4)))
    ]
    corners = [
        (0.5 * size_m * draw(st.floats(0.3, 1.0)) * math.cos(a), 0.5 * size_m * draw(st.floats(0.3, 1.0)) * math.sin(a))
        for a in np.linspace(0.0, 2.0 * math.pi, draw(st.integers(4, 9)), endpoint=False).tolist()
    ]
    polygons = [PolygonTable(points_m=corners, inclusion=True)]
    if draw(st.booleans()):
        round_ = CircleTable(x_m=draw(places), y_m=draw(places), radius_m=0.5 * size_m, inclusion=True)
        polygons, obstacles = polygons if draw(st.booleans()) else [], [*obstacles, round_]
    return fence_of(FenceTable(polygon=polygons, circle=obstacles))


@settings(max_examples=150, deadline=None)
@given(fence=fences(), floor_m=st.floats(0.2, 20.0), top_m=st.floats(0.0, 1.0), band_m=st.floats(0.1, 5.0))
@example(fence=tank(5.0, 3.0), floor_m=1.5, top_m=0.05, band_m=1.15)
def test_all_items_are_inside_with_the_margin_or_an_error_says_why(
    fence: tuple[PlanItem, ...], floor_m: float, top_m: float, band_m: float
) -> None:
    params = ParamSet({"DEPTH_MIN": top_m, "DEPTH_MAX": top_m + band_m})
    try:
        items = calibration_mission(
            fence, ORIGIN, params, radius_m=RADIUS_M, floor_m=floor_m, near_ned_m=np.array([0.3, -0.2]), laps=2
        )
    except ConfigError as error:
        assert any(word in str(error) for word in ("the fence leaves a circle", "DEPTH_MAX", "upload a fence"))
        return
    steps, broken = read_mission(items, ORIGIN)
    shapes, _ = read_fence(fence, ORIGIN)
    places = np.array([step.pos_ned_m for step in steps if isinstance(step, GoTo)])
    assert not broken
    # Between them as well: the legs are straight.
    between = np.concatenate([np.linspace(a, b, 9) for a, b in zip(places, np.roll(places, -1, axis=0), strict=True)])
    keep_m = RADIUS_M + params["MPC_MARGIN"] + CALIBRATION.margin_m
    assert fence_clearance_m(build_fence(shapes, params), between[:, :2]).min() >= keep_m - ROUNDING_M
    assert places[:, 2].min() >= top_m + CALIBRATION.margin_m - 1e-6
    assert places[:, 2].max() <= min(top_m + band_m, floor_m - RADIUS_M) - CALIBRATION.margin_m + 1e-6
    heights_m = floor_m - places[:, 2]
    assert heights_m.max() >= CALIBRATION.least_factor * heights_m.min() - 1e-6
    verdict = judge_file(
        PlanFile(mission=items, fence=fence), ORIGIN, params, radius_m=RADIUS_M, goal_margin_m=params["MPC_MARGIN"]
    )
    assert not [problem.reason for problem in (*verdict.own, *verdict.joint) if problem.kind == 0]


def made(fence: tuple[PlanItem, ...], floor_m: float = 1.5, **params: float) -> tuple[PlanItem, ...]:
    near = np.array([1.0, 0.0])
    return calibration_mission(
        fence, ORIGIN, ParamSet(params), radius_m=RADIUS_M, floor_m=floor_m, near_ned_m=near, laps=1
    )


def test_a_full_circle_at_each_of_two_heights_near_the_markers() -> None:
    steps, _ = read_mission(made(tank(12.0, 6.0)), ORIGIN)
    goals = [step for step in steps if isinstance(step, GoTo)]
    places = np.array([goal.pos_ned_m for goal in goals])
    assert sorted({round(1.5 - depth, 2) for depth in places[:, 2]}) == [0.6, 1.2]
    assert places[:, :2].mean(axis=0) == pytest.approx([1.0, 0.0], abs=0.1)
    yaw = np.array([goal.yaw_rad for goal in goals], dtype=float)
    for level in np.split(yaw, 2):
        turned = np.sum((np.diff(level[3:]) + math.pi) % (2.0 * math.pi) - math.pi)
        assert abs(turned) == pytest.approx(2.0 * math.pi, abs=1e-6)


@pytest.mark.parametrize(
    ("fence", "floor_m", "words"),
    [
        ((), 1.5, "has no fence to stay inside; upload one"),
        (fence_of(FenceTable(circle=[CircleTable(x_m=1.0, y_m=1.0, radius_m=0.2)])), 1.5, "no fence to stay inside"),
        (tank(1.0, 1.0), 1.5, r"leaves a circle of 0.50 m free; the calibration needs 0.68 m"),
        (tank(2.0, 2.0, (0.0, 0.0, 0.3)), 1.5, "enlarge it, or remove obstacles"),
        (tank(5.0, 3.0), 0.7, "over a floor at 0.70 m, heights"),
        (tank(5.0, 3.0), 20.0, "calibrate where the water is"),
        (tank(5.0, 3.0)[:3], 1.5, "polygon has 3 of 4 vertices"),
    ],
)
def test_what_does_not_fit_is_named(fence: tuple[PlanItem, ...], floor_m: float, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        made(fence, floor_m)
