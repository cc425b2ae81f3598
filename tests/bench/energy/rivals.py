"""``autopilot bench energy-rivals``: short legs at shipped defaults, this controller beside simpler ones.

The whole service flies on the simulated vehicle in open water; no parameter of the controller is set but MPC_COST. J is
taken from the plant's thrusters, beside the optimum of the vehicle that is flown, with its drag and its thrust, in the
true current from rest over ground.
"""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from autopilot.control.energy.power import PowerModel
from autopilot.core.vehicle import load_vehicle
from autopilot.mission.local_plan import LocalPlan, WaypointTable, plan_of_local
from autopilot.mission.paper import ORIGIN
from autopilot.mission.plan_files import write_plan
from autopilot.sitl.scenario import load_tables
from tests.bench.energy.cases import DEPTH_M, REGION_M, Case, EnergyGoal, bickley, uniform
from tests.bench.energy.flight import EnergyFlight
from tests.bench.energy.optimum import THRUST_N, LeastEnergy, Optimum, grid_of, open_guesses, rest_over_ground
from tests.bench.energy.record import flown_model
from tests.bench.energy.service_flight import fly_tables

BASE = "b3-est"
"""Scenario of which current, start, mismatch and parameters are replaced."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pilot:
    name: str
    currents: str
    """What is known of the current: "map" or "estimate"."""
    controller: str = "nmpc"
    cost: float = 1.0
    """MPC_COST."""


PILOTS = (
    Pilot(name="minimum energy, map", currents="map"),
    Pilot(name="minimum energy, estimated flow", currents="estimate"),
    Pilot(name="quadratic", currents="estimate", cost=0.0),
    Pilot(name="los-pid", currents="estimate", controller="los-pid"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    case: Case
    current: dict[str, Any]
    """The same flow as a table of a scenario file."""
    drag: float = 1.0
    thrust: float = 1.0
    """Factors of the vehicle that is flown, unknown to the controller."""


JET_M_S, JET_WIDTH_M, JET_ASIDE_M, JET_LEG_M = 0.3, 2.0, 4.0, 18.0
STREAM_M_S, STREAM_LEG_M = 0.27, 6.0


def _case(name: str, flow_name: str, flow: Any, length_m: float) -> Case:
    goal = EnergyGoal(pos_ned_m=(length_m, 0.0, DEPTH_M), yaw_rad=None)
    return Case(name=name, flow_name=flow_name, flow=flow, start=(0.0, 0.0, DEPTH_M, 0.0), goals=(goal,))


def _jet(name: str, drag: float = 1.0, thrust: float = 1.0) -> Leg:
    return Leg(
        case=_case(name, "bickley", bickley(JET_M_S, JET_WIDTH_M, JET_ASIDE_M), JET_LEG_M),
        current={"kind": "bickley", "speed_m_s": JET_M_S, "width_m": JET_WIDTH_M, "center_y_m": JET_ASIDE_M},
        drag=drag,
        thrust=thrust,
    )


def _upstream(name: str, drag: float = 1.0, thrust: float = 1.0) -> Leg:
    return Leg(
        case=_case(name, "uniform", uniform(-STREAM_M_S, 0.0), STREAM_LEG_M),
        current={"kind": "uniform", "velocity_m_s": [-STREAM_M_S, 0.0, 0.0]},
        drag=drag,
        thrust=thrust,
    )


LEGS = (
    _jet("jet aside"),
    _jet("jet aside, drag 1.2", drag=1.2),
    _upstream("upstream"),
    _upstream("upstream, drag 1.2, thrust 0.85", drag=1.2, thrust=0.85),
)
SHORT_LEGS = LEGS[2:3]


@dataclass(frozen=True, slots=True, kw_only=True)
class RivalRow:
    """One flight; without ``pilot``'s arrival its ratio says nothing."""

    leg: str
    pilot: str
    finished: bool
    j: float
    optimum_j: float
    ratio: float
    s: float
    """Until the acceptance ball is entered."""
    optimum_s: float
    top_m_s: float
    """Largest planar speed through the water."""


def bench_rivals(short: bool = False, progress: Callable[[str], None] = lambda _: None) -> Iterator[RivalRow]:
    """Every leg by every pilot; ``short``: upstream only."""
    for leg in SHORT_LEGS if short else LEGS:
        optimum = leg_optimum(leg)
        progress(f"{leg.case.name}, optimum: {optimum.energy_j:.1f} J, {optimum.t_s[-1]:.1f} s")
        for pilot in PILOTS:
            row = row_of(leg, fly_leg(leg, pilot), optimum)
            progress(f"{row.leg}, {row.pilot}: {row.j:.1f} J, {row.ratio:.3f}, {row.s:.1f} s")
            yield row


def leg_optimum(leg: Leg) -> Optimum:
    """The least energy of the vehicle that is flown."""
    vehicle = load_vehicle("lbv150")
    model, power = flown_model(vehicle, drag=leg.drag), PowerModel.of(vehicle)
    program = LeastEnergy(model, power, leg.case, *grid_of(leg.case), thrust_n=leg.thrust * THRUST_N)
    found = [program.solve(guess, rest_over_ground(leg.case)) for guess in open_guesses(leg.case)]
    return min((each for each in found if each.solved), key=lambda each: each.energy_j)


def fly_leg(leg: Leg, pilot: Pilot) -> EnergyFlight:
    x, y, z, yaw = leg.case.start
    tables = load_tables(BASE)
    tables["current"] = leg.current
    tables["vehicle"] |= {"start_m": [x, y, z], "start_yaw_rad": yaw}
    tables["vehicle"]["mismatch"] = {"drag": leg.drag, "thrust": leg.thrust}
    tables["controller"]["currents"] = pilot.currents
    tables["params"] = {"DEPTH_MAX": tables["params"]["DEPTH_MAX"], "MPC_COST": pilot.cost}
    points = [
        WaypointTable(x_m=goal.pos_ned_m[0], y_m=goal.pos_ned_m[1], depth_m=goal.pos_ned_m[2], accept_m=REGION_M)
        for goal in leg.case.goals
    ]
    with tempfile.TemporaryDirectory() as folder:
        plan = Path(folder) / "leg.plan"
        write_plan(plan, plan_of_local(LocalPlan(origin=ORIGIN, waypoint=points)))
        return fly_tables(leg.case, tables, plan, pilot.name, pilot.controller)


def row_of(leg: Leg, flight: EnergyFlight, optimum: Optimum) -> RivalRow:
    return RivalRow(
        leg=leg.case.name,
        pilot=flight.pilot,
        finished=flight.finished,
        j=flight.energy_j,
        optimum_j=optimum.energy_j,
        ratio=flight.energy_j / optimum.energy_j,
        s=sum(flight.leg_s),
        optimum_s=float(optimum.t_s[-1]),
        top_m_s=flight.top_m_s,
    )
