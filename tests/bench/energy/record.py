"""The optima as committed data, and how they are computed anew."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.analysis.nmpc_flight import TANK
from autopilot.control.constraints.obstacles import Features
from autopilot.control.energy.field import LONGEST_MOVE, EnergyField
from autopilot.control.energy.flow import FlowField, area_of, sample_flow
from autopilot.control.energy.power import PowerModel, speed_table
from autopilot.core.frames import FloatArray
from autopilot.core.free_space import FreeSpace
from autopilot.core.geometry import Fence
from autopilot.core.model4 import Model4
from autopilot.core.vehicle import Vehicle, load_vehicle
from tests.bench.energy.cases import BODY_RADIUS_M, CASES, REGION_M, SPEED_CAP_M_S, Case
from tests.bench.energy.flight import known_current, nav_state, plant_of
from tests.bench.energy.optimum import (
    LeastEnergy,
    Optimum,
    grid_of,
    open_guesses,
    solve_laps,
    start_state,
    tank_guesses,
    worst_gap_m,
)

DATA = Path(__file__).with_name("optima.json")
TRACK_POINTS = 80

MASS, DRAGS = 1.2, (1.2, 0.8)
"""Factors on the mass and on the quadratic drag of the vehicle where the controller's model is wrong."""

CORRIDOR = "b1 corridor"
"""B1 with the 0.115 m between cylinder and south wall open."""

LAPS, CORRIDOR_LAPS = "b1 three laps", "b1 corridor three laps"
"""The same over as many laps as are flown: later ones begin in motion."""

SINGLE = {LAPS: "b1", CORRIDOR_LAPS: CORRIDOR}
"""The single lap of each."""

WRONG_CASES = (CORRIDOR_LAPS, "b2 0.15@60", "b3 up", "b4", "b5")
"""What is flown with it too."""

PUBLISHED_CORRIDOR_J = 382.4
BEST_LAPS = 6
"""Single laps of which flights of several are made."""
CLASSES = 64
"""How many are kept."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Record:
    """The least energy of one flight, which may have several laps."""

    name: str
    energy_j: float
    """Of the nominal vehicle, of the whole flight: this is what flights are compared with."""
    duration_s: float
    leg_j: tuple[float, ...]
    lap_j: tuple[float, ...]
    label: str
    """The way it goes: see :class:`tests.bench.energy.optimum.TankLeg`."""
    classes: dict[str, float]
    """Energy of the best solution of each class that was solved [J]; the first ones of several laps."""
    neutral_j: float
    """The same with a vehicle that neither floats nor sinks, as published."""
    heavier_j: dict[str, float]
    """By factor on quadratic drag: the least energy of a vehicle that is 20 % heavier and has that drag [J]."""
    published_j: float | None
    """What it was first computed to take, with other tools; None: nobody did."""
    grid_j: float
    """From the centre of one goal to the next by the grid of the energy planner: an independent check."""
    gap_m: float
    """Largest distance between a node and where a fine integration of its interval ends."""
    track_ned_m: FloatArray
    """(m, 2)"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparator:
    """What a flight is compared with."""

    name: str
    lap_j: float
    """Mean of its laps."""


def comparator(records: dict[str, Record], case: str, laps: int, corridor: bool, drag: float | None) -> Comparator:
    """The optimum with the freedom of a flight: as many laps, the corridor open or closed, the vehicle that is flown.

    ``drag``: factor on quadratic drag of a vehicle that is 20 % heavier, None = the nominal one."""
    name = case
    if case == "b1":
        name = {(False, 1): "b1", (True, 1): CORRIDOR, (False, 3): LAPS, (True, 3): CORRIDOR_LAPS}[corridor, laps]
    record = records[name]
    whole_j = record.energy_j if drag is None else record.heavier_j[f"{drag:g}"]
    return Comparator(name=name if drag is None else f"{name}, as flown", lap_j=whole_j / len(record.lap_j))


def load_records() -> dict[str, Record]:
    raw: dict[str, dict[str, Any]] = json.loads(DATA.read_text())
    return {
        name: Record(
            name=name,
            **{
                **fields,
                "leg_j": tuple(fields["leg_j"]),
                "lap_j": tuple(fields["lap_j"]),
                "track_ned_m": np.array(fields["track_ned_m"]),
            },
        )
        for name, fields in raw.items()
    }


def save_records(records: dict[str, Record]) -> None:
    """As JSON, one case per line."""
    lines = []
    for name, record in records.items():
        fields: dict[str, object] = {
            "energy_j": round(record.energy_j, 2),
            "duration_s": round(record.duration_s, 2),
            "leg_j": [round(value, 2) for value in record.leg_j],
            "lap_j": [round(value, 2) for value in record.lap_j],
            "label": record.label,
            "classes": {key: round(value, 1) for key, value in record.classes.items()},
            "neutral_j": round(record.neutral_j, 2),
            "heavier_j": {key: round(value, 2) for key, value in record.heavier_j.items()},
            "published_j": record.published_j,
            "grid_j": round(record.grid_j, 1),
            "gap_m": round(record.gap_m, 5),
            "track_ned_m": [[round(x, 3) for x in row] for row in record.track_ned_m.tolist()],
        }
        lines.append(f"{json.dumps(name)}: {json.dumps(fields)}")
    DATA.write_text("{\n" + ",\n".join(lines) + "\n}\n")


