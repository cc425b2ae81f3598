"""Kills at random moments: what a vehicle has accepted must be there when it comes up again.

A client changes plans and parameters without a pause and has the vehicle armed, so that it writes its log, too; after
a random time the service gets SIGKILL. The next one is asked for everything. A change counts as accepted when its last
answer has come (MISSION_ACK, PARAM_VALUE); the one that was under way may be there or not, but whole.
"""

import itertools
import random
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from pymavlink.dialects.v20 import development as mav

from autopilot.client.client_session import CommandRefusedError, VehicleConnection
from autopilot.core.errors import AutopilotError
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.log.reader import open_log
from autopilot.mavlink.wire import Message
from autopilot.mission.paper import paper_plan
from autopilot.run.children import LOCAL, Child, autopilot_command, free_port

LATEST_KILL_S = 3.0
MOST_CHANGES = 6
CONNECT_S = 60.0
AGAIN_S = 1.0
"""A request without an answer is made again."""
PARAMETERS = {"SPD_CRUISE": (0.1, 0.4), "WP_ACCEPT_RADIUS": (0.1, 1.0)}
"""Parameters that are changed, and between which values."""


@dataclass(slots=True)
class Known:
    """What a thing must be after a kill: the last accepted, or the one that was under way."""

    accepted: str
    under_way: str | None = None

    def allows(self, found: str) -> bool:
        """Whether nothing was lost."""
        return found in (self.accepted, self.under_way)


@dataclass(slots=True, kw_only=True)
class Kills:
    """What all rounds together found."""

    kills: int = 0
    accepted: int = 0
    """Changes that were answered as accepted."""
    under_way: int = 0
    """Kills in the middle of a change."""
    lost: list[str] = field(default_factory=list)
    """Accepted changes that were not there any more, and what was there that nobody sent."""
    logs: int = 0
    longest_log_gap_s: float = 0.0
    """Between the last time that the vehicle told and the end of its log."""
    damaged_logs: list[str] = field(default_factory=list)
    start_cpu_s: list[float] = field(default_factory=list)
    """CPU time of a start until the first answer."""


class _Vehicle:
    """A service of our own and a client of it."""

    def __init__(self, child: Child, session: VehicleConnection) -> None:
        self.child, self.session = child, session

    def parameter(self, name: str, value: float | None = None) -> str:
        """Read a parameter, or set it; the value that the vehicle tells, as text."""
        request: Message = mav.MAVLink_param_request_read_message(1, 1, name.encode(), -1)
        if value is not None:
            request = mav.MAVLink_param_set_message(1, 1, name.encode(), value, mav.MAV_PARAM_TYPE_REAL32)
        sent_s = float("-inf")
        while True:
            if time.monotonic() - sent_s > AGAIN_S:
                sent_s = time.monotonic()
                self.session.send(request)
            for message in self.session.poll():
                if getattr(message, "param_id", None) != name:
                    continue
                if message.get_type() == "PARAM_ERROR":
                    raise CommandRefusedError(f"parameter {name}: error {message.error}")
                return f"{message.param_value:.6g}"
            self.child.at_work()


@contextmanager
def _vehicle(folder: Path) -> Iterator[_Vehicle]:
    port = free_port()
    arguments = ["sitl", "--quiet", "--sensors", "pose", "--keep-plans", "--connect", f"udpin:{LOCAL}:{port}"]
    places = {"AUTOPILOT_STATE_DIR": str(folder / "state"), "AUTOPILOT_LOG_DIR": str(folder / "logs")}
    child = Child(autopilot_command(*arguments), places)
    try:
        with VehicleConnection(f"udpout:{LOCAL}:{port}", at_work=child.at_work) as session:
            session.connect(CONNECT_S)
            yield _Vehicle(child, session)
    finally:
        child.process.kill()
        child.process.wait()


def run(runs: int, seed: int, progress: Callable[[int], None] = lambda _: None) -> Kills:
    """``runs`` kills, one service after the other in the same folder."""
    rng = random.Random(seed)
    result = Kills()
    known: dict[str, Known] = {}
    with tempfile.TemporaryDirectory(prefix="autopilot-") as name:
        folder = Path(name)
        armed: tuple[float, float] | None = None
        for number in range(runs + 1):
            with _vehicle(folder) as vehicle:
                _compare(vehicle, known, result)
                result.start_cpu_s.append(vehicle.child.cpu_s() or 0.0)
                _check_logs(folder, armed, result)
                if number == runs:
                    return result
                armed = _live_and_die(vehicle, known, rng, result)
            result.kills += 1
            progress(result.kills)
    return result


