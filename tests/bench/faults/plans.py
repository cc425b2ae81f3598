"""Plans as operators send them: what does not fit together, fences in flight, long checks, submerged vehicles."""

import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import development as mav

from autopilot.bench.live_service import live_service
from autopilot.core.messages import Outputs
from autopilot.core.plan import MissionResult, PlanItem, PlanKind
from autopilot.mavlink.api import FlightMode
from autopilot.mavlink.profiles import CUSTOM_MODE_FLAG, profile_by_name
from autopilot.mavlink.vehicle_commands import FORCE_ARM
from autopilot.mission.paper import paper_plan
from autopilot.mission.plan_files import write_plan
from autopilot.run.children import LOCAL, autopilot_command
from tests.bench.faults.finding import Finding, Measured
from tests.bench.faults.pilot import PilotedFlight, crowded_plan, piloted

ARM, START, SET_MODE, CONTINUE, ITEM = 400, 300, 176, 193, 224
"""MAV_CMD_COMPONENT_ARM_DISARM, MISSION_START, DO_SET_MODE, DO_PAUSE_CONTINUE, DO_SET_MISSION_CURRENT (common.xml)."""
LONGEST_TICK_MS = 50.0
"""What is promised of every tick."""
OCTAGONS = 50
PLAN = paper_plan(1)
INTO_THE_PILLAR = replace(PLAN.mission[1], frame=1, x=9375, y=0, z=0.5)
BAD_MISSION = (PLAN.mission[0], INTO_THE_PILLAR, *PLAN.mission[2:])


def _mode_params(mode: FlightMode) -> tuple[float, ...]:
    """DO_SET_MODE's parameters under the default profile."""
    custom = profile_by_name("px4").custom_modes[mode]
    return float(CUSTOM_MODE_FLAG), float(custom >> 16 & 0xFF), float(custom >> 24)


def _ask(flight: PilotedFlight, command: int, *params: float) -> int:
    """A command and its MAV_RESULT."""
    asked = len(flight.pilot.heard)
    flight.pilot.command(command, *params)

    def answers() -> list[int]:
        heard = flight.pilot.heard[asked:]
        return [m.result for m in heard if m.get_type() == "COMMAND_ACK" and m.command == command]

    flight.until(lambda: bool(answers()), f"answer to command {command}")
    return answers()[0]


def _offer(flight: PilotedFlight, kind: PlanKind, items: Sequence[PlanItem]) -> int | None:
    """An upload and its MAV_MISSION_RESULT."""
    exchange = flight.pilot.upload(kind, items)
    flight.until(lambda: exchange.outcome is not None, f"{kind.name.lower()} upload")
    assert exchange.outcome is not None
    return exchange.outcome.result


@contextmanager
def _tank(*plans: tuple[PlanKind, Sequence[PlanItem]]) -> Iterator[PilotedFlight]:
    """The paper's tank, ready, with plans taken one after the other."""
    with piloted("paper-tank") as flight:
        flight.fly(2.0)
        for kind, items in plans:
            _offer(flight, kind, items)
        flight.fly(0.5)
        yield flight


def _wrong_together() -> Measured:
    plans = ((PlanKind.MISSION, BAD_MISSION), (PlanKind.FENCE, PLAN.fence), (PlanKind.RALLY, ()))
    with _tank(*plans) as flight:
        commander = flight.session.parts.commander
        told = any(text.startswith("No start: item 1 is") for text in flight.pilot.texts())
        fenced = bool(flight.session.parts.plans.items(PlanKind.FENCE))
        armed = _ask(flight, ARM, 1.0) == 0
        forced = _ask(flight, ARM, 1.0, FORCE_ARM) == 0
        ways: list[tuple[int, tuple[float, ...]]] = [
            (START, ()),
            (START, (1.0,)),
            (SET_MODE, _mode_params(FlightMode.MISSION)),
            (CONTINUE, (1.0,)),
            (ITEM, (1.0,)),
            (SET_MODE, _mode_params(FlightMode.MISSION)),
        ]
        started = 0
        for command, params in ways:
            started += _ask(flight, command, *params) == 0 and command != ITEM
        flight.fly(2.0)
        flew = commander.mode is FlightMode.MISSION
    text = (
        f"{'both stored' if fenced else 'fence refused'}, {'told' if told else 'not told'}; arming "
        f"{'accepted' if armed else 'denied'}; forced arming {'holds' if forced and not flew else 'flies it'}, "
        f"{started} of {len(ways) - 1} ways start it"
    )
    return Measured(text=text, kept=fenced and told and not armed and not started and not flew)


def _fence_of_an_armed_vehicle() -> Measured:
    with _tank((PlanKind.FENCE, PLAN.fence), (PlanKind.MISSION, PLAN.mission)) as flight:
        flight.start()
        flight.fly(1.0)
        over_waypoint = (*PLAN.fence[:4], replace(INTO_THE_PILLAR, seq=4, command=5004, param1=0.1, x=17_500, z=0.0))
        results = {
            "removed": _offer(flight, PlanKind.FENCE, ()),
            "laid over a waypoint": _offer(flight, PlanKind.FENCE, over_waypoint),
        }
        kept = len(flight.session.parts.plans.items(PlanKind.FENCE)) == len(PLAN.fence)
        flying = flight.session.parts.commander.mode is FlightMode.MISSION
    refused = [what for what, result in results.items() if result == MissionResult.DENIED]
    after = f"the mission {'goes on' if flying else 'holds'}, {'fenced as before' if kept else 'unfenced'}"
    text = f"refused when {' and '.join(refused) or 'never'}; {after}"
    return Measured(text=text, kept=len(refused) == len(results) and kept and flying)


