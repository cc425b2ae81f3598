"""Flights with sensors that go wrong without saying so: how far the estimate is off, what it claims, what it says.

A fault begins in the middle of a flight of the whole service, alone or just before the markers go out of view. What is
held against a flight: the true error stays inside 3 sigma, nothing is touched, and an estimate that is far off does not
go on being called good.
"""

import math
import tempfile
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from autopilot.core.frames import wrap_pi
from autopilot.core.messages import AidStatus, Failsafe, NavHealth, Outputs, Severity
from autopilot.core.samples import Sample
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl
from autopilot.sitl.scenario import scenario_path
from autopilot.sitl.toml_text import toml_text
from tests.bench.estimator_flights import overlaid

SIGMAS = 3.0
FAR_M = 0.10
FAR_RAD = math.radians(5.0)
"""An error beyond 3 sigma that is also larger than this must not be called good for long: half of what the fence's
margin leaves."""
DEADLINE_S = 1.0
"""So long it may take until health says so."""
LEAD_S = 0.5
"""A fault that is flown with a gap begins so long before it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultFlight:
    faults: tuple[Mapping[str, Any], ...] = ()
    """``[[fault]]`` tables without ``at_s``."""
    gap_s: float = 0.0
    """Length of the gap in the markers, 0 = none."""
    at_s: float = 14.0
    """When the faults begin."""
    lasts_s: float | None = None
    """How long they last, None = to the end."""
    seed: int = 1
    sensors: str = "pose"
    scenario: str = "paper-tank"
    changes: Mapping[str, Any] | None = None
    duration_s: float = 24.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultResult:
    """What a flight showed, from the beginning of the fault on."""

    inside: float
    """Share of the ticks with all of north, east, down and heading inside 3 sigma."""
    worst_m: float
    """Largest true error of the position."""
    worst_claim_m: float
    """3 sigma (of the worst axis) at that moment."""
    worst_yaw_rad: float
    unflagged_s: float
    """Longest time in a row in which the estimate was far off, outside 3 sigma, and called good."""
    outside_s: float
    """The same outside 3 sigma by however little."""
    back_s: float | None
    """From the end of the faults to the first fix that is used, None = none is, or they do not end."""
    contacts: int
    resets: int
    good: float
    """Share of the ticks called good."""
    thrusters_blamed: bool
    """A sound thruster was declared weak, or commands late."""
    texts: tuple[str, ...]
    """What the operator was told, notices left out,"""
    said_s: tuple[float, ...]
    """and how long after the beginning of the fault."""

    @property
    def kept(self) -> bool:
        honest = self.inside >= 0.95 and self.unflagged_s <= DEADLINE_S
        return honest and self.contacts == 0 and not self.thrusters_blamed


class Longest:
    """The longest time in a row for which something holds."""

    def __init__(self) -> None:
        self.most_s = 0.0
        self._since_s: float | None = None

    def update(self, t_s: float, *, holds: bool) -> None:
        self._since_s = (t_s if self._since_s is None else self._since_s) if holds else None
        if self._since_s is not None:
            self.most_s = max(self.most_s, t_s - self._since_s)


def _seen_after(aid: AidStatus, t_s: float) -> bool:
    """Whether this is a fix of markers, seen after that time, that is used."""
    return aid.sensor == "markers" and aid.fused and 1e-6 * aid.t_us >= t_s


class _Watch:
    def __init__(self, session: SitlSession, from_s: float, until_s: float = math.inf) -> None:
        self._truth = session.device
        self._from_s = from_s
        self._until_s = until_s
        self._back_s: float | None = None
        self._outside = Longest()
        self._unflagged = Longest()
        self._inside: list[bool] = []
        self._good: list[bool] = []
        self._worst = (0.0, 0.0)
        self._worst_yaw = 0.0
        self._blamed = False
        self._contacts = 0
        self._resets: list[int] = []
        self._texts: dict[str, float] = {}

    def tick(self, outputs: Outputs) -> None:
        t_s, nav, truth = 1e-6 * outputs.t_us, outputs.nav, self._truth.truth
        self._contacts = truth.contact_count
        if self._back_s is None and any(_seen_after(aid, self._until_s) for aid in outputs.aids):
            self._back_s = t_s - self._until_s
        if t_s < self._from_s:
            return
        for event in outputs.events:
            if event.severity <= Severity.WARNING:
                self._texts.setdefault(event.text, t_s - self._from_s)
        if nav is None or not outputs.mode.armed:
            return
        error = np.abs([*(nav.pos_ned_m - truth.pos_ned_m), wrap_pi(float(nav.rpy_rad[2] - truth.rpy_rad[2]))])
        bound = SIGMAS * np.sqrt(nav.variance[[0, 1, 2, 5]])
        inside = bool((error <= bound).all())
        self._inside.append(inside)
        self._good.append(nav.health is NavHealth.GOOD)
        self._resets.append(nav.reset_count)
        off_m = float(np.linalg.norm(error[:3]))
        if off_m > self._worst[0]:
            self._worst = (off_m, float(bound[:3].max()))
        self._worst_yaw = max(self._worst_yaw, float(error[3]))
        claimed = not inside and nav.health is NavHealth.GOOD
        self._outside.update(t_s, holds=claimed)
        self._unflagged.update(t_s, holds=claimed and (off_m > FAR_M or error[3] > FAR_RAD))
        if outputs.thrusters is not None:
            self._blamed = self._blamed or bool((outputs.thrusters.effectiveness < 1.0).any())
        self._blamed = self._blamed or bool(outputs.mode.failsafes >> Failsafe.LATENCY & 1)

    def result(self) -> FaultResult:
        return FaultResult(
            inside=float(np.mean(self._inside)) if self._inside else math.nan,
            worst_m=self._worst[0],
            worst_claim_m=self._worst[1],
            worst_yaw_rad=self._worst_yaw,
            unflagged_s=self._unflagged.most_s,
            outside_s=self._outside.most_s,
            back_s=self._back_s,
            contacts=self._contacts,
            resets=self._resets[-1] - self._resets[0] if self._resets else 0,
            good=float(np.mean(self._good)) if self._good else math.nan,
            thrusters_blamed=self._blamed,
            texts=tuple(self._texts),
            said_s=tuple(self._texts.values()),
        )


PLAIN_WAY = {"MPC_COST": 0.0}
"""The estimate is what is judged: all flights go the same way, whatever the water is believed to be."""


Change: TypeAlias = Callable[[int, Sequence[Sample]], Sequence[Sample]]
"""Samples of a tick as a sensor sends them that is broken, from those of a sound one."""


def fly_fault(flight: FaultFlight, change: Change | None = None) -> FaultResult:
    """Fly it through the real service in lockstep, without sockets or a log."""
    tables = flight_tables(flight)
    with tempfile.TemporaryDirectory() as folder:
        scenario = Path(folder) / "scenario.toml"
        scenario.write_text(toml_text(tables), encoding="utf-8")
        given = {"scenario": str(scenario), "speed": 0.0, "sensors": flight.sensors, "duration": flight.duration_s}
        settings = flight_settings(folder, {**given, "seed": flight.seed, "start": True})
        watches: list[_Watch] = []
        session = open_sitl(settings, PLAIN_WAY, log=False, on_tick=lambda outputs: watches[0].tick(outputs))
        until_s = math.inf if flight.lasts_s is None else flight.at_s + flight.lasts_s
        watches.append(_Watch(session, flight.at_s, until_s))
        if change is not None:
            step = session.service.step
            session.runtime.wrap_step(
                lambda inputs: step(replace(inputs, samples=tuple(change(inputs.t_us, inputs.samples))))
            )
        session.run()
    return watches[0].result()


def flight_tables(flight: FaultFlight) -> dict[str, Any]:
    """The scenario with the faults and the gap."""
    path = scenario_path(flight.scenario)
    tables = overlaid(tomllib.loads(path.read_text(encoding="utf-8")), flight.changes or {})
    tables.pop("spread", None)
    plan = tables["scenario"].get("plan")
    if plan is not None:
        tables["scenario"] = {**tables["scenario"], "plan": str((path.parent / plan).resolve())}
    when = {"at_s": flight.at_s} if flight.lasts_s is None else {"at_s": flight.at_s, "duration_s": flight.lasts_s}
    faults: list[Mapping[str, Any]] = [*tables.get("fault", ()), *({**fault, **when} for fault in flight.faults)]
    if flight.gap_s:
        at_s = flight.at_s + LEAD_S
        faults.append({"kind": "camera_blackout", "at_s": at_s, "duration_s": flight.gap_s})
    return {**tables, "fault": faults} if faults else tables
