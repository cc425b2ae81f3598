"""Obstacles that move: where they are, what they do to the hull, and what the obstacle sensor says of them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.samples import ObstacleTrack
from autopilot.core.vehicle import load_vehicle
from autopilot.log.analysis import obstacle_position
from autopilot.log.description import Obstacle
from autopilot.sitl.backend import SimulatedVehicle, simulated_vehicle
from autopilot.sitl.contact import MovingCylinder, MovingPath, SolidGeometry
from autopilot.sitl.plant import Plant
from autopilot.sitl.scenario import load_scenario
from autopilot.sitl.simulated_waters import SimulatedWaters

VEHICLE = load_vehicle("lbv150")
CORNERS = [(0.0, 0.0), (3.0, 0.0), (3.0, 4.0)]


@given(st.floats(0.0, 500.0), st.sampled_from(["bounce", "loop", "stop"]), st.floats(0.0, 30.0))
@settings(max_examples=200, deadline=None)
def test_the_log_finds_a_moving_obstacle_where_the_simulator_has_it(t_s: float, ends, start_s: float) -> None:
    path = MovingPath(CORNERS, 0.3, ends, start_s)
    told = Obstacle(center_m=CORNERS[0], radius_m=0.2, path_m=tuple(CORNERS), speed_m_s=0.3, ends=ends, start_s=start_s)
    assert obstacle_position(told, np.array([t_s]))[0] == pytest.approx(path.at(t_s).center_ned_m, abs=1e-9)


@given(st.floats(0.0, 200.0), st.sampled_from(["bounce", "loop", "stop"]))
@settings(max_examples=200, deadline=None)
def test_the_velocity_is_that_of_the_motion(t_s: float, ends) -> None:
    path = MovingPath(CORNERS, 0.3, ends)
    before, now, after = (np.array(path.at(t_s + dt).center_ned_m) for dt in (-1e-4, 0.0, 1e-4))
    velocity = np.array(path.at(t_s).velocity_ned_m_s)
    if t_s > 1e-3 and np.allclose(after - now, now - before, atol=1e-12):
        assert (after - now) / 1e-4 == pytest.approx(velocity, abs=1e-6)
    assert np.hypot(*velocity) in (pytest.approx(0.3), 0.0)


def test_ends() -> None:
    assert MovingPath(CORNERS, 1.0, "stop").at(50.0).center_ned_m == (3.0, 4.0)
    assert MovingPath(CORNERS, 1.0, "stop").at(50.0).velocity_ned_m_s == (0.0, 0.0)
    assert MovingPath(CORNERS, 1.0, "bounce").at(8.0).center_ned_m == pytest.approx((3.0, 3.0))
    assert MovingPath(CORNERS, 1.0, "bounce").at(8.0).velocity_ned_m_s == pytest.approx((0.0, -1.0))
    assert MovingPath(CORNERS, 1.0, "loop").at(9.0).center_ned_m == pytest.approx((3.0 - 2.0 * 0.6, 4.0 - 2.0 * 0.8))
    assert MovingPath(CORNERS, 1.0, "bounce", 5.0).at(4.0) == ((0.0, 0.0), (0.0, 0.0))


def world(speed_m_s: float) -> SimulatedWaters:
    path = MovingPath([(2.0, 0.0), (-2.0, 0.0)], speed_m_s, "stop")
    return SimulatedWaters(solids=(MovingCylinder(name="drifter", path=path, radius_m=0.2),))


def test_a_moving_obstacle_pushes_a_vehicle_that_rests() -> None:
    plant = Plant(VEHICLE, world(0.2), start_pos_ned_m=(0.0, 0.0, 0.5))
    plant.advance(5_000_000, (1500, 1500, 1500, 1500))
    assert plant.truth.contact_count == 0
    assert abs(float(plant.truth.pos_ned_m[0])) < 1e-6
    plant.advance(12_000_000, (1500, 1500, 1500, 1500))
    truth = plant.truth
    assert truth.contact_count >= 1
    assert plant.contacts[0].what == "drifter"
    assert plant.contacts[0].t_us == pytest.approx((2.0 - 0.2 - VEHICLE.hull_radius_m) / 0.2 * 1e6, abs=2e5)
    assert float(truth.pos_ned_m[0]) < -0.2
    assert truth.max_penetration_m < 0.05


def test_clearance_follows_the_obstacle() -> None:
    around = SolidGeometry(
        polygon_ned_m=None, floor_m=None, solids=world(0.5).solids, hull_radius_m=0.2, hull_half_height_m=0.1
    )
    assert around.fastest_m_s == 0.5
    for t_s in (0.0, 1.0, 3.0):
        around.move_to(t_s)
        assert around.clearance_m((0.0, 1.0, 0.3)) == pytest.approx(math.hypot(2.0 - 0.5 * t_s, 1.0) - 0.4)


SCENARIO = """
[scenario]
name = "sensor"
description = "Open water with obstacles"

