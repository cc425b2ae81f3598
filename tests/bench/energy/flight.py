"""A benchmark case flown on the 6-DoF plant: nominal, thrust straight to the hull, everything known."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import msgspec
import numpy as np

from autopilot.analysis.nmpc_flight import TANK
from autopilot.control.constraints.obstacles import clearance_m
from autopilot.control.controller import MotionController
from autopilot.control.current.currents import CurrentForecast, MappedCurrent, PointwiseField
from autopilot.control.energy.power import PowerModel
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.geometry import Circle, Fence
from autopilot.core.messages import Goal, NavHealth, NavState
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle
from autopilot.log.analysis import STATE_FIELDS
from autopilot.sitl.contact import Cylinder
from autopilot.sitl.current_fields import Bickley, Current, CurrentField, Gyre, TankJet, Uniform, Vortex, current_field
from autopilot.sitl.plant import Plant, Truth
from autopilot.sitl.simulated_waters import SimulatedWaters
from autopilot.sitl.thruster_models import wrench_of
from tests.bench.energy.cases import (
    CYLINDERS,
    REGION_M,
    REGION_YAW_RAD,
    TANK_X_M,
    TANK_Y_M,
    Case,
    EnergyGoal,
)

STEP_US = 50_000
CRUISE_M_S = 0.35
LIMIT_S = 400.0
"""A leg that takes longer is missed."""

TANK_FLOOR_M = 1.5

NO_LAG_S = 1e-3
"""The controller's idea of a thruster without lag."""

TANK_CLOSED = replace(
    TANK, exclusions=(*TANK.exclusions, Circle(center_ned_m=np.array([CYLINDERS[0][0], -TANK_Y_M]), radius_m=0.2))
)
"""The tank with the 0.115 m corridor between cylinder and south wall closed, as in the optimum that counts."""

OPEN_WATER = Fence(depth_max_m=50.0)

ENERGY_PARAMS = {
    "MPC_COST": 1.0,
    "MPC_MARGIN": 0.02,
    "MPC_SPEED_MARGIN": 0.01,
    "MPC_W_CURRENT": 0.0,
    "MPC_W_FORCE": 0.0,
    "MPC_W_MOMENT": 0.0,
}
"""As in the scenario b1: least energy; nothing is unmodelled but roll and pitch."""

Pilot: TypeAlias = Callable[[int, NavState, Goal, Fence], FloatArray]
"""(time [us], state, goal, fence) -> thrust (4,) [N]."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EnergyFlight:
    case: str
    pilot: str
    finished: bool
    energy_j: float
    """Of all laps."""
    leg_j: tuple[float, ...]
    leg_s: tuple[float, ...]
    nearest_m: float
    """Smallest distance of the centre from a boundary beyond the body radius, inf in open water."""
    top_m_s: float
    """Largest planar speed through the water."""
    track: FloatArray
    """(m, 2) N, E every step."""
    laps: int = 1
    """Asked for."""
    corridor: bool = True
    """The way between cylinder and south wall was open."""
    drag: float | None = None
    """Factor on quadratic drag where the vehicle is not as believed; None: it is the nominal one."""

    @property
    def lap_j(self) -> float:
        """Mean over the laps, inf if they were not all flown."""
        return sum(self.leg_j) / self.laps if self.finished else math.inf


def plant_field(case: Case) -> CurrentField:
    """The flow of a case by the simulator's own equations."""
    north, east = case.flow(0.0, 0.0, math)
    tables: dict[str, Current] = {
        "jet": TankJet(),
        "bickley": Bickley(speed_m_s=0.30, width_m=3.0, center_y_m=10.0),
        "taylor-green": Gyre(speed_m_s=0.3, cell_m=20.0),
        "vortex": Vortex(circulation_m2_s=6.0, core_m=2.0),
        "uniform": Uniform(velocity_m_s=(north, east, 0.0)),
    }
    return current_field(tables[case.flow_name])


def known_current(case: Case) -> MappedCurrent:
    """The flow of a case as the controller knows it."""

    def known(place: tuple[float, float, float], t_s: float) -> tuple[float, float, float]:
        north, east = case.flow(place[0], place[1], math)
        return north, east, 0.0

    return MappedCurrent(PointwiseField(known))


def nmpc_pilot(
    vehicle: Vehicle, case: Case, params: dict[str, float], currents: CurrentForecast | None = None
) -> Pilot:
    """The controller of this repository, the flow known unless ``currents`` says otherwise."""

    drive = msgspec.structs.replace(vehicle.drive, time_constant_s=NO_LAG_S)
    source = currents or known_current(case)
    controller = MotionController(msgspec.structs.replace(vehicle, drive=drive), currents=source, cpu_clock=lambda: 0.0)
    depth = {} if case.tank else {"DEPTH_MAX": OPEN_WATER.depth_max_m}
    given = ParamSet({**params, **depth})

    def pilot(t_us: int, nav: NavState, goal: Goal, fence: Fence) -> FloatArray:
        return controller.step(t_us, nav, goal, fence, given).thrust_n

    return pilot


