"""What the estimator costs, and whether the loop keeps its time while the camera runs."""

import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from autopilot.bench.machine import Pace, slowness
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState
from autopilot.core.samples import MarkerSighting, Sample
from autopilot.estimator.create import create_estimator
from autopilot.run.sitl_session import SitlSession
from autopilot.sitl.floor import given_markers
from tests.bench.estimator_figures import EstimatorBenchRow, Limit, verdict
from tests.bench.estimator_flights import FlightSpec, open_flight, watch

ESTIMATOR_BAR_PCT, VISION_BAR_PCT, LATE_BAR_PCT = 5.0, 30.0, 1.0
"""Shares of one core at the reference speed; ticks more than one period (10 ms) late: 1 % is the 99 % point."""
COST_S, SHORT_COST_S = 12.0, 6.0


HAND_LAID = {"markers": {"laid": {"sheet_m": 0.6, "sigma_m": 0.0017, "sigma_rad": 0.006, "seed": 1}}}
"""The floor of the scenario ``hand-laid``: where sheets lie are states."""
PACE_EVERY = 20
"""Ticks between looks at how fast the machine is."""


class _Timed:
    """The estimator as it is flown, with the other one in its shadow; adds up what it and the detector spend."""

    def __init__(self, session: SitlSession, sensors: str) -> None:
        scenario = session.scenario
        markers = given_markers(scenario) if sensors == "camera" else None
        floor_m = None if scenario.tank is None else scenario.tank.depth_m
        self._estimator = create_estimator("ekf", session.vehicle, markers, floor_depth_m=floor_m, shadow=True)
        self.nav: NavState | None = None
        self.estimator_s = self.vision_s = self.simulated_s = 0.0
        self.pace = Pace()
        self._ticks = 0

    def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray, *, keep: bool) -> None:
        self._ticks += 1
        if self._ticks % PACE_EVERY == 1:
            self.pace.measure()
        begin_s = time.thread_time()
        self.nav = self._estimator.step(t_us, samples, thrust_n)
        self._estimator.take_aids()
        self.estimator_s += time.thread_time() - begin_s
        self.vision_s += 1e-6 * sum(sample.decode_us for sample in samples if isinstance(sample, MarkerSighting))
        self.simulated_s = 1e-6 * t_us


def bench_cost(duration_s: float = COST_S) -> list[EstimatorBenchRow]:
    """Shares of a core with poses and with pictures, and late ticks with pictures in real time."""
    poses, pictures = _flown("pose", duration_s), _flown("camera", duration_s)
    sheets = _flown("camera", duration_s, HAND_LAID)
    slow = slowness()
    late_pct = _late_pct(duration_s, 1.0 / max(1.0, slow))
    both_s = pictures.estimator_s + pictures.vision_s
    pace = "real time" if slow <= 1.0 else f"real time / {slow:.1f}"
    return [
        *_fractions("cost: estimator, poses, share of a core", poses.estimator_s, poses, ESTIMATOR_BAR_PCT),
        *_fractions("cost: estimator, pictures, share of a core", pictures.estimator_s, pictures, ESTIMATOR_BAR_PCT),
        *_fractions(
            "cost: estimator, pictures of sheets, share of a core", sheets.estimator_s, sheets, ESTIMATOR_BAR_PCT
        ),
        *_fractions("cost: estimator and vision at 30 Hz, share of a core", both_s, pictures, VISION_BAR_PCT),
        _row(f"cost: ticks more than 10 ms late with camera, {pace}", late_pct, LATE_BAR_PCT),
    ]


def _fractions(figure: str, cpu_s: float, spent: _Timed, bar: float) -> list[EstimatorBenchRow]:
    """At the reference speed, and as measured."""
    raw, slow = 100.0 * cpu_s / spent.simulated_s, spent.pace.slowness
    return [_row(figure, raw / slow, bar), _row(f"{figure}, raw (machine {slow:.2f} times slower)", raw, None)]


def _row(figure: str, value: float, bar: float | None) -> EstimatorBenchRow:
    limit = None if bar is None else Limit(high=bar)
    return EstimatorBenchRow(
        figure=figure,
        measured=value,
        low=None,
        median=None,
        high=None,
        unit="%",
        bar="" if limit is None else str(limit),
        goal="",
        verdict=verdict(value, limit, None),
        seeds=1,
    )


def _flown(sensors: str, duration_s: float, changes: Mapping[str, Any] | None = None) -> _Timed:
    """One flight of the paper's tour as fast as it goes."""
    spec = FlightSpec(name="cost", changes=changes or {}, duration_s=duration_s, seed=1, sensors=sensors)
    with tempfile.TemporaryDirectory() as folder:
        session = open_flight(spec, Path(folder), Path(folder) / "flight.mcap")
        timed = _Timed(session, sensors)
        watch(session, [timed], {}, None)
        session.run()
    return timed


def _late_pct(duration_s: float, speed: float) -> float:
    """Share of the ticks that begin more than a period late [%]: service, detection, simulation and rendering in one
    process."""
    spec = FlightSpec(name="late", changes={}, duration_s=duration_s, seed=1, sensors="camera", speed=speed)
    with tempfile.TemporaryDirectory() as folder:
        session = open_flight(spec, Path(folder), Path(folder) / "flight.mcap")
        session.run()
        counters = session.runtime.counters
    return 100.0 * counters.overruns / max(counters.ticks, 1)
