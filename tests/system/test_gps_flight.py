"""GPS at the surface and dead reckoning under water: the whole service in open water, without markers."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from autopilot.core.messages import NavHealth, Outputs
from autopilot.mavlink.api import FlightMode
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl

SCENARIO = """
[scenario]
name = "gps"
description = "open water; nothing but GPS, DVL and pressure"
seed = 1

[current]
kind = "uniform"
velocity_m_s = [0.10, 0.05, 0.0]

[vehicle]
model = "bluerov2"
start_m = [20.0, -10.0, 0.10]
start_yaw_rad = 0.0
held = true

[sensors]
position = "pose"

[sensors.gps]
sigma_m = {sigma_m}

[sensors.depth]
[sensors.dvl]

[[fault]]
kind = "camera_blackout"
at_s = 0.0
duration_s = 1000.0
"""
PARAMS = {"EST_SIGMA_MAX": 5.0, "DEPTH_MAX": 5.0, "FENCE_REQUIRED": 0.0}


class Flight:
    def __init__(self, folder: Path, *, sigma_m: float = 1.5, log: bool = False, seed: int = 3) -> None:
        scenario = folder / "gps.toml"
        scenario.write_text(SCENARIO.format(sigma_m=sigma_m))
        given: dict[str, Any] = {"scenario": str(scenario), "speed": 0.0, "seed": seed, "sensors": "pose"}
        if log:
            given["log"] = str(folder / "run.mcap")
        self.rows: list[tuple[float, float, float, NavHealth, float]] = []
        """Time, planar error, its 3 sigma, health, true depth."""
        self.used_us: list[int] = []
        self.texts: list[str] = []
        self.t_us = 0
        self.session: SitlSession = open_sitl(flight_settings(folder, given), PARAMS, log=log, on_tick=self._look)

    def _look(self, outputs: Outputs) -> None:
        truth, nav = self.session.device.truth, outputs.nav
        self.texts += [event.text for event in outputs.events]
        self.used_us += [aid.t_us for aid in outputs.aids if aid.sensor == "gps" and aid.fused]
        if nav is not None:
            off_m = float(np.hypot(*(nav.pos_ned_m - truth.pos_ned_m)[:2]))
            sigma_m = 3.0 * math.sqrt(float(nav.variance[:2].max()))
            self.rows.append((1e-6 * nav.t_us, off_m, sigma_m, nav.health, float(truth.pos_ned_m[2])))

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        for _ in range(round(100 * seconds)):
            self.t_us += 10_000
            self.session.runtime.tick(self.t_us)
            if until():
                return

    def dive(self) -> None:
        """Arm at the surface, dive to 2 m."""
        commander = self.session.parts.commander
        self.run(30.0, lambda: commander.prearm_reasons() == ())
        assert commander.prearm_reasons() == ()
        assert commander.arm(force=False).reason == ""


@pytest.mark.parametrize("sigma_m", [1.5])
def test_probe(tmp_path: Path, sigma_m: float) -> None:
    flight = Flight(tmp_path, sigma_m=sigma_m)
    flight.run(20.0)
    print(flight.rows[:1], flight.rows[-1], len(flight.used_us), flight.texts)
    print(flight.session.parts.commander.prearm_reasons(), list(FlightMode))
