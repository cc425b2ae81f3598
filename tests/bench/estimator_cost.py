"""What the estimator costs, and whether the loop keeps its time while the camera runs."""

import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState
from autopilot.core.samples import MarkerSighting, Sample
from autopilot.estimator.create import create_estimator
from autopilot.run.sitl_session import SitlSession
from autopilot.sitl.floor import given_markers
from tests.bench.estimator_figures import EstimatorBenchRow, Limit, whole
from tests.bench.estimator_flights import FlightSpec, open_flight, watch

ESTIMATOR_BAR_PCT, VISION_BAR_PCT, LATE_BAR_PCT = 5.0, 30.0, 1.0
"""Shares of one core as measured; ticks more than one period (10 ms) late: 1 % is the 99 % point."""
COST_S, SHORT_COST_S = 12.0, 6.0


HAND_LAID = {"markers": {"laid": {"sheet_m": 0.6, "sigma_m": 0.0017, "sigma_rad": 0.006, "seed": 1}}}
"""The floor of the scenario ``hand-laid``: where sheets lie are states."""


class _Timed:
    """The estimator as it is flown, with the other one in its shadow; and what it and the detector spend."""

    def __init__(self, session: SitlSession, sensors: str) -> None:
        scenario = session.world.scenario
        markers = given_markers(scenario) if sensors == "camera" else None
        floor_m = None if scenario.tank is None else scenario.tank.depth_m
        self._estimator = create_estimator("ekf", session.vehicle, markers, floor_depth_m=floor_m, shadow=True)
        self.nav: NavState | None = None
        self.ticks_s: list[float] = []
        """CPU time of the estimator in each tick."""
        self.vision_s = self.simulated_s = 0.0

    def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray, *, keep: bool) -> None:
        begin_s = time.thread_time()
        self.nav = self._estimator.step(t_us, samples, thrust_n)
        self._estimator.take_aids()
        self.ticks_s.append(time.thread_time() - begin_s)
        self.vision_s += 1e-6 * sum(sample.decode_us for sample in samples if isinstance(sample, MarkerSighting))
        self.simulated_s = 1e-6 * t_us

    @property
    def estimator_s(self) -> float:
        return sum(self.ticks_s)


def bench_cost(duration_s: float = COST_S) -> list[EstimatorBenchRow]:
    """Shares of a core with poses and with pictures, and late ticks with pictures in real time: raw figures, which the
    load of the machine is part of."""
    poses, pictures = _flown("pose", duration_s), _flown("camera", duration_s)
    sheets = _flown("camera", duration_s, HAND_LAID)
    both_s = pictures.estimator_s + pictures.vision_s
    named = {"poses": poses, "pictures": pictures, "pictures of sheets": sheets}
    shares = {f"estimator, {name}": (flown, flown.estimator_s, ESTIMATOR_BAR_PCT) for name, flown in named.items()}
    shares["estimator and vision at 30 Hz"] = pictures, both_s, VISION_BAR_PCT
    return [
        *(
            _row(f"cost: {name}, share of a core", 100.0 * cpu_s / flown.simulated_s, bar)
            for name, (flown, cpu_s, bar) in shares.items()
        ),
        _row(
            "cost: tick of the estimator, pictures of sheets, p99",
            1e3 * float(np.quantile(sheets.ticks_s, 0.99)),
            None,
            "ms",
        ),
        _row("cost: tick of the estimator, pictures of sheets, max", 1e3 * max(sheets.ticks_s), None, "ms"),
        _row("cost: ticks more than 10 ms late with camera, real time", _late_pct(duration_s), LATE_BAR_PCT),
    ]


def _row(figure: str, value: float, bar: float | None, unit: str = "%") -> EstimatorBenchRow:
    return whole(figure, value, unit, 1, None if bar is None else Limit(high=bar))


def _flown(sensors: str, duration_s: float, changes: Mapping[str, Any] | None = None) -> _Timed:
    """One flight of the paper's tour as fast as it goes."""
    spec = FlightSpec(name="cost", changes=changes or {}, duration_s=duration_s, seed=1, sensors=sensors)
    with tempfile.TemporaryDirectory() as folder:
        session = open_flight(spec, Path(folder), Path(folder) / "flight.mcap")
        timed = _Timed(session, sensors)
        watch(session, [timed], {}, None)
        session.run()
    return timed


def _late_pct(duration_s: float) -> float:
    """Share of the ticks that begin more than a period late [%]: service, detection, simulation and rendering in one
    process."""
    spec = FlightSpec(name="late", changes={}, duration_s=duration_s, seed=1, sensors="camera", speed=1.0)
    with tempfile.TemporaryDirectory() as folder:
        session = open_flight(spec, Path(folder), Path(folder) / "flight.mcap")
        session.run()
        counters = session.runtime.counters
    return 100.0 * counters.overruns / max(counters.ticks, 1)
