"""Control does only what fits into a tick: fences, goals and planners that once stopped the loop or ended it."""

import threading
from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import numpy as np

from autopilot.control.energy.search import EnergyPlanner
from autopilot.control.robust import terminal
from autopilot.control.way.planner import Planner
from autopilot.core.geodesy import geodetic_from_ned
from autopilot.core.messages import Outputs, Severity
from autopilot.core.plan import PlanKind
from autopilot.mission.paper import paper_plan
from tests.bench.faults.finding import Finding, Measured
from tests.bench.faults.pilot import KEPT_FREE, PilotedFlight, crowded_plan, piloted

P99_MS, MAX_MS = 10.0, 50.0
"""What a tick may cost of CPU time."""

GO_TOS = 20
"""One every 0.1 s, far less than a plan by energy takes."""


def _crowded_flight(cost: int, *, round_ones: bool = False) -> Measured:
    """On its way in open water; then comes a fence that bars the way, then a go-to behind another obstacle."""
    with piloted("open-water", {"MPC_COST": cost}) as flight:
        flight.upload(PlanKind.MISSION, crowded_plan(flight.origin(), 0, 2, 1).mission)
        flight.start()
        flight.fly(3.0)
        since = len(flight.control_s)
        fence = crowded_plan(flight.origin(), 50, 2, 1, round_ones=round_ones).fence
        flight.upload(PlanKind.FENCE, fence)
        flight.fly(2.0)
        go_to(flight, (*KEPT_FREE[2], 0.6))
        flight.fly(3.0)
        ms = 1e3 * np.array(flight.control_s[since:])
        kept = float(np.percentile(ms, 99)) <= P99_MS and float(ms.max()) <= MAX_MS
        return Measured(text=f"control {flight.figures(flight.control_s, since)} of CPU per tick", kept=kept)


def _on_the_loop(cost: int) -> Measured:
    """Which slow work the loop's own thread does in the paper's tank."""
    here, seen = threading.get_ident(), {"route": [0, 0], "trajectory": [0, 0], "certificate": [0, 0]}

    def counted(sound: Callable[..., Any], kind: str) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            seen[kind][threading.get_ident() == here] += 1
            return sound(*args, **kwargs)

        return call

    with (
        patch.object(Planner, "path", counted(Planner.path, "route")),
        patch.object(EnergyPlanner, "plan", counted(EnergyPlanner.plan, "trajectory")),
        patch("autopilot.control.robust.regions.certify", counted(terminal.certify, "certificate")),
        piloted("paper-tank", {"MPC_COST": cost}) as flight,
    ):
        on_its_way(flight, 4.0)
    text = ", ".join(f"{kind} {beside} beside, {on_it} on the loop" for kind, (beside, on_it) in seen.items())
    done = sum(beside for beside, _ in seen.values())
    return Measured(text=text, kept=done > 0 and not any(on_it for _, on_it in seen.values()))


def _many_go_tos() -> Measured:
    """Goals that come faster than plans: how many are planned to the end."""
    sound, done = EnergyPlanner.plan, []

    def plan(self: EnergyPlanner, request: Any, *args: Any) -> Any:
        made = sound(self, request, *args)
        done.append(request.goal)
        return made

    with patch.object(EnergyPlanner, "plan", plan), piloted("paper-tank", {"MPC_COST": 1.0}) as flight:
        on_its_way(flight, 1.0)
        done.clear()
        for i in range(GO_TOS):
            go_to(flight, (1.2 + 0.02 * i, 0.9, 0.4))
            flight.fly(0.1)
        flight.fly(0.3)
        goal = None if flight.outputs is None else flight.outputs.goal
        last = goal is not None and len(done) > 0 and bool(np.allclose(done[-1].pos_ned_m, goal.pos_ned_m))
    text = f"{len(done)} of {GO_TOS} planned to the end{', the last among them' if last else ''}"
    return Measured(text=text, kept=len(done) <= 2 and last)


