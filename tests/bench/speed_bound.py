"""True planar speed through the water beside its limit, with drag and thrust that the vehicle file does not have.

``python -m tests.bench.speed_bound``: flights of the whole service at shipped parameters, half of them in uniform
streams, the others in jets, vortices, shear, gyres and the built-in scenarios.
"""

import math
import multiprocessing
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from autopilot.cli.console_output import print_table
from autopilot.core.messages import Outputs
from autopilot.core.own_python import safe_path
from autopilot.core.params import ParamSet
from autopilot.mission.local_plan import LocalPlan, WaypointTable, plan_of_local
from autopilot.mission.paper import ORIGIN
from autopilot.mission.plan_files import write_plan
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl
from autopilot.sitl.scenario import load_scenario, load_tables, plan_path
from autopilot.sitl.toml_text import toml_text
from tests.bench.gaps import water

OPEN = "b3-est"
"""Scenario in open water of which current, start, mismatch and plan are replaced."""
BUILT_IN = ("paper-tank", "b1-est", "b2-est", "b4-est", "b5-est", "b6-est")
VARYING = ("jet", "vortex", "shear", "bickley", "gyre")
DEPTH_M, ACCEPT_M = 0.7, 0.3
CUTOFF_S = 30.0
DRAG, THRUST, STREAM_M_S = (0.8, 1.25), (0.85, 1.15), 0.35
WORST = (0.8, 1.15)
"""Drag and thrust of every fourth flight: the combination that makes a vehicle faster than it believes by most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundFlight:
    seed: int
    kind: str
    current: str
    drag: float
    thrust: float
    top_m_s: float
    """Largest true planar speed through the water after the first thrust, where the current is no strong stream."""
    known: float
    """Fraction of the flight with a smaller margin than without knowledge."""
    least_margin_m_s: float
    """Of the controller, while it flew."""
    finished: bool
    limit_m_s: float

    @property
    def kept(self) -> bool:
        return self.top_m_s <= self.limit_m_s


def tables_of(seed: int) -> tuple[str, dict[str, Any], list[WaypointTable]]:
    """Kind of the water, scenario tables, and waypoints (none: the scenario's own plan)."""
    rng = np.random.default_rng((3002, seed))
    mismatch = {"drag": round(float(rng.uniform(*DRAG)), 3), "thrust": round(float(rng.uniform(*THRUST)), 3)}
    if seed % 4 == 0:
        mismatch = dict(zip(("drag", "thrust"), WORST, strict=True))
    kind = "uniform" if seed % 2 == 0 else str(rng.choice((*VARYING, "built-in")))
    if kind == "built-in":
        name = BUILT_IN[seed // 2 % len(BUILT_IN)]
        tables = load_tables(name)
        tables["scenario"]["plan"] = str(plan_path(name, load_scenario(name)))
        tables["vehicle"]["mismatch"] = mismatch
        return name, tables, []
    tables = load_tables(OPEN)
    to = rng.uniform(-math.pi, math.pi)
    north, east = rng.uniform(0.0, STREAM_M_S) * np.array((math.cos(to), math.sin(to)))
    stream = {"kind": "uniform", "velocity_m_s": [round(float(north), 4), round(float(east), 4), 0.0]}
    tables["current"] = stream if kind == "uniform" else water(kind, rng)
    tables["vehicle"] |= {"start_m": [0.0, 0.0, DEPTH_M], "start_yaw_rad": round(float(rng.uniform(-3.1, 3.1)), 3)}
    tables["vehicle"]["mismatch"] = mismatch
    tables["controller"]["currents"] = "estimate"
    tables["params"] = {"DEPTH_MAX": tables["params"]["DEPTH_MAX"], "MPC_COST": float(seed % 3 != 2)}
    places = np.cumsum(rng.uniform(-5.0, 5.0, (4, 2)), axis=0)
    points = [
        WaypointTable(x_m=round(float(x), 2), y_m=round(float(y), 2), depth_m=DEPTH_M, accept_m=ACCEPT_M)
        for x, y in places
    ]
    return kind, tables, points


def fly_bound(seed: int, cutoff_s: float = CUTOFF_S) -> BoundFlight:
    kind, tables, points = tables_of(seed)
    return flown(seed, kind, tables, points, cutoff_s)


def flown(
    seed: int, kind: str, tables: dict[str, Any], points: list[WaypointTable], cutoff_s: float = CUTOFF_S
) -> BoundFlight:
    """Fly the plan in the scenario of ``tables``, with waypoints if there are any."""
    opened: list[SitlSession] = []
    speeds: list[float] = []
    margins: list[float] = []
    left = [(point.x_m, point.y_m) for point in points]

    def note(outputs: Outputs) -> None:
        if not opened:
            return
        truth = opened[0].device.truth
        if not speeds and not np.abs(truth.thrust_n).max() > 0.0:
            return
        # In stronger streams the vehicle gives up its margin, whatever is known.
        weak = math.hypot(*truth.current_ned_m_s[:2]) <= STREAM_M_S
        speeds.append(math.hypot(*truth.vel_water_frd_m_s[:2]) if weak else 0.0)
        if weak and outputs.control is not None and outputs.control.status.speed_margin_m_s:
            margins.append(outputs.control.status.speed_margin_m_s)
        if left and math.dist(truth.pos_ned_m[:2], left[0]) < ACCEPT_M:
            left.pop(0)

    with tempfile.TemporaryDirectory() as folder:
        if points:
            plan = Path(folder) / "legs.plan"
            write_plan(plan, plan_of_local(LocalPlan(origin=ORIGIN, waypoint=points)))
            tables["scenario"]["plan"] = str(plan)
        altered = Path(folder) / "altered.toml"
        altered.write_text(toml_text(tables))
        given = {"speed": 0.0, "sensors": "pose", "duration": cutoff_s, "start": True, "scenario": str(altered)}
        session = open_sitl(flight_settings(folder, given), {}, log=False, on_tick=note)
        opened.append(session)
        session.run(stop=lambda: bool(points) and not left)
    mismatch, params = tables["vehicle"]["mismatch"], ParamSet()
    least_m_s = params["MPC_SPEED_MARGIN"]
    return BoundFlight(
        seed=seed,
        kind=kind,
        current=" ".join(str(each) for key, each in tables["current"].items() if key != "kind"),
        drag=mismatch["drag"],
        thrust=mismatch["thrust"],
        top_m_s=max(speeds, default=0.0),
        known=float(np.mean(np.array(margins) < least_m_s)) if margins else 0.0,
        least_margin_m_s=min(margins, default=least_m_s),
        finished=bool(points) and not left,
        limit_m_s=params["SPD_PLANAR_MAX"],
    )


COLUMNS = ("seed", "water", "drag", "thrust", "fastest m/s", "smaller margin %", "least margin", "finished", "current")


def _row(flight: BoundFlight) -> list[str]:
    return [
        str(flight.seed),
        flight.kind,
        f"{flight.drag:.2f}",
        f"{flight.thrust:.2f}",
        f"{flight.top_m_s:.3f}" + ("" if flight.kept else " above"),
        f"{100.0 * flight.known:.0f}",
        f"{flight.least_margin_m_s:.3f}",
        "yes" if flight.finished else "no",
        flight.current,
    ]


@click.command()
@click.option("--flights", type=click.IntRange(1), default=60, show_default=True)
@click.option("--seed", type=int, default=1, show_default=True, help="First one.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True)
def main(flights: int, seed: int, jobs: int) -> None:
    """The largest true speed of every flight; exit code 1 if one is above SPD_PLANAR_MAX."""
    seeds, found = range(seed, seed + flights), []
    with safe_path(), ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        for flight in pool.map(fly_bound, seeds):
            found.append(flight)
            print("  ".join(_row(flight)), flush=True)
    print_table("speed bound", list(COLUMNS), [_row(flight) for flight in found])
    worst = max(found, key=lambda flight: flight.top_m_s)
    print(f"fastest {worst.top_m_s:.3f} m/s of {worst.limit_m_s:g} (seed {worst.seed}), {len(found)} flights")
    raise SystemExit(not all(flight.kept for flight in found))


if __name__ == "__main__":
    main()
