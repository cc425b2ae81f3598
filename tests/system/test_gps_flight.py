"""GPS at the surface and dead reckoning under water: the whole service in open water, without markers."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.core.geodesy import place_from_ned
from autopilot.core.messages import NavHealth, Outputs
from autopilot.log.reader import open_log
from autopilot.mavlink.api import FlightMode
from autopilot.record.estimator_setup import read_setup
from autopilot.replay.estimator_replay import matches, replay
from autopilot.replay.service_replay import replay_service
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
bias_m = 0.01
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

    def part(self, begin_s: float, end_s: float) -> list[tuple[float, float, float, NavHealth, float]]:
        return [row for row in self.rows if begin_s < row[0] <= end_s]


def test_it_begins_by_gps_dives_by_the_velocity_log_and_finds_itself_again(tmp_path: Path) -> None:
    flight = Flight(tmp_path)
    commander = flight.session.parts.commander
    flight.run(10.0)
    assert commander.prearm_reasons() == ()
    assert {row[3] for row in flight.part(2.0, 10.0)} == {NavHealth.GOOD}
    assert 1 <= len(flight.used_us) <= 10, "a hundred fixes are no better than one"
    assert commander.arm(force=False).reason == ""
    assert commander.take_off(2.0).reason == ""
    flight.run(20.0)
    below_s = 1e-6 * flight.t_us
    away = place_from_ned(flight.session.parts.plans.origin, 32.0, -4.0, 2.0)
    assert commander.go_to(away, None).reason == ""
    flight.run(60.0)
    dived = flight.part(below_s, 1e-6 * flight.t_us)
    assert {row[3] for row in dived} == {NavHealth.DEAD_RECKONING}
    assert min(row[4] for row in dived) > 1.0
    assert max(flight.used_us) < 1e6 * below_s, "there is no GPS under water"
    assert np.hypot(*(flight.session.device.truth.pos_ned_m[:2] - [32.0, -4.0])) < 5.0
    assert commander.set_mode(FlightMode.SURFACE).reason == ""
    flight.run(90.0, lambda: not commander.armed)
    assert not commander.armed
    flight.run(10.0)
    assert flight.rows[-1][3] is NavHealth.GOOD, "fixes agree again"
    assert np.mean([off_m <= sigma_m for _, off_m, sigma_m, *_ in flight.rows]) > 0.95
    assert not any("disagree" in text for text in flight.texts)


def test_a_recorded_flight_by_gps_gives_the_same_bits(tmp_path: Path) -> None:
    flight = Flight(tmp_path, log=True)
    flight.run(8.0)
    flight.session.close()
    log = open_log(tmp_path / "run.mcap")
    assert len(log["/in/gps"]) > 30 and len(log["/nav/gps"]) == len(log["/in/gps"])
    assert [match.topic for match in matches(log, replay(log, read_setup(log))) if not match.same] == []
    result = replay_service(log)
    assert result.same, [str(one) for one in result.differences]
    assert result.stopped == "" and result.ticks == len(log["/in/tick"])
