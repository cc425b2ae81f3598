"""The least energy that physics allows: one nonlinear program over the whole flight, for every way to fly it.

Direct multiple shooting on the 4-DoF model: one phase per leg with a free duration, thrust constant over an interval,
RK4 steps of at most 0.25 s (with longer ones the program makes a profit of integration errors in the unstable
sway-yaw mode), J exact for such thrust. IPOPT finds the best flight near its first guess; the guesses are one
for each side of every obstacle and each way of turning, or a few bent ways in open water.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from autopilot.control.energy.power import PowerModel
from autopilot.core import model4
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import AXES, NX, YAW, Model4, R, U, V, W, X, Y, Z
from tests.bench.energy.cases import (
    BODY_RADIUS_M,
    CYLINDERS,
    HEAVE_CAP_M_S,
    REGION_M,
    REGION_YAW_RAD,
    SPEED_CAP_M_S,
    TANK_DEPTH_M,
    TANK_X_M,
    TANK_Y_M,
    YAW_RATE_CAP_RAD_S,
    Case,
)

SUBSTEP_S = 0.25
THRUST_N = 12.0
COST_SCALE = 1e-2
TOLERANCE = 1e-6
GUESS_TOP_M_S = 0.45
GUESS_SHARE = 0.75
"""Speed through the water of the first guess, and how much of what cross-currents leave of it: about 0.33 m/s, the
cheapest speed in still water."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Guess:
    label: str
    paths_ned_m: tuple[tuple[tuple[float, float], ...], ...]
    """Places between start and goal, per leg."""
    yaw_rad: tuple[float | None, ...]
    """Heading at the end of each leg on the turn by which it is reached; None = free."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Optimum:
    guess: Guess
    """Where it began."""
    solved: bool
    energy_j: float
    leg_j: tuple[float, ...]
    leg_s: tuple[float, ...]
    t_s: FloatArray
    """(m + 1,)"""
    x: FloatArray
    """(m + 1, 8)"""
    thrust_n: FloatArray
    """(m, 4)"""

    @property
    def label(self) -> str:
        return self.guess.label


def grid_of(case: Case) -> tuple[int, int]:
    """Intervals per leg and RK4 steps per interval."""
    if case.tank:
        return 48, 2
    return (160, 6) if case.published_j is not None and case.published_j > 4000.0 else (100, 6)


class LeastEnergy:
    """The program of one case from one start."""

    def __init__(
        self,
        model: Model4,
        power: PowerModel,
        case: Case,
        intervals: int,
        substeps: int,
        *,
        thrust_n: float = THRUST_N,
    ) -> None:
        self._case, self._n, self._power, self._model, self._thrust_n = case, intervals, power, model, thrust_n
        self._thrusters = model.thrusters
        n, legs = intervals, len(case.goals)
        self._longest_s = SUBSTEP_S * n * substeps
        interval = _interval(model, case, substeps).map(n)
        self._x0 = ca.MX.sym("x0", NX)
        xs = [ca.MX.sym(f"x{i}", NX, n) for i in range(legs)]
        us = [ca.MX.sym(f"u{i}", model.thrusters, n) for i in range(legs)]
        ts = ca.MX.sym("t", legs)
        ends = ca.MX.sym("ends", legs)
        g: list[Any] = []
        low: list[FloatArray] = []
        high: list[FloatArray] = []

        def add(rows: Any, lower: float, upper: float) -> None:
            flat = ca.vec(rows)
            g.append(flat)
            low.append(np.full(flat.shape[0], lower))
            high.append(np.full(flat.shape[0], upper))

        cost: Any = 0.0
        before = self._x0
        for leg, goal in enumerate(case.goals):
            x, u, dt = xs[leg], us[leg], ts[leg] / n
            begin = ca.horzcat(before, x[:, : n - 1])
            add(interval(begin, u, ca.repmat(dt, 1, n)) - x, 0.0, 0.0)
            cost += dt * (n * power.hotel_w + ca.sum1(ca.sum2(power.thrust_w(u))))
            add(x[U, :] ** 2 + x[V, :] ** 2, 0.0, SPEED_CAP_M_S**2)
            if case.tank:
                for cx, cy, radius in CYLINDERS:
                    keep = (radius + BODY_RADIUS_M) ** 2
                    places = ca.horzcat(x[:2, :], 0.5 * (begin[:2, :] + x[:2, :]))
                    add((places[0, :] - cx) ** 2 + (places[1, :] - cy) ** 2, keep, math.inf)
            end = x[:, n - 1]
            add(ca.sumsqr(end[:3] - ca.DM(goal.pos_ned_m)), 0.0, REGION_M**2)
            if goal.yaw_rad is not None:
                add(end[YAW] - ends[leg], -REGION_YAW_RAD, REGION_YAW_RAD)
            before = end
        variables = ca.vertcat(*(ca.vec(x) for x in xs), *(ca.vec(u) for u in us), ts)
        program: Any = {
            "x": variables,
            "f": COST_SCALE * cost,
            "g": ca.vertcat(*g),
            "p": ca.vertcat(self._x0, ends),
        }
        options: dict[str, Any] = {
            "print_time": False,
            "ipopt": {"print_level": 0, "sb": "yes", "tol": TOLERANCE, "max_iter": 400},
        }
        self._solver: Any = ca.nlpsol("least", "ipopt", program, options)
        self._low, self._high = np.concatenate(low), np.concatenate(high)
        self._bounds = self._variable_bounds()

    def _variable_bounds(self) -> tuple[FloatArray, FloatArray]:
        n, legs = self._n, len(self._case.goals)
        top = np.full(NX, np.inf)
        top[[U, V, W, R]] = SPEED_CAP_M_S, SPEED_CAP_M_S, HEAVE_CAP_M_S, YAW_RATE_CAP_RAD_S
        bottom = -top
        if self._case.tank:
            top[[X, Y, Z]] = TANK_X_M - BODY_RADIUS_M, TANK_Y_M - BODY_RADIUS_M, TANK_DEPTH_M
            bottom[[X, Y, Z]] = -top[X], -top[Y], 0.0
        thrust = np.full(self._thrusters * n * legs, self._thrust_n)
        upper = np.concatenate([np.tile(top, n * legs), thrust, np.full(legs, self._longest_s)])
        lower = np.concatenate([np.tile(bottom, n * legs), -thrust, np.full(legs, 0.5)])
        return lower, upper

    def solve(self, guess: Guess, x0: FloatArray, near: Optimum | None = None) -> Optimum:
        """From a state (8,) along a way; ``near``, a solution of a similar program along that way, saves the search."""
        n, legs = self._n, len(self._case.goals)
        states, times = self._first(guess, x0)
        thrust = self._steady(states).ravel()
        if near is not None:
            states, thrust, times = near.x[1:], near.thrust_n.ravel(), np.array(near.leg_s)
        flat = np.concatenate([states.ravel(), thrust, times])
        ends = [0.0 if yaw is None else yaw for yaw in guess.yaw_rad]
        answer = self._solver(
            x0=flat,
            lbx=self._bounds[0],
            ubx=self._bounds[1],
            lbg=self._low,
            ubg=self._high,
            p=np.concatenate([x0, ends]),
        )
        z = answer["x"].full().ravel()
        x = np.vstack([x0, z[: NX * n * legs].reshape(n * legs, NX)])
        u = z[NX * n * legs : -legs].reshape(n * legs, self._thrusters)
        leg_s = z[-legs:]
        dt = np.repeat(leg_s / n, n)
        spent = dt * (self._power.hotel_w + np.asarray(self._power.thrust_w(u)).sum(axis=1))
        leg_j = spent.reshape(legs, n).sum(axis=1)
        return Optimum(
            guess=guess,
            solved=bool(self._solver.stats()["success"]),
            energy_j=float(leg_j.sum()),
            leg_j=tuple(leg_j.tolist()),
            leg_s=tuple(leg_s.tolist()),
            t_s=np.concatenate([[0.0], np.cumsum(dt)]),
            x=x,
            thrust_n=u,
        )

    def _steady(self, states: FloatArray) -> FloatArray:
        """Thrust (m, 4) that keeps the surge speed of states (m, 8), and the depth.

        From no thrust at all the search ends in local minima, swaying, up to 5 % above steady motion."""
        model, u = self._model, states[:, U]
        wrench = np.zeros((len(states), AXES))
        if not self._case.tank:
            wrench[:, 0] = (model.linear_drag[0] + model.quadratic_drag[0] * np.abs(u)) * u
            wrench[:, 2] = model.buoyancy_excess_n
        thrust: FloatArray = ControlAllocator(model).thrust_n(wrench, np.full(model.thrusters, np.inf))
        return np.clip(thrust, -0.9 * self._thrust_n, 0.9 * self._thrust_n)

    def _first(self, guess: Guess, x0: FloatArray) -> tuple[FloatArray, FloatArray]:
        """States (legs n, 8) and durations (legs,): steady motion along the way, turning evenly in a tank."""
        case, n = self._case, self._n
        begin, states, times = x0.copy(), [], []
        for leg, goal in enumerate(case.goals):
            points = np.array([begin[:2], *guess.paths_ned_m[leg], goal.pos_ned_m[:2]])
            s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
            at = np.linspace(0.0, s[-1] - 0.5 * REGION_M, n + 1)
            path = np.stack([np.interp(at, s, points[:, i]) for i in range(2)], axis=1)
            ahead = np.gradient(path, at, axis=0)
            current = np.stack(np.broadcast_arrays(*case.flow(path[:, 0], path[:, 1], np)), axis=1)
            along = (current * ahead).sum(axis=1)
            across = ahead[:, 0] * current[:, 1] - ahead[:, 1] * current[:, 0]
            through = np.sqrt(np.maximum(GUESS_TOP_M_S**2 - across**2, 0.01))
            ground = np.maximum(GUESS_SHARE * through + along, 0.08)
            duration = float((np.diff(at) / ground[1:]).sum())
            duration = min(duration, 0.95 * self._longest_s)
            t = np.concatenate([[0.0], np.cumsum(np.diff(at) / ground[1:])])
            even = np.linspace(0.0, t[-1], n + 1)
            x = np.zeros((n + 1, NX))
            x[:, X], x[:, Y] = np.interp(even, t, path[:, 0]), np.interp(even, t, path[:, 1])
            x[:, Z] = np.linspace(begin[Z], goal.pos_ned_m[2], n + 1)
            velocity = np.gradient(x[:, :2], even, axis=0)
            water = velocity - np.stack(np.broadcast_arrays(*case.flow(x[:, 0], x[:, 1], np)), axis=1)
            end = guess.yaw_rad[leg]
            if end is None:
                x[:, YAW] = np.unwrap(np.concatenate([[begin[YAW]], np.arctan2(water[1:, 1], water[1:, 0])]))
            else:
                x[:, YAW] = np.linspace(begin[YAW], end, n + 1)
            c, sn = np.cos(x[:, YAW]), np.sin(x[:, YAW])
            x[:, U], x[:, V] = c * water[:, 0] + sn * water[:, 1], c * water[:, 1] - sn * water[:, 0]
            states.append(x[1:])
            times.append(duration)
            begin = x[-1].copy()
        return np.vstack(states), np.array(times)


def _interval(model: Model4, case: Case, substeps: int) -> ca.Function:
    """RK4 over one interval of ``dt``: (x, thrust, dt) -> x."""
    x, u, dt = ca.SX.sym("x", NX), ca.SX.sym("u", model.thrusters), ca.SX.sym("dt")

    def f(state: Any) -> Any:
        current = [*case.flow(state[0], state[1], ca), 0.0]
        return ca.vertcat(*model4.state_derivative(model, ca.vertsplit(state), ca.vertsplit(u), current, ca))

    h, state = dt / substeps, x
    for _ in range(substeps):
        state = model4.rk4(f, state, h)
    return ca.Function("interval", [x, u, dt], [state])


def worst_gap_m(model: Model4, case: Case, optimum: Optimum, step_s: float = 0.01) -> float:
    """Largest distance [m] between a node and where a fine integration of its interval ends."""
    worst = 0.0
    for k, thrust in enumerate(optimum.thrust_n):
        dt = float(optimum.t_s[k + 1] - optimum.t_s[k])
        steps = max(1, math.ceil(dt / step_s))
        x = optimum.x[k]
        for _ in range(steps):
            x = _rk4(model, case, x, thrust, dt / steps)
        worst = max(worst, float(np.hypot(*(x[:2] - optimum.x[k + 1, :2]))))
    return worst


def _rk4(model: Model4, case: Case, x: FloatArray, thrust: FloatArray, h: float) -> FloatArray:
    def f(state: FloatArray) -> FloatArray:
        current = (*case.flow(state[0], state[1], math), 0.0)
        return np.array(model4.state_derivative(model, state.tolist(), thrust.tolist(), current, math))

    result: FloatArray = model4.rk4(f, x, h)
    return result


def start_state(case: Case) -> FloatArray:
    """(8,) at rest in the water."""
    return np.array([*case.start, 0.0, 0.0, 0.0, 0.0])


def rest_over_ground(case: Case) -> FloatArray:
    """(8,) at rest over ground."""
    state = start_state(case)
    north, east = case.flow(case.start[0], case.start[1], math)
    c, s = math.cos(case.start[3]), math.sin(case.start[3])
    state[U], state[V] = -c * north - s * east, s * north - c * east
    return state


SIDES = {"N": 1.0, "S": -1.0}
"""Sides of a cylinder: N is the +y side, S the -y side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TankLeg:
    """One way between the two goals of the tank: sides on which the cylinders are passed, seen from A, and the turn."""

    sides: str
    clockwise: bool

    @property
    def label(self) -> str:
        """``NS+``: north of the first, south of the second, turned clockwise."""
        return f"{self.sides}{'+' if self.clockwise else '-'}"


