"""Flights for the estimator's benchmark: varied scenarios, flown by the real service, watched by estimators beside it.

The estimators beside the flown one get the same samples and thrusts. One of them is the same filter, so it says the
same bit for bit, but shows its whole covariance; others have something switched off or get altered fixes.
"""

import tempfile
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.marker_files import marker_file_text
from autopilot.core.messages import AidStatus, Inputs, NavState, Outputs
from autopilot.core.samples import PoseSample, PowerSample, Sample
from autopilot.estimator.engine import AidedEstimator
from autopilot.estimator.kalman import KalmanCore
from autopilot.estimator.measurement import CHI2_999
from autopilot.estimator.options import DEFAULT_OPTIONS, EstimatorOptions
from autopilot.estimator.states import FilterState
from autopilot.log.analysis import VehicleTrack, load_flight, wrap
from autopilot.log.reader import open_log
from autopilot.mission.paper import paper_plan
from autopilot.mission.plan_files import write_plan
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl
from autopilot.sitl.floor import given_markers
from autopilot.sitl.scenario import load_scenario, scenario_path
from autopilot.sitl.toml_text import toml_text
from tests.bench.calibrations import exact_map, exact_text
from tests.bench.estimator_figures import Watched

BASE = "paper-tank"
"""The scenario that is varied."""
RECORD_EVERY_TICKS = 5
"""20 Hz."""
SHIFT_M = 0.5
SHIFTED_S = (12.0, 20.0)
"""When fixes are shifted north for the estimator ``shifted``."""

SAME, NAIVE, NO_MODEL, SHIFTED = "same", "naive", "no-model", "shifted"
OPTIONS = {
    SAME: DEFAULT_OPTIONS,
    NAIVE: EstimatorOptions(compensate_latency=False),
    NO_MODEL: EstimatorOptions(model_aid=False),
    SHIFTED: DEFAULT_OPTIONS,
}
"""Estimators that can watch a flight."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightSpec:
    """One flight of the paper's tour."""

    name: str
    changes: Mapping[str, Any]
    """Tables laid over the scenario's."""
    duration_s: float
    seed: int
    sensors: str = "pose"
    watchers: tuple[str, ...] = (SAME,)
    speed: float = 0.0
    """Simulated over real time, 0 = as fast as it goes."""


def overlaid(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """``base`` with ``changes``: tables are merged, except one that changes its ``kind``; anything else replaced."""
    result = dict(base)
    for key, value in changes.items():
        old = result.get(key)
        merge = isinstance(value, Mapping) and isinstance(old, Mapping) and "kind" not in value
        result[key] = overlaid(old, value) if merge and isinstance(old, Mapping) else value
    return result


class _OpenCore(KalmanCore):
    """The filter, keeping the covariance that its last report was made of."""

    def __init__(self) -> None:
        super().__init__()
        self.covariance: FloatArray = np.zeros((7, 7))
        """Of position, yaw and velocity: the first seven states."""

    def variance(self, state: FilterState, cos_yaw: float, sin_yaw: float) -> list[float]:
        self.covariance = state.p[:7, :7].copy()
        return super().variance(state, cos_yaw, sin_yaw)


class Watching(Protocol):
    nav: NavState | None
    """What it says now."""

    def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray, *, keep: bool) -> None:
        """One tick; ``keep`` = record the state."""
        ...


class _Watcher:
    """One estimator beside the flown one, and what it said."""

    def __init__(self, name: str, session: SitlSession, sensors: str) -> None:
        scenario = session.world.scenario
        self._core = _OpenCore()
        markers = given_markers(scenario) if sensors == "camera" else None
        floor_depth_m = None if scenario.tank is None else scenario.tank.depth_m
        self._engine = AidedEstimator(self._core, session.vehicle, markers, floor_depth_m, OPTIONS[name])
        self._alter: Callable[[Sample], Sample] = _shifted if name == SHIFTED else lambda sample: sample
        self.nav: NavState | None = None
        """What it says now."""
        self._states: list[tuple[NavState, FloatArray]] = []
        self._fixes: list[AidStatus] = []

    def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray, *, keep: bool) -> None:
        """One tick; ``keep`` = record the state."""
        self.nav = self._engine.step(t_us, [self._alter(sample) for sample in samples], thrust_n)
        self._fixes += [aid for aid in self._engine.take_aids() if aid.sensor == "markers"]
        if keep and self.nav is not None:
            self._states.append((self.nav, self._core.covariance))

    def watched(self, truth: VehicleTrack, poses: Mapping[int, FloatArray]) -> Watched:
        """Compared with the truth; ``poses`` are the sensor's positions by time [us]."""
        nav = [state for state, _ in self._states]
        t_us = np.array([state.t_us for state in nav])
        k = np.searchsorted(truth.t_s, t_us * 1e-6 - 1e-6)
        yaw = wrap(np.array([state.rpy_rad[2] for state in nav]) - truth.rpy_rad[k, 2])
        velocity = np.array([_vel_ned(state.rpy_rad, state.vel_frd_m_s) for state in nav])
        true_velocity = np.array([_vel_ned(truth.rpy_rad[i], truth.vel_frd_m_s[i]) for i in k])
        position = np.array([state.pos_ned_m for state in nav]) - truth.pos_ned_m[k]
        current = np.array([state.current_ned_m_s for state in nav]) - truth.current_ned_m_s[k]
        fixes = self._fixes
        sigma = np.sqrt([aid.innovation_var for aid in fixes])
        return Watched(
            t_s=t_us * 1e-6,
            error=np.column_stack((position, yaw, velocity - true_velocity)),
            covariance=np.array([covariance for _, covariance in self._states]),
            current_error=current[:, :2],
            fix_t_s=np.array([aid.t_us for aid in fixes]) * 1e-6,
            fix_used=np.array([aid.fused for aid in fixes]),
            fix_distance=np.array([aid.test_ratio for aid in fixes]) * CHI2_999[4],
            fix_residual=np.array([aid.innovation for aid in fixes]) / sigma,
            fix_off_m=np.array([_off_m(truth, aid.t_us, poses.get(aid.t_us)) for aid in fixes]),
        )