def _failing_planner() -> Measured:
    """Every plan by energy ends with an exception."""

    def plan(*_: Any, **__: Any) -> Any:
        raise RuntimeError("planner broken on purpose")

    with patch.object(EnergyPlanner, "plan", plan), piloted("paper-tank", {"MPC_COST": 1.0}) as flight:
        on_its_way(flight, 1.0)
        begin = flight.session.device.truth.pos_ned_m.copy()
        flight.fly(6.0)
        moved = float(np.linalg.norm(flight.session.device.truth.pos_ned_m - begin))
        told = [text for text in flight.pilot.texts() if text.startswith("No energy plan")]
        armed = flight.session.parts.commander.armed
    text = f"{'armed' if armed else 'disarmed'}, {moved:.1f} m flown by the plain route in 6 s, told {len(told)} time"
    return Measured(text=text, kept=armed and moved > 0.5 and len(told) == 1)


def _certificate_texts() -> Measured:
    """What the operator reads of certificates in the paper's tank."""
    logged: list[str] = []

    def note(outputs: Outputs) -> None:
        logged.extend(event.text for event in outputs.events if event.severity == Severity.DEBUG)

    with piloted("paper-tank") as flight:
        flight.on_tick = note
        on_its_way(flight, 4.0)
        told = [text for text in flight.pilot.texts() if "alpha" in text or "violate" in text]
    certificates = sum("alpha" in text for text in logged)
    return Measured(text=f"{len(told)} told, {certificates} in the log", kept=not told and certificates > 0)


def on_its_way(flight: PilotedFlight, seconds: float) -> None:
    """Upload the paper's plan, start it and fly for a while."""
    plan = paper_plan(1)
    flight.upload(PlanKind.FENCE, plan.fence)
    flight.upload(PlanKind.MISSION, plan.mission)
    flight.start()
    flight.fly(seconds)


def go_to(flight: PilotedFlight, place_ned_m: tuple[float, float, float]) -> None:
    """Send a go-to in local coordinates."""
    lat, lon, _ = geodetic_from_ned(flight.session.parts.plans.origin, np.array(place_ned_m))
    flight.pilot.go_to(lat, lon, place_ned_m[2])


FINDINGS = (
    Finding(
        part="loop",
        name="50 octagons uploaded in flight, then a go-to behind one; plain route",
        before="the route is searched in the tick: 103 ms (378 ms the first time) of CPU",
        promise=f"control p99 <= {P99_MS:g} ms, none above {MAX_MS:g} ms of CPU per tick",
        measure=lambda: _crowded_flight(0),
    ),
    Finding(
        part="loop",
        name="50 cylinders uploaded in flight, then a go-to behind one; plain route",
        before="the route is searched in the tick: 99 ms of CPU",
        promise=f"control p99 <= {P99_MS:g} ms, none above {MAX_MS:g} ms of CPU per tick",
        measure=lambda: _crowded_flight(0, round_ones=True),
    ),
    Finding(
        part="loop",
        name="50 octagons uploaded in flight, then a go-to behind one; least energy",
        before="the tick waits for the plan, 2 to 5 s without a heartbeat at speed 0",
        promise=f"control p99 <= {P99_MS:g} ms, none above {MAX_MS:g} ms of CPU per tick",
        measure=lambda: _crowded_flight(1),
    ),
    Finding(
        part="loop",
        name="a flight in the paper's tank by least energy: whose thread does the slow work",
        before="routes and certificates on the loop's",
        promise="none of it on the loop's thread",
        measure=lambda: _on_the_loop(1),
    ),
    Finding(
        part="loop",
        name="a flight in the paper's tank by plain routes: whose thread does the slow work",
        before="routes and certificates on the loop's",
        promise="none of it on the loop's thread",
        measure=lambda: _on_the_loop(0),
    ),
    Finding(
        part="loop",
        name=f"{GO_TOS} go-tos 0.1 s apart, least energy",
        before=f"all {GO_TOS} are planned, the last is answered after {GO_TOS} plan times",
        promise="at most the one in work and the last",
        measure=_many_go_tos,
    ),
    Finding(
        part="guard",
        name="the energy planner raises at every request",
        before="the exception ends the service",
        promise="told once, and flown by the plain route",
        measure=_failing_planner,
    ),
    Finding(
        part="link",
        name="certificates of terminal regions as STATUSTEXT",
        before='"Item 1: alpha 0.443 (0.047 m, 8.6 deg) by acceptance heading, 0 of 20000 violate"',
        promise="in the log, not on the operator's screen",
        measure=_certificate_texts,
    ),
)
