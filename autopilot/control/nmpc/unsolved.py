"""Serialisation of QPs that were not solved, for the log and for later analysis.

``problem.*`` are the fields of :class:`autopilot.control.nmpc.solver.NmpcProblem`, ``guess.*`` states and thrust of
the linearisation, ``grid.dt_s`` the intervals, ``model.*`` the coefficients of :class:`autopilot.core.model4.Model4`.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import TimeGrid, grid_of
from autopilot.control.nmpc.solver import Nmpc, NmpcProblem
from autopilot.core.errors import ConfigError, LogError
from autopilot.core.frames import FloatArray
from autopilot.core.messages import SolveStatus, UnsolvedProgram
from autopilot.core.model4 import Model4


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    solver: str
    status: SolveStatus | None
    """None = it does not work on this machine."""
    violation: float
    """Largest of a row: 0.001 counts as solved."""
    gap: float
    """Largest defect of the guess in the dynamics."""
    thrust_n: tuple[float, ...]
    """The first of the plan; of the guess when it was not solved."""


def saved(
    t_us: int, nmpc: Nmpc, status: SolveStatus, problem: NmpcProblem, x: FloatArray, thrust_n: FloatArray
) -> UnsolvedProgram:
    """A program that was not solved around the guess ``x`` (N+1, 8), ``thrust_n`` (N, 4)."""
    arrays = {f"problem.{f.name}": np.array(getattr(problem, f.name), dtype=float) for f in dataclasses.fields(problem)}
    arrays |= {
        f"model.{f.name}": np.array(getattr(nmpc.model, f.name), dtype=float) for f in dataclasses.fields(Model4)
    }
    arrays |= {"guess.x": x.copy(), "guess.thrust_n": thrust_n.copy(), "grid.dt_s": nmpc.grid.dt_s.copy()}
    return UnsolvedProgram(t_us=t_us, solver=nmpc.solver, status=status, arrays=arrays)


def _part(arrays: Mapping[str, FloatArray], name: str) -> dict[str, FloatArray]:
    return {key[len(name) :]: value for key, value in arrays.items() if key.startswith(name)}


def solve_again(program: UnsolvedProgram) -> list[Trial]:
    """Results of every solver. LogError if the record is incomplete."""
    try:
        model = Model4(**{name: _plain(value) for name, value in _part(program.arrays, "model.").items()})
        # Programs of before the buoyancy was learned have the vehicle file's.
        trimmed = {"buoyancy_excess_n": np.array([model.buoyancy_excess_n])}
        problem = NmpcProblem(**(trimmed | _part(program.arrays, "problem.")))
        grid = grid_of(program.arrays["grid.dt_s"])
        x, thrust = program.arrays["guess.x"], program.arrays["guess.thrust_n"]
    except (KeyError, TypeError) as error:
        raise LogError(
            f"the program at {program.t_us} us is not complete ({error}); use the version that saved it"
        ) from None
    return [_trial(model, grid, problem, x, thrust, backend) for backend in ocp.BACKENDS]


def _trial(
    model: Model4, grid: TimeGrid, problem: NmpcProblem, x: FloatArray, thrust: FloatArray, backend: ocp.QpBackend
) -> Trial:
    try:
        nmpc = Nmpc(model, grid, planes=problem.plane_n.shape[1], backends=(backend,))
    except ConfigError:
        nothing = tuple(thrust[0].tolist())
        return Trial(solver=backend.plugin, status=None, violation=np.nan, gap=np.nan, thrust_n=nothing)
    nmpc.set_plan(x, thrust)
    result = nmpc.solve(problem)
    return Trial(
        solver=backend.plugin,
        status=result.status,
        violation=nmpc.violation,
        gap=result.gap_max,
        thrust_n=tuple(result.thrust_n[0].tolist()),
    )


def _plain(value: FloatArray) -> Any:
    """Numbers and tuples as a vehicle file gives them."""
    if value.ndim == 0:
        return float(value)
    return tuple(tuple(row) if isinstance(row, list) else row for row in value.tolist())
