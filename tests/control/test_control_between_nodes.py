"""Between the nodes of the prediction nothing tunnels: poles, walls of a millimetre, random places and speeds."""

import math
from itertools import pairwise

import numpy as np
import pytest
from control_loop import VEHICLE, fly, goal
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.control.constraints.obstacles import Features, Movers, clearance_m
from autopilot.control.controller import MotionController
from autopilot.core.geometry import Circle, Fence, Polygon

RADIUS_M = 0.33
POLE_M = 0.0025
THIN_M = 0.001


def pole(x: float, y: float) -> Circle:
    return Circle(center_ned_m=np.array([x, y]), radius_m=POLE_M)


def wall(x: float, y: float, angle_rad: float, length_m: float) -> Polygon:
    """A wall of a millimetre with its middle at x, y."""
    along = 0.5 * length_m * np.array([math.cos(angle_rad), math.sin(angle_rad)])
    across = 0.5 * THIN_M * np.array([-math.sin(angle_rad), math.cos(angle_rad)])
    return Polygon(
        vertices_ned_m=np.array([x, y]) + np.array([along + across, along - across, -along - across, -along + across])
    )


def chord_clearance(fence: Fence, path: np.ndarray) -> np.ndarray:
    """Smallest clearance of each chord, by brute force."""
    share = np.linspace(0.0, 1.0, 51)[:, None]
    return np.array([clearance_m(fence, a + share * (b - a)).min() for a, b in pairwise(path)])


def half_planes(fence: Fence, path: np.ndarray, movers: Movers | None = None, t_s: np.ndarray | None = None):
    m = len(path) - 1
    normals, offsets = np.zeros((m, 24, 2)), np.zeros((m, 24))
    times = np.linspace(0.0, 8.0, m + 1) if t_s is None else t_s
    margin = Features(fence).half_planes(path, times, RADIUS_M, 24, normals, offsets, movers)
    return normals, offsets, margin


@given(st.integers(0, 100_000), st.floats(0.2, 1.0))
@settings(max_examples=40, deadline=None)
def test_what_keeps_the_half_planes_keeps_clear_between_its_nodes(seed: int, step_m: float) -> None:
    rng = np.random.default_rng(seed)
    turns = np.cumsum(rng.normal(0.0, 0.4, 8))
    path = np.concatenate([[[0.0, 0.0]], np.cumsum(step_m * np.stack([np.cos(turns), np.sin(turns)], axis=1), axis=0)])
    shapes = [pole(*rng.uniform(-1.0, 4.0, 2)) for _ in range(2)]
    shapes += [wall(*rng.uniform(-1.0, 4.0, 2), rng.uniform(0.0, 3.0), rng.uniform(0.3, 1.5)) for _ in range(2)]
    fence = Fence(exclusions=tuple(shapes))
    if clearance_m(fence, path[:1])[0] < RADIUS_M or chord_clearance(fence, path).min() < 0.02:
        return
    normals, offsets, margin = half_planes(fence, path)
    assert margin == pytest.approx(chord_clearance(fence, path).min() - RADIUS_M, abs=0.01)
    for _ in range(6):
        moved = path + np.concatenate([np.zeros((1, 2)), rng.normal(0.0, 0.15, (len(path) - 1, 2))])
        room = np.einsum("mks,ms->mk", normals, moved[1:]) - offsets
        chords = chord_clearance(fence, moved)
        for k in range(len(chords)):
            keeps = room[k].min() >= 0.0 and (k == 0 or room[k - 1].min() >= 0.0)
            assert not keeps or chords[k] >= RADIUS_M - 0.03


