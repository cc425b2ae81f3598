"""The NMPC by itself, without service and estimator: a 4-DoF vehicle file and a goal.

The optimal control problem, its solver and its constraints are those of the service's controller. Routes round
obstacles, margins, tubes and certificates are not in here (:mod:`autopilot.control.controller`).
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.api.arrays import finite, thrust_limit_n
from autopilot.control.constraints.obstacles import Features
from autopilot.control.nmpc.grid import TimeGrid, geometric_grid
from autopilot.control.nmpc.solver import Nmpc, NmpcProblem, NmpcResult
from autopilot.control.path.guidance import Weights
from autopilot.control.protocol import STEP_S
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray, unwrap_near
from autopilot.core.geometry import Fence
from autopilot.core.messages import SolveStatus
from autopilot.core.model4 import NX, YAW, rk4, state_derivative
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import load_vehicle

CONVERGED_N = 0.05
MOST_QPS = 15
"""QPs of a step are repeated until the first thrust changes by less, or so often."""

CLIMB_SHARE = 0.8
"""Of SPD_HEAVE_MAX, at which the reference changes its depth."""


class GoalMpc:
    """Flies a vehicle model to a goal.

    Parameters
    ----------
    vehicle
        Name of a shipped vehicle, or a file.
    fence
        The workspace with its depth band, for the vehicle's centre; the body radius is kept from its boundaries. None =
        open water.
    params
        Changed parameters: MPC_Q_*, MPC_R_THRUST, SPD_*, THR_LIMIT (docs/parameters.md).
    grid
        Prediction grid, default 20 intervals over 8 s.

    Raises
    ------
    ConfigError
        No such vehicle or parameter.
    """

    def __init__(
        self,
        vehicle: str | Path = "lbv150",
        *,
        fence: Fence | None = None,
        params: Mapping[str, float] | None = None,
        grid: TimeGrid | None = None,
    ) -> None:
        self.vehicle = load_vehicle(str(vehicle))
        self.model = self.vehicle.to_model()
        self.params = ParamSet()
        for name, value in (params or {}).items():
            self.params.set(name, value)
        self.nmpc = Nmpc(self.model, grid or geometric_grid())
        """The solver; ``x`` (N+1, 8) and ``u`` (N, n) are the predicted states and thrust."""
        self._fence = Fence() if fence is None else fence
        self._features = Features(self._fence)
        self._begun = False

    @property
    def t_s(self) -> FloatArray:
        """(N+1,) times of the predicted states [s]."""
        return self.nmpc.grid.t_s

    def step(
        self, x: FloatArray, goal: Sequence[float], current_ned_m_s: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> FloatArray:
        """Thrust (n,) [N] for the next 50 ms.

        Parameters
        ----------
        x
            (8,) state (:mod:`autopilot.core.model4`): north, east, depth [m], yaw [rad], velocity through the water
            ahead, to starboard, down [m/s], yaw rate [rad/s].
        goal
            (4,) north, east, depth [m], yaw [rad].
        current_ned_m_s
            (3,) uniform current [m/s].

        Raises
        ------
        ConfigError
            State, goal or current of another shape, or no solution from there.
        """
        x0, end, flow = finite("x", x, NX), finite("goal", goal, 4), finite("current_ned_m_s", current_ned_m_s, 3)
        nmpc = self.nmpc
        if self._begun:
            nmpc.shift(STEP_S)
        else:
            nmpc.set_plan(np.tile(x0, (nmpc.grid.n + 1, 1)), np.zeros_like(nmpc.u))
        for _ in range(MOST_QPS):
            before_n = nmpc.u[0].copy()
            found = self._solve(x0, end, flow)
            if found.status is not SolveStatus.OK:
                self._begun = False
                raise ConfigError(f"no solution from x={x0.tolist()!r} ({found.status.name}): it must lie in the fence")
            if np.abs(nmpc.u[0] - before_n).max() < CONVERGED_N:
                break
        self._begun = True
        first_n: FloatArray = nmpc.u[0].copy()
        return first_n

    def simulate(
        self, x: FloatArray, thrust_n: FloatArray, current_ned_m_s: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> FloatArray:
        """(8,) state after 50 ms of that thrust (n,) [N], by the model."""

        def slope(state: Any) -> Any:
            return np.array(state_derivative(self.model, state, list(thrust_n), current_ned_m_s, np))

        return np.asarray(rk4(slope, np.array(x, float), STEP_S), dtype=np.float64)

    def plot(self) -> Any:
        """The prediction as a matplotlib figure: track, speeds, thrust. ImportError without the extra ``analysis``."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(12.0, 3.6), layout="constrained")
        track, speed, thrust = figure.subplots(1, 3)
        states = self.nmpc.x
        track.plot(states[:, 1], states[:, 0], ".-")
        track.set(xlabel="east [m]", ylabel="north [m]", aspect="equal")
        for column, name in ((4, "ahead"), (5, "to starboard"), (6, "down")):
            speed.plot(self.t_s, states[:, column], label=name)
        speed.set(xlabel="time [s]", ylabel="speed through the water [m/s]")
        for number, each in enumerate(self.vehicle.thrusters):
            thrust.step(self.t_s[:-1], self.nmpc.u[:, number], where="post", label=each.name)
        thrust.set(xlabel="time [s]", ylabel="thrust [N]")
        speed.legend()
        thrust.legend()
        return figure

    def _solve(self, x0: FloatArray, end: FloatArray, flow: FloatArray) -> NmpcResult:
        nmpc, params, model = self.nmpc, self.params, self.model
        n, weights = nmpc.grid.n, Weights(model.thrusters).update(params)
        plane_n, plane_d = np.zeros((n - 1, nmpc.planes, 2)), np.zeros((n - 1, nmpc.planes))
        self._features.half_planes(
            nmpc.x[:n, :2], nmpc.grid.t_s[:n], self.vehicle.radius_m, nmpc.planes, plane_n, plane_d
        )
        limits = (
            *(params["SPD_PLANAR_MAX"], params["SPD_HEAVE_MAX"], params["SPD_YAW_MAX"]),
            *(self._fence.depth_min_m, self._fence.depth_max_m),
        )
        return nmpc.solve(
            NmpcProblem(
                x0=x0,
                x_ref=self._reference(x0, end),
                thrust_ref_n=np.zeros_like(nmpc.u),
                current_ned_m_s=np.tile(flow, (n, 1)),
                weight_x=weights.x,
                weight_u=weights.u,
                terminal=weights.terminal,
                limits=np.array(limits),
                thrust_limit_n=thrust_limit_n(self.vehicle, params),
                plane_n=plane_n,
                plane_d_m=plane_d,
                buoyancy_excess_n=np.array([model.buoyancy_excess_n]),
            )
        )

    def _reference(self, x0: FloatArray, end: FloatArray) -> FloatArray:
        """(N+1, 8) straight to the goal at cruising speed, heading on the same turn as the state."""
        way, params = end[:3] - x0[:3], self.params
        time_s = max(np.hypot(*way[:2]) / params["SPD_CRUISE"], abs(way[2]) / (CLIMB_SHARE * params["SPD_HEAVE_MAX"]))
        done = np.minimum(1.0, self.t_s / max(float(time_s), 1e-9))
        reference = np.zeros((len(done), NX))
        reference[:, :3] = x0[:3] + done[:, None] * way
        reference[:, YAW] = unwrap_near(end[YAW], x0[YAW])
        return reference
