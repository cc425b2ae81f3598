"""The compiled step: what it is made of, what is done about a library that is not what it should be."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from control_loop import MODEL
from vehicles import drawn

from autopilot.control.nmpc import ocp
from autopilot.control.nmpc import solver as native
from autopilot.control.nmpc.grid import grid_of, uniform_grid
from autopilot.control.nmpc.model_code import COEFFICIENTS, coefficients, model_function
from autopilot.control.nmpc.solver import Nmpc
from autopilot.core import compiled
from autopilot.core.errors import ConfigError
from autopilot.core.model4 import AXES, NX, Model4, state_derivative
from autopilot.core.seal import DAMAGED, GENERATORS, flaw, seal
from tests.hostile_numbers import HOSTILE, with_one

GRID = uniform_grid(5)


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


def test_it_can_be_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(compiled.SWITCH, compiled.OFF)
    nmpc = Nmpc(MODEL, GRID)
    assert nmpc.solver == "hpipm"
    assert compiled.SWITCH in nmpc.slower


def _refused(monkeypatch: pytest.MonkeyPatch, library: Path, reason: str) -> None:
    """The controller does not start, and says what to do; slower ways are taken where there are any."""
    monkeypatch.setattr(compiled, "LIBRARY", library)
    assert compiled.library() is None
    with pytest.raises(ConfigError, match=f"{reason}.*; run pip install again with a C compiler at hand"):
        Nmpc(MODEL, GRID)


def test_without_the_library_there_is_no_controller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _refused(monkeypatch, tmp_path / "none.so", "none.so is missing")


def test_a_library_cut_short_or_changed_anywhere_is_not_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, rng, path = compiled.LIBRARY.read_bytes(), np.random.default_rng(2), tmp_path / "damaged.so"
    loaded = _stripped(tmp_path).stat().st_size
    for length in (0, 1, 63, 4096, *rng.integers(1, loaded // 2, 20).tolist()):
        path.write_bytes(whole[:length])
        assert flaw(path, compiled.SOURCES) == DAMAGED
    changed = bytearray(whole)
    changed[len(whole) // 2] ^= 1
    path.write_bytes(changed)
    _refused(monkeypatch, path, DAMAGED)


def _stripped(folder: Path) -> Path:
    path = folder / "stripped.so"
    path.write_bytes(compiled.LIBRARY.read_bytes())
    if shutil.which("strip") is None:
        pytest.skip("no strip")
    subprocess.run(["strip", path], check=True)
    return path


def test_symbols_may_be_stripped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = _stripped(tmp_path)
    assert path.stat().st_size < compiled.LIBRARY.stat().st_size
    monkeypatch.setattr(compiled, "LIBRARY", path)
    assert compiled.missing() is None


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
    path.write_bytes(compiled.LIBRARY.read_bytes())
    seal(path, older / "data" / "native")
    _refused(monkeypatch, path, "other sources")


@pytest.mark.parametrize("kind", ["of another processor", "with other functions"])
def test_a_library_that_does_not_fit_is_not_used(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = bytearray(compiled.LIBRARY.read_bytes().replace(b"control_step\0", b"control_stop\0"))
    if kind == "of another processor":
        content[18:20] = (0x5A).to_bytes(2, "little")  # ELF e_machine of no processor of ours
    path = tmp_path / "other.so"
    path.write_bytes(content)
    seal(path, compiled.SOURCES)
    _refused(monkeypatch, path, "cannot be loaded")


def test_a_library_with_another_struct_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    class Longer(compiled.Mirror):
        _fields_ = (*native._Task._fields_, ("more", ctypes.c_long))

    Longer.__name__ = "_Task"
    monkeypatch.setattr(native, "_Task", Longer)
    with pytest.raises(ConfigError, match="another version: Task has 27 fields in 216 bytes, there 26 in 208"):
        native.NativeStep(MODEL, GRID, 8, ocp.NATIVE)


def test_a_call_keeps_the_interpreter() -> None:
    """Else each of the tick's many short calls would offer it to the threads beside the loop."""
    assert isinstance(compiled.load(), ctypes.PyDLL)


ARGUMENTS = (
    *("x_guess", "u_guess", "x_ref", "u_ref", "current", "weight_x", "weight_u", "terminal", "limits", "thrust_limit"),
    *("plane_n", "plane_d"),
)


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