@given(st.floats(-0.2, 0.2), st.floats(0.1, 0.9), st.floats(0.1, 1.0))
@settings(max_examples=60, deadline=None)
def test_a_pole_between_two_nodes_binds_both(aside_m: float, share: float, step_m: float) -> None:
    """Both nodes are farther from the pole than the chord is: only the chord shows how near the path comes."""
    path = np.array([[-step_m, 0.0], [0.0, 0.0], [step_m, 0.0], [2.0 * step_m, 0.0]])
    fence = Fence(exclusions=(pole(share * step_m, aside_m),))
    normals, offsets, margin = half_planes(fence, path)
    assert margin <= abs(aside_m) - POLE_M - RADIUS_M + 1e-9
    side = 1.0 if aside_m <= 0.0 else -1.0
    for node in (0, 1):
        room = normals[node] @ path[node + 1] - offsets[node]
        assert room.min() == pytest.approx(abs(aside_m) - POLE_M - RADIUS_M, abs=1e-9) or abs(aside_m) < 1e-6
        if abs(aside_m) > 1e-6:
            assert normals[node][room.argmin()] == pytest.approx([0.0, side], abs=1e-9)


def test_a_guess_through_a_wall_is_held_where_it_came_from() -> None:
    fence = Fence(exclusions=(wall(1.0, 0.0, math.pi / 2.0, 2.0),))
    path = np.array([[0.0, 0.0], [0.4, 0.0], [0.8, 0.0], [1.2, 0.0], [1.6, 0.0]])
    normals, offsets, margin = half_planes(fence, path)
    assert margin <= -RADIUS_M
    for k in range(2, 4):
        assert (normals[k] @ np.array([1.2, 0.0]) < offsets[k]).any()
        assert (normals[k] @ np.array([0.6, 0.0]) >= offsets[k] - 1e-9).all()


def test_moving_obstacles_are_met_where_they_will_be() -> None:
    """A vehicle to the north and an obstacle to the east that would meet at 2 m after 4 s."""
    t_s = np.linspace(0.0, 8.0, 9)
    path = np.stack([0.5 * t_s, np.zeros(9)], axis=1)
    movers = Movers(
        center=np.array([2.0 - 2.0j]),
        velocity_m_s=np.array([0.5j]),
        radius_m=np.array([0.2]),
        growth_m_s=np.array([0.0]),
    )
    normals, _, margin = half_planes(Fence(), path, movers, t_s)
    assert margin == pytest.approx(-0.2 - RADIUS_M)
    missed = path + np.array([0.0, 1.5])
    early, late = half_planes(Fence(), path - [2.0, 0.0], movers, t_s)[2], half_planes(Fence(), missed, movers, t_s)[2]
    fine = np.linspace(0.0, 8.0, 4001)
    for shift, found in (([-2.0, 0.0], early), ([0.0, 1.5], late)):
        rays = np.stack([0.5 * fine, 0.0 * fine], axis=1) + shift - np.stack([2.0 + 0 * fine, 0.5 * fine - 2.0], axis=1)
        assert found == pytest.approx(np.hypot(*rays.T).min() - 0.2 - RADIUS_M, abs=1e-5)
    assert (np.linalg.norm(normals, axis=2).max(axis=1) > 0.99).all()
    growing = Movers(
        center=movers.center, velocity_m_s=movers.velocity_m_s, radius_m=movers.radius_m, growth_m_s=np.array([0.05])
    )
    assert half_planes(Fence(), missed, growing, t_s)[2] < late - 0.1


@pytest.mark.parametrize("seed", range(2))
def test_thin_obstacles_are_never_crossed_in_flight(seed: int) -> None:
    """Poles of 5 mm and walls of 1 mm between start and goal, at random places and speeds."""
    rng = np.random.default_rng(seed)
    speed = float(rng.uniform(0.2, 0.45))
    shapes = (
        pole(rng.uniform(1.0, 1.6), rng.uniform(-0.2, 0.2)),
        wall(2.5, rng.uniform(-0.3, 0.3), rng.uniform(0.8, 2.3), rng.uniform(0.3, 1.0)),
        pole(rng.uniform(3.4, 4.0), rng.uniform(-0.3, 0.3)),
    )
    fence = Fence(exclusions=shapes, depth_max_m=1.2)
    controller = MotionController(VEHICLE, cpu_clock=lambda: 0.0)
    flight = fly(
        controller,
        [goal(5.0, 0.0, 0.4, None, speed_m_s=speed)],
        [0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0],
        fence=fence,
        limit_s=40.0,
    )
    assert len(flight.reached_s) == 1
    assert clearance_m(fence, flight.x[:, :2]).min() >= VEHICLE.radius_m
