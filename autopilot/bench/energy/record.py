"""The optima as committed data, and how they are computed anew."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.bench.energy.cases import BODY_RADIUS_M, CASES, REGION_M, SPEED_CAP_M_S, Case
from autopilot.bench.energy.flight import known_current, nav_state, plant_of
from autopilot.bench.energy.optimum import (
    Guess,
    LeastEnergy,
    Optimum,
    grid_of,
    open_guesses,
    start_state,
    tank_guesses,
    worst_gap_m,
)
from autopilot.bench.nmpc import TANK
from autopilot.control.energy.field import LONGEST_MOVE, EnergyField
from autopilot.control.energy.flow import Flow, area_of, sample_flow
from autopilot.control.energy.power import PowerModel, speed_table
from autopilot.control.obstacles import Features
from autopilot.core.frames import FloatArray
from autopilot.core.free_space import FreeSpace
from autopilot.core.geometry import Fence
from autopilot.core.vehicle import Vehicle, load_vehicle

DATA = Path(__file__).with_name("optima.json")
TRACK_POINTS = 80

MASS, DRAGS = 1.2, (1.2, 0.8)
"""Factors on the mass and on the quadratic drag of the vehicle where the controller's model is wrong."""

WRONG_CASES = ("b1", "b2 0.15@60", "b3 up", "b4", "b5")
"""The cases that are flown with it too."""

CORRIDOR = "b1 corridor"
"""B1 with the 0.115 m between cylinder and south wall open."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Record:
    """The least energy of one case."""

    name: str
    energy_j: float
    """Of the nominal vehicle: this is what flights are compared with."""
    duration_s: float
    leg_j: tuple[float, ...]
    label: str
    """The way it goes: see :func:`autopilot.bench.energy.optimum.tank_guesses`."""
    classes: dict[str, float]
    """Energy of the best solution of each class that was solved [J]."""
    neutral_j: float
    """The same with a vehicle that neither floats nor sinks, as published."""
    heavier_j: dict[str, float]
    """By factor on quadratic drag: the least energy of a vehicle that is 20 % heavier and has that drag [J]."""
    published_j: float
    grid_j: float
    """From the centre of one goal to the next by the grid of the energy planner: an independent check."""
    gap_m: float
    """Largest distance between a node and where a fine integration of its interval ends."""
    track_ned_m: FloatArray
    """(m, 2)"""


def load_records(path: Path = DATA) -> dict[str, Record]:
    """The committed optima."""
    raw: dict[str, dict[str, Any]] = json.loads(path.read_text())
    return {
        name: Record(
            name=name,
            **{
                **fields,
                "leg_j": tuple(fields["leg_j"]),
                "track_ned_m": np.array(fields["track_ned_m"]),
            },
        )
        for name, fields in raw.items()
    }


def save_records(records: dict[str, Record], path: Path = DATA) -> None:
    """As JSON, one case per line."""
    lines = []
    for name, record in records.items():
        fields: dict[str, object] = {
            "energy_j": round(record.energy_j, 2),
            "duration_s": round(record.duration_s, 2),
            "leg_j": [round(value, 2) for value in record.leg_j],
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
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n")


def recompute(progress: Callable[[str], None] = lambda _: None, names: tuple[str, ...] = ()) -> dict[str, Record]:
    """All optima (or those of ``names``); a few minutes."""
    vehicle = load_vehicle("lbv150")
    records = {}
    for name in names or (CORRIDOR, *CASES):
        corridor = name == CORRIDOR
        case = CASES["b1" if corridor else name]
        record = _record(vehicle, case, name, tank_guesses(corridor) if case.tank else open_guesses(case))
        published = 382.4 if corridor else record.published_j
        records[name] = replace(record, published_j=published)
        progress(f"{name}: {record.energy_j:.1f} J, neutral {record.neutral_j:.1f} J, published {published:.1f} J")
    return records


def _record(vehicle: Vehicle, case: Case, name: str, guesses: list[Guess]) -> Record:
    model, power = vehicle.model4.to_model(), PowerModel.of(vehicle)
    intervals, substeps = grid_of(case)
    program = LeastEnergy(model, power, case, intervals, substeps)
    solved = [(program.solve(guess, start_state(case)), guess) for guess in guesses]
    found = sorted((pair for pair in solved if pair[0].solved), key=lambda pair: pair[0].energy_j)
    best = found[0][0]
    afloat = LeastEnergy(replace(model, buoyancy_excess_n=0.0), power, case, intervals, substeps)
    neutral = [afloat.solve(guess, start_state(case), near) for near, guess in found[:3]]
    heavier = {f"{drag:g}": _heavier_j(vehicle, case, drag, found) for drag in DRAGS} if name in WRONG_CASES else {}
    rows = np.linspace(0, len(best.x) - 1, min(TRACK_POINTS, len(best.x))).round().astype(int)
    return Record(
        name=name,
        energy_j=best.energy_j,
        duration_s=float(best.t_s[-1]),
        leg_j=best.leg_j,
        label=best.label,
        classes={optimum.label: optimum.energy_j for optimum, _ in reversed(found)},
        neutral_j=min(optimum.energy_j for optimum in neutral if optimum.solved),
        heavier_j=heavier,
        published_j=case.published_j or 0.0,
        grid_j=grid_energy_j(vehicle, case),
        gap_m=worst_gap_m(model, case, best),
        track_ned_m=best.x[rows, :2],
    )


def _heavier_j(vehicle: Vehicle, case: Case, drag: float, found: list[tuple[Optimum, Guess]]) -> float:
    """What the best classes take with the vehicle that is flown where the controller's model is wrong."""
    model, (intervals, substeps) = vehicle.model4.to_model(), grid_of(case)
    surge, sway, heave, yaw = model.mass_kg
    more_kg = (MASS - 1.0) * vehicle.body.mass_kg
    d1, d2, d3, d4 = model.quadratic_drag
    flown = replace(
        model,
        mass_kg=(surge + more_kg, sway + more_kg, heave + more_kg, yaw),
        quadratic_drag=(drag * d1, drag * d2, drag * d3, drag * d4),
    )
    program = LeastEnergy(flown, PowerModel.of(vehicle), case, intervals, substeps)
    solved = [program.solve(guess, start_state(case), near) for near, guess in found[:3]]
    return min(optimum.energy_j for optimum in solved if optimum.solved)


def grid_energy_j(vehicle: Vehicle, case: Case) -> float:
    """Dijkstra over steady speeds: no inertia, no turning, to the border of each region along the way."""
    table = speed_table(vehicle.model4.to_model(), PowerModel.of(vehicle), SPEED_CAP_M_S)
    start = nav_state(plant_of(case, vehicle).truth)
    fence = TANK if case.tank else Fence()
    features, total = Features(fence), 0.0
    begin = np.array(case.start[:2])
    places = np.stack([begin, *(np.array(goal.pos_ned_m[:2]) for goal in case.goals)])
    area = area_of(fence, places)
    flow = Flow(sample_flow(known_current(case), start, area, case.start[2]))
    field = EnergyField(FreeSpace(features, area, BODY_RADIUS_M + 0.02, long_moves=LONGEST_MOVE), flow, table)
    for goal in case.goals:
        end = np.array(goal.pos_ned_m[:2])
        to_go = field.to(end)
        way = None if to_go is None else to_go.way(begin)
        if way is None:
            return float("nan")
        length = float(np.hypot(*np.diff(way.points_ned_m, axis=0).T).sum())
        total += way.energy_j * (length - REGION_M) / length
        begin = end
    return total
