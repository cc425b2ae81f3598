"""Flies one fault scenario through the whole service: reaction time and outcome.

Reaction time counts from the beginning of the fault. The closest approach is taken from the ground truth, from the
vehicle's centre to the nearest boundary of the fence, from then on.
"""

import math
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.campaign.fault_cases import FaultCase
from autopilot.command.failsafe_table import Effect
from autopilot.control.controller import MotionController
from autopilot.control.protocol import ControllerContext
from autopilot.core.frames import FloatArray
from autopilot.core.messages import ControlOutput, NavState, Outputs
from autopilot.core.samples import Sample
from autopilot.estimator.engine import AidedEstimator
from autopilot.estimator.kalman import KalmanCore
from autopilot.estimator.protocol import EstimatorContext
from autopilot.mavlink.api import FlightMode
from autopilot.mission.clearance import Clearance
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl
from autopilot.sitl.scenario import load_scenario, plan_path, scenario_path
from autopilot.sitl.toml_text import toml_text

SCENARIOS = ("paper-tank", "harbour")
"""Each is flown with its plan."""

CHECK_TICKS = 10
STILL_M_S = 0.08
AT_SURFACE_M = 0.12
"""Below where it floats."""


class Breaking(MotionController):
    """Flies as shipped until ``from_s``.

    A flight names them as plug-ins (``package:Class``), and sets :attr:`Breaking.from_s` before."""

    from_s = math.inf
    """Of the service's clock; of all instances."""

    def __init__(self, given: ControllerContext) -> None:
        super().__init__(given.vehicle, currents=given.currents, desks=given.desks, trajectories=given.trajectories)

    def step(self, t_us: int, *given: Any, **named: Any) -> ControlOutput:
        if t_us >= Breaking.from_s * 1e6:
            self._break()
        return super().step(t_us, *given, **named)

    def _break(self) -> None:
        raise NotImplementedError


class Unsolved(Breaking):
    """From then on no program of the optimiser is solved: the whole chain behind it has to fly."""

    def _break(self) -> None:
        solver_step = self.nmpc._step

        def nothing() -> None:
            solver_step.figures[:] = math.nan

        setattr(solver_step, "evaluate", nothing)  # noqa: B010 - a method of another's object


class Raising(Breaking):
    raised = False

    def _break(self) -> None:
        if not self.raised:
            self.raised = True
            raise RuntimeError("controller broken by the campaign")


class DisplacedEstimator(AidedEstimator):
    """The shipped filter, whose depth is off for some seconds."""

    LASTS_S = 4.0
    OFF_M = 0.25
    """Down: nothing to run into."""

    def __init__(self, given: EstimatorContext) -> None:
        core = KalmanCore(current_3d=given.options.current_3d)
        super().__init__(core, given.vehicle, given.markers, given.floor_depth_m, given.options)

    def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray) -> NavState | None:
        nav = super().step(t_us, samples, thrust_n)
        since_s = 1e-6 * t_us - Breaking.from_s
        if nav is None or not 0.0 <= since_s < self.LASTS_S:
            return nav
        return replace(nav, pos_ned_m=nav.pos_ned_m + np.array([0.0, 0.0, self.OFF_M]))


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultResult:
    rule: str
    scenario: str
    seed: int
    at_s: float
    effect: Effect
    armed: bool
    """Whether it was flying when the fault began."""
    raised_s: float | None
    """From the fault to the failsafe, None = never raised."""
    acted_s: float | None
    """To another mode or disarming."""
    end: str
    """Mode, or "disarmed"; where."""
    kept: bool
    """In time, and the end that the effect promises."""
    closest_m: float
    contacts: int
    texts: tuple[str, ...]


class _FlightWatch:
    """Evaluates every tick of a flight."""

    def __init__(self, session: SitlSession, case: FaultCase, at_s: float) -> None:
        self._session = session
        self._case = case
        self._at_us = round(at_s * 1e6)
        self._ticks = 0
        self._mode = FlightMode.HOLD
        self._begun = False
        self.armed_then = False
        self.raised_us: int | None = None
        self.acted_us: int | None = None
        self.dropped = self.handed_back = False
        self.closest_m = math.inf
        self.texts: dict[str, None] = {}
        self.last: Outputs | None = None

    def tick(self, outputs: Outputs) -> None:
        t_us, case, self.last = outputs.t_us, self._case, outputs
        commander = self._session.parts.commander
        if t_us < self._at_us:
            self._mode, self.armed_then = commander.mode, outputs.mode.armed
            return
        if not self._begun:
            self._begun = True
            for name, value in case.set_then.items():
                self._session.parts.params.set(name, value)
        if self.raised_us is None and outputs.mode.failsafes >> case.rule & 1:
            self.raised_us = t_us
        if self.acted_us is None and (commander.mode is not self._mode or not outputs.mode.armed):
            self.acted_us = t_us
        self.dropped |= outputs.drop_weight
        self.handed_back |= outputs.hand_back
        self.texts.update({event.text: None for event in outputs.events if event.severity <= 4})
        self._ticks += 1
        if self._ticks % CHECK_TICKS == 1:
            here = self._session.device.truth.pos_ned_m
            boundaries = Clearance.of(commander.fence)
            self.closest_m = min(self.closest_m, float(boundaries.clearance_m(here[None, :2])[0]))


