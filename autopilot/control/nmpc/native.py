"""The control step in C: the problem of ``nmpc/ocp.py``, four times as fast as with a general QP solver.

Part of the compiled library (:mod:`autopilot.core.compiled`), which serves all vehicles: the coefficients are
arguments. If it is missing, does not support the vehicle or fails the self-test, the next solver is used.
"""

import ctypes

import numpy as np

from autopilot.control.nmpc import ocp
from autopilot.control.nmpc.grid import REFERENCE_DT_S, TimeGrid
from autopilot.control.nmpc.model_code import BUOYANCY, coefficients
from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import Model4

PLANES = 8
"""Half-plane slots that the C code is written for."""

FIGURES = 8
"""As the other solvers' six, then interior point iterations and whether the program is unsolved."""

ARRAYS = (
    *("coefficients", "allocation", "step_s", "steps", "scale", "x_guess", "u_guess", "x_ref", "u_ref", "current"),
    *("weight_x", "weight_u", "terminal", "limits", "thrust_limit", "plane_n", "plane_d"),
    *("x", "u", "slack", "figures", "work"),
)


class _Task(compiled.Mirror):
    """ctypes layout of the struct in task.h."""

    _fields_ = (
        ("n", ctypes.c_long),
        ("thrusters", ctypes.c_long),
        ("slack_l1", ctypes.c_double),
        ("slack_l2", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ARRAYS),
    )


class NativeStep(ocp.StepArrays):
    """The step in C with its argument and result arrays; the same interface as ``solver.QpStep``.

    RuntimeError when there is none for this machine or vehicle.
    """

    def __init__(self, model: Model4, grid: TimeGrid, planes: int, backend: ocp.QpBackend) -> None:
        if planes != PLANES:
            raise RuntimeError(f"made for {PLANES} half-planes, not {planes}")
        if compiled.switched_off():
            raise RuntimeError(f"switched off by {compiled.SWITCH}={compiled.OFF}")
        library = compiled.load(_Task)
        size = library.workspace_bytes(grid.n, model.thrusters)
        if size == 0:
            raise RuntimeError(f"not made for {model.thrusters} thrusters")
        n = grid.n
        self.backend = backend
        super().__init__(model, n, planes)
        self.figures = np.zeros(FIGURES)
        steps = np.array(grid.substeps(ocp.longest_step_s(model)), dtype=float)
        self._arrays: dict[str, FloatArray] = {
            **self.arguments,
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
        self._arrays["coefficients"][BUOYANCY] = self.buoyancy[0, 0]
        self._call(self._reference)
