"""What a run is judged by: the limits that it was flown with, unless its scenario says otherwise."""

from pathlib import Path

from autopilot.log.check import acceptance_table
from autopilot.log.reader import open_log
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import open_sitl


def test_a_run_is_judged_by_its_own_limits(tmp_path: Path) -> None:
    """Legs at 5 m, where the paper's tank has a limit of 1.2 m."""
    given = {"scenario": "b2", "duration": 2.0, "start": True, "log": str(tmp_path / "run.mcap")}
    open_sitl(flight_settings(tmp_path / "state", given), {"SPD_PLANAR_MAX": 0.4}).run()
    log = open_log(tmp_path / "run.mcap")
    run = log.description
    assert run is not None
    accept, params = run.accept, run.parameters
    assert params["DEPTH_MAX"] == 50.0 == accept.depth_max_m
    assert accept.planar_speed_m_s == 0.42 and accept.heave_m_s == 0.26 and accept.yaw_rate_rad_s == 1.05
    assert accept.thrust_n == params["THR_LIMIT"]
    deepest = next(row for row in acceptance_table(log) if row.name == "depth, deepest")
    assert deepest.limit == 50.0