def fly_fault_case(case: FaultCase, scenario: str, seed: int, at_s: float) -> FaultResult:
    """One flight in lockstep, without sockets or a log."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scenario.toml"
        path.write_text(toml_text(_tables(case, scenario, at_s)), encoding="utf-8")
        plan = plan_path(scenario, load_scenario(scenario))
        end_s = at_s + case.within_s + case.settle_s
        given = {"scenario": str(path), "sensors": "pose", "duration": end_s, "plan": str(plan)}
        parts = {"controller": case.controller, "estimator": case.estimator}
        settings = flight_settings(folder, {**given, **parts, "seed": seed, "start": True})
        watches: list[_FlightWatch] = []
        Breaking.from_s = at_s
        params = {"MPC_COST": 0.0, **case.params}
        session = open_sitl(settings, params, log=False, on_tick=lambda outputs: watches[0].tick(outputs))
        session.parts.guard.raises = False
        watches.append(_FlightWatch(session, case, at_s))
        session.run()
    return _result(case, scenario, seed, at_s, session, watches[0])


def _tables(case: FaultCase, scenario: str, at_s: float) -> dict[str, Any]:
    path = scenario_path(scenario)
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    tables.pop("spread", None)
    tables["scenario"].pop("plan", None)
    faults: list[Mapping[str, Any]] = list(tables.get("fault", ()))
    faults += [{**fault, "at_s": max(0.0, at_s + fault["at_s"])} for fault in case.faults]
    return {**tables, "fault": faults} if faults else tables


def _result(
    case: FaultCase, scenario: str, seed: int, at_s: float, session: SitlSession, watch: _FlightWatch
) -> FaultResult:
    truth, commander = session.device.truth, session.parts.commander
    raised_s = None if watch.raised_us is None else 1e-6 * watch.raised_us - at_s
    acted_s = None if watch.acted_us is None else 1e-6 * watch.acted_us - at_s
    depth_m = float(truth.pos_ned_m[2])
    mode = "disarmed" if not commander.armed else commander.mode.name
    return FaultResult(
        rule=case.rule.name,
        scenario=scenario,
        seed=seed,
        at_s=round(at_s, 2),
        effect=case.effect,
        armed=watch.armed_then,
        raised_s=None if raised_s is None else round(raised_s, 2),
        acted_s=None if acted_s is None else round(acted_s, 2),
        end=f"{mode} at {depth_m:.2f} m",
        kept=raised_s is not None and raised_s <= case.within_s and _ends_well(case.effect, session, watch),
        closest_m=round(watch.closest_m, 3),
        contacts=int(truth.contact_count),
        texts=tuple(watch.texts),
    )


def _ends_well(effect: Effect, session: SitlSession, watch: _FlightWatch) -> bool:
    """Whether the vehicle is where its effect promises."""
    truth, commander, last = session.device.truth, session.parts.commander, watch.last
    assert last is not None
    top_m = max(session.parts.params["DEPTH_MIN"], session.vehicle.hull_half_height_m)
    up = float(truth.pos_ned_m[2]) <= top_m + AT_SURFACE_M
    still = float(np.linalg.norm(truth.vel_frd_m_s)) < STILL_M_S
    idle = not np.any(last.command.thrust_n)
    return {
        "off": True,
        "warn": commander.armed,
        "hold": commander.armed and still and commander.mode is FlightMode.HOLD,
        "return": commander.armed and commander.mode is FlightMode.RETURN,
        "surface": commander.mode is FlightMode.SURFACE or (not commander.armed and up),
        "drop": watch.dropped and (commander.mode is FlightMode.SURFACE or not commander.armed),
        "hand back": watch.handed_back and not commander.armed and idle,
        "disarm": not commander.armed and idle,
    }[effect]