def fly(
    case: Case,
    pilot: Pilot,
    name: str,
    vehicle: Vehicle,
    *,
    laps: int = 0,
    corridor: bool = True,
    clock_us: int = 0,
) -> EnergyFlight:
    """Fly all laps of a case (or ``laps``); a leg ends when its region is entered.

    ``corridor``: the way between cylinder and south wall is open, as in the tank; else a fence closes it. ``clock_us``:
    the pilot's clock at the start, for one who has flown before.
    """
    plant = plant_of(case, vehicle)
    power = PowerModel.of(vehicle)
    columns = np.array(wrench_of(vehicle)).T
    fence = (TANK if corridor else TANK_CLOSED) if case.tank else OPEN_WATER
    goals = [_goal(goal, case, index) for index, goal in _sequence(case, laps or case.laps)]
    t_us, index, begin_us, spent, top = 0, 0, 0, 0.0, 0.0
    leg_j: list[float] = []
    leg_s: list[float] = []
    track: list[FloatArray] = []
    truth = plant.truth
    while index < len(goals) and t_us - begin_us < LIMIT_S * 1e6:
        nav = nav_state(truth)
        thrust = pilot(clock_us + t_us, replace(nav, t_us=clock_us + nav.t_us), goals[index], fence)
        push = thrust @ columns
        plant.set_external_wrench(force_frd_n=_three(push[:3]), moment_frd_n_m=_three(push[3:]))
        t_us += STEP_US
        plant.advance(t_us, ())
        truth = plant.truth
        spent += STEP_US * 1e-6 * (power.hotel_w + float(np.asarray(power.thrust_w(thrust)).sum()))
        top = max(top, math.hypot(*truth.vel_water_frd_m_s[:2]))
        track.append(truth.pos_ned_m[:2].copy())
        if _reached(truth, goals[index]):
            leg_j.append(spent - sum(leg_j))
            leg_s.append((t_us - begin_us) * 1e-6)
            index, begin_us = index + 1, t_us
    path = np.array(track)
    near = float(clearance_m(TANK, path).min()) - vehicle.radius_m if case.tank else math.inf
    return EnergyFlight(
        case=case.name,
        pilot=name,
        finished=index == len(goals),
        energy_j=spent,
        leg_j=tuple(leg_j),
        leg_s=tuple(leg_s),
        nearest_m=near,
        top_m_s=top,
        track=path,
        laps=laps or case.laps,
        corridor=corridor,
    )


def nav_state(truth: Truth) -> NavState:
    """What a perfect estimator says."""
    return NavState(
        t_us=truth.t_us,
        health=NavHealth.GOOD,
        variance=np.zeros(12),
        **{name: getattr(truth, name) for name in STATE_FIELDS},
    )


def plant_of(case: Case, vehicle: Vehicle) -> Plant:
    """At rest in the water; no tether."""
    north_m, east_m, z, yaw = case.start
    north, east = case.flow(north_m, east_m, math)
    c, s = math.cos(yaw), math.sin(yaw)
    walls = TANK_X_M, TANK_Y_M
    world = SimulatedWaters(current=plant_field(case))
    if case.tank:
        world = SimulatedWaters(
            polygon_ned_m=tuple((i * walls[0], j * walls[1]) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))),
            floor_m=TANK_FLOOR_M,
            solids=tuple(Cylinder(name="cylinder", center_ned_m=(x, y), radius_m=r) for x, y, r in CYLINDERS),
            current=plant_field(case),
        )
    return Plant(
        vehicle,
        world,
        start_pos_ned_m=(north_m, east_m, z),
        start_rpy_rad=(0.0, 0.0, yaw),
        start_vel_frd_m_s=(c * north + s * east, c * east - s * north, 0.0),
    )


def _sequence(case: Case, laps: int) -> list[tuple[int, EnergyGoal]]:
    return [(index, goal) for _ in range(laps) for index, goal in enumerate(case.goals)]


def _goal(goal: EnergyGoal, case: Case, index: int) -> Goal:
    if len(case.goals) == 1:
        return _plain(goal)
    after = [_plain(case.goals[(index + k) % len(case.goals)]) for k in (1, 2)]
    return _plain(goal, replace(after[0], following=after[1]))


def _plain(goal: EnergyGoal, following: Goal | None = None) -> Goal:
    return Goal(
        pos_ned_m=np.array(goal.pos_ned_m),
        yaw_rad=goal.yaw_rad,
        speed_m_s=CRUISE_M_S,
        accept_radius_m=REGION_M,
        accept_yaw_rad=REGION_YAW_RAD,
        seq=0,
        following=following,
    )


def _reached(truth: Truth, goal: Goal) -> bool:
    if float(np.linalg.norm(truth.pos_ned_m - goal.pos_ned_m)) > goal.accept_radius_m:
        return False
    return goal.yaw_rad is None or abs(wrap_pi(float(truth.rpy_rad[2]) - goal.yaw_rad)) <= goal.accept_yaw_rad


def _three(values: FloatArray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
