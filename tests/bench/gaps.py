"""Gaps in the fixes in moving water: is the truth inside 3 sigma, and what is reported that is not so?

``python -m tests.bench.gaps``: flights of the whole service between random places, at random speeds and headings,
through a jet, a vortex or a shear current anywhere. The estimator is told nothing of the water.
"""

import math
import multiprocessing
import tempfile
import tomllib
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np

from autopilot.cli.console_output import print_table
from autopilot.core.frames import wrap_pi
from autopilot.core.messages import NavDoubt, NavHealth, Outputs
from autopilot.core.own_python import safe_path
from autopilot.mission.local_plan import FenceTable, LocalPlan, PolygonTable, WaypointTable, plan_of_local
from autopilot.mission.paper import ORIGIN
from autopilot.mission.plan_files import write_plan
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl
from autopilot.sitl.scenario import scenario_path
from autopilot.sitl.toml_text import toml_text
from tests.bench.estimator_flights import overlaid
from tests.bench.sensor_faults import DEADLINE_S, PLAIN_WAY, SIGMAS, Longest

KINDS = ("jet", "vortex", "shear", "bickley", "gyre")
GAPS_S = (3.0, 5.0, 10.0)
AFTER_S = 3.0
"""So long after a gap the estimate is still judged."""
TANK_M = [(-4.0, -3.0), (4.0, -3.0), (4.0, 3.0), (-4.0, 3.0)]
"""Wide enough that a vehicle whose estimate has drifted touches nothing."""
FAULTS: dict[str, tuple[NavDoubt, float]] = {"gyro": (NavDoubt.GYRO, 0.05), "accel": (NavDoubt.ACCELEROMETER, 0.3)}
"""Sensor -> its name in health, and the size of an offset [rad/s, m/s^2] that begins with the gap."""


@dataclass(slots=True)
class Gap:
    """What one gap has shown, from its beginning to :data:`AFTER_S` after its end."""

    start_s: float
    length_s: float
    end_m: float = math.nan
    """Error of the position at the end,"""
    end_sigma_m: float = math.nan
    """and the larger one of its planar standard deviations."""
    inside: list[bool] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    """Of north, east, down and heading each by its own variance, in the gap; 1 = as sure as it should be."""
    unflagged_s: float = 0.0
    """Longest time in a row outside and called good."""
    doubts: set[NavDoubt] = field(default_factory=set)
    named_s: float = math.nan
    """When the sensor that is wrong was first suspect, after the end of the gap."""


def water(kind: str, rng: np.random.Generator) -> dict[str, Any]:
    """A ``[current]`` table of that kind, anywhere in the tank."""
    center = [round(float(rng.uniform(-x, x)), 3) for x in (1.0, 0.7)]
    speed = float(rng.uniform(0.15, 0.35) * rng.choice((-1.0, 1.0)))
    if kind == "jet":
        angle = float(rng.uniform(-math.pi, math.pi))
        return {"kind": kind, "speed_m_s": abs(speed), "center_m": center, "direction_rad": angle}
    if kind == "vortex":  # fastest at 1.12 cores, with 0.64 of circulation / (2 pi core)
        core = float(rng.uniform(0.4, 1.5))
        return {
            "kind": kind, "center_m": center, "core_m": core, "circulation_m2_s": 2.0 * math.pi * core * speed / 0.64
        }  # fmt: skip
    if kind == "shear":
        return {
            "kind": kind, "shear_1_s": speed, "speed_m_s": float(rng.uniform(-0.15, 0.15)), "center_y_m": center[1]
        }  # fmt: skip
    if kind == "bickley":
        return {"kind": kind, "speed_m_s": speed, "width_m": float(rng.uniform(0.3, 1.0)), "center_y_m": center[1]}
    return {"kind": "gyre", "speed_m_s": speed, "cell_m": float(rng.uniform(1.0, 3.0))}


