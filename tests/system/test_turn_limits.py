"""Turns and dives of vehicles with less drag and more thrust than their file says: limits hold on the truth."""

from pathlib import Path

import numpy as np
import pytest

from autopilot.campaign.tick_watch import TickWatch
from autopilot.campaign.worlds.vehicles import vehicle_tables
from autopilot.core.messages import Outputs
from autopilot.mission.local_plan import LocalPlan, WaypointTable, plan_of_local
from autopilot.mission.paper import ORIGIN
from autopilot.mission.plan_files import write_plan
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl
from autopilot.sitl.scenario import load_tables
from autopilot.sitl.toml_text import toml_text

MISMATCH = {"drag": 0.8, "thrust": 1.15}
DEPTH_M = 0.7


def waypoint(x_m: float, y_m: float, yaw_rad: float | None = None, depth_m: float = DEPTH_M) -> WaypointTable:
    return WaypointTable(x_m=x_m, y_m=y_m, depth_m=depth_m, yaw_rad=yaw_rad, accept_m=0.3)


def flown(
    folder: Path,
    vehicle: str | int,
    waypoints: list[WaypointTable],
    params: dict[str, float],
    duration_s: float,
    *,
    yaw_rad: float = 0.0,
    current_m_s: tuple[float, float] = (0.0, 0.0),
) -> TickWatch:
    """A flight in open water; a number is a vehicle of the random worlds."""
    tables = load_tables("b3-est")
    if isinstance(vehicle, int):
        (folder / "vehicle.toml").write_text(toml_text(vehicle_tables(vehicle)))
    tables["scenario"]["plan"] = str(folder / "turns.plan")
    tables["current"] = {"kind": "uniform", "velocity_m_s": [*current_m_s, 0.0]}
    tables["controller"]["currents"] = "estimate"
    tables["params"] = {"DEPTH_MAX": 6.0, **params}
    tables["vehicle"] |= {
        "model": "vehicle.toml" if isinstance(vehicle, int) else vehicle,
        "start_m": [0.0, 0.0, DEPTH_M],
        "start_yaw_rad": yaw_rad,
        "mismatch": MISMATCH,
    }
    write_plan(folder / "turns.plan", plan_of_local(LocalPlan(origin=ORIGIN, waypoint=waypoints)))
    (folder / "turns.toml").write_text(toml_text(tables))
    given = {"speed": 0.0, "sensors": "pose", "duration": duration_s, "start": True}
    opened: list[SitlSession] = []
    watch = TickWatch(lambda: opened[0].device.truth)

    def note(outputs: Outputs) -> None:
        if opened:
            watch.tick(outputs)

    settings = flight_settings(str(folder), {**given, "scenario": str(folder / "turns.toml")})
    opened.append(open_sitl(settings, {}, log=False, on_tick=note))
    opened[0].run()
    return watch


@pytest.mark.parametrize("vehicle", ["lbv150", 4, "bluerov2-heavy"])
def test_a_mission_of_turns_keeps_the_yaw_rate(tmp_path: Path, vehicle: str | int) -> None:
    turns = [waypoint(1.0, 0.0, 0.0), waypoint(1.0, 1.0, 3.0)]
    watch = flown(tmp_path, vehicle, turns, {"SPD_YAW_MAX": 0.6, "SPD_CRUISE": 0.4}, 10.0)
    fastest = float(np.abs(watch.column("r")).max())
    assert 0.5 < fastest <= 0.6, "the limit is used, and kept"


def test_a_start_across_a_current_keeps_the_yaw_rate(tmp_path: Path) -> None:
    """Its first turn is over before the current is known."""
    params = {"MPC_COST": 0.0, "SPD_YAW_MAX": 0.63, "SPD_CRUISE": 0.4, "SPD_PLANAR_MAX": 0.63}
    legs = [waypoint(-1.44, -1.77), waypoint(-0.42, -0.03)]
    watch = flown(tmp_path, 5, legs, params, 6.0, yaw_rad=-1.6, current_m_s=(0.162, -0.159))
    fastest = float(np.abs(watch.column("r")).max())
    assert 0.5 < fastest <= 0.63


def test_a_dive_keeps_the_heave_speed_though_the_vehicle_pitches(tmp_path: Path) -> None:
    params = {"SPD_HEAVE_MAX": 0.2, "SPD_PLANAR_MAX": 0.65}
    watch = flown(tmp_path, 5, [waypoint(3.0, 0.0, depth_m=2.5)], params, 12.0)
    assert 0.15 < float(np.abs(watch.track.vel_level_m_s[:, 2]).max()) <= 0.2
    assert float(np.abs(watch.column("pitch")).max()) > 0.1