def tank_legs(corridor: bool) -> list[TankLeg]:
    """Every side of both cylinders and every turn; with or without the 0.115 m between cylinder and wall."""
    sides = [first + second for first in ("NS" if corridor else "N") for second in "NS"]
    return [TankLeg(sides=each, clockwise=turn) for each in sides for turn in (True, False)]


def tank_guess(legs: Sequence[TankLeg]) -> Guess:
    """Legs out and back in turn, as many as there are; the turns add up."""
    paths, turned, heading = [], [], 0.0
    for number, leg in enumerate(legs):
        y1 = -0.625 + (0.56 if leg.sides[0] == "N" else -0.515)
        path = ((-0.625, y1), (0.9375, SIDES[leg.sides[1]] * 0.56))
        paths.append(path if number % 2 == 0 else path[::-1])
        heading += math.pi if leg.clockwise else -math.pi
        turned.append(heading)
    return Guess(label=" ".join(leg.label for leg in legs), paths_ned_m=tuple(paths), yaw_rad=tuple(turned))


def tank_guesses(corridor: bool) -> list[Guess]:
    return [tank_guess(lap) for lap in itertools.product(tank_legs(corridor), repeat=2)]


def solve_laps(program: LeastEnergy, x0: FloatArray, laps: Sequence[str], count: int) -> list[Optimum]:
    """Flights of ``count`` laps, from the best on.

    They begin with the best of ``laps`` (labels of single laps) flown ``count`` times; then one leg after the other is
    flown in every other way that those laps have, as long as that is cheaper."""
    known = {leg.label: leg for leg in tank_legs(True)}
    paths = [tuple(known[label] for label in lap.split()) for lap in laps]
    found: dict[tuple[TankLeg, ...], Optimum] = {}

    def solve(legs: tuple[TankLeg, ...]) -> float:
        if legs not in found:
            found[legs] = program.solve(tank_guess(legs), x0)
        return found[legs].energy_j if found[legs].solved else math.inf

    best = min((path * count for path in paths), key=solve)
    improved = True
    while improved:
        before = solve(best)
        for place in range(len(best)):
            others = dict.fromkeys(path[place % len(path)] for path in paths)
            best = min(((*best[:place], leg, *best[place + 1 :]) for leg in others), key=solve)
        improved = solve(best) < before
    return sorted((each for each in found.values() if each.solved), key=lambda each: each.energy_j)


def open_guesses(case: Case) -> list[Guess]:
    """The straight way, and where the flow varies ways bent to both sides."""
    start, goal = np.array(case.start[:2]), np.array(case.goals[0].pos_ned_m[:2])
    along = goal - start
    side = np.array([-along[1], along[0]])
    guesses = [Guess(label="straight", paths_ned_m=((),), yaw_rad=(None,))]
    if case.flow_name == "uniform":
        return guesses
    for name, bend in (("right", 0.2), ("left", -0.2)):
        path = [
            start + fraction * along + 4.0 * fraction * (1.0 - fraction) * bend * side
            for fraction in (0.2, 0.4, 0.6, 0.8)
        ]
        points = tuple((float(p[0]), float(p[1])) for p in path)
        guesses.append(Guess(label=name, paths_ned_m=(points,), yaw_rad=(None,)))
    if case.flow_name == "taylor-green":
        half = ((12.0, 3.5), (20.0, 10.0), (28.0, 16.5))
        guesses.append(Guess(label="left-right", paths_ned_m=(half,), yaw_rad=(None,)))
        other = tuple((x, 20.0 - y) for x, y in half)
        guesses.append(Guess(label="right-left", paths_ned_m=(other,), yaw_rad=(None,)))
    return guesses