def _compare(vehicle: _Vehicle, known: dict[str, Known], result: Kills) -> None:
    """Everything that is known of against what the vehicle has; that is what is known from now on."""
    names = [*(kind.name for kind in PlanKind), *PARAMETERS]
    for name in names:
        found = vehicle.parameter(name) if name in PARAMETERS else _text(vehicle.session.download(PlanKind[name]))
        if name in known and not known[name].allows(found):
            result.lost.append(f"kill {result.kills}: {name} is {found[:80]}, accepted was {known[name].accepted[:80]}")
        known[name] = Known(accepted=found)


def _live_and_die(
    vehicle: _Vehicle, known: dict[str, Known], rng: random.Random, result: Kills
) -> tuple[float, float] | None:
    """Change things until the kill; the vehicle times of arming and of the end as far as it told them [s].

    None if it was not armed.
    """
    # Every other kill comes with an answer, when what is accepted is most easily lost.
    deadly = rng.randint(1, MOST_CHANGES) if rng.random() < 0.5 else 0
    killer = threading.Timer(rng.uniform(0.0, LATEST_KILL_S), vehicle.child.process.kill)
    armed_s: float | None = None
    if not deadly:
        killer.start()
    try:
        for number in itertools.count():
            if deadly and number == deadly:
                vehicle.child.process.kill()
                return None
            if number == 1:
                vehicle.session.arm(force=True)
                armed_s = vehicle.session.vehicle_clock_s
            name = rng.choice([*(kind.name for kind in PlanKind), *PARAMETERS])
            try:
                _change(vehicle, name, known[name], rng)
                result.accepted += 1
            except CommandRefusedError:  # nothing changes
                known[name].under_way = None
    except AutopilotError:
        result.under_way += any(thing.under_way is not None for thing in known.values())
    finally:
        if not deadly:
            killer.join()
        vehicle.child.process.wait()
    end_s = vehicle.session.vehicle_clock_s
    return None if armed_s is None or end_s is None else (armed_s, end_s)


def _change(vehicle: _Vehicle, name: str, thing: Known, rng: random.Random) -> None:
    """One change, until it is accepted. AutopilotError when the service goes."""
    if name in PARAMETERS:
        value = rng.uniform(*PARAMETERS[name])
        thing.under_way = f"{mav_float(value):.6g}"
        confirmed = vehicle.parameter(name, value)
        thing.accepted, thing.under_way = confirmed, None
        return
    kind = PlanKind[name]
    items = _draw(kind, rng)
    thing.under_way = _text(items)
    vehicle.session.upload(kind, items)
    thing.accepted, thing.under_way = thing.under_way, None


def mav_float(value: float) -> float:
    """A number as a float32 of the wire has it."""
    packed = mav.MAVLink_param_set_message(1, 1, b"", value, mav.MAV_PARAM_TYPE_REAL32).pack(mav.MAVLink(None))
    (message,) = mav.MAVLink(None).parse_buffer(packed)
    return float(message.param_value)


def _draw(kind: PlanKind, rng: random.Random) -> tuple[PlanItem, ...]:
    """A plan that differs from the last ones; the fence keeps what the missions need."""
    plan = paper_plan(laps=rng.randint(1, 400))
    if kind is PlanKind.MISSION:
        return plan.mission
    if kind is PlanKind.FENCE:
        return tuple(
            replace(item, param1=0.1 + 0.001 * rng.randint(0, 60))
            if item.command == mav.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION
            else item
            for item in plan.fence
        )
    first = plan.mission[0]
    place = replace(first, command=mav.MAV_CMD_NAV_RALLY_POINT, param1=0.0, param2=0.0, param4=0.0)
    return (replace(place, x=first.x + rng.randint(-30, 30)),)


def _text(items: Sequence[PlanItem]) -> str:
    """What a plan says, as comparable text: numbers as the wire rounds them."""
    return "; ".join(
        f"{item.command} {item.x} {item.y} {mav_float(item.z):.6g} {mav_float(item.param1):.6g}" for item in items
    )


def _check_logs(folder: Path, armed: tuple[float, float] | None, result: Kills) -> None:
    """Logs that the new service has repaired; the last one against the times that its vehicle told."""
    logs = sorted((folder / "logs").rglob("*.mcap"), key=lambda path: path.stat().st_mtime)
    for path in logs:
        log = open_log(path)
        result.damaged_logs += [f"{path.name}: {problem}" for problem in log.problems]
    if logs and armed is not None:
        begin_s, end_s = armed
        stats = open_log(logs[-1]).get("/sys/mode")
        logged_s = begin_s if stats is None or not len(stats) else 1e-6 * float(stats["t_us"][-1])
        result.logs += 1
        result.longest_log_gap_s = max(result.longest_log_gap_s, end_s - logged_s)
    for path in logs:
        path.unlink()