def recompute(progress: Callable[[str], None] = lambda _: None, names: tuple[str, ...] = ()) -> dict[str, Record]:
    """All optima, those of ``names`` (all) computed anew; a quarter of an hour."""
    vehicle, records = load_vehicle("lbv150"), load_records()
    for name in names or (CORRIDOR, *CASES, CORRIDOR_LAPS, LAPS):
        record = records[name] = _record(vehicle, name, records)
        progress(f"{name}: {record.energy_j:.1f} J, neutral {record.neutral_j:.1f} J, published {record.published_j} J")
    return records


def case_of(name: str) -> Case:
    """The flight that a record is of, lap after lap."""
    if name == CORRIDOR:
        return replace(CASES["b1"], published_j=PUBLISHED_CORRIDOR_J)
    if name in SINGLE:
        lap = CASES["b1"]
        return replace(lap, goals=lap.goals * lap.laps, published_j=None)
    return CASES[name]


def _record(vehicle: Vehicle, name: str, records: dict[str, Record]) -> Record:
    case = case_of(name)
    model, power = vehicle.to_model(), PowerModel.of(vehicle)
    intervals, substeps = grid_of(case)
    found = _solve(model, power, name, records)
    best = found[0]
    afloat = LeastEnergy(replace(model, buoyancy_excess_n=0.0), power, case, intervals, substeps)
    neutral = [afloat.solve(near.guess, start_state(case), near) for near in found[:3]]
    heavier = {f"{drag:g}": _heavier_j(vehicle, case, drag, found) for drag in DRAGS} if name in WRONG_CASES else {}
    rows = np.linspace(0, len(best.x) - 1, min(TRACK_POINTS, len(best.x))).round().astype(int)
    legs = len(CASES["b1"].goals) if case.tank else 1
    return Record(
        name=name,
        energy_j=best.energy_j,
        duration_s=float(best.t_s[-1]),
        leg_j=best.leg_j,
        lap_j=tuple(sum(best.leg_j[i : i + legs]) for i in range(0, len(best.leg_j), legs)),
        label=best.label,
        classes={optimum.label: optimum.energy_j for optimum in reversed(found[:CLASSES])},
        neutral_j=min(optimum.energy_j for optimum in neutral if optimum.solved),
        heavier_j=heavier,
        published_j=case.published_j,
        grid_j=grid_energy_j(vehicle, case),
        gap_m=worst_gap_m(model, case, best),
        track_ned_m=best.x[rows, :2],
    )


def _solve(model: Model4, power: PowerModel, name: str, records: dict[str, Record]) -> list[Optimum]:
    """All solved flights, from the best on."""
    case = case_of(name)
    program, start = LeastEnergy(model, power, case, *grid_of(case)), start_state(case)
    if name in SINGLE:
        classes = records[SINGLE[name]].classes
        return solve_laps(program, start, sorted(classes, key=lambda lap: classes[lap])[:BEST_LAPS], CASES["b1"].laps)
    guesses = tank_guesses(name == CORRIDOR) if case.tank else open_guesses(case)
    solved = [program.solve(guess, start) for guess in guesses]
    return sorted((each for each in solved if each.solved), key=lambda each: each.energy_j)


def flown_model(vehicle: Vehicle, *, mass: float = 1.0, drag: float = 1.0) -> Model4:
    """The model of a vehicle with factors on the hull's mass and on quadratic drag, as the plant's mismatch."""
    model = vehicle.to_model()
    surge, sway, heave, yaw = model.mass_kg
    more_kg = (mass - 1.0) * vehicle.body.mass_kg
    d1, d2, d3, d4 = model.quadratic_drag
    return replace(
        model,
        mass_kg=(surge + more_kg, sway + more_kg, heave + more_kg, yaw),
        quadratic_drag=(drag * d1, drag * d2, drag * d3, drag * d4),
    )


def _heavier_j(vehicle: Vehicle, case: Case, drag: float, found: list[Optimum]) -> float:
    """What the best classes take with the vehicle that is flown where the controller's model is wrong."""
    intervals, substeps = grid_of(case)
    flown = flown_model(vehicle, mass=MASS, drag=drag)
    program = LeastEnergy(flown, PowerModel.of(vehicle), case, intervals, substeps)
    solved = [program.solve(near.guess, start_state(case), near) for near in found[:3]]
    return min(optimum.energy_j for optimum in solved if optimum.solved)


def grid_energy_j(vehicle: Vehicle, case: Case) -> float:
    """Dijkstra over steady speeds: no inertia, no turning, to the border of each region along the way."""
    table = speed_table(vehicle.to_model(), PowerModel.of(vehicle), SPEED_CAP_M_S)
    start = nav_state(plant_of(case, vehicle).truth)
    fence = TANK if case.tank else Fence()
    features, total = Features(fence), 0.0
    begin = np.array(case.start[:2])
    places = np.stack([begin, *(np.array(goal.pos_ned_m[:2]) for goal in case.goals)])
    area = area_of(fence, places)
    flow = FlowField(sample_flow(known_current(case), start, area, case.start[2]))
    field = EnergyField(FreeSpace(features, area, BODY_RADIUS_M + 0.02, long_moves=LONGEST_MOVE), flow, table)
    for goal in case.goals:
        end = np.array(goal.pos_ned_m[:2])
        to_go = field.to(end)
        path = None if to_go is None else to_go.path(begin)
        if path is None:
            return float("nan")
        length = float(np.hypot(*np.diff(path.points_ned_m, axis=0).T).sum())
        total += path.energy_j * (length - REGION_M) / length
        begin = end
    return total
