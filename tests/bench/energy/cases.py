"""The benchmark cases B1 to B5: flow, start, goals and obstacles of each leg.

One formula per flow serves the offline optimum (CasADi symbols), the controller's map and the figures (numbers). The
plant has equations of its own in :mod:`autopilot.sitl.current_fields`; a test compares the two.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

Flow: TypeAlias = Callable[[Any, Any, Any], tuple[Any, Any]]
"""(x, y, ops) -> velocity north, east [m/s]; ops is :mod:`math`, :mod:`numpy` or :mod:`casadi`."""

DEPTH_M = 5.0
"""Of the legs in open water; nothing depends on it."""

REGION_M = 0.3
REGION_YAW_RAD = 0.15
"""A leg ends in this ball, and within this heading where the goal has one (paper, section IV)."""

SPEED_CAP_M_S = 0.5
HEAVE_CAP_M_S = 0.25
YAW_RATE_CAP_RAD_S = 1.0
"""Bounds of the paper, section IV: planar speed (norm), heave, yaw rate."""

BODY_RADIUS_M = 0.3

TANK_X_M, TANK_Y_M, TANK_DEPTH_M = 2.5, 1.5, 1.2
CYLINDERS = ((-0.625, -0.625, 0.16), (0.9375, 0.0, 0.16))
"""x, y, radius [m]: the paper's obstacles."""

A = (-1.60, -0.35, 0.45, 0.0)
B = (1.75, 0.0, 0.30, math.pi)
"""The paper's waypoints: x, y, z [m], yaw [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EnergyGoal:
    pos_ned_m: tuple[float, float, float]
    yaw_rad: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One flight of one lap or one leg."""

    name: str
    flow_name: str
    flow: Flow
    start: tuple[float, float, float, float]
    """x, y, z [m], yaw [rad]; at rest in the water."""
    goals: tuple[EnergyGoal, ...]
    tank: bool = False
    """Walls, depth band and cylinders of the paper's tank."""
    laps: int = 1
    """How often the closed loop flies the goals."""
    published_j: float | None = None
    """What this case was first computed to take [J], with other tools."""


def tank_jet(x: Any, y: Any, ops: Any) -> tuple[Any, Any]:
    """Jet of 0.25 m/s along the middle of the tank with return flow along its walls."""
    xi, phase = x / 5.0 + 0.5, 2.0 * math.pi * (y / 3.0 + 0.5)
    scale = 6.75 * 0.25 * (1.0 - xi)
    aspect = 3.0 / (2.0 * math.pi * 5.0)
    return -scale * ops.cos(phase) * xi * (1.0 - xi), scale * ops.sin(phase) * (1.0 - 3.0 * xi) * aspect


def bickley(speed_m_s: float, width_m: float, center_y_m: float) -> Flow:
    """Jet along +x about y = ``center_y_m``."""

    def flow(x: Any, y: Any, ops: Any) -> tuple[Any, Any]:
        return speed_m_s / ops.cosh((y - center_y_m) / width_m) ** 2, 0.0 * x

    return flow


bickley_jet = bickley(0.30, 3.0, 10.0)
"""0.30 m/s at y = 10 m, half-width 3 m."""


def taylor_green(x: Any, y: Any, ops: Any) -> tuple[Any, Any]:
    """Gyres of 0.3 m/s in cells of 20 m."""
    k = math.pi / 20.0
    return 0.3 * ops.sin(k * x) * ops.cos(k * y), -0.3 * ops.cos(k * x) * ops.sin(k * y)


def lamb_oseen(x: Any, y: Any, ops: Any) -> tuple[Any, Any]:
    """Vortex of 6 m^2/s with a core of 2 m in the origin."""
    r2 = x * x + y * y + 1e-9
    swirl = 6.0 / (2.0 * math.pi * r2) * (1.0 - ops.exp(-r2 / 4.0))
    return -y * swirl, x * swirl


def uniform(speed_m_s: float, direction_rad: float) -> Flow:
    """The same everywhere; the direction is where it flows to."""
    north, east = speed_m_s * math.cos(direction_rad), speed_m_s * math.sin(direction_rad)

    def flow(x: Any, y: Any, ops: Any) -> tuple[Any, Any]:
        return north + 0.0 * x, east + 0.0 * x

    return flow


def _open(
    name: str,
    flow_name: str,
    flow: Flow,
    start: tuple[float, float],
    goal: tuple[float, float],
    published_j: float,
) -> Case:
    yaw = math.atan2(goal[1] - start[1], goal[0] - start[0])
    return Case(
        name=name,
        flow_name=flow_name,
        flow=flow,
        start=(*start, DEPTH_M, yaw),
        goals=(EnergyGoal(pos_ned_m=(*goal, DEPTH_M), yaw_rad=None),),
        published_j=published_j,
    )


B2_LEG_M = 40.0
B2_FLOWS = (
    (0.0, 0, 2459.0),
    (0.15, 0, 1614.0),
    (0.15, 60, 2144.0),
    (0.15, 90, 2742.0),
    (0.15, 120, 3394.0),
    (0.15, 180, 4089.0),
    (0.30, 0, 1152.0),
    (0.30, 60, 2245.0),
    (0.30, 90, 3654.0),
    (0.30, 120, 5317.0),
    (0.30, 180, 7369.0),
)
"""Speed [m/s], direction from the course [deg], energy [J]: OCP in still water, limit of steady motion otherwise."""


def _cases() -> tuple[Case, ...]:
    tour = (EnergyGoal(pos_ned_m=B[:3], yaw_rad=B[3]), EnergyGoal(pos_ned_m=A[:3], yaw_rad=A[3]))
    b1 = Case(name="b1", flow_name="jet", flow=tank_jet, start=A, goals=tour, tank=True, laps=3, published_j=431.5)
    b2 = tuple(
        _open(
            f"b2 {speed:.2f}@{degrees}",
            "uniform",
            uniform(speed, math.radians(degrees)),
            (0.0, 0.0),
            (B2_LEG_M, 0.0),
            energy,
        )
        for speed, degrees, energy in B2_FLOWS
    )
    return (
        b1,
        *b2,
        _open("b3 up", "bickley", bickley_jet, (0.0, 0.0), (-10.0, 20.0), 1582.0),
        _open("b3 down", "bickley", bickley_jet, (0.0, 0.0), (10.0, 20.0), 1253.0),
        _open("b4", "taylor-green", taylor_green, (4.0, 10.0), (36.0, 10.0), 1498.0),
        _open("b5", "vortex", lamb_oseen, (-10.0, 0.0), (10.0, 0.0), 956.0),
    )


CASES = {case.name: case for case in _cases()}
"""By name."""
