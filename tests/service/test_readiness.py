"""What the margins of the controller have against arming."""

import dataclasses
import math

import numpy as np
import pytest
from commander_bench import OK, Bench

from autopilot.command.commander import Commander
from autopilot.command.margin_check import MarginCheck
from autopilot.control.controller import MotionController
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.vehicle import load_vehicle
from autopilot.mission.reach import widest_m

VEHICLE = load_vehicle("lbv150")


def checked(**params: float) -> tuple[Bench, MarginCheck]:
    """A commander that asks the margins, with the paper's plan."""
    bench = Bench(**params)
    check = MarginCheck(MotionController(VEHICLE), bench.params, bench.plans)
    bench.commander = Commander(VEHICLE, bench.params, bench.plans, controller_check=check)
    bench.load()
    return bench, check


def test_the_papers_plan_may_be_flown() -> None:
    bench, _ = checked()
    bench.run()
    assert bench.commander.arm(force=False).result is OK


@pytest.mark.parametrize(
    ("params", "says"),
    [
        ({"MPC_TIGHTEN": 2, "MPC_W_FORCE": 90.0}, "Lipschitz sets are empty from node 1"),
        ({"MPC_MARGIN": 0.4}, "item"),
        ({"DEPTH_MIN": 0.28, "DEPTH_MAX": 0.46, "MPC_W_FORCE": 90.0}, "depth band 0.18 m leaves too little"),
        ({"MPC_W_FORCE": 90.0}, "planar speed limit 0.5 m/s leaves too little beside the tube margin 0.25"),
    ],
)
def test_an_empty_tightened_set_is_a_named_refusal(params: dict[str, float], says: str) -> None:
    bench, _ = checked()
    for name, value in params.items():
        bench.params.set(name, value)
    bench.run()
    answer = bench.commander.arm(force=False)
    assert answer.result is not OK and says in answer.reason
    assert any(says in reason for reason in bench.commander.prearm_reasons())
    assert bench.commander.arm(force=True).result is OK, "force is force"


def test_water_that_is_faster_than_the_vehicle_is_a_named_refusal() -> None:
    bench, check = checked()
    nav = bench.nav()
    assert nav is not None and check(nav) == ()
    fast = dataclasses.replace(nav, current_ned_m_s=np.array([0.4, 0.4, 0.0]))
    assert len(check(fast)) == 1 and "current 0.57 m/s" in check(fast)[0]


def test_the_widest_place_of_a_workspace() -> None:
    square = Polygon(vertices_ned_m=np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]]))
    assert widest_m(Fence(inclusions=(square,), depth_max_m=2.0)) == pytest.approx(1.0, abs=0.1)
    round_one = Circle(center_ned_m=np.array([5.0, 5.0]), radius_m=3.0)
    assert widest_m(Fence(inclusions=(round_one,), depth_max_m=2.0)) == pytest.approx(3.0, abs=0.3)
    assert widest_m(Fence(depth_max_m=2.0)) == math.inf
