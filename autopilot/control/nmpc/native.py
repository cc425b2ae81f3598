"""The control step in C: the problem of ``nmpc/ocp.py``, four times faster than with a solver from a library.

Compiled once, when the package is installed where a C compiler is at hand (``setup.py``); running, nothing is compiled
or cached. Only the file inside the package is loaded, and that only if it is whole and made of the C sources beside it
(:mod:`autopilot.control.nmpc.seal`). One library serves all vehicles: the hull's coefficients are arguments. Nothing
needs it: where it is missing, damaged, old, of another processor or fails the self-test, the next solver is used. The
environment variable ``AUTOPILOT_COMPILED=no`` switches it off.
"""

import ctypes
import os
import sysconfig
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import REFERENCE_DT_S, TimeGrid
from autopilot.control.nmpc.model_code import coefficients
from autopilot.control.nmpc.seal import flaw
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import NX, Model4

SWITCH = "AUTOPILOT_COMPILED"
OFF = "no"
LIBRARY = Path(__file__).with_name(f"_step{sysconfig.get_config_var('EXT_SUFFIX')}")
SOURCES = Path(__file__).resolve().parents[2] / "data" / "native"
AGAIN = "run pip install again with a C compiler at hand"
PLANES = 8
"""Half-plane slots that the C code is written for."""

FIGURES = 8
"""As the other solvers' six, then interior point iterations and whether the program is unsolved."""

ARRAYS = (
    *("coefficients", "allocation", "step_s", "steps", "scale", "x_guess", "u_guess", "x_ref", "u_ref", "current"),
    *("weight_x", "weight_u", "terminal", "limits", "thrust_limit", "plane_n", "plane_d"),
    *("x", "u", "slack", "figures", "work"),
)


class _Task(ctypes.Structure):
    """The struct of task.h."""

    _fields_ = (
        ("n", ctypes.c_long),
        ("thrusters", ctypes.c_long),
        ("slack_l1", ctypes.c_double),
        ("slack_l2", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ARRAYS),
    )


def missing() -> str | None:
    """Why the compiled step is not used, and what to do about it; None if it is."""
    try:
        load()
    except RuntimeError as error:
        return str(error)
    return None


def load() -> Any:
    """The library. RuntimeError says why there is none."""
    if os.environ.get(SWITCH, "").strip().lower() == OFF:
        raise RuntimeError(f"switched off by {SWITCH}={OFF}")
    return _load(LIBRARY)


@lru_cache(maxsize=2)
def _load(path: Path) -> Any:
    if not path.exists():
        raise RuntimeError(f"not compiled when it was installed; {AGAIN}")
    try:
        wrong = flaw(path, SOURCES)
        if wrong:
            raise RuntimeError(f"{path.name} {wrong}; {AGAIN}")
        library = ctypes.CDLL(str(path))
        library.workspace_bytes.restype = library.task_bytes.restype = ctypes.c_long
        library.workspace_bytes.argtypes = [ctypes.c_long, ctypes.c_long]
        library.control_step.restype = None
    except (OSError, AttributeError) as error:
        raise RuntimeError(f"{path.name} cannot be loaded ({error}); {AGAIN}") from error
    if library.task_bytes() != ctypes.sizeof(_Task):
        raise RuntimeError(f"{path.name} was built for another version; {AGAIN}")
    return library


class NativeStep:
    """The step in C with its argument and result arrays; the same interface as ``solver.QpStep``.

    RuntimeError when there is none for this machine or vehicle.
    """

    def __init__(self, model: Model4, grid: TimeGrid, planes: int, backend: ocp.QpBackend) -> None:
        if planes != PLANES:
            raise RuntimeError(f"made for {PLANES} half-planes, not {planes}")
        library = load()
        size = library.workspace_bytes(grid.n, model.thrusters)
        if size == 0:
            raise RuntimeError(f"not made for {model.thrusters} thrusters")
        n = grid.n
        self.backend = backend
        self.told = ocp.Arguments(n, planes, model.thrusters)
        arguments = self.told.arrays
        self.x_guess, self.u_guess = arguments["x_guess"], arguments["u_guess"]
        self.x_ref, self.u_ref, self.current = arguments["x_ref"], arguments["u_ref"], arguments["current"]
        self.weight_x, self.weight_u = arguments["weight_x"], arguments["weight_u"]
        self.terminal, self.limits = arguments["terminal"], arguments["limits"]
        self.thrust_limit = arguments["thrust_limit"]
        self.plane_n, self.plane_d = arguments["plane_n"].reshape(n - 1, planes, 2), arguments["plane_d"]
        self.x, self.u = np.zeros((n + 1, NX)), np.zeros((n, model.thrusters))
        self.slack, self.figures = np.zeros((n - 1, ocp.N_SLACKS)), np.zeros(FIGURES)
        steps = np.array(grid.substeps(ocp.longest_step_s(model)), dtype=float)
        self._arrays: dict[str, FloatArray] = {
            **arguments,
            "step_s": grid.dt_s / steps,
            "steps": steps,
            "scale": grid.dt_s / REFERENCE_DT_S,
            "x": self.x,
            "u": self.u,
            "slack": self.slack,
            "figures": self.figures,
            "work": np.zeros(size // 8 + 1),
            "coefficients": np.array(coefficients(model)),
            "allocation": np.array(model.allocation),
        }
        addresses = {name: self._arrays[name].ctypes.data for name in ARRAYS}
        self._task = _Task(n=n, thrusters=model.thrusters, slack_l1=ocp.SLACK_L1, slack_l2=ocp.SLACK_L2, **addresses)
        self._reference, self._call = ctypes.byref(self._task), library.control_step

    def evaluate(self) -> None:
        """Linearise at the guess, solve, write the results. An unsolved program has an infinite violation."""
        self._call(self._reference)