def places(rng: np.random.Generator) -> LocalPlan:
    """A way through the tank with random speeds and headings."""
    low, high = (-1.9, -1.3, 0.3), (1.9, 1.3, 0.8)
    waypoints = []
    for _ in range(24):
        x_m, y_m, depth_m = (float(value) for value in rng.uniform(low, high))
        yaw_rad, speed_m_s = float(rng.uniform(-math.pi, math.pi)), float(rng.uniform(0.15, 0.45))
        where = {"x_m": x_m, "y_m": y_m, "depth_m": depth_m, "accept_m": 0.3}
        waypoints.append(WaypointTable(**where, yaw_rad=yaw_rad, speed_m_s=speed_m_s))
    fence = FenceTable(polygon=[PolygonTable(points_m=TANK_M, inclusion=True)])
    return LocalPlan(origin=ORIGIN, waypoint=waypoints, fence=fence)


class GapWatch:
    """Judges the ticks in and after the gaps."""

    def __init__(self, gaps: Sequence[Gap], fault: str = "") -> None:
        self.gaps = gaps
        self.session: SitlSession | None = None
        self._outside = [Longest() for _ in gaps]
        self._named = FAULTS[fault][0] if fault else None

    def tick(self, outputs: Outputs) -> None:
        t_s, nav = 1e-6 * outputs.t_us, outputs.nav
        if nav is None or self.session is None or not outputs.mode.armed:
            return
        for gap, outside in zip(self.gaps, self._outside, strict=True):
            end_s = gap.start_s + gap.length_s
            if not gap.start_s <= t_s < end_s + AFTER_S:
                continue
            truth = self.session.device.truth
            error = np.array([*(nav.pos_ned_m - truth.pos_ned_m), wrap_pi(float(nav.rpy_rad[2] - truth.rpy_rad[2]))])
            variance = nav.variance[[0, 1, 2, 5]]
            inside = bool((np.abs(error) <= SIGMAS * np.sqrt(variance)).all())
            gap.inside.append(inside)
            outside.update(t_s, holds=not inside and nav.health is NavHealth.GOOD)
            gap.unflagged_s = outside.most_s
            gap.doubts |= nav.doubts
            if math.isnan(gap.named_s) and self._named in nav.doubts:
                gap.named_s = t_s - end_s
            if t_s < end_s:
                gap.nees.append(float((error**2 / variance).mean()))
                gap.end_m, gap.end_sigma_m = float(np.linalg.norm(error[:3])), float(np.sqrt(variance[:2].max()))


def gap_tables(kind: str, seed: int, lengths_s: Sequence[float], fault: str) -> tuple[dict[str, Any], list[Gap]]:
    """The scenario of one flight, and its gaps."""
    rng = np.random.default_rng((seed, 2))
    gaps, t_s = [], float(rng.uniform(12.0, 18.0))
    for length_s in lengths_s:
        gaps.append(Gap(round(t_s, 2), length_s))
        t_s += length_s + float(rng.uniform(6.0, 12.0))
    blackouts = [{"kind": "camera_blackout", "at_s": gap.start_s, "duration_s": gap.length_s} for gap in gaps]
    wrong: list[dict[str, Any]] = []
    if fault:
        offset = [0.0, 0.0, 0.0]
        offset[2 if fault == "gyro" else int(rng.integers(2))] = FAULTS[fault][1] * float(rng.choice((-1.0, 1.0)))
        wrong = [{"kind": "imu_offset", "sensor": fault, "offset": offset, "at_s": gaps[0].start_s}]
    # Of a stream of its own: the same seed has the same water, whatever the gaps.
    world = np.random.default_rng((seed, 3))
    changes = {
        "tank": {"polygon_m": TANK_M},
        "obstacle": [],
        "current": water(kind, world),
        "vehicle": {"start_m": [-1.5, 0.6, 0.4], "start_yaw_rad": float(world.uniform(-math.pi, math.pi))},
        "fault": [*blackouts, *wrong],
    }
    return overlaid(tomllib.loads(scenario_path("paper-tank").read_text(encoding="utf-8")), changes), gaps


