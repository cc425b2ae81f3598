"""A flight with other drag and thrust than the file's: the margin shrinks, and the true speed stays below the limit."""

import pytest

from autopilot.mission.local_plan import WaypointTable
from autopilot.sitl.scenario import load_tables
from tests.bench.speed_bound import DEPTH_M, DRAG, OPEN, THRUST, flown, tables_of


@pytest.mark.long
def test_high_drag_makes_the_margin_smaller_and_the_bound_holds() -> None:
    tables = load_tables(OPEN)
    tables["current"] = {"kind": "uniform", "velocity_m_s": [-0.1, 0.1, 0.0]}
    tables["vehicle"] |= {"start_m": [0.0, 0.0, DEPTH_M], "start_yaw_rad": 0.0}
    tables["vehicle"]["mismatch"] = {"drag": 1.2, "thrust": 0.9}
    tables["params"] = {"DEPTH_MAX": tables["params"]["DEPTH_MAX"], "MPC_COST": 0.0}
    points = [WaypointTable(x_m=x, y_m=y, depth_m=DEPTH_M, accept_m=0.3) for x, y in ((4.0, 0.0), (0.0, 0.0))]
    flight = flown(0, "uniform", tables, points, cutoff_s=22.0)
    assert flight.kept and flight.top_m_s > 0.3
    assert flight.known > 0.1 and flight.least_margin_m_s < 0.06


def test_draws_differ_and_stay_within_their_limits() -> None:
    drawn = [tables_of(seed) for seed in range(1, 25)]
    assert len({kind for kind, _, _ in drawn}) > 4
    for _, tables, _ in drawn:
        mismatch = tables["vehicle"]["mismatch"]
        assert DRAG[0] <= mismatch["drag"] <= DRAG[1] and THRUST[0] <= mismatch["thrust"] <= THRUST[1]
