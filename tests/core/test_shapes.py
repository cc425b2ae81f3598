"""Plane geometry against slow and obvious computations."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from autopilot.core.geometry import Circle, Polygon, Shape
from autopilot.core.shapes import boundary_gap_m, clearance_m, crossing_edges, inside_polygon, is_inside, signed_area_m2

coordinate = st.floats(-5.0, 5.0)
point = st.tuples(coordinate, coordinate).map(np.array)


@st.composite
def star_polygons(draw: st.DrawFn) -> Polygon:
    """Simple polygons, usually not convex: vertices round a centre at increasing angles."""
    count = draw(st.integers(3, 9))
    radii = draw(st.lists(st.floats(0.3, 2.0), min_size=count, max_size=count))
    center = draw(point)
    angles = 2.0 * np.pi * np.arange(count) / count + draw(st.floats(0.0, 1.0))
    vertices = center + np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)
    return Polygon(vertices_ned_m=vertices if draw(st.booleans()) else vertices[::-1].copy())


circles = st.builds(Circle, center_ned_m=point, radius_m=st.floats(0.1, 2.0))
shapes: st.SearchStrategy[Shape] = star_polygons() | circles


def _winding(vertices: np.ndarray, p: np.ndarray) -> float:
    rel = vertices - p
    angles = np.arctan2(rel[:, 1], rel[:, 0])
    turns = np.remainder(np.diff(np.append(angles, angles[0])) + np.pi, 2 * np.pi) - np.pi
    return float(np.sum(turns)) / (2 * np.pi)


def _outline(shape: Shape, per_edge: int = 400) -> np.ndarray:
    if isinstance(shape, Circle):
        a = np.linspace(0, 2 * np.pi, 4 * per_edge)
        return shape.center_ned_m + shape.radius_m * np.stack([np.cos(a), np.sin(a)], axis=1)
    t = np.linspace(0, 1, per_edge)[:, None]
    v = shape.vertices_ned_m
    return np.concatenate([a + t * (b - a) for a, b in zip(v, np.roll(v, -1, axis=0), strict=True)])


@given(star_polygons(), point)
def test_inside_agrees_with_the_winding_number(shape: Polygon, p: np.ndarray) -> None:
    assume(abs(clearance_m(shape, p[None])[0]) > 1e-6)
    vertices = shape.vertices_ned_m
    inside = abs(_winding(vertices, p)) > 0.5
    assert bool(inside_polygon(vertices, p[None])[0]) == inside
    assert is_inside([(float(n), float(e)) for n, e in vertices], float(p[0]), float(p[1])) == inside


@given(shapes, point)
def test_clearance_is_the_distance_to_the_outline(shape: Shape, p: np.ndarray) -> None:
    outline = _outline(shape)
    nearest = float(np.min(np.hypot(*(outline - p).T)))
    assert abs(clearance_m(shape, p[None])[0]) == pytest.approx(nearest, abs=0.012)


@given(shapes, point, point)
def test_clearance_changes_no_faster_than_one_moves(shape: Shape, p: np.ndarray, q: np.ndarray) -> None:
    a, b = clearance_m(shape, np.array([p, q]))
    assert abs(a - b) <= math.hypot(*(p - q)) + 1e-9


@given(star_polygons())
def test_star_polygons_are_simple_and_twisted_ones_are_not(shape: Polygon) -> None:
    vertices = shape.vertices_ned_m
    assert crossing_edges(vertices) is None
    if len(vertices) >= 4:
        twisted = np.array([vertices[0], vertices[2], vertices[1], vertices[3]])
        straight = np.array([vertices[0], vertices[1], vertices[2], vertices[3]])
        assume(crossing_edges(straight) is None)
        convex = len({np.sign(_turn(straight, k)) for k in range(4)}) == 1
        assume(convex)
        assert crossing_edges(twisted) is not None


def _turn(v: np.ndarray, k: int) -> float:
    a, b, c = v[k], v[(k + 1) % 4], v[(k + 2) % 4]
    return float((b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]))


@pytest.mark.parametrize(
    "vertices",
    [
        [(0, 0), (1, 0), (1, 0), (0, 1)],
        [(0, 0), (2, 0), (1, 0), (1, 1)],
        [(0, 0), (2, 2), (2, 0), (0, 2)],
        [(0, 0), (4, 0), (4, 4), (2, 0), (0, 4)],
    ],
    ids=["repeated vertex", "folds back", "bow tie", "touches itself"],
)
def test_degenerate_polygons_are_found(vertices: list[tuple[float, float]]) -> None:
    assert crossing_edges(np.array(vertices, dtype=float)) is not None


@given(star_polygons())
def test_area_changes_sign_with_the_winding(shape: Polygon) -> None:
    assert signed_area_m2(shape.vertices_ned_m) == pytest.approx(-signed_area_m2(shape.vertices_ned_m[::-1]))


def test_area_of_a_rectangle_far_from_the_origin() -> None:
    vertices = np.array([(0, 0), (2, 0), (2, 3), (0, 3)]) + 15_000.0
    assert signed_area_m2(vertices) == pytest.approx(6.0, abs=1e-9)


@settings(max_examples=50)
@given(shapes, shapes)
def test_gap_is_the_distance_of_the_outlines(a: Shape, b: Shape) -> None:
    gap, middle = boundary_gap_m(a, b)
    one, two = _outline(a, 120), _outline(b, 120)
    sampled = float(np.min(np.hypot(one[:, None, 0] - two[None, :, 0], one[:, None, 1] - two[None, :, 1])))
    assert gap <= sampled + 1e-9
    assert sampled <= gap + 0.06
    assert bool(np.all(np.isfinite(middle)))
    if gap > 0.0 and clearance_m(a, middle[None])[0] > 0 and clearance_m(b, middle[None])[0] > 0:
        assert clearance_m(a, middle[None])[0] == pytest.approx(gap / 2, abs=1e-6)
        assert clearance_m(b, middle[None])[0] == pytest.approx(gap / 2, abs=1e-6)


def test_nested_circles_have_a_gap() -> None:
    outer = Circle(center_ned_m=np.zeros(2), radius_m=2.0)
    inner = Circle(center_ned_m=np.array([1.0, 0.0]), radius_m=0.5)
    gap, middle = boundary_gap_m(outer, inner)
    assert gap == pytest.approx(0.5)
    assert middle == pytest.approx([1.75, 0.0])
