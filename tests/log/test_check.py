"""Verdicts on synthetic runs: a perfect one passes, and each planted violation turns its own row."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_synthetic import (
    DESCRIPTION,
    EPOCH_NS,
    LEG_S,
    TANK,
    Run,
    Truth,
    inputs_at,
    outputs_at,
    shifted,
    truth_at,
    write_run,
)

from autopilot.control.robust.margins import AT_REST
from autopilot.core.errors import LogError
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.messages import Event, Fallback, ModeState
from autopilot.log.analysis import (
    Span,
    VehicleTrack,
    distance_to_fence,
    distance_to_polygon,
    energy_j,
    load_flight,
    visits,
)
from autopilot.log.check import BoundRow, BoundVerdict, acceptance_table, format_figure, overall
from autopilot.log.compare import compare_logs
from autopilot.log.description import (
    AcceptBounds,
    Obstacle,
    RunDescription,
    Waypoint,
    fence_shapes,
    from_json,
    to_json,
)
from autopilot.log.log_session import RunLog, open_run_log
from autopilot.log.reader import open_log

STEP_US = 200_000
LAPS_1 = replace(DESCRIPTION, accept=AcceptBounds(laps=1))


def table(tmp_path: Path, **changes: Any) -> dict[str, BoundRow]:
    run = Run(**{"laps": 1, "step_us": STEP_US, "description": LAPS_1, **changes})
    rows = acceptance_table(open_log(write_run(tmp_path / "run.mcap", run)))
    assert len({row.name for row in rows}) == len(rows)
    return {row.name: row for row in rows}


def broken(rows: dict[str, BoundRow]) -> set[str]:
    return {name for name, row in rows.items() if row.verdict is BoundVerdict.FAIL}


def test_a_perfect_run_passes_everything(tmp_path: Path) -> None:
    rows = table(tmp_path, laps=3, description=DESCRIPTION)
    assert overall(rows.values()) is BoundVerdict.PASS
    assert rows["laps"].worst == 3.0 and rows["laps"].margin == 0.0
    assert rows["waypoint A position"].note == "reached 4 of 4"
    assert rows["waypoint B heading"].note == "reached 3 of 3"
    assert rows["distance to cylinder 2"].margin == pytest.approx(0.5303 - 0.45, abs=2e-3)
    assert rows["planar speed |u+v|"].verdict is BoundVerdict.INFO
    assert rows["estimate position rms"].worst == pytest.approx(0.004 / math.sqrt(2.0), rel=0.02)
    # 36 s at 20 W of thrusters and 12 W of hotel load
    assert rows["energy lap 2"].worst == pytest.approx(36.0 * 32.0, rel=0.01)
    assert rows["time lap 3"].worst == pytest.approx(36.0, abs=0.5)
    for name in ("log messages lost", "loop overruns", "NMPC fallbacks", "failsafes raised", "contacts"):
        assert rows[name].verdict is BoundVerdict.PASS and rows[name].worst == 0.0


VIOLATIONS: dict[str, dict[str, Any]] = {
    "distance to cylinder 1": {"pos_ned_m": np.array([-0.625, -0.625 + 0.44, 0.42])},
    "distance to cylinder 2": {"pos_ned_m": np.array([0.9375, 0.44, 0.33])},
    "distance to walls": {"pos_ned_m": np.array([0.0, 1.5 - 0.28, 0.40])},
    "depth, shallowest": {"pos_ned_m": np.array([0.2, 0.55, -0.001])},
    "depth, deepest": {"pos_ned_m": np.array([0.2, 0.55, 1.201])},
    "planar speed": {"vel_water_frd_m_s": np.array([0.37, -0.37, 0.0])},
    "heave": {"vel_water_frd_m_s": np.array([0.1, 0.0, -0.261])},
    "yaw rate": {"rate_frd_rad_s": np.array([0.0, 0.0, -1.06])},
}


@pytest.mark.parametrize("name", VIOLATIONS)
def test_each_violation_of_the_truth_turns_its_row(tmp_path: Path, name: str) -> None:
    rows = table(tmp_path, change_truth=shifted(9.0, 0.3, **VIOLATIONS[name]))
    also = {"distance to fence"} if name.startswith("distance") else set()
    assert broken(rows) - {"estimate position rms"} == {name} | also
    row = rows[name]
    assert row.margin is not None and -0.05 < row.margin < 0.0
    assert row.at_s == pytest.approx(9.1, abs=0.3)


@given(st.lists(st.floats(-1.2, 1.2), min_size=2, max_size=2), st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3))
def test_speeds_are_judged_in_the_frame_in_which_they_are_limited(tilt: list[float], water_m_s: list[float]) -> None:
    one = replace(AT_REST, rpy_rad=np.array([*tilt, 0.3]), vel_water_frd_m_s=np.array(water_m_s))
    names = ("pos_ned_m", "rpy_rad", "vel_frd_m_s", "vel_water_frd_m_s", "rate_frd_rad_s", "current_ned_m_s")
    track = VehicleTrack(t_s=np.zeros(1), **{name: getattr(one, name)[None] for name in names})
    level = one.in_level_frame().vel_water_frd_m_s
    assert track.vel_level_m_s[0] == pytest.approx(level, abs=1e-12)
    assert track.planar_speed_m_s[0] == pytest.approx(math.hypot(*level[:2]), abs=1e-12)


def test_the_literal_speed_is_reported_and_not_judged(tmp_path: Path) -> None:
    """0.36 and 0.36 m/s: the norm is 0.509, within the bound; the literal sum is 0.72."""
    rows = table(tmp_path, change_truth=shifted(9.0, 0.3, vel_water_frd_m_s=np.array([0.36, 0.36, 0.0])))
    assert not broken(rows)
    assert rows["planar speed |u+v|"].worst == pytest.approx(0.72)


def test_the_tolerance_warns(tmp_path: Path) -> None:
    rows = table(tmp_path, change_truth=shifted(9.0, 0.3, pos_ned_m=np.array([0.9375, 0.452, 0.33])))
    assert not broken(rows) - {"estimate position rms"}
    row = rows["distance to cylinder 2"]
    assert row.verdict is BoundVerdict.WARN and row.margin == pytest.approx(0.002) and row.limit == 0.46


def test_larger_cylinders_need_their_own_clearance(tmp_path: Path) -> None:
    thick = (Obstacle(center_m=(0.9375, 0.0), radius_m=0.25, name="pillar"),)
    rows = table(tmp_path, description=replace(LAPS_1, obstacles=thick))
    assert rows["distance to pillar"].limit == pytest.approx(0.55)


def test_a_sphere_is_judged_in_three_dimensions(tmp_path: Path) -> None:
    sphere = (Obstacle(center_m=(0.2, 0.55, 1.4), radius_m=0.1, name="buoy"),)
    rows = table(tmp_path, description=replace(LAPS_1, obstacles=sphere))
    assert rows["distance to buoy"].worst == pytest.approx(1.02, abs=0.02)


def test_other_violations(tmp_path: Path) -> None:
    assert broken(table(tmp_path, thrust_n=12.01)) == {"thrust command"}
    assert broken(table(tmp_path, nav_error_m=0.02)) == {"estimate position rms"}
    rows = table(tmp_path, contacts=2)
    assert broken(rows) == {"contacts"} and rows["contacts"].note == "deepest 10.0 mm"
    rows = table(tmp_path, fallback=Fallback.SHIFTED_PLAN)
    assert rows["NMPC fallbacks"].verdict is BoundVerdict.WARN and not broken(rows)
    assert overall(rows.values()) is BoundVerdict.WARN


def turned(t_s: float, truth: Truth) -> Truth:
    """A yaw error of the vehicle itself near B."""
    near = t_s % (2 * LEG_S) > 0.7 * LEG_S and t_s % (2 * LEG_S) < 1.3 * LEG_S
    return replace(truth, rpy_rad=truth.rpy_rad - np.array([0.0, 0.0, 0.3])) if near else truth


def test_yaw_error_of_the_estimate(tmp_path: Path) -> None:
    rows = table(tmp_path, change_truth=lambda t, x: replace(x, rpy_rad=x.rpy_rad))
    assert rows["estimate yaw rms"].worst == pytest.approx(0.002, rel=0.01)
    bounds = replace(LAPS_1, accept=AcceptBounds(laps=1, yaw_rms_deg=0.1))
    assert broken(table(tmp_path, description=bounds)) == {"estimate yaw rms"}


def test_missing_laps_and_waypoints(tmp_path: Path) -> None:
    rows = table(tmp_path, laps=2, description=DESCRIPTION)
    assert {"laps", "waypoint B position"} <= broken(rows)
    assert rows["laps"].worst == 2.0 and rows["waypoint B position"].note == "reached 2 of 3"
    rows = table(tmp_path, change_truth=turned)
    assert {"laps", "waypoint B heading"} <= broken(rows)
    assert rows["waypoint B heading"].margin is not None and rows["waypoint B heading"].margin < 0.0


def test_position_and_heading_have_to_hold_at_once(tmp_path: Path) -> None:
    """Right place with the wrong heading and right heading at the wrong place do not add up to a visit."""
    far = replace(LAPS_1, waypoints=(Waypoint(name="C", pos_ned_m=(1.75, 0.0, 0.3), yaw_rad=1.0),), closed_tour=False)
    rows = table(tmp_path, description=far)
    assert {"laps"} < broken(rows) and rows["waypoint C position"].note.startswith("reached 0 of 1")


def test_a_free_heading_is_no_condition(tmp_path: Path) -> None:
    free = replace(LAPS_1, waypoints=(Waypoint(name="C", pos_ned_m=(1.75, 0.0, 0.3)),), closed_tour=False)
    rows = table(tmp_path, description=free)
    assert not broken(rows) and "waypoint C heading" not in rows


def test_bounds_that_are_none_are_not_judged(tmp_path: Path) -> None:
    accept = AcceptBounds(
        cylinder_clearance_m=None,
        wall_clearance_m=None,
        depth_min_m=None,
        depth_max_m=None,
        planar_speed_m_s=None,
        heave_m_s=None,
        yaw_rate_rad_s=None,
        thrust_n=None,
        pos_rms_m=None,
        yaw_rms_deg=None,
    )
    rows = table(tmp_path, thrust_n=99.0, description=replace(DESCRIPTION, accept=accept))
    assert not broken(rows)
    assert not {"laps", "depth, deepest", "thrust command", "distance to walls", "heave"} & set(rows)


def test_without_truth_the_estimate_is_judged_and_that_is_said(tmp_path: Path) -> None:
    rows = table(tmp_path, with_truth=False, change_truth=shifted(9.0, 0.3, **VIOLATIONS["depth, deepest"]))
    assert broken(rows) == {"depth, deepest"}
    assert "estimate" in rows["judged on"].note and "estimate position rms" not in rows
    assert "energy lap 1" not in rows


def test_not_a_number_fails(tmp_path: Path) -> None:
    nan = np.array([math.nan, 0.0, 0.4])
    rows = table(tmp_path, change_truth=shifted(9.0, 0.3, pos_ned_m=nan))
    assert {"distance to cylinder 1", "distance to fence"} <= broken(rows)


def run_with_disarming(path: Path, disarm_us: int) -> Path:
    """A run that surfaces and is carried away after it has been disarmed."""
    log = open_run_log(
        path, epoch_ns=EPOCH_NS, description=replace(LAPS_1, waypoints=()), metadata={}, attachments={}, lossless=True
    )
    for t_us in range(0, 20_000_000, STEP_US):
        _disarming_tick(log, t_us, disarm_us)
    log.close()
    return path


def _disarming_tick(log: RunLog, t_us: int, disarm_us: int) -> None:
    truth = truth_at(t_us * 1e-6)
    armed = 2_000_000 <= t_us < disarm_us
    if not armed:
        truth = replace(truth, pos_ned_m=np.array([2.4, 1.4, 0.0]))
    outputs = outputs_at(t_us, truth, Run())
    log.truth(t_us, truth)
    log.inputs(inputs_at(t_us, truth))
    log.outputs(replace(outputs, mode=ModeState(t_us=t_us, armed=armed, custom_mode=1, failsafes=0)))
    log.event(Event(t_us=t_us, severity=6, text="x"))


def test_only_the_armed_time_is_judged(tmp_path: Path) -> None:
    path = run_with_disarming(tmp_path / "a.mcap", 15_000_000)
    log = open_log(path)
    assert load_flight(log).armed == Span(2.0, pytest.approx(15.0, abs=2e-6))
    rows = {row.name: row for row in acceptance_table(log)}
    assert not {"distance to walls", "distance to fence", "depth, shallowest"} & broken(rows)
    end = rows["distance to walls"]
    assert end.worst is not None and end.worst > 0.3


def test_a_log_without_description_or_track(tmp_path: Path) -> None:
    from autopilot.log.packing.records import pack_record
    from autopilot.log.writer import LogWriter

    path = tmp_path / "bare.mcap"
    with LogWriter(path, epoch_ns=EPOCH_NS, metadata={}, attachments={}) as log:
        log.write("/sim/contact", 0, pack_record("/sim/contact", EPOCH_NS, (1, 0.0)))
    for bare in (path, write_bare(tmp_path / "d.mcap", to_json(DESCRIPTION))):
        with pytest.raises(LogError, match="neither /sim/truth nor /nav/state"):
            acceptance_table(open_log(bare))
    with pytest.raises(LogError, match=r"run\.json is damaged"):
        acceptance_table(open_log(write_bare(tmp_path / "e.mcap", b"{}")))


def write_bare(path: Path, description: bytes) -> Path:
    from autopilot.log.writer import LogWriter

    LogWriter(path, epoch_ns=EPOCH_NS, metadata={}, attachments={"run.json": description}).close()
    return path


def test_description_round_trip_and_fence() -> None:
    fence = Fence(
        inclusions=(Polygon(vertices_ned_m=np.array(TANK)),),
        exclusions=(Circle(center_ned_m=np.array([0.9375, 0.0]), radius_m=0.16),),
    )
    shapes = fence_shapes(fence)
    assert shapes == DESCRIPTION.fence[:1] + DESCRIPTION.fence[2:]
    for run in (DESCRIPTION, RunDescription(scenario="", vehicle="x")):
        assert from_json(to_json(run), "x") == run


@given(st.floats(-4.0, 4.0), st.floats(-3.0, 3.0))
@settings(deadline=None)
def test_distances(x: float, y: float) -> None:
    point = np.array([[x, y]])
    inside = abs(x) < 2.5 and abs(y) < 1.5
    expected = min(2.5 - abs(x), 1.5 - abs(y)) if inside else -math.hypot(max(abs(x) - 2.5, 0), max(abs(y) - 1.5, 0))
    assert distance_to_polygon(point, TANK)[0] == pytest.approx(expected, abs=1e-12)
    assert distance_to_polygon(point, TANK[::-1])[0] == pytest.approx(expected, abs=1e-12)
    around = [math.hypot(x - cx, y - cy) - 0.16 for cx, cy in ((-0.625, -0.625), (0.9375, 0.0))]
    fence = distance_to_fence(point, DESCRIPTION.fence)[0]
    assert fence == pytest.approx(min([expected, *around]), abs=1e-12)


def test_visits_are_counted_in_order(tmp_path: Path) -> None:
    track = load_flight(open_log(write_run(tmp_path / "a.mcap", Run(laps=1, step_us=STEP_US)))).judged
    tour = visits(track, LAPS_1)
    assert [v.waypoint.name for v in tour] == ["A", "B", "A"]
    times = [v.t_s for v in tour if v.t_s is not None]
    assert times == sorted(times) and len(times) == 3
    backwards = replace(LAPS_1, waypoints=LAPS_1.waypoints[::-1])
    assert [v.t_s is not None for v in visits(track, backwards)] == [True, True, False]


def test_energy_falls_back_to_the_battery(tmp_path: Path) -> None:
    run = Run(laps=1, step_us=STEP_US, with_truth=False, full_inputs=True)
    flight = load_flight(open_log(write_run(tmp_path / "a.mcap", run)))
    assert energy_j(flight, Span(0.0, 10.0)) == pytest.approx(10e6 * 3e-5)


def test_differences_are_found_and_named(tmp_path: Path) -> None:
    base = open_log(write_run(tmp_path / "a.mcap", Run(laps=1, step_us=500_000)))
    same = open_log(write_run(tmp_path / "b.mcap", Run(laps=1, step_us=500_000)))
    assert compare_logs(base, same, (), ()) == []
    moved = shifted(9.0, 0.3, pos_ned_m=np.array([0.0, 0.0, 0.4]))
    other = open_log(write_run(tmp_path / "c.mcap", Run(laps=1, step_us=500_000, change_truth=moved)))
    found = compare_logs(base, other)
    places = {(d.topic, d.field) for d in found}
    assert ("/sim/truth", "pos_ned_m") in places and ("/ctl/horizon", "poses[0].pose.position.x") in places
    first = next(d for d in found if d.topic == "/sim/truth")
    assert first.t_s == pytest.approx(9.0) and str(first).startswith("/sim/truth.pos_ned_m at 9.000 s: ")
    assert ("/sim/truth", "pos_ned_m") not in {
        (d.topic, d.field) for d in compare_logs(base, other, (), ("/sim/truth.pos_ned_m",))
    }
    blind = open_log(write_run(tmp_path / "d.mcap", Run(laps=1, step_us=500_000, with_truth=False)))
    missing = {d.topic for d in compare_logs(base, blind)}
    drawn = {"/viz/truth", "/viz/tf", "/viz/body", "/viz/current"}
    assert missing - drawn == {"/sim/truth", "/sim/thrusters", "/sim/contact"}
    longer = open_log(write_run(tmp_path / "e.mcap", Run(laps=2, step_us=500_000)))
    assert any("against" in d.what and d.topic == "/nav/state" for d in compare_logs(base, longer))


def test_figures_in_text() -> None:
    assert [format_figure(v) for v in (None, 3.0, 0.12345, math.inf, math.nan)] == ["", "3", "0.1235", "inf", "nan"]
