"""Half-planes and clearances against brute force, from both sides of every boundary."""

import math

import numpy as np
import pytest
from control_loop import TANK
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from autopilot.control.constraints.constraints_tuning import FEATURES
from autopilot.control.constraints.obstacles import Features, clearance_m
from autopilot.core.geometry import Circle, Fence, Polygon

L_ROOM = np.array([[-3.0, -3.0], [-3.0, 3.0], [0.0, 3.0], [0.0, 0.0], [3.0, 0.0], [3.0, -3.0]])
WEDGE = np.array([[-2.0, -2.0], [-1.5, -1.2], [-1.2, -2.2]])
STAR = np.array([[1.0, -1.0], [1.4, -1.6], [2.0, -1.5], [1.5, -1.9], [1.6, -2.5], [1.1, -2.0]])
ROOM = Fence(
    inclusions=(Polygon(vertices_ned_m=L_ROOM),),
    exclusions=(
        Polygon(vertices_ned_m=WEDGE),
        Polygon(vertices_ned_m=STAR),
        Circle(center_ned_m=np.array([-1.5, 1.5]), radius_m=0.4),
    ),
)
point = st.tuples(st.floats(-4.0, 4.0), st.floats(-4.0, 4.0)).map(np.array)


def winding(p: np.ndarray, polygon: np.ndarray) -> bool:
    """Inside by the sum of angles: another method than the one under test."""
    rays = polygon - p
    angles = np.arctan2(rays[:, 1], rays[:, 0])
    turns = (np.roll(angles, -1) - angles + math.pi) % (2.0 * math.pi) - math.pi
    return abs(float(turns.sum())) > math.pi


def edge_distance(p: np.ndarray, polygon: np.ndarray) -> float:
    best = math.inf
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        t = min(max(float((p - a) @ (b - a) / ((b - a) @ (b - a))), 0.0), 1.0)
        best = min(best, float(np.linalg.norm(p - a - t * (b - a))))
    return best


def brute_clearance(p: np.ndarray) -> float:
    values = [edge_distance(p, L_ROOM) * (1.0 if winding(p, L_ROOM) else -1.0)]
    values += [edge_distance(p, q) * (-1.0 if winding(p, q) else 1.0) for q in (WEDGE, STAR)]
    values.append(float(np.linalg.norm(p - [-1.5, 1.5])) - 0.4)
    return min(values)


def planes(fence: Fence, points: np.ndarray, radius: float, normals: np.ndarray, offsets: np.ndarray) -> float:
    """Half-planes at points much later than now, when nothing of a present violation is left."""
    points = np.concatenate([points[:1], points])
    t_s = np.full(len(points), 1e3)
    return Features(fence).half_planes(points, t_s, radius, normals.shape[1], normals, offsets)


@given(point)
@settings(max_examples=300, deadline=None)
def test_clearance(p: np.ndarray) -> None:
    assert clearance_m(ROOM, [p])[0] == pytest.approx(brute_clearance(p), abs=1e-8)


@given(point, st.floats(0.0, 0.5), st.sampled_from([2, 8, 30]))
@settings(max_examples=200, deadline=None)
def test_nearest_half_plane_touches_at_the_nearest_point(p: np.ndarray, radius: float, slots: int) -> None:
    assume(not (ROOM.inclusions[0].vertices_ned_m == p).all(axis=1).any())  # a corner itself has no normal
    normals, offsets = np.full((1, slots, 2), np.nan), np.full((1, slots), np.nan)
    worst = planes(ROOM, p[None], radius, normals, offsets)
    assert np.isfinite(normals).all()
    assert np.isfinite(offsets).all()
    length = np.linalg.norm(normals[0], axis=1)
    used = length > 0.5
    assert np.allclose(length[used], 1.0)
    assert (offsets[0][~used] == -1.0).all()
    room = normals[0] @ p - offsets[0]
    assert room[used].min() == pytest.approx(brute_clearance(p) - radius, abs=1e-8)
    assert worst == pytest.approx(brute_clearance(p) - radius, abs=1e-8)


@given(point)
@settings(max_examples=200, deadline=None)
def test_from_forbidden_ground_the_worst_half_plane_points_the_way_out(p: np.ndarray) -> None:
    clearance = brute_clearance(p)
    if clearance > -1e-3:
        return
    normals, offsets = np.zeros((1, 8, 2)), np.zeros((1, 8))
    planes(ROOM, p[None], 0.0, normals, offsets)
    worst = int((normals[0] @ p - offsets[0]).argmin())
    step = min(0.3, -clearance)
    assert brute_clearance(p + step * normals[0, worst]) > clearance + 1e-6


@given(st.floats(-2.1, 2.1), st.floats(-1.1, 1.1))
@settings(max_examples=100, deadline=None)
def test_half_planes_never_admit_more_than_the_tank_has(x: float, y: float) -> None:
    """Whatever satisfies all half-planes of a free point lies in free ground: circles and walls are convex."""
    p = np.array([x, y])
    if clearance_m(TANK, [p])[0] <= 0.0:
        return
    normals, offsets = np.zeros((1, 8, 2)), np.zeros((1, 8))
    planes(TANK, p[None], 0.3, normals, offsets)
    rng = np.random.default_rng(3)
    others = rng.uniform([-2.5, -1.5], [2.5, 1.5], (200, 2))
    admitted = (others @ normals[0].T >= offsets[0]).all(axis=1)
    if admitted.any():
        assert clearance_m(TANK, others[admitted]).min() >= 0.3 - 1e-9


