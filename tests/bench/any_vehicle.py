"""Vehicles made at random: 3 to 8 thrusters anywhere, in any direction and order, on any channels, flown or refused.

A vehicle is the LBV150's hull with thrusters of its own. It is written as a file, and what a user does with one is done
with it: it is refused with a sentence that names an axis, or it flies in open water with a current for 20 s, by the
whole service. Half of them have thrusters along the body's axes, as people build, which is where geometry is singular.
"""

import math
import tempfile
import tomllib
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.core.messages import Outputs
from autopilot.core.model4 import AXIS_NAMES
from autopilot.core.thrusters import MAX_CHANNEL, MAX_THRUSTERS, MIN_THRUSTERS
from autopilot.core.vehicle import load_vehicle
from autopilot.run.config import gather, sitl_defaults
from autopilot.run.sitl_session import open_sitl
from autopilot.sitl.toml_text import toml_text

FLOWN_S = 20.0
GOAL_M = (2.0, 1.0, 1.0)
"""From the start at (0, 0, 0.6)."""
MAX_LEFT_M = 0.8
"""So near it is then, of 2.3 m at first."""

MISSION = f"""
[origin]
lat_deg = 37.9755
lon_deg = 23.7790
alt_m = 0.0

[[waypoint]]
x_m = {GOAL_M[0]}
y_m = {GOAL_M[1]}
depth_m = {GOAL_M[2]}
yaw_rad = 1.0
accept_m = 0.2
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    seed: int
    thrusters: int
    refused: str
    """Why it cannot be flown, "" if it can."""
    left_m: float
    """Distance to the goal at the end."""
    tilt_deg: float
    """Largest tilt on the way."""
    faults: tuple[str, ...]
    """Exceptions inside the service."""

    @property
    def problem(self) -> str:
        """What is wrong with that, "" if nothing is."""
        if self.refused:
            named = any(axis in self.refused for axis in AXIS_NAMES)
            return "" if named else f"refused without an axis: {self.refused}"
        if self.faults:
            return f"fault: {self.faults[0]}"
        return "" if self.left_m <= MAX_LEFT_M else f"{self.left_m:.2f} m left"


def vehicle_tables(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng((20_251, seed))
    shipped = resources.files("autopilot") / "data" / "vehicles" / "lbv150.toml"
    tables: dict[str, Any] = tomllib.loads(shipped.read_text(encoding="utf-8"))
    count = int(rng.integers(MIN_THRUSTERS, MAX_THRUSTERS + 1))
    square, channels = rng.uniform() < 0.5, rng.permutation(MAX_CHANNEL)[:count] + 1
    tables["name"], tables["description"] = f"made{seed}", f"{count} thrusters made at random"
    tables["thruster"], tables["body"]["thruster_offset_frd_m"] = [], {}
    for index in range(count):
        if square:
            direction, place = np.zeros(3), rng.integers(-1, 2, 3) * [0.15, 0.12, 0.0]
            direction[rng.integers(3)] = rng.choice([-1.0, 1.0])
        else:
            direction, place = rng.normal(size=3), rng.uniform(-1.0, 1.0, 3) * [0.2, 0.15, 0.02]
        thruster = {
            "name": f"t{index}",
            "position_frd_m": place.tolist(),
            "direction_frd": direction.tolist(),
            "channel": int(channels[index]),
            "reversed": bool(rng.uniform() < 0.3),
            "limit_n": float(rng.uniform(7.0, 12.0)),
        }
        if rng.uniform() < 0.2:
            thruster["drive"] = {**tables["drive"], "time_constant_s": float(rng.uniform(0.08, 0.25))}
        tables["thruster"].append(thruster)
    if rng.uniform() < 0.5:
        tables["levelling"] = {"inertia_kg_m2": [0.15, 0.30]}
    tables["sources"] = {"thruster": "made at random"}
    return tables


def fly(seed: int, seconds: float = FLOWN_S) -> Outcome:
    """Make it, and fly it if it can be flown."""
    tables = vehicle_tables(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file, plan = folder / "made.toml", folder / "made.mission.toml"
        file.write_text(toml_text(tables), encoding="utf-8")
        plan.write_text(MISSION, encoding="utf-8")
        count = len(tables["thruster"])
        try:
            load_vehicle(str(file))
        except ConfigError as error:
            return Outcome(seed=seed, thrusters=count, refused=str(error), left_m=math.nan, tilt_deg=0.0, faults=())
        given = {"scenario": "open-water", "vehicle": str(file), "plan": str(plan), "speed": 0.0, "start": True}
        settings = gather(sitl_defaults(0), {**given, "duration": seconds}, {})
        for key, value in (("connect", ()), ("state_dir", name), ("log", None)):
            settings.put(key, value, "bench")
        faults: list[str] = []
        tilt_rad = 0.0

        def on_tick(outputs: Outputs) -> None:
            nonlocal tilt_rad
            faults.extend(fault.line for fault in outputs.faults)
            tilt_rad = max(tilt_rad, float(np.abs(session.device.truth.rpy_rad[:2]).max()))

        session = open_sitl(settings, {}, log=False, on_tick=on_tick)
        session.run()
        place = session.device.truth.pos_ned_m
    return Outcome(
        seed=seed,
        thrusters=count,
        refused="",
        left_m=float(np.linalg.norm(place - np.array(GOAL_M))),
        tilt_deg=math.degrees(tilt_rad),
        faults=tuple(faults),
    )