def fly(spec: FlightSpec, on_tick: Callable[[Outputs, NavState | None], None] | None = None) -> dict[str, Watched]:
    """Fly it and return what each of its estimators made of it.

    ``on_tick`` gets every tick's outputs beside what the estimator :data:`SAME` says."""
    poses: dict[int, FloatArray] = {}
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "flight.mcap"
        session = open_flight(spec, Path(folder), log)
        watchers = {name: _Watcher(name, session, spec.sensors) for name in spec.watchers}
        watch(session, list(watchers.values()), poses, on_tick)
        session.run()
        truth = load_flight(open_log(log)).truth
    assert truth is not None, "simulated flights have a truth"
    return {name: watcher.watched(truth, poses) for name, watcher in watchers.items()}


def open_flight(spec: FlightSpec, folder: Path, log: Path) -> SitlSession:
    """The paper's tour in the varied scenario, with a scripted operator and no sockets. The vehicle file leaves nothing
    open, and neither does the map: the simulated camera has no errors."""
    changes = dict(spec.changes)
    scenario, plan, vehicle, floor = (
        folder / name for name in ("scenario.toml", "tour.plan", "exact.toml", "floor.toml")
    )
    vehicle.write_text(exact_text(), encoding="utf-8")
    planned = given_markers(load_scenario(BASE))
    assert planned is not None
    floor.write_text(marker_file_text(exact_map(planned)), encoding="utf-8")
    changes["markers"] = {"file": str(floor), **changes.get("markers", {})}
    tables = overlaid(tomllib.loads(scenario_path(BASE).read_text(encoding="utf-8")), changes)
    scenario.write_text(toml_text(tables), encoding="utf-8")
    write_plan(plan, paper_plan())
    given = {"scenario": str(scenario), "speed": spec.speed, "sensors": spec.sensors, "duration": spec.duration_s}
    given["vehicle"] = str(vehicle)
    settings = flight_settings(folder, {**given, "seed": spec.seed, "plan": str(plan), "start": True, "log": str(log)})
    return open_sitl(settings, {})


def watch(
    session: SitlSession,
    watchers: Sequence[Watching],
    poses: dict[int, FloatArray],
    on_tick: Callable[[Outputs, NavState | None], None] | None,
) -> None:
    """Let the watchers see every tick: the samples of this one and the thrust that the last one's pulses give."""
    step, allocation = session.service.step, session.parts.actuation.allocation
    count = len(session.vehicle.thrusters)
    thrust_n, supply_v, ticks = np.zeros(count), None, 0

    def watched(inputs: Inputs) -> Outputs:
        nonlocal thrust_n, supply_v, ticks
        ticks += 1
        for sample in inputs.samples:
            if isinstance(sample, PowerSample):
                supply_v = sample.voltage_v
            elif isinstance(sample, PoseSample):
                poses[sample.t_us] = sample.pos_ned_m
        for watcher in watchers:
            watcher.step(inputs.t_us, inputs.samples, thrust_n, keep=ticks % RECORD_EVERY_TICKS == 0)
        outputs = step(inputs)
        pulses_us = outputs.command.pwm_us[:count]
        thrust_n = allocation.thrusts_n(pulses_us, supply_v) if outputs.mode.armed else np.zeros(count)
        if on_tick is not None:
            on_tick(outputs, watchers[0].nav)
        return outputs

    session.runtime.wrap_step(watched)


def _shifted(sample: Sample) -> Sample:
    """A fix that lies elsewhere for a while, as after being carried away."""
    if isinstance(sample, PoseSample) and SHIFTED_S[0] <= 1e-6 * sample.t_us < SHIFTED_S[1]:
        return replace(sample, pos_ned_m=sample.pos_ned_m + np.array([SHIFT_M, 0.0, 0.0]))
    return sample


def _vel_ned(rpy_rad: FloatArray, vel_frd_m_s: FloatArray) -> FloatArray:
    result: FloatArray = r_ned_from_frd(rpy_rad) @ vel_frd_m_s
    return result


def _off_m(truth: VehicleTrack, t_us: int, pos_ned_m: FloatArray | None) -> float:
    """Distance of a fix from the truth at its time, NaN if it is not known."""
    if pos_ned_m is None:
        return float("nan")
    then = [np.interp(1e-6 * t_us, truth.t_s, truth.pos_ned_m[:, axis]) for axis in range(3)]
    return float(np.linalg.norm(pos_ned_m - np.array(then)))
