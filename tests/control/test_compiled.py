"""The compiled step: what it is made of, what is done about a library that is not what it should be."""

import ctypes
import dataclasses
from pathlib import Path

import numpy as np
import pytest
from control_loop import MODEL, nav_state
from vehicles import drawn

from autopilot.control.fence.obstacles import Features
from autopilot.control.nmpc import native, ocp
from autopilot.control.nmpc.grid import grid_of, uniform_grid
from autopilot.control.nmpc.model_code import COEFFICIENTS, coefficients, model_function
from autopilot.control.nmpc.solver import Nmpc
from autopilot.control.robust.margins import Margins
from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.model4 import AXES, NX, Model4, state_derivative
from autopilot.core.params import ParamSet
from autopilot.core.seal import DIGEST, GENERATORS, MAGIC, flaw, seal
from tests.hostile_numbers import HOSTILE, agree, with_one

GRID = uniform_grid(5)
needs_library = pytest.mark.skipif(compiled.missing() is not None, reason="not compiled")


def test_forces_of_thrusters_enter_the_generated_model_through_their_matrix() -> None:
    rng, function = np.random.default_rng(4), model_function()
    for thrusters in (4, 6, 8):
        model = drawn(rng, thrusters).to_model()
        assert len(coefficients(model)) == COEFFICIENTS
        x, thrust, current = rng.normal(size=NX), rng.normal(size=thrusters), rng.normal(size=3)
        force = np.array(model.allocation) @ thrust
        slope, jacobian = (value.full() for value in function(x, force, current, coefficients(model)))
        assert np.allclose(slope.ravel(), state_derivative(model, x, thrust, current, np), atol=1e-12)
        by_state = jacobian.T[:, AXES:]
        for axis in range(NX):
            aside = x.astype(complex)
            aside[axis] += 1e-20j
            exact = np.imag(np.array(state_derivative(model, aside, thrust, current, np))) / 1e-20
            assert np.allclose(by_state[:, axis], exact, atol=1e-9)


@needs_library
@pytest.mark.parametrize("thrusters", [4, 5, 6, 7, 8])
def test_one_library_linearises_every_vehicle(thrusters: int) -> None:
    model = drawn(np.random.default_rng(thrusters), thrusters).to_model()
    grid = grid_of(np.array([0.1, 0.3, 0.7]))
    step = native.NativeStep(model, grid, 8, ocp.NATIVE)
    rng = np.random.default_rng(thrusters)
    step.x_guess[:] = 0.2 * rng.normal(size=(4, NX))
    step.u_guess[:] = rng.normal(size=(3, thrusters))
    step.current[:] = 0.1
    step.weight_x[:], step.weight_u[:], step.terminal[:] = 1.0, 0.1, np.eye(NX)
    step.x_ref[:], step.limits[:], step.thrust_limit[:] = step.x_guess, [9.0, 9.0, 9.0, -9.0, 9.0], 10.0
    step.plane_d[:] = -1.0
    step.evaluate()
    longest, gaps = ocp.longest_step_s(model), []
    for k, (dt, substeps) in enumerate(zip(grid.dt_s, grid.substeps(longest), strict=True)):
        interval = ocp.discrete_dynamics(model, dt, substeps)
        after, by_x, by_u = (v.full() for v in interval(step.x_guess[k], step.u_guess[k], step.current[k]))
        gaps.append(np.abs(after.ravel() - step.x_guess[k + 1]).max())
        moved = by_x @ (step.x[k] - step.x_guess[k]) + by_u @ (step.u[k] - step.u_guess[k])
        assert np.allclose(step.x[k + 1], after.ravel() + moved, atol=1e-7)
    assert step.figures[7] == 0.0
    assert step.figures[2] == pytest.approx(max(gaps), abs=1e-12)


@needs_library
def test_vehicles_that_the_library_is_not_made_for_are_left_to_the_next_solver() -> None:
    eleven = Model4(
        mass_kg=MODEL.mass_kg,
        linear_drag=MODEL.linear_drag,
        quadratic_drag=MODEL.quadratic_drag,
        buoyancy_excess_n=0.0,
        allocation=tuple(row + row + row[:3] for row in MODEL.allocation),
    )
    with pytest.raises(RuntimeError, match="11 thrusters"):
        native.NativeStep(eleven, GRID, 8, ocp.NATIVE)
    assert Nmpc(eleven, GRID).solver == "hpipm"


