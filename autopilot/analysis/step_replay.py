"""Analysis of one control step of a logged run: inputs, solution, and active limits.

The run is replayed up to that step, which restores the controller's state. The step's program is solved by the
real-time iteration, as in flight, and to convergence by IPOPT, with half-planes that follow the plan. Active limits
are those with multipliers; for every obstacle near the route the route around its other side is searched.
"""

from dataclasses import dataclass, replace

import numpy as np

from autopilot.analysis.ipopt import PLANE, IpoptNmpc
from autopilot.control.controller import MotionController
from autopilot.control.nmpc.solver import PLANES, NmpcProblem
from autopilot.control.path.planner import Planner
from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Circle, Fence, Polygon, Shape, lengths_m, points_at
from autopilot.core.messages import ControlOutput, Goal
from autopilot.core.model4 import R, U, V, W, Z
from autopilot.core.shapes import clearance_m
from autopilot.log.reader import Log
from autopilot.replay.service_replay import Rerun

MOST_ROUNDS = 8
"""Of IPOPT, each with the half-planes of the plan before."""
STANDS_M = 1e-4
"""A plan that moves less than this from one round to the next has converged."""
ACTIVE = 0.02
"""Smaller multipliers are none: an interior point leaves some at every limit."""
BESIDE_M = 1.5
"""An obstacle closer than this to route or prediction is analysed."""
WALL_M = 0.02
"""Half the thickness of the wall that closes one side of an obstacle."""
WALL_CLEARANCE_M = 0.08
"""Distance of the barrier, with the clearance of routes, from the ends of the route."""
OPEN_WALL_M = 20.0
"""Its length where there is no workspace."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Limit:
    """A limit that the converged plan lies against."""

    name: str
    from_s: float
    to_s: float
    """First and last node at which it is active, after the step."""
    value: str
    """Description."""
    multiplier: float
    """Largest: decrease of the cost per unit of relaxation (m, m/s, rad/s, N)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OtherSide:
    """The route around the other side of an obstacle."""

    obstacle: str
    center_ned_m: FloatArray
    side: str
    """Side of the path on which the obstacle lies: port, starboard."""
    way_m: float
    """Length of the route flown, from the vehicle to the goal."""
    other_m: float | None
    """The same around the other side of the obstacle; None = there is no such route."""
    route_ned_m: FloatArray
    """(m, 2) that route."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ControlStepView:
    t_s: float
    output: ControlOutput
    """As it was flown."""
    goal: Goal
    problem: NmpcProblem
    """Of its last QP."""
    fence: Fence
    radius_m: float
    """That the route keeps."""
    grid_t_s: FloatArray
    thrusters: tuple[str, ...]
    plan_x: FloatArray
    plan_n: FloatArray
    """States (N+1, 8) and thrust (N, n) of the real-time iteration."""
    best_x: FloatArray
    best_n: FloatArray
    """The same of IPOPT."""
    converged: bool
    rounds: int
    plan_cost: float
    best_cost: float
    limits: tuple[Limit, ...]
    others: tuple[OtherSide, ...]


def inspect_step(log: Log, t_s: float) -> ControlStepView:
    """Analyse the first control step at or after ``t_s``. LogError if there is none, or another controller flew."""
    controller, output, at_s, thrusters = _flown_to(log, t_s)
    now, problem = controller.situation, controller.nmpc.last_problem
    assert now is not None and problem is not None
    problem = _copied(problem)
    nmpc = controller.nmpc
    plan_x, plan_n = nmpc.x.copy(), nmpc.u.copy()
    exact = IpoptNmpc(nmpc.model, nmpc.grid, PLANES)
    plan_cost = exact.cost_of(problem, plan_x, plan_n)
    best_x, best_n, final, converged, rounds = _converge(
        exact, now.planner, problem, nmpc.grid.t_s, controller.keep_m, plan_x, plan_n
    )
    return ControlStepView(
        t_s=at_s,
        output=output,
        goal=now.goal,
        problem=problem,
        fence=now.fence,
        radius_m=now.radius_m,
        grid_t_s=nmpc.grid.t_s.copy(),
        thrusters=thrusters,
        plan_x=plan_x,
        plan_n=plan_n,
        best_x=best_x,
        best_n=best_n,
        converged=converged,
        rounds=rounds,
        plan_cost=plan_cost,
        best_cost=exact.cost,
        limits=_active(exact, final, best_x, nmpc.grid.t_s, controller.keep_m, now.fence, thrusters),
        others=other_sides(
            now.fence,
            now.radius_m,
            now.x0[:2].copy(),
            np.array(now.goal.pos_ned_m[:2], dtype=float),
            output.route_ned_m,
            best_x[:, :2],
        ),
    )


def _flown_to(log: Log, t_s: float) -> tuple[MotionController, ControlOutput, float, tuple[str, ...]]:
    with Rerun(log) as rerun:
        controller = rerun.parts.controller
        if not isinstance(controller, MotionController):
            raise LogError(f"{log.path}: its controller is not the shipped one (nmpc); its steps cannot be taken apart")
        last_s = 0.0
        for inputs in rerun.inputs:
            outputs = rerun.step(inputs)
            last_s = 1e-6 * inputs.t_us
            found = outputs.control
            if last_s >= t_s - 1e-9 and found is not None and found.nominal.size:
                return controller, found, last_s, tuple(each.name for each in rerun.parts.vehicle.thrusters)
    raise LogError(
        f"{log.path}: no control step at or after {t_s:g} s, the log ends at {last_s:.2f} s; "
        "give a time at which the vehicle was armed and had a goal"
    )


def _copied(problem: NmpcProblem) -> NmpcProblem:
    names = NmpcProblem.__slots__
    return NmpcProblem(**{name: np.array(getattr(problem, name)) for name in names})


def _converge(
    exact: IpoptNmpc,
    planner: Planner,
    problem: NmpcProblem,
    t_s: FloatArray,
    keep_m: FloatArray,
    x: FloatArray,
    thrust_n: FloatArray,
) -> tuple[FloatArray, FloatArray, NmpcProblem, bool, int]:
    """The plan that is a fixed point of its own half-planes, and its program."""
    plane_n, plane_d = problem.plane_n.copy(), problem.plane_d_m.copy()
    nodes = len(plane_d) + 1
    for rounds in range(1, MOST_ROUNDS + 1):
        exact.set_plan(x, thrust_n)
        last, (x, thrust_n, good) = x, exact.solve(problem)
        if not good:
            return x, thrust_n, problem, False, rounds
        if float(np.abs(x[:, :2] - last[:, :2]).max()) < STANDS_M:
            return x, thrust_n, problem, True, rounds
        plane_n, plane_d = np.zeros_like(plane_n), np.zeros_like(plane_d)
        planner.features.half_planes(x[:nodes, :2], t_s[:nodes], keep_m, plane_d.shape[1], plane_n, plane_d)
        problem = replace(problem, plane_n=plane_n, plane_d_m=plane_d)
    return x, thrust_n, problem, False, MOST_ROUNDS


def _active(
    exact: IpoptNmpc,
    problem: NmpcProblem,
    x: FloatArray,
    t_s: FloatArray,
    keep_m: FloatArray,
    fence: Fence,
    thrusters: tuple[str, ...],
) -> tuple[Limit, ...]:
    """Limits with a multiplier, the strongest first."""
    found: dict[str, list[tuple[float, float, str]]] = {}
    limits = np.broadcast_to(problem.limits, (len(t_s) - 2, 5))
    for (node, name), multiplier in zip(exact.rows, exact.multipliers.tolist(), strict=True):
        if not name or multiplier <= 0.0:
            continue
        if name.startswith(PLANE):
            slot = int(name.removeprefix(PLANE))
            normal, offset = problem.plane_n[node - 1, slot], float(problem.plane_d_m[node - 1, slot])
            away_m = float(normal @ x[node, :2]) - offset + float(keep_m[node - 1])
            name, value = _boundary(fence, x[node, :2], away_m), f"{away_m:.2f} m from its edge"
        else:
            column = {"planar speed": 0, "sinking": 1, "rising": 1, "least depth": 3, "greatest depth": 4}.get(name, 2)
            unit = ("m/s", "m/s", "rad/s", "m", "m")[column]
            value = f"{limits[node - 1, column]:.3f} {unit}"
        found.setdefault(name, []).append((float(t_s[node]), multiplier, value))
    bound = np.broadcast_to(problem.thrust_limit_n, exact.thrust_multipliers.shape)
    for k, row in enumerate(exact.thrust_multipliers.tolist()):
        for thruster, (name, multiplier) in enumerate(zip(thrusters, row, strict=True)):
            sign = "+" if multiplier > 0.0 else "-"
            value = f"{sign}{bound[k, thruster]:.2f} N"
            found.setdefault(f"thrust of {name}", []).append((float(t_s[k]), abs(multiplier), value))
    kept = []
    for name, entries in found.items():
        strong = [entry for entry in entries if entry[1] > ACTIVE]
        if strong:
            _, multiplier, value = max(strong, key=lambda entry: entry[1])
            kept.append(Limit(name=name, from_s=strong[0][0], to_s=strong[-1][0], value=value, multiplier=multiplier))
    return tuple(sorted(kept, key=lambda limit: -limit.multiplier))


def _boundary(fence: Fence, place: FloatArray, away_m: float) -> str:
    """The shape whose edge is that far away."""
    shapes = _named(fence)
    if not shapes:
        return "moving obstacle"
    off = [abs(abs(float(clearance_m(shape, place[None])[0])) - away_m) for _, shape in shapes]
    return shapes[int(np.argmin(off))][0]


def _named(fence: Fence) -> list[tuple[str, Shape]]:
    return [
        *((f"exclusion {n} ({_place(shape)})", shape) for n, shape in enumerate(fence.exclusions, start=1)),
        *((f"workspace {n}", shape) for n, shape in enumerate(fence.inclusions, start=1)),
    ]


def _middle(shape: Shape) -> FloatArray:
    if isinstance(shape, Circle):
        return np.asarray(shape.center_ned_m, dtype=float)
    middle: FloatArray = np.asarray(shape.vertices_ned_m, dtype=float).mean(axis=0)
    return middle


def _place(shape: Shape) -> str:
    north, east = _middle(shape).tolist()
    return f"N {north:.2f} E {east:.2f}" + (f" r {shape.radius_m:.2f}" if isinstance(shape, Circle) else "")


def other_sides(
    fence: Fence, radius_m: float, start: FloatArray, goal: FloatArray, route: FloatArray, plan: FloatArray
) -> tuple[OtherSide, ...]:
    """For every obstacle near route (m, 2) or prediction (n, 2) the route from ``start`` to ``goal`` (2,) around
    its other side. ``radius_m``: clearance of routes.
    """
    path = np.vstack([start, goal]) if len(route) < 2 else route[:, :2]
    line = np.vstack([_sampled(path), plan])
    found = []
    for name, shape in _named(fence)[: len(fence.exclusions)]:
        near = clearance_m(shape, line)
        if float(near.min()) > BESIDE_M:
            continue
        center, points = _middle(shape), _sampled(path)
        at = _crossing(center, points, clearance_m(shape, points), radius_m)
        if at is None:
            continue  # one end of the route lies beside it: it is passed already, or not at all
        ahead = points[min(at + 1, len(points) - 1)] - points[max(at - 1, 0)]
        off = center - points[at]
        side = "starboard" if ahead[0] * off[1] - ahead[1] * off[0] > 0.0 else "port"
        wall = _wall(fence, center, points[at] - center)
        closed = replace(fence, exclusions=(*fence.exclusions, wall))
        other = Planner(closed, radius_m).path(start, goal)
        found.append(
            OtherSide(
                obstacle=name,
                center_ned_m=center,
                side=side,
                way_m=_length_m(path),
                other_m=None if other is None else _length_m(other),
                route_ned_m=np.zeros((0, 2)) if other is None else other,
            )
        )
    return tuple(found)


def _crossing(center: FloatArray, points: FloatArray, near_m: FloatArray, radius_m: float) -> int | None:
    """Where a barrier from an obstacle may cross the route: near the obstacle, and clear of both ends."""
    for at in np.argsort(near_m, kind="stable").tolist():
        towards = points[at] - center
        along = towards / max(float(np.hypot(*towards)), 1e-9)
        ends = points[[0, -1]] - center
        ahead = np.maximum(ends @ along, 0.0)
        off_m = np.hypot(*(ends - ahead[:, None] * along).T)
        if float(off_m.min()) > radius_m + WALL_CLEARANCE_M:
            return int(at)
    return None


def _wall(fence: Fence, center: FloatArray, towards: FloatArray) -> Polygon:
    """A thin barrier from an obstacle's middle across the route to the end of the workspace."""
    length = float(np.hypot(*towards))
    along = towards / length if length > 1e-9 else np.array([1.0, 0.0])
    far_m = OPEN_WALL_M
    for shape in fence.inclusions:
        corners = (
            shape.vertices_ned_m if isinstance(shape, Polygon) else shape.center_ned_m[None] + shape.radius_m * along
        )
        far_m = max(float(np.hypot(*(np.asarray(corners) - center).T).max()), 0.1)
    across = WALL_M * np.array([-along[1], along[0]])
    end = center + far_m * along
    return Polygon(vertices_ned_m=np.stack([center - across, end - across, end + across, center + across]))


def _sampled(path: FloatArray, step_m: float = 0.05) -> FloatArray:
    s = lengths_m(path)
    at = np.linspace(0.0, float(s[-1]), max(2, int(float(s[-1]) / step_m)))
    return points_at(path, s, at)


def _length_m(path: FloatArray) -> float:
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


def worst(view: ControlStepView) -> dict[str, float]:
    """Largest difference of the flown plan from the converged one: position [m], first thrust [N], cost."""
    return {
        "place_m": float(np.hypot(*(view.plan_x[:, :2] - view.best_x[:, :2]).T).max()),
        "first_thrust_n": float(np.abs(view.plan_n[0] - view.best_n[0]).max()),
        "cost_share": view.plan_cost / view.best_cost - 1.0 if view.best_cost else 0.0,
        "speed_m_s": float(np.hypot(view.plan_x[:, U], view.plan_x[:, V]).max()),
        "heave_m_s": float(np.abs(view.plan_x[:, W]).max()),
        "yaw_rate_rad_s": float(np.abs(view.plan_x[:, R]).max()),
        "depth_m": float(view.plan_x[:, Z].max()),
    }
