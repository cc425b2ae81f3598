"""The tables of ``autopilot certify``."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from autopilot.analysis.plan_margins import certificate_table, cost_table, lipschitz_table, tube_table
from autopilot.cli.certify import certify
from autopilot.core.geometry import Circle, Fence
from autopilot.core.messages import Goal
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import load_vehicle

VEHICLE = load_vehicle("lbv150")


def test_tube_table_widens_with_the_estimate_and_stays_small_when_it_is_good() -> None:
    rows = tube_table(VEHICLE, ParamSet({"MPC_SPEED_MARGIN": 0.02}))
    at_cruise = {row.estimate: row for row in rows if row.speed_m_s == 0.35}
    assert at_cruise["perfect"].clearance_m[-1] <= 0.035 and at_cruise["perfect"].planar_m_s <= 0.025
    order = [at_cruise[name].clearance_m[-1] for name in ("perfect", "pose", "camera", "lost for 5 s")]
    assert order == sorted(order) and order[-1] > 5.0 * order[0]
    caps = [at_cruise[name].speed_cap_m_s for name in ("perfect", "pose", "camera", "lost for 5 s")]
    assert caps == sorted(caps, reverse=True) and caps[0] - caps[-1] > 0.1
    for row in rows:
        assert 0.02 < row.worst_case_m < 0.05, "even at the bounds for ever"


def test_lipschitz_table_says_when_it_is_vacuous() -> None:
    for row in lipschitz_table(VEHICLE, ParamSet(), 1.2):
        assert row.empty_node is not None and row.empty_s is not None and row.empty_s < 1.0 and row.limited_by
        assert row.gamma_05_m < row.gamma_1_m < row.gamma_2_m
    calm = ParamSet({"MPC_W_FORCE": 0.0, "MPC_W_MOMENT": 0.0, "MPC_W_CURRENT": 0.0})
    assert {row.empty_node for row in lipschitz_table(VEHICLE, calm, None)} == {None}


def test_certificate_table_has_a_row_per_goal_and_current() -> None:
    fence = Fence(exclusions=(Circle(center_ned_m=np.zeros(2), radius_m=0.5),), depth_max_m=1.2)
    places = ((1.0, 0.0, 0.5), (0.845, 0.0, 0.5), (0.6, 0.0, 0.5))
    goals = [
        Goal(pos_ned_m=np.array(place), yaw_rad=0.5, speed_m_s=0.3, accept_radius_m=0.15, accept_yaw_rad=0.15, seq=seq)
        for seq, place in enumerate(places)
    ]
    rows = certificate_table(VEHICLE, ParamSet(), goals, fence, [np.zeros(3), np.array([0.2, 0.1, 0.0])], 500)
    assert [row.item for row in rows] == [0, 0, 1, 1, 2, 2]
    roomy, tight, inside = rows[0], rows[2], rows[4]
    assert roomy.fits and roomy.alpha > 0.0 and roomy.violations == 0
    assert not tight.fits and 0.0 < tight.radius_m < 0.02 and tight.binding == "clearance"
    assert inside.alpha == 0.0 and "no terminal region" in inside.text


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--current", "fast"], "give NORTH,EAST"),
        (["--current", "nan,0"], "m/s together at most"),
        (["--current", "99,0"], "m/s together at most"),
        (["no-such.plan"], "no-such.plan"),
        (["--param", "NO=1"], "NO"),
    ],
)
def test_bad_arguments_are_named(arguments: list[str], says: str) -> None:
    done = CliRunner().invoke(certify, arguments)
    assert done.exit_code != 0 and says in f"{done.output} {done.exception}"


def test_json_of_a_short_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("autopilot.analysis.munk.bench_munk", lambda seconds: [])
    monkeypatch.setattr("autopilot.analysis.plan_margins.cost_table", lambda *_: [])
    done = CliRunner().invoke(certify, ["--short", "--json", "--current", "0.1,0"])
    assert done.exit_code == 0, done.output
    tables = json.loads(done.output)
    assert {row["violations"] for row in tables["certificates"]} == {0} and len(tables["certificates"]) == 2
    assert tables["lipschitz"] and tables["tube"]


def test_cost_table_times_each_mode() -> None:
    """Its timers stand between the controller and its margins: whatever these are called with."""
    fence = Fence(exclusions=(Circle(center_ned_m=np.zeros(2), radius_m=0.5),), depth_max_m=1.2)
    goal = Goal(
        pos_ned_m=np.array([1.5, 0.3, 0.5]),
        yaw_rad=0.0,
        speed_m_s=0.3,
        accept_radius_m=0.15,
        accept_yaw_rad=0.15,
        seq=0,
    )
    rows = cost_table(VEHICLE, goal, fence, 3)
    assert [row.mode for row in rows] == ["fixed", "tube", "lipschitz"]
    assert all(row.step_median_ms > 0.0 for row in rows)