def _falls_back(monkeypatch: pytest.MonkeyPatch, library: Path, said: str) -> None:
    monkeypatch.delenv(compiled.SWITCH, raising=False)
    monkeypatch.setattr(compiled, "LIBRARY", library)
    assert said in str(compiled.missing())
    assert "pip install" in str(compiled.missing())
    nmpc = Nmpc(MODEL, GRID)
    assert nmpc.solver == "hpipm"
    assert said in nmpc.slower


def test_without_the_library_the_next_solver_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _falls_back(monkeypatch, tmp_path / "none.so", "not compiled")


def test_it_can_be_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(compiled.SWITCH, compiled.OFF)
    nmpc = Nmpc(MODEL, GRID)
    assert nmpc.solver == "hpipm"
    assert compiled.SWITCH in nmpc.slower


@needs_library
def test_a_library_cut_short_anywhere_is_not_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, rng = compiled.LIBRARY.read_bytes(), np.random.default_rng(2)
    lengths = [0, 1, 63, 4096, len(whole) - 1, *rng.integers(1, len(whole), 20).tolist()]
    for i, length in enumerate(lengths):
        path = tmp_path / f"{i}.so"
        path.write_bytes(whole[:length])
        assert flaw(path, compiled.SOURCES) == "is damaged or unfinished"
    _falls_back(monkeypatch, tmp_path / "5.so", "is damaged or unfinished")


@needs_library
def test_a_library_with_a_changed_byte_is_not_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = bytearray(compiled.LIBRARY.read_bytes())
    whole[len(whole) // 2] ^= 1
    path = tmp_path / "changed.so"
    path.write_bytes(whole)
    _falls_back(monkeypatch, path, "is damaged or unfinished")


@needs_library
@pytest.mark.parametrize("changed", ["data/native/step.c", *GENERATORS])
def test_a_library_of_other_sources_is_not_loaded(
    changed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package, older = compiled.SOURCES.parents[1], tmp_path / "package"
    for source in [*compiled.SOURCES.glob("*.[ch]"), *(package / name for name in GENERATORS)]:
        copy = older / source.relative_to(package)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(source.read_bytes() + (b"\n" if source == package / changed else b""))
    path = tmp_path / "old.so"
    path.write_bytes(_unsealed())
    seal(path, older / "data" / "native")
    _falls_back(monkeypatch, path, "other sources")


@needs_library
def test_a_library_of_another_processor_is_not_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = bytearray(_unsealed())
    content[18:20] = (0x5A).to_bytes(2, "little")  # ELF e_machine of no processor of ours
    path = tmp_path / "other.so"
    path.write_bytes(content)
    seal(path, compiled.SOURCES)
    _falls_back(monkeypatch, path, "cannot be loaded")


@needs_library
def test_a_library_that_has_other_functions_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "other.so"
    path.write_bytes(_unsealed().replace(b"control_step\0", b"control_stop\0"))
    seal(path, compiled.SOURCES)
    _falls_back(monkeypatch, path, "cannot be loaded")


@needs_library
def test_a_library_with_another_struct_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    class Longer(compiled.Mirror):
        _fields_ = (*native._Task._fields_, ("more", ctypes.c_long))

    Longer.__name__ = "_Task"
    monkeypatch.setattr(native, "_Task", Longer)
    with pytest.raises(RuntimeError, match="another version: Task has 27 fields in 216 bytes, there 26 in 208"):
        native.NativeStep(MODEL, GRID, 8, ocp.NATIVE)


def _unsealed() -> bytes:
    return compiled.LIBRARY.read_bytes()[: -(len(MAGIC) + 2 * DIGEST)]


def _fence(rng: np.random.Generator) -> Fence:
    """A tank, sometimes an octagon or concave, with pillars, islands and sometimes a round outside."""
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(4, 8)))
    reach = rng.uniform(2.0, 4.0, len(angles))
    inclusions: list[Polygon | Circle] = [
        Polygon(vertices_ned_m=np.stack([reach * np.cos(angles), reach * np.sin(angles)], axis=1))
    ]
    if rng.random() < 0.3:
        inclusions.append(Circle(center_ned_m=rng.normal(size=2), radius_m=4.0))
    exclusions: list[Polygon | Circle] = [
        Circle(center_ned_m=rng.uniform(-2.0, 2.0, 2), radius_m=rng.uniform(0.0, 0.4))
        for _ in range(rng.integers(0, 4))
    ]
    if rng.random() < 0.5:
        corner = rng.uniform(-1.5, 1.5, 2)
        exclusions.append(Polygon(vertices_ned_m=corner + np.array([[0.0, 0.0], [0.5, 0.1], [0.4, 0.6], [0.2, 0.3]])))
    return Fence(inclusions=tuple(inclusions), exclusions=tuple(exclusions), depth_max_m=2.0)


