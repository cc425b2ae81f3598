"""``autopilot bench modes``: the two costs of the controller beside each other, in the tank and in other waters.

Each flight is the whole service in the simulator, judged on the plant's truth as a run of a campaign is; the vehicle
knows nothing of the water beforehand.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from autopilot.campaign.flight import fly
from autopilot.campaign.results import RunResult, Task
from autopilot.campaign.run_table import MODE, MODES
from autopilot.mission.local_plan import LocalPlan, RepeatTable, WaypointTable, plan_of_local
from autopilot.mission.paper import ORIGIN, paper_plan
from autopilot.mission.plan_files import write_plan
from autopilot.mission.plan_model import PlanFile
from autopilot.sitl.scenario import load_tables
from autopilot.sitl.toml_text import toml_text

LIMIT_S = 400.0
"""A flight that takes longer has not arrived."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Water:
    """Where both modes fly, and what."""

    name: str
    scenario: str
    plan: Callable[[], PlanFile]
    tables: dict[str, Any]
    """Tables of the scenario that are others here."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeRow:
    """One flight. Energy and time are means of its laps."""

    water: str
    mode: str
    laps: str
    lap_j: float | None
    lap_s: float | None
    nearest_mm: float | None
    """Least distance that is left to a boundary beyond what has to be kept."""
    contacts: int
    alternating_pct: float | None
    """Smoothness of the commands as in ``autopilot log check``; None if there were too few."""
    variation_n_s: float | None
    variation_ratio: float | None
    """Over what is left of it below 2 Hz."""
    step_n: float | None
    reversals_1_s: float | None
    silent: int | None
    fallbacks_pct: float
    cpu_ms: float
    """CPU time of the whole process per control step (50 ms), the simulator's included."""


def tour(*places: tuple[float, float, float]) -> Callable[[], PlanFile]:
    """Round these places (x, y, depth [m]) once and back to the first, heading free."""

    def plan() -> PlanFile:
        points = [WaypointTable(x_m=x, y_m=y, depth_m=depth) for x, y, depth in (*places, places[0])]
        return plan_of_local(
            LocalPlan(origin=ORIGIN, waypoint=points, repeat=RepeatTable(first_waypoint=1, laps=1)),
        )

    return plan


def _uniform(*velocity_m_s: float) -> dict[str, Any]:
    return {"current": {"kind": "uniform", "velocity_m_s": [*velocity_m_s, 0.0]}}


WATERS = (
    Water(name="paper's tank, jet 0.25 m/s", scenario="paper-tank", plan=lambda: paper_plan(2), tables={}),
    Water(name="paper's tank, still", scenario="paper-tank-still", plan=lambda: paper_plan(1), tables={}),
    Water(
        name="paper's tank, 0.15 m/s through it",
        scenario="paper-tank",
        plan=lambda: paper_plan(1),
        tables=_uniform(0.13, 0.075),
    ),
    Water(
        name="harbour, twelve pillars, tide",
        scenario="harbour",
        plan=tour((-13.0, -8.0, 0.6), (-2.5, -3.0, 1.1), (-7.0, 4.0, 0.8)),
        tables={},
    ),
    Water(
        name="open water, gyres 0.3 m/s",
        scenario="open-water",
        plan=tour((0.0, 0.0, 0.6), (12.0, 4.0, 1.1), (8.0, -6.0, 0.8)),
        tables={"current": {"kind": "gyre", "speed_m_s": 0.3, "cell_m": 20.0}},
    ),
)


def bench_modes(short: bool = False, progress: Callable[[str], None] = lambda _: None) -> Iterator[ModeRow]:
    """Every water in both modes; ``short``: the first two."""
    for water in WATERS[:2] if short else WATERS:
        for cost in MODES:
            result = fly(task_of(water, cost))
            if result is not None:
                row = row_of(water, cost, result)
                progress(f"{row.water}, {row.mode}: {row.laps} laps, {row.lap_j or 0.0:.0f} J")
                yield row


def task_of(water: Water, cost: float) -> Task:
    """One flight, complete in itself; tours have no fence."""
    tables = {**load_tables(water.scenario), **water.tables}
    tables["scenario"] = {**tables["scenario"], "plan": "tour.plan"}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "tour.plan"
        write_plan(path, water.plan())
        plan = path.read_bytes()
    return Task(
        run=0,
        seed=int(tables["scenario"]["seed"]),
        drawn={},
        scenario_toml=toml_text(tables),
        plan_name="tour.plan",
        plan=plan,
        estimator="ekf",
        sensors="pose",
        duration_s=LIMIT_S,
        params={MODE: cost, "FENCE_REQUIRED": 0.0},
    )


def row_of(water: Water, cost: float, result: RunResult) -> ModeRow:
    steps, smooth = max(result.steps, 1), result.smoothness
    return ModeRow(
        water=water.name,
        mode=MODES[cost],
        laps=f"{result.laps} of {result.laps_asked}",
        lap_j=float(np.mean(result.energy_j)) if result.energy_j else None,
        lap_s=float(np.mean(result.lap_s)) if result.lap_s else None,
        nearest_mm=None if result.least_m is None else 1000.0 * result.least_m,
        contacts=result.contacts,
        alternating_pct=None if smooth is None else 100.0 * smooth.alternating,
        variation_n_s=None if smooth is None else smooth.variation_n_s,
        variation_ratio=None if smooth is None else smooth.ratio,
        step_n=None if smooth is None else smooth.step_n,
        reversals_1_s=None if smooth is None else smooth.reversals_1_s,
        silent=None if smooth is None else smooth.silent,
        fallbacks_pct=100.0 * result.fallbacks / steps,
        cpu_ms=1000.0 * result.cpu_s / steps,
    )
