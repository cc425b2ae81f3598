"""What the plans of a flight draw: the ways of moving obstacles, currents of every strength, tours of one waypoint."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_synthetic import DESCRIPTION, Run, Truth, write_run

from autopilot.log.analysis import FlightRecord, VehicleTrack, load_flight, obstacle_position
from autopilot.log.check import acceptance_table
from autopilot.log.description import AcceptBounds, Obstacle
from autopilot.log.figure_paper import trajectory
from autopilot.log.figure_parts import LAP_COLORS, make_scene
from autopilot.log.plan_summary import LONGEST_ARROW, met_current, moved_obstacles, plan_box, round_figure
from autopilot.log.reader import open_log
from autopilot.log.report_plots import Plots

MOVING = Obstacle(center_m=(0.2, 1.2), radius_m=0.12, name="moving", path_m=((0.2, 1.2), (0.0, -1.2)), speed_m_s=0.12)
EAST_M_S = 0.02


def slow_eddy(t_s: float, truth: Truth) -> Truth:
    return replace(truth, current_ned_m_s=np.array([0.0, EAST_M_S, 0.0]))


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> FlightRecord:
    """One waypoint, a slow current and a moving obstacle."""
    run = replace(
        DESCRIPTION,
        obstacles=(*DESCRIPTION.obstacles, MOVING),
        waypoints=DESCRIPTION.waypoints[1:2],
        accept=AcceptBounds(laps=1),
    )
    path = tmp_path_factory.mktemp("plan") / "run.mcap"
    made = Run(laps=1, step_us=100_000, description=run, change_truth=slow_eddy)
    return load_flight(open_log(write_run(path, made)))


def track_along(size_m: float, flow_m_s: float) -> VehicleTrack:
    n = 200
    at = np.linspace(0.0, size_m, n)
    zero = np.zeros((n, 3))
    flow = np.column_stack((np.full(n, flow_m_s), np.zeros((n, 2))))
    return VehicleTrack(
        t_s=at,
        pos_ned_m=np.column_stack((at, np.zeros((n, 2)))),
        rpy_rad=zero,
        vel_frd_m_s=zero,
        vel_water_frd_m_s=zero,
        rate_frd_rad_s=zero,
        current_ned_m_s=flow,
    )


@given(st.floats(0.5, 5000.0), st.floats(0.006, 5.0))
@settings(deadline=None, max_examples=50)
def test_arrows_are_to_scale_with_the_field(size_m: float, flow_m_s: float) -> None:
    met = met_current(track_along(size_m, flow_m_s), None)
    assert met is not None
    longest = met.scale_m * float(np.hypot(*met.flow_m_s.T).max())
    assert longest == pytest.approx(LONGEST_ARROW * size_m)
    assert 0.39 * flow_m_s <= met.key_m_s <= 1.0001 * flow_m_s
    assert 5 <= len(met.place_m) <= 100


def test_still_water_has_no_arrows() -> None:
    assert met_current(track_along(5.0, 0.0), None) is None
    assert met_current(track_along(0.0, 0.2), None) is None
    assert round_figure(0.2) == pytest.approx(0.2) and round_figure(0.0499) == pytest.approx(0.02)


def test_a_moving_obstacle_is_drawn_where_it_was(flight: FlightRecord) -> None:
    assert flight.run is not None
    track = flight.judged.between(flight.armed)
    (moved,) = moved_obstacles(track, flight.run)
    np.testing.assert_allclose(moved.path_m[0], obstacle_position(MOVING, track.t_s[:1])[0])
    np.testing.assert_allclose(moved.path_m[-1], obstacle_position(MOVING, track.t_s[-1:])[0])
    apart = np.hypot(*(track.pos_ned_m[:, :2] - obstacle_position(MOVING, track.t_s)).T)
    nearest = track.pos_ned_m[np.searchsorted(track.t_s, moved.nearest_s), :2]
    assert np.hypot(*(nearest - moved.nearest_m)) == pytest.approx(apart.min())
    solid = [
        (float(r.data_source.data["x"][0]), float(r.data_source.data["y"][0]))
        for r in Plots(flight).all()["Overview"]["Plan"].renderers
        if getattr(r.glyph, "fill_color", None) == "#777777"
    ]
    assert any(place == pytest.approx(moved.nearest_m) for place in solid)
    assert not any(place == pytest.approx(MOVING.center_m) for place in solid), "not only where it began"


def test_the_lap_of_one_waypoint_is_the_way_to_it(flight: FlightRecord) -> None:
    rows = {row.name: row for row in acceptance_table(flight.log)}
    reached = rows["waypoint B position"].at_s
    assert reached is not None
    assert rows["time lap 1"].worst == pytest.approx(reached - flight.armed.start_s)
    assert (rows["energy lap 1"].worst or 0.0) > 100.0
    figure = trajectory(make_scene(flight.log))
    assert figure is not None
    (ax,) = figure.axes
    ways = {line.get_label(): line for line in ax.get_lines()}
    assert ways["lap 1"].get_color() == LAP_COLORS[0]
    assert len(np.asarray(ways["lap 1"].get_xdata())) > 100
    items = [item.label.value for item in Plots(flight).all()["Overview"]["Plan"].legend[0].items]
    assert any(item.startswith("lap 1: ") for item in items)


def test_the_key_and_every_arrow_are_in_the_plan(flight: FlightRecord) -> None:
    track = flight.judged.between(flight.armed)
    met = met_current(track, flight.run)
    assert met is not None and met.key_m_s == pytest.approx(EAST_M_S)
    low, high = plan_box(track, flight.run)
    assert met.key_m[0] == pytest.approx(low[0]) and met.key_m[1] > high[1]
    words = [
        text
        for r in Plots(flight).all()["Overview"]["Plan"].renderers
        for text in (r.data_source.data.get("text") if r.data_source.data.get("text") is not None else ())
    ]
    assert "current 0.02 m/s" in words


def test_a_flight_that_finishes_no_lap_is_not_grey(tmp_path: Path) -> None:
    far = replace(DESCRIPTION.waypoints[0], pos_ned_m=(50.0, 0.0, 0.5))
    run = replace(DESCRIPTION, waypoints=(far,), accept=AcceptBounds(laps=1))
    log = open_log(write_run(tmp_path / "run.mcap", Run(laps=1, step_us=200_000, description=run)))
    figure = trajectory(make_scene(log))
    assert figure is not None
    assert {line.get_label(): line.get_color() for line in figure.axes[0].get_lines()}["truth"] == LAP_COLORS[0]