@needs_library
def test_half_planes_are_those_of_the_code_that_says_what_they_mean() -> None:
    rng, quick = np.random.default_rng(8), 0
    for _ in range(400):
        features, slots, m = Features(_fence(rng)), int(rng.integers(2, 10)), int(rng.integers(1, 20))
        if features.many:
            continue
        x = np.zeros((m + 2, 8))
        x[:, :2] = rng.uniform(-1.5, 1.5, 2) + np.cumsum(rng.normal(size=(m + 2, 2)) * 0.1, axis=0)
        path, t_s = x[: m + 1, :2], np.linspace(0.0, 4.0, m + 1)
        keep = rng.uniform(0.2, 0.5, m) if rng.random() < 0.8 else 0.33
        normals, offsets = np.full((m, slots, 2), 7.0), np.full((m, slots), 7.0)
        assert features._quick is not None
        margin = features._quick.margin_m(path, t_s, keep, slots, normals, offsets)
        if margin is None:
            continue
        quick += 1
        assert features._quick.margin_m(path, t_s, keep) == margin
        features._quick, plain_n, plain_d = None, np.zeros_like(normals), np.zeros_like(offsets)
        assert margin == pytest.approx(features.half_planes(path, t_s, keep, slots, plain_n, plain_d), abs=1e-12)
        for row in range(m):
            ours, theirs = (_in_order(n[row], d[row]) for n, d in ((normals, offsets), (plain_n, plain_d)))
            assert np.allclose(ours, theirs, atol=1e-9)
    assert quick > 150


def _in_order(normals: FloatArray, offsets: FloatArray) -> FloatArray:
    """Half-planes of a node (slots, 3), sorted: solvers do not care which is first."""
    rows = np.concatenate([normals, offsets[:, None]], axis=1)
    return rows[np.lexsort(np.round(rows, 6).T)]


@needs_library
@pytest.mark.parametrize("thrusters", [4, 8])
def test_margins_of_the_tube_are_those_of_the_code_that_says_what_they_mean(thrusters: int) -> None:
    rng, grid, params = np.random.default_rng(3), uniform_grid(12), ParamSet()
    model = drawn(rng, thrusters).to_model()
    tube = Margins(model, grid).tube
    plain = Margins(model, grid).tube
    plain._quick = None
    for _ in range(50):
        nav = nav_state(0, rng.normal(size=8))
        nav = dataclasses.replace(
            nav, variance=np.abs(rng.normal(size=nav.variance.shape)) * 10.0 ** rng.uniform(-6, 0)
        )
        x = 0.4 * rng.normal(size=(13, 8))
        share = rng.uniform(0.2, 1.0)
        ours, theirs = (each.back_offs(nav, x, np.zeros((12, thrusters)), params, share) for each in (tube, plain))
        for field in dataclasses.fields(ours):
            assert np.allclose(getattr(ours, field.name), getattr(theirs, field.name), rtol=1e-12, atol=1e-15)
        at_rest = plain.back_offs(nav, np.zeros((13, 8)), np.zeros((12, thrusters)), params).planar_speed_m_s[-1]
        assert tube.rest_speed_m_s(nav, params) == pytest.approx(at_rest, rel=1e-12)


@needs_library
def test_a_call_keeps_the_interpreter() -> None:
    """Else each of the tick's many short calls would offer it to the threads beside the loop."""
    assert isinstance(compiled.load(), ctypes.PyDLL)