def test_points_on_lines_and_centres_have_a_way_out() -> None:
    fence = Fence(
        inclusions=(Polygon(vertices_ned_m=np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])),),
        exclusions=(Circle(center_ned_m=np.array([2.0, 2.0]), radius_m=0.5),),
    )
    normals, offsets = np.zeros((2, 8, 2)), np.zeros((2, 8))
    planes(fence, np.array([[2.0, 2.0], [1.0, 0.0]]), 0.3, normals, offsets)
    assert np.isfinite(normals).all()
    room = np.einsum("mks,ms->mk", normals, np.array([[2.0, 2.0], [1.0, 0.0]])) - offsets
    assert room[0].min() == pytest.approx(-0.8)
    worst = int(room[1].argmin())
    assert room[1].min() == pytest.approx(-0.3)
    assert np.allclose(normals[1, worst], [0.0, 1.0])


def test_circle_to_stay_in() -> None:
    fence = Fence(inclusions=(Circle(center_ned_m=np.array([1.0, 0.0]), radius_m=2.0),))
    assert np.allclose(clearance_m(fence, [[1.0, 0.5], [1.0, -1.9], [4.0, 0.0]]), [1.5, 0.1, -1.0])


def test_winding_of_the_polygon_does_not_matter() -> None:
    other = Fence(
        inclusions=(Polygon(vertices_ned_m=L_ROOM[::-1]),),
        exclusions=(Polygon(vertices_ned_m=WEDGE[::-1]), Polygon(vertices_ned_m=STAR[::-1]), ROOM.exclusions[2]),
    )
    points = np.random.default_rng(0).uniform(-4, 4, (200, 2))
    assert np.allclose(clearance_m(ROOM, points), clearance_m(other, points))


def test_push_out_brings_points_to_the_radius() -> None:
    points = np.random.default_rng(0).uniform([-2.4, -1.4], [2.4, 1.4], (200, 2))
    features = Features(TANK)
    one_boundary = np.sort(features.nearest(points.view(complex)[:, 0])[0], axis=1)[:, 1] > 0.6
    moved = points + features.push_out(points, 0.3)
    assert features.clearance_m(moved[one_boundary]).min() >= 0.3 - 1e-9


def test_open_water_has_no_constraints() -> None:
    normals, offsets = np.ones((3, 8, 2)), np.ones((3, 8))
    assert planes(Fence(), np.zeros((3, 2)), 0.3, normals, offsets) == FEATURES.far_m
    assert not normals.any()
    assert (offsets == -1.0).all()
    assert clearance_m(Fence(), [[0.0, 0.0]])[0] == FEATURES.far_m


def test_a_violated_boundary_is_asked_for_gradually_and_others_at_once() -> None:
    """0.5 m outside the west wall and 0.2 m too near to the south wall beside it."""
    room = Fence(inclusions=(Polygon(vertices_ned_m=np.array([[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]])),))
    points = np.array([[-2.5, 0.0], [-2.4, 0.0], [-1.5, -1.9], [1.0, -1.9]])
    normals, offsets = np.zeros((3, 4, 2)), np.zeros((3, 4))
    Features(room).half_planes(points, np.array([0.0, 0.5, 2.0, 10.0]), 0.3, 4, normals, offsets)
    demanded = []
    for k in range(3):
        west = np.flatnonzero(np.isclose(normals[k, :, 0], 1.0))
        demanded.append(offsets[k, west[0]])
    assert demanded == pytest.approx([-2.5 + 0.2 * 0.5, -2.5 + 0.2 * 2.0, -1.7])
    south = np.flatnonzero(np.isclose(normals[1, :, 1], 1.0))
    assert offsets[1, south[0]] == pytest.approx(-1.7)


def test_of_many_obstacles_the_near_ones_are_the_same_as_without_culling() -> None:
    rng = np.random.default_rng(8)
    circles = tuple(
        Circle(center_ned_m=rng.uniform(-12, 12, 2), radius_m=float(rng.uniform(0.1, 0.8))) for _ in range(60)
    )
    fence = Fence(inclusions=(Circle(center_ned_m=np.zeros(2), radius_m=14.0),), exclusions=circles)
    features = Features(fence)
    points = np.cumsum(rng.uniform(-0.3, 0.4, (20, 2)), axis=0)
    normals, offsets = np.zeros((19, 8, 2)), np.zeros((19, 8))
    margin = features.half_planes(points, np.zeros(20), 0.3, 8, normals, offsets)
    between = points[:-1] + np.linspace(0.0, 1.0, 201)[:, None, None] * np.diff(points, axis=0)
    nearest = features.clearance_m(between.reshape(-1, 2)).min() - 0.3
    assert margin == pytest.approx(nearest, abs=1e-3)
    assert features.margin_m(points, np.zeros(20), 0.3) == margin
    room = (np.einsum("mks,ms->mk", normals, points[1:]) - offsets)[np.abs(normals).sum(axis=2) > 0.0]
    assert room.min() == pytest.approx(nearest, abs=1e-3)


@given(st.integers(0, 10_000), st.floats(0.1, 3.0))
def test_clearance_up_to_a_bound_is_the_clearance(seed: int, cap_m: float) -> None:
    rng = np.random.default_rng(seed)
    circles = tuple(
        Circle(center_ned_m=rng.uniform(-8.0, 8.0, 2), radius_m=float(rng.uniform(0.1, 1.0))) for _ in range(40)
    )
    tank = Polygon(vertices_ned_m=np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]]))
    points = np.cumsum(rng.normal(0.0, 0.2, (200, 2)), axis=0)
    for fence in (
        Fence(exclusions=circles),
        Fence(inclusions=(tank,), exclusions=circles),
        Fence(exclusions=circles[:3]),
    ):
        features = Features(fence)
        capped = features.clearance_up_to_m(points, cap_m)
        assert np.allclose(capped, np.minimum(features.clearance_m(points), cap_m), atol=1e-12)