def _parameter_in_flight() -> Measured:
    with _tank((PlanKind.FENCE, PLAN.fence), (PlanKind.MISSION, PLAN.mission)) as flight:
        flight.start()
        flight.fly(1.0)
        begin_us = flight.t_us
        flight.session.parts.params.set("DEPTH_MAX", 0.4)
        commander = flight.session.parts.commander
        flight.until(lambda: commander.mode is not FlightMode.MISSION, "hold")
        took_s = (flight.t_us - begin_us) * 1e-6
        denied = _ask(flight, CONTINUE, 1.0) != 0
    again = "may not go on" if denied else "goes on"
    return Measured(text=f"holds after {took_s:.2f} s, {again} before it is mended", kept=took_s < 0.2 and denied)


def _long_check(waypoints: int, octagons: int) -> Callable[[], Measured]:
    def measure() -> Measured:
        with piloted("open-water") as flight:
            plan = crowded_plan(flight.origin(), octagons, waypoints, seed=1)
            flight.fly(2.0)
            flight.fly(1.0)
            since = len(flight.step_s)
            begin_us = flight.t_us
            for kind in (PlanKind.FENCE, PlanKind.MISSION):
                flight.upload(kind, plan.items(kind))
            took_s = (flight.t_us - begin_us) * 1e-6
            flight.fly(0.5)
            worst_ms = 1e3 * max(flight.step_s[since:])
            text = f"CPU of a tick: {flight.figures(flight.step_s, since)}; taken after {took_s:.1f} s of vehicle time"
        return Measured(text=text, kept=worst_ms <= LONGEST_TICK_MS)

    return measure


def _submerged() -> Measured:
    states: list[int] = []

    def listen(outputs: Outputs) -> None:
        for frame in outputs.mavlink_tx:
            heard = parser.parse_buffer(bytearray(frame.data)) or ()
            states.extend(m.landed_state for m in heard if m.get_type() == "EXTENDED_SYS_STATE")

    parser: Any = mav.MAVLink(None)
    parser.robust_parsing = True
    with _tank((PlanKind.FENCE, PLAN.fence), (PlanKind.MISSION, PLAN.mission)) as flight:
        flight.on_tick = listen
        seen: dict[str, int] = {}

        def look(when: str) -> None:
            states.clear()
            flight.until(lambda: bool(states), "EXTENDED_SYS_STATE")
            flight.fly(1.1)
            seen[when] = states[-1]

        look("disarmed")
        _ask(flight, ARM, 1.0)
        look("armed")
        _ask(flight, START)
        look("mission")
        _ask(flight, CONTINUE, 0.0)
        look("paused")
    names = {mav.MAV_LANDED_STATE_ON_GROUND: "on ground", mav.MAV_LANDED_STATE_IN_AIR: "in air"}
    text = ", ".join(f"{when}: {names.get(state, str(state))}" for when, state in seen.items())
    ground, air = mav.MAV_LANDED_STATE_ON_GROUND, mav.MAV_LANDED_STATE_IN_AIR
    return Measured(text=text, kept=list(seen.values()) == [ground, ground, air, air])


def _command_line() -> Measured:
    def said_by(*arguments: str) -> tuple[int, str]:
        done = subprocess.run(autopilot_command("mission", *arguments), capture_output=True, text=True, check=False)
        return done.returncode, done.stdout + done.stderr

    with tempfile.TemporaryDirectory() as folder, live_service(scenario="paper-tank") as service:
        file = Path(folder) / "into-the-pillar.plan"
        write_plan(file, replace(PLAN, mission=BAD_MISSION))
        connect = ("--connect", f"udpout:{LOCAL}:{service.udp}", "--patience", "60")
        online, text = said_by("upload", str(file), *connect)
        offline, _ = said_by("check", str(file))
    said = "item 1 is" in text
    text = f"exit code {online}, reason {'printed' if said else 'not printed'}; check: {offline}"
    return Measured(text=text, kept=online == offline == 3 and said)


def _finding(name: str, before: str, promise: str, measure: Callable[[], Measured]) -> Finding:
    return Finding(part="plans", name=name, before=before, promise=promise, measure=measure)


FINDINGS: tuple[Finding, ...] = (
    _finding(
        "mission into an obstacle, then its fence, then rally points, as a ground station sends them",
        "fence refused; armed, flew the mission unfenced into the obstacle and pushed",
        "stored and told; no arming, no start by any way",
        _wrong_together,
    ),
    _finding(
        "the fence of a flying vehicle is removed, or laid over its mission",
        "removal accepted in silence",
        "refused, the mission goes on fenced",
        _fence_of_an_armed_vehicle,
    ),
    _finding(
        "a parameter in flight that forbids the mission (DEPTH_MAX)",
        "flown on",
        "holds at once, does not go on before it is mended",
        _parameter_in_flight,
    ),
    _finding(
        f"a fence of {OCTAGONS} octagons and a mission of 4 items are uploaded",
        "loop stopped for 2.3 s of CPU, longest tick 4 s",
        f"no tick above {LONGEST_TICK_MS:g} ms of CPU",
        _long_check(4, OCTAGONS),
    ),
    _finding(
        f"a fence of {OCTAGONS} octagons and a mission of 500 items are uploaded",
        "0.6 s of CPU more in another tick",
        f"no tick above {LONGEST_TICK_MS:g} ms of CPU",
        _long_check(500, OCTAGONS),
    ),
    _finding(
        "a submerged vehicle and a ground station that arms on the ground and pauses in the air",
        "always in the air: neither Arm nor Start Mission",
        "on the ground until it is sent somewhere",
        _submerged,
    ),
    _finding(
        "mission upload of a plan that does not fit together",
        "the part that came second was refused, exit code 1",
        "exit code 3 and the reason, as from mission check",
        _command_line,
    ),
)