@needs_library
@pytest.mark.parametrize("value", HOSTILE)
def test_no_half_plane_is_made_of_what_is_no_number(value: float) -> None:
    rng, quick = np.random.default_rng(4), 0
    for turn in range(90):
        features, slots, m = Features(_fence(rng)), 6, 9
        if features.many:
            continue
        x = np.zeros((m + 1, 8))
        x[:, :2] = rng.uniform(-0.5, 0.5, 2) + np.cumsum(rng.normal(size=(m + 1, 2)) * 0.05, axis=0)
        given = [x[:, :2], np.linspace(0.0, 4.0, m + 1), rng.uniform(0.2, 0.5, m)]
        given[turn % 3] = with_one(rng, given[turn % 3], value)
        normals, offsets = np.full((m, slots, 2), 7.0), np.full((m, slots), 7.0)
        assert features._quick is not None
        with np.errstate(all="ignore"):
            margin = features._quick.margin_m(*given, slots, normals, offsets)
        if margin is None:
            continue
        quick += 1
        features._quick, plain_n, plain_d = None, np.zeros_like(normals), np.zeros_like(offsets)
        with np.errstate(all="ignore"):
            assert agree(margin, features.half_planes(*given, slots, plain_n, plain_d)), (turn, margin)
        # Where a number is none rows have no order.
        ours, theirs = (np.isfinite(each).sum(axis=1) for each in (offsets, plain_d))
        assert (ours == theirs).all(), turn
    assert quick > 15 or not np.isfinite(value)


@needs_library
@pytest.mark.parametrize("value", HOSTILE)
def test_no_margin_of_the_tube_is_made_of_what_is_no_number(value: float) -> None:
    rng, grid, params = np.random.default_rng(3), uniform_grid(12), ParamSet()
    tube, plain = Margins(MODEL, grid).tube, Margins(MODEL, grid).tube
    plain._quick = None
    for _ in range(20):
        x, thrust = 0.4 * rng.normal(size=(13, 8)), np.zeros((12, MODEL.thrusters))
        x[:, 4] = with_one(rng, x[:, 4], value)
        nav = dataclasses.replace(nav_state(0, np.zeros(8)), variance=1e-4 * np.ones(12))
        with np.errstate(all="ignore"):
            ours, theirs = (each.back_offs(nav, x, thrust, params) for each in (tube, plain))
        for field in dataclasses.fields(ours):
            assert agree(getattr(ours, field.name), getattr(theirs, field.name), 1e-12), field.name


ARGUMENTS = (
    *("x_guess", "u_guess", "x_ref", "u_ref", "current", "weight_x", "weight_u", "terminal", "limits", "thrust_limit"),
    *("plane_n", "plane_d"),
)


@needs_library
@pytest.mark.parametrize("value", HOSTILE[:5])
@pytest.mark.parametrize("hostile", ARGUMENTS)
def test_no_plan_is_made_of_what_is_no_number(hostile: str, value: float) -> None:
    """The step itself, without the look at its arguments in front of it: unsolved, or a plan within limits."""
    rng, grid = np.random.default_rng(6), grid_of(np.array([0.1, 0.3, 0.7]))
    step = native.NativeStep(MODEL, grid, 8, ocp.NATIVE)
    for _ in range(6):
        step.x_guess[:], step.u_guess[:] = 0.2 * rng.normal(size=(4, NX)), rng.normal(size=(3, MODEL.thrusters))
        step.current[:], step.weight_x[:], step.weight_u[:], step.terminal[:] = 0.1, 1.0, 0.1, np.eye(NX)
        step.x_ref[:], step.u_ref[:], step.limits[:] = step.x_guess, 0.0, [9.0, 9.0, 9.0, -9.0, 9.0]
        step.thrust_limit[:], step.plane_n[:], step.plane_d[:] = 10.0, 0.0, -1.0
        # Not looked at: the reference of the state that is given, the depth limit on the far side.
        given = {"x_ref": step.x_ref[1:], "limits": step.limits[:, :3]}.get(hostile, getattr(step, hostile))
        given[:] = with_one(rng, given, value)
        step.evaluate()
        _, violation, gap, _, total = step.figures[:5].tolist()
        solved = np.isfinite(total + gap) and violation < 1e-6 and step.figures[7] == 0.0
        if solved:
            assert np.isfinite(step.x).all()
            assert (np.abs(step.u) <= step.thrust_limit.reshape(step.u.shape)).all()
        if np.isnan(value):
            assert not solved
