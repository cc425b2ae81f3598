"""The plan check beside a grid search, over random worlds: ``python -m tests.bench.verdicts --worlds 2000``.

The search knows neither the shapes' formulas nor the quadtree of the check: it takes the distance transform of a
picture of the world, and looks for the widest path of every leg, the one from the start included. A verdict has to be
the same unless the world is within :data:`BAND_M` of the limit, or nearer to it than the picture can tell.
"""

import argparse
import json
from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from autopilot.campaign.worlds.distance_map import DistanceMap
from autopilot.campaign.worlds.random_world import RandomWorld, files_of, make_world
from autopilot.campaign.worlds.world_shapes import Point, clearance_m
from autopilot.control.robust.margins import goal_margin_m
from autopilot.core.params import ParamSet
from autopilot.mission.local_plan import read_local_plan
from autopilot.mission.mission_tuning import VALIDATION
from autopilot.mission.plan_check import judge_file

BAND_M = 0.022
"""1 cm, and 12 mm by which fence and waypoints are rounded on the wire."""
FINE_M, FINE_PIXELS = 0.004, 25_000_000
"""Of the second picture, for worlds near the limit."""
BISECTIONS = 12
SIZES = (0.8, 4.0)
"""The vehicle is so many times as large as that for which the world was made, or nothing would be refused."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VerdictRow:
    seed: int
    reason: str
    """Of the plan check, "" = it can be flown."""
    spare_m: float
    """By which the tightest place or path of the mission is wider than the vehicle needs, by the search."""
    pixel_m: float
    """Of the picture."""
    begins_free: bool
    """The vehicle fits where it starts."""

    @property
    def kind(self) -> str:
        if not self.begins_free:
            return "begins in a wall"
        if bool(self.reason) is (self.spare_m < 0.0):
            return "refused by both" if self.reason else "accepted by both"
        if abs(self.spare_m) <= BAND_M:
            return "in the band"
        return "not told by the picture" if abs(self.spare_m) <= 1.5 * self.pixel_m else "DIFFERENT"


def judged(seed: int) -> VerdictRow:
    world = make_world(seed)
    plan = read_local_plan(files_of(world, mode=0, duration_s=1.0)["plan.toml"].decode(), "plan.toml")
    params = ParamSet(world.scenario["params"])
    margin_m = goal_margin_m(world.vehicle, params)
    radius_m = world.vehicle.radius_m * float(np.random.default_rng(seed).uniform(*SIZES))
    assert plan.home is not None
    verdict = judge_file(plan, plan.home, params, radius_m=radius_m, goal_margin_m=margin_m)
    found = [problem.reason for problem in verdict.joint]
    reason = found[0] if found else verdict.path_problem(np.array(world.scenario["vehicle"]["start_m"]), 0)
    spare_m, pixel_m = _spare(world, params, radius_m, margin_m, {})
    if abs(spare_m) < 2.0 * pixel_m:
        spare_m, pixel_m = _spare(world, params, radius_m, margin_m, {"finest_m": FINE_M, "most_pixels": FINE_PIXELS})
    begins_free = clearance_m(world.layout, world.start_m) >= radius_m
    return VerdictRow(
        seed=seed, reason=reason, spare_m=round(spare_m, 4), pixel_m=round(pixel_m, 4), begins_free=begins_free
    )


def _spare(
    world: RandomWorld, params: ParamSet, radius_m: float, margin_m: float, picture: dict[str, Any]
) -> tuple[float, float]:
    """:attr:`VerdictRow.spare_m` and the size of a pixel."""
    keep_m = radius_m + params["MPC_MARGIN"]
    places = [(float(w["x_m"]), float(w["y_m"])) for w in world.waypoints]
    spare = []
    for place, waypoint in zip(places, world.waypoints, strict=True):
        accept_m = float(waypoint.get("accept_m", params["WP_ACCEPT_RADIUS"]))
        short_m = min(VALIDATION.approach_fraction * accept_m, VALIDATION.approach_m)
        spare.append(clearance_m(world.layout, place) - radius_m - max(0.0, margin_m - short_m))
    chart = DistanceMap(world.layout, [world.start_m, *places], **picture)
    if min(spare) >= -BAND_M:
        here = world.start_m
        for place in places:
            spare.append(_widest(chart, here, place, keep_m) - keep_m)
            here = place
    return min(spare), chart.pixel_m


def _widest(chart: DistanceMap, here: Point, there: Point, keep_m: float) -> float:
    """Clearance [m] of the widest path between two points, up to half a metre more than ``keep_m``."""
    low, high = 0.0, keep_m + 0.5
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        regions = chart.regions(middle)
        near = [
            chart.regions_near(regions, place, 1.5 * max(0.0, middle - chart.clearance_m(place)) + 2.0 * chart.pixel_m)
            for place in (here, there)
        ]
        if near[0] & near[1]:
            low = middle
        else:
            high = middle
    return low


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=50_000, help="of the first world")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    rows = []
    for seed in range(given.seed, given.seed + given.worlds):
        row = judged(seed)
        rows.append(row)
        if row.kind == "DIFFERENT" and not given.json:
            print(f"world {seed}: {row.reason or 'accepted'}; spare {row.spare_m} m, pixel {row.pixel_m} m", flush=True)
    counts = Counter(row.kind for row in rows)
    print(json.dumps([asdict(row) for row in rows]) if given.json else dict(counts))


if __name__ == "__main__":
    main()