def open_gaps(
    folder: Path, kind: str, seed: int, lengths_s: Sequence[float], fault: str = ""
) -> tuple[SitlSession, list[Gap]]:
    """One flight, ready to run; its gaps are filled in by then."""
    tables, gaps = gap_tables(kind, seed, lengths_s, fault)
    write_plan(folder / "way.plan", plan_of_local(places(np.random.default_rng((seed, 1)))))
    tables["scenario"]["plan"] = str(folder / "way.plan")
    (folder / "scenario.toml").write_text(toml_text(tables), encoding="utf-8")
    duration_s = gaps[-1].start_s + gaps[-1].length_s + AFTER_S
    given = {"scenario": str(folder / "scenario.toml"), "speed": 0.0, "sensors": "pose", "duration": duration_s}
    settings = flight_settings(folder, {**given, "seed": seed, "start": True})
    watch = GapWatch(gaps, fault)
    watch.session = open_sitl(settings, PLAIN_WAY, log=False, on_tick=watch.tick)
    return watch.session, gaps


def fly_gaps(kind: str, seed: int, lengths_s: Sequence[float], fault: str = "") -> list[Gap]:
    with tempfile.TemporaryDirectory() as folder:
        session, gaps = open_gaps(Path(folder), kind, seed, lengths_s, fault)
        session.run()
    return gaps


def summed(kind: str, gaps: Sequence[Gap], fault: str) -> list[str]:
    """One row of the table."""
    expected = {FAULTS[fault][0]} if fault else set()
    false = [[doubt.name for doubt in gap.doubts - expected] for gap in gaps]
    off_m, shares = [gap.end_m for gap in gaps], [float(np.mean(gap.inside)) for gap in gaps]
    named = [gap.named_s for gap in gaps if not math.isnan(gap.named_s)]
    late = sum(gap.unflagged_s > DEADLINE_S for gap in gaps)
    return [
        f"{kind} {fault}".strip(),
        f"{gaps[0].length_s:g}",
        str(len(gaps)),
        f"{1e3 * np.median(off_m):.0f}",
        f"{1e3 * max(off_m):.0f}",
        f"{1e3 * np.median([gap.end_sigma_m for gap in gaps]):.0f}",
        f"{100 * np.mean([tick for gap in gaps for tick in gap.inside]):.1f}",
        f"{100 * min(shares):.0f}",
        str(sum(share < 0.95 for share in shares)),
        f"{np.mean([nees for gap in gaps for nees in gap.nees]):.2f}",
        str(late),
        " ".join(sorted({name for names in false for name in names})) + f" {sum(map(bool, false))}",
        f"{len(named)}: {max(named):.1f}" if named else "",
    ]


COLUMNS = (
    "water", "gap s", "n", "end mm, median", "worst", "sigma mm", "inside %", "worst %", "below 95 %", "NEES/4",
    "told late", "falsely named", "named, by s",
)  # fmt: skip


@click.command()
@click.option("--gaps", "count", type=click.IntRange(1), default=20, show_default=True, help="Per water and length.")
@click.option("--seed", type=int, default=92001, show_default=True, help="First one.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True)
@click.option("--kind", "kinds", multiple=True, type=click.Choice(KINDS), default=KINDS[:3], show_default=True)
@click.option("--fault", type=click.Choice(tuple(FAULTS)), default=None, help="A sensor that is wrong from the gap on.")
def main(count: int, seed: int, jobs: int, kinds: Sequence[str], fault: str | None) -> None:
    """Gaps of 3, 5 and 10 s in the fixes, in moving water: one row per kind of water and length."""
    # A sensor that is wrong is so to the end: it has a flight of its own for each gap.
    orders = [(length_s,) for length_s in GAPS_S] if fault else [GAPS_S]
    flights = [(kind, number, order) for kind in kinds for number in range(seed, seed + count) for order in orders]
    spawn = multiprocessing.get_context("spawn")
    with safe_path(), ProcessPoolExecutor(jobs, mp_context=spawn) as pool:
        flown = list(pool.map(fly_gaps, *zip(*flights, strict=True), [fault or ""] * len(flights)))
    found: dict[tuple[str, float], list[Gap]] = {}
    for (kind, _, _), gaps in zip(flights, flown, strict=True):
        for gap in gaps:
            found.setdefault((kind, gap.length_s), []).append(gap)
    rows = [summed(kind, gaps, fault or "") for (kind, _), gaps in sorted(found.items(), key=lambda item: item[0])]
    print_table("gaps", list(COLUMNS), rows)


if __name__ == "__main__":
    main()