[[obstacle]]
kind = "moving"
path_m = [[3.0, 0.0], [-3.0, 0.0]]
speed_m_s = 0.5
radius_m = 0.2

[[obstacle]]
kind = "cylinder"
center_m = [0.0, 1.0]
radius_m = 0.1
surprise = true

[[obstacle]]
kind = "cylinder"
center_m = [0.0, -1.0]
radius_m = 0.1

[vehicle]
start_m = [0.0, 0.0, 0.5]

[sensors]
position = "pose"

[sensors.obstacles]
range_m = 1.5
rate_hz = 10.0
sigma_m = 0.02
sigma_velocity_m_s = 0.01
latency_s = 0.3
"""


def simulated(tmp_path, text: str = SCENARIO, seed: int = 1) -> SimulatedVehicle:
    file = tmp_path / "sensor.toml"
    file.write_text(text)
    return simulated_vehicle(load_scenario(str(file)), VEHICLE, seed=seed)


def reports(device: SimulatedVehicle, until_s: float) -> list[tuple[float, ObstacleTrack]]:
    found = []
    for tick in range(1, round(until_s * 100.0) + 1):
        device.advance(tick * 10_000)
        found += [(tick * 0.01, s) for s in device.poll(tick * 10_000) if isinstance(s, ObstacleTrack)]
    device.close()
    return found


def test_the_sensor_reports_what_moves_and_what_is_a_surprise(tmp_path) -> None:
    found = reports(simulated(tmp_path), 4.0)
    assert {track.track_id for _, track in found} == {1, 2}
    for arrived_s, track in found:
        assert arrived_s - track.t_us * 1e-6 == pytest.approx(0.3, abs=0.011)
        if track.track_id == 2:
            assert track.vel_ned_m_s == pytest.approx([0.0, 0.0])
            assert track.pos_ned_m == pytest.approx([0.0, 1.0], abs=0.1)
            continue
        truth = 3.0 - 0.5 * track.t_us * 1e-6
        assert track.pos_ned_m == pytest.approx([truth, 0.0], abs=0.1)
        assert track.vel_ned_m_s == pytest.approx([-0.5, 0.0], abs=0.05)
        assert truth <= 1.7 + 1e-6
    assert min(t for t, track in found if track.track_id == 1) == pytest.approx(2.6 + 0.3, abs=0.15)
    errors = [track.pos_ned_m[1] for _, track in found if track.track_id == 1]
    assert np.std(errors) > 0.005


def test_the_sensor_is_deterministic_and_follows_the_seed(tmp_path) -> None:
    first, again, other = (reports(simulated(tmp_path, seed=seed), 1.5) for seed in (1, 1, 2))

    def values(found: list[tuple[float, ObstacleTrack]]) -> list[float]:
        return [float(x) for _, track in found for x in (*track.pos_ned_m, *track.vel_ned_m_s)]

    assert values(first) == values(again)
    assert values(first) != values(other)


def test_a_world_without_surprises_has_nothing_to_report(tmp_path) -> None:
    text = SCENARIO.replace("surprise = true\n", "")
    begin, end = text.index("[[obstacle]]"), text.index('[[obstacle]]\nkind = "cylinder"')
    assert reports(simulated(tmp_path, text[:begin] + text[end:]), 1.0) == []
