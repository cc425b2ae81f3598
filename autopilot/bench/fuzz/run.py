"""The real service on the simulated vehicle, in lockstep, with traffic and samples that nobody should send.

After every tick the rules are looked at that hold whatever comes in: no exception, disarmed means neutral pulses,
pulses within the drive's range, a heartbeat every second, what is refused changes nothing, no plan changes without an
accepted transfer, nothing is heard that a key in force has not signed, whoever is not in control changes nothing, and
a vehicle that flies with sound sensors stays inside its fence and touches nothing.

Every service flies several moods in turn. Services are without a key and with one by turns, packets are passed on
between clients of three links, some clients speak MAVLink 1.
"""

import math
import os
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from autopilot.bench.fuzz.messages import Sender, Traffic
from autopilot.bench.fuzz.samples import Noise
from autopilot.command.service import Autopilot
from autopilot.core.clients import Reach
from autopilot.core.guard import VARIABLE
from autopilot.core.messages import Event, Inputs, MavlinkFrame, Outputs
from autopilot.core.plan import PlanKind
from autopilot.mavlink.api import VehicleView
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.server import MavlinkServer
from autopilot.mavlink.signing import UNSIGNABLE
from autopilot.mavlink.vehicle_commands import FORCE_ARM, FORCE_DISARM
from autopilot.run.config import gather, sitl_defaults
from autopilot.run.sitl_session import SitlSession, open_sitl
from mission.fence import fence_clearance_m
from mission.paper import paper_plan

TICK_US = 10_000
LONGEST_GAP_US = 1_200_000
"""Between two heartbeats."""
EPISODE_TICKS = 600
"""So long one mood lasts."""
PER_TICK = (1, 10, 30, 40)
"""Messages per tick."""
EPISODES = 12
"""Of one service: then comes one with another key, or none."""
OWNER = 250
"""System id of the operator who puts things right."""
WAITING_US = 2_000_000
"""What was let in before a key came into force may wait so long for its turn."""
DEEPEST_M = 0.03
"""So far a body may be beyond the fence: what the estimate does not know, and the optimiser's tolerance."""
GROWTH_MB = 80.0
"""Of the process's memory, beyond which the run has failed."""
SETTLE_TICKS = 800
"""So long a vehicle may take to come into its fence and fly: after wild moods it may be anywhere."""
BACKLOG_TICKS = 1000
"""In so many ticks at most every client's backlog is worked off."""
LOGGED_S = 1_767_261_600
"""Unix time of the first log that clients can ask for, and of the first signature: the same on every run."""
SETTLED_MESSAGES = 20_000
"""Memory counts from here: everything has been imported and every cache is warm."""


class BrokenRuleError(AssertionError):
    """A rule that holds whatever comes in did not."""


@dataclass(slots=True)
class Result:
    """What a run of the fuzzer found."""

    seed: int
    messages: int = 0
    ticks: int = 0
    samples: int = 0
    armed_ticks: int = 0
    accepted: Counter[str] = field(default_factory=Counter)
    """Answers by kind: what was really taken and refused."""
    seconds: float = 0.0
    rss_start_mb: float = 0.0
    rss_end_mb: float = 0.0
    handled: Counter[str] = field(default_factory=Counter)
    """Messages that reached their handler, by what is special about them."""
    moods: Counter[str] = field(default_factory=Counter)
    """Ticks of each mood."""
    least_m: float = math.inf
    """Least distance of the hull from the fence in flights that have to keep it."""
    failures: list[str] = field(default_factory=list)
    """Exceptions and broken rules, one line each."""

    @property
    def per_second(self) -> float:
        """Messages per second of wall time."""
        return self.messages / self.seconds if self.seconds > 0.0 else 0.0

    def rows(self) -> list[tuple[str, str]]:
        """Name and value of every figure."""
        answers = ", ".join(f"{name} {count}" for name, count in sorted(self.accepted.items()))
        return [
            ("messages", f"{self.messages}, {self.per_second:.0f} per second of wall time"),
            ("ticks", f"{self.ticks}, armed on {self.armed_ticks}; {self.samples} samples"),
            ("handled", ", ".join(f"{name} {count}" for name, count in sorted(self.handled.items()))),
            ("ticks by mood", ", ".join(f"{name} {count}" for name, count in sorted(self.moods.items()))),
            ("answers", answers),
            ("hull from the fence at least", f"{self.least_m:.3f} m"),
            ("exceptions and broken rules", str(len(self.failures))),
            ("memory", f"{self.rss_start_mb:.0f} MB warm, {self.rss_end_mb - self.rss_start_mb:+.0f} MB at the end"),
            *(("found", line) for line in dict.fromkeys(self.failures)),
        ]


class Mood(StrEnum):
    """What is thrown at the service for a while."""

    ANYTHING = "anything"
    """Messages and, at times, samples, in flight and disarmed."""
    STRANGERS = "strangers"
    """Anything, of clients who are not in control, while the one who is flies a mission."""
    STEERING = "steering"
    """Sticks, set points and orders that move the vehicle."""


class _Witness:
    """Stands before the MAVLink server and sees what a message has changed that must not."""

    def __init__(self, session: SitlSession) -> None:
        self._server: MavlinkServer = session.parts.server
        self._session = session
        self._inside: Any = self._server._dispatcher
        self._stamps: set[tuple[tuple[int, int, int], int]] = set()
        self._key: bytes | None = None
        self._key_us = 0
        self._plans = self._plans_now()
        self.handled: Counter[str] = Counter()
        self._reader = mav.MAVLink(None)
        self._answers = mav.MAVLink(None)
        self._reader.robust_parsing = self._answers.robust_parsing = True
        self.accepted: Counter[str] = Counter()
        self.heard: list[Any] = []
        """Of this tick and since the one before."""
        self._served: list[Any] = []
        inside = self._inside
        inside._handlers = {number: self._watched(handler) for number, handler in inside._handlers.items()}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._server, name)

    def step(
        self,
        t_us: int,
        rx: Sequence[MavlinkFrame],
        view: VehicleView,
        events: Sequence[Event] = (),
        reached: Sequence[int] = (),
    ) -> tuple[MavlinkFrame, ...]:
        """As the server's; what it sends is read."""
        sent = self._server.step(t_us, rx, view, events, reached)
        self.heard, self._served = self._served + self._read(sent), []
        for message in self.heard:
            self._count(message)
        self._look_at_plans()
        return sent

    def serve(self, t_us: int, rx: Sequence[MavlinkFrame]) -> tuple[MavlinkFrame, ...]:
        """As the server's."""
        sent = self._server.serve(t_us, rx)
        self._served += self._read(sent)
        return sent

    def _read(self, sent: Sequence[MavlinkFrame]) -> list[Any]:
        """What the vehicle says; what is passed on of others is no word of its."""
        said = [message for frame in sent for message in self._reader.parse_buffer(frame.data) or ()]
        return [m for m in said if (m.get_srcSystem(), m.get_srcComponent()) == (1, 1)]

    def _plans_now(self) -> dict[PlanKind, object]:
        return {kind: self._session.parts.plans.items(kind) for kind in PlanKind}

    def allow(self) -> None:
        """The plans are as they are for a reason that no client gave."""
        self._plans = self._plans_now()

    def _look_at_plans(self) -> None:
        """A plan is another one only if its transfer or its removal has been accepted on this tick."""
        now, before = self._plans_now(), self._plans
        self._plans = now
        said = [m for m in self.heard if m.get_type() in ("MISSION_ACK", "STATUSTEXT")]
        taken = {m.mission_type for m in said if m.get_type() == "MISSION_ACK" and m.type == 0}
        text = "".join(m.text for m in said if m.get_type() == "STATUSTEXT")
        for kind in PlanKind:
            told = f"{kind.name.capitalize()} plan accepted" in text
            if now[kind] != before[kind] and not told and not taken & {int(kind), mav.MAV_MISSION_TYPE_ALL}:
                raise BrokenRuleError(f"the {kind.name.lower()} has changed, and no transfer was accepted")

    def _look_at_sender(self, message: Any) -> None:
        """A frame is heard only with the signature that is in force, and once."""
        frame, key, t_us = bytes(message.get_msgbuf()), self._inside._ctx.signing.key, self._inside._ctx.t_us
        if key != self._key:
            self._key, self._key_us = key, t_us
        signed = frame[0] == 0xFD and bool(frame[2] & 1)
        self.handled["MAVLink 1" if frame[0] == 0xFE else "signed" if signed else "MAVLink 2"] += 1
        if not signed:
            if key is not None and t_us > self._key_us + WAITING_US and message.get_msgId() not in UNSIGNABLE:
                raise BrokenRuleError(f"{message} is not signed, and was heard")
            return
        if t_us > self._key_us + WAITING_US and (key is None or sha256(key + frame[:-6]).digest()[:6] != frame[-6:]):
            raise BrokenRuleError(f"{message} is signed with another key, and was heard")
        stream, stamp = (frame[-13], frame[5], frame[6]), int.from_bytes(frame[-12:-6], "little")
        if (stream, stamp) in self._stamps:
            raise BrokenRuleError(f"{message} was heard a second time")
        self._stamps.add((stream, stamp))

    def _watched(self, handler: Callable[[Any, Any], None]) -> Callable[[Any, Any], None]:
        """A message's handler between two looks at the state: by its answers it is judged."""
        ctx = self._server._dispatcher._ctx

        operators = self._inside._operators

        def handle(peer: Any, message: Any) -> None:
            self._look_at_sender(message)
            before, sent, kept_out = self._state(), len(ctx.tx), operators.keeps_out(peer)
            handler(peer, message)
            answers = [a for frame in ctx.tx[sent:] for a in self._answers.parse_buffer(frame.data) or ()]
            after = self._state() if answers or kept_out else before
            if kept_out and after != before:
                changed = [name for name in before if before[name] != after[name]]
                raise BrokenRuleError(f"{message} of system {peer.sysid}, not in control, has changed {changed}")
            for answer in answers:
                self._judge(message, answer, before, after)

        return handle

    def _state(self) -> dict[str, object]:
        parts = self._session.parts
        plans, commander = parts.plans, parts.commander
        return {
            "params": tuple(parts.params.values()),
            "mission": plans.items(PlanKind.MISSION),
            "fence": plans.items(PlanKind.FENCE),
            "rally": plans.items(PlanKind.RALLY),
            "home": plans.home_ned_m.tolist(),
            "origin": plans.origin,
            "armed": commander.armed,
            "mode": commander.intended_mode,
            "key": self._inside._ctx.signing.key,
            "sticks": self._inside.pilot.sticks,
            "owner": self._inside._operators.in_control,
        }

    def _count(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "COMMAND_ACK":
            self.accepted[f"command {'accepted' if message.result == 0 else 'refused'}"] += 1
        elif kind == "MISSION_ACK":
            self.accepted[f"plan {'accepted' if message.type == 0 else 'refused'}"] += 1
        elif kind in ("PARAM_ERROR", "PARAM_VALUE"):
            self.accepted[f"parameter {'refused' if kind == 'PARAM_ERROR' else 'told'}"] += 1

    def _judge(self, message: Any, answer: Any, before: dict[str, object], after: dict[str, object]) -> None:
        kind = answer.get_type()
        refused = (kind == "COMMAND_ACK" and answer.result not in (0, 5)) or (kind == "MISSION_ACK" and answer.type)
        if refused or kind == "PARAM_ERROR":
            changed = [name for name in before if before[name] != after[name]]
            if changed:
                raise BrokenRuleError(f"{message} is refused by {answer}, and yet it has changed {changed}")


class Fuzzer:
    """One service and what is thrown at it."""

    def __init__(self, seed: int, folder: Path, *, signed: bool = False) -> None:
        """``signed``: the service has a key, and some of its clients do."""
        self.result = Result(seed=seed)
        self._rng = np.random.default_rng(seed)
        self._key = sha256(seed.to_bytes(8, "little")).digest() if signed else None
        self.session = _session(seed, folder, self._key)
        self._witness = _Witness(self.session)
        signing = self._witness._inside._ctx.signing
        self._traffic = Traffic(seed, _clients(self._key), lambda: int(signing.stamp))
        self._operator = Traffic(seed, (Sender(OWNER, link=2, client=1, key=self._key),), lambda: int(signing.stamp))
        self._noise = Noise(seed)
        parts: Any = replace(self.session.parts, server=self._witness)  # type: ignore[arg-type]
        self._service = Autopilot(parts)
        drive = self.session.vehicle.drive
        self._neutral = (drive.neutral_us,) * len(self.session.vehicle.thrusters)
        self._low_us, self._high_us = drive.neutral_us - drive.span_us, drive.neutral_us + drive.span_us
        self._beat_us = 0
        self._t_us = 0
        self._keeps_fence = False
        """Whether the vehicle has been inside its fence since sensors were sound and orders sensible."""
        self._contacts = 0
        self.inputs: Inputs | None = None
        """Of the last tick, to reproduce what it did."""

    def close(self) -> None:
        """End everything of the service."""
        self.session.close()

    def step(self, frames: Sequence[MavlinkFrame | bytes], *, wild: bool) -> Outputs:
        """One tick with these frames (bytes: of link 0), and with wild samples or without."""
        device = self.session.device
        self._t_us += TICK_US
        t_us = self._t_us
        device.advance(t_us)
        samples = tuple(device.poll(t_us))
        if wild:
            samples = self._noise.samples(t_us, samples)
        rx = tuple(MavlinkFrame(link=0, data=frame) if isinstance(frame, bytes) else frame for frame in frames)
        between = len(rx) // 2 if self._rng.random() < 0.5 else 0
        if between:
            self._service.serve(t_us - TICK_US // 2, rx[:between])
        self.inputs = Inputs(t_us=t_us, samples=samples, mavlink_rx=rx[between:])
        outputs = self._service.step(self.inputs)
        self.session.parts.witness.take()
        device.write(t_us, outputs.command)
        result = self.result
        result.messages += len(frames)
        result.ticks += 1
        result.samples += len(samples)
        result.armed_ticks += outputs.mode.armed
        result.accepted, result.handled = self._witness.accepted, self._witness.handled
        self._check(outputs)
        return outputs

    def _check(self, outputs: Outputs) -> None:
        pulses = outputs.command.pwm_us[: len(self._neutral)]
        if not outputs.mode.armed and pulses != self._neutral:
            raise BrokenRuleError(f"disarmed, and pulses are {pulses}")
        if any(not isinstance(p, int) or not self._low_us <= p <= self._high_us for p in pulses):
            raise BrokenRuleError(f"pulses {pulses} are beyond the drive")
        if any(message.get_type() == "HEARTBEAT" for message in self._witness.heard):
            self._beat_us = self._t_us
        if self._t_us - self._beat_us > LONGEST_GAP_US:
            raise BrokenRuleError(f"no heartbeat for {1e-6 * (self._t_us - self._beat_us):.2f} s")
        self._check_fence(outputs)

    def _check_fence(self, outputs: Outputs) -> None:
        """The hull is inside the fence and touches nothing, from the moment when it is armed inside of it."""
        if not outputs.mode.armed:
            self._keeps_fence = False
            return
        device, fence = self.session.device, self.session.parts.commander.fence
        inside_m = float(fence_clearance_m(fence, device.truth.pos_ned_m[None, :2])[0]) - self.session.vehicle.radius_m
        if self._keeps_fence:
            self.result.least_m = min(self.result.least_m, inside_m)
            if inside_m < -DEEPEST_M:
                raise BrokenRuleError(f"the hull is {-inside_m:.3f} m beyond the fence at {device.truth.pos_ned_m}")
            if device.truth.contact_count > self._contacts:
                raise BrokenRuleError(f"the hull touches something at {device.truth.pos_ned_m}")

    def episode(self, ticks: int = EPISODE_TICKS, mood: Mood | None = None) -> bool:
        """One mood: calm first, so that there is something to lose. False = with this vehicle it is not possible."""
        rng = self._rng
        mood = mood or (Mood.ANYTHING, Mood.ANYTHING, Mood.STRANGERS, Mood.STEERING)[rng.integers(4)]
        wild, per_tick = bool(rng.random() < 0.4) and mood is Mood.ANYTHING, int(rng.choice(PER_TICK))
        self._traffic.steering = mood is Mood.STEERING
        self._calm()
        if mood is not Mood.ANYTHING and not self._fly(owned=mood is Mood.STRANGERS):
            return False
        for tick in range(ticks):
            frames = [self._traffic.frame() for _ in range(per_tick)]
            if mood is Mood.STRANGERS and tick % 100 == 0:
                frames.append(self._order(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)))
            outputs = self.step(frames, wild=wild)
            if mood is Mood.STRANGERS and not outputs.mode.armed:
                said = [event.text for event in outputs.events]
                raise BrokenRuleError(f"disarmed while its operator is in control: {outputs.mode}, {said}")
            self.result.moods[mood] += 1
        self._keeps_fence = False
        return True

    def _order(self, message: Any) -> MavlinkFrame:
        """Of the operator who puts things right."""
        (sender,) = self._operator._senders
        return MavlinkFrame(
            link=sender.link, client=sender.client, data=self._operator._spoken_by(sender, message), reach=Reach.MACHINE
        )

    def _calm(self) -> None:
        """An operator who puts things right again: key, parameters, plans, and (if the vehicle can) arming."""
        parts, inside = self.session.parts, self._witness._inside
        for _ in range(BACKLOG_TICKS):
            if not inside._intake._turns:
                break
            self.step((), wild=False)  # what floods have left would undo what is put right
        if inside._ctx.signing.key != self._key:
            inside._ctx.signing.set_key(self._key)
            inside._ctx.key_changed()
        inside._operators._owner = None
        for name in parts.params:
            parts.params.set(name, parts.params.spec(name).default)
        parts.params.set("ORIGIN_LAT", 37.9755)
        parts.params.set("MAV_FORWARD", 1.0)
        command = mav.MAVLink_command_long_message
        for message in (
            command(1, 1, 400, 0, 0.0, FORCE_DISARM, 0.0, 0.0, 0.0, 0.0, 0.0),
            mav.MAVLink_mission_clear_all_message(1, 1, 255),
            mav.MAVLink_set_gps_global_origin_message(1, 379_755_000, 237_790_000, 0),
            command(1, 1, 400, 0, 1.0, FORCE_ARM, 0.0, 0.0, 0.0, 0.0, 0.0),
        ):
            self.step([self._order(message)], wild=False)
            for _ in range(20):
                self.step((), wild=False)

    def _fly(self, *, owned: bool) -> bool:
        """The paper's plan, armed and under way inside its fence; False = this vehicle does not any more, for wild
        samples have spoken of leaks and worse. ``owned``: the operator is in control."""
        parts, device, command = self.session.parts, self.session.device, mav.MAVLink_command_long_message
        plan = paper_plan(50)
        for kind, items in ((PlanKind.FENCE, plan.fence), (PlanKind.MISSION, plan.mission)):
            problem = parts.plans.replace(kind, items)
            if problem is not None:
                raise BrokenRuleError(f"the paper's plan is refused: {problem}")
        self._witness.allow()
        for message in (
            command(1, 1, 400, 0, 1.0, FORCE_ARM, 0.0, 0.0, 0.0, 0.0, 0.0),
            command(1, 1, 300, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            *([command(1, 1, 32100, 0, 1.0, 0.0, 10.0, 0.0, 0.0, 0.0, 0.0)] if owned else ()),
        ):
            self.step([self._order(message)], wild=False)
            for _ in range(20):
                self.step((), wild=False)
        for _ in range(SETTLE_TICKS):
            frames = (
                [self._order(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))] if self._t_us % 1_000_000 == 0 else []
            )
            outputs = self.step(frames, wild=False)
            fence = parts.commander.fence
            inside_m = float(fence_clearance_m(fence, device.truth.pos_ned_m[None, :2])[0])
            if owned and self._witness._inside._operators.in_control != OWNER:
                return False  # what was left of floods before has taken it
            if outputs.mode.armed and inside_m >= self.session.vehicle.radius_m:
                self._keeps_fence, self._contacts = True, device.truth.contact_count
                return True
        return False


def _clients(key: bytes | None) -> tuple[Sender, ...]:
    """Of three links: a line that two share, and addresses; some speak MAVLink 1, some sign, not all with the key."""
    return (
        Sender(255, key=key),
        Sender(254, 1, old=key is None),
        Sender(7, 9, link=1, client=1, key=key),
        Sender(1, 191, link=1, client=2),
        Sender(66, link=1, client=3, key=bytes(range(32))),
        Sender(67, link=1, client=4, old=True),
        Sender(255, link=2, client=2),
        Sender(1, 1, link=2, client=3, key=key),
        Sender(68, link=2, client=4, key=key, reach=Reach.MACHINE),
    )


def _session(seed: int, folder: Path, key: bytes | None = None) -> SitlSession:
    settings = gather(sitl_defaults(0), {"scenario": "paper-tank", "speed": 0.0, "sensors": "pose", "seed": seed}, {})
    settings.put("connect", (), "fuzz")
    settings.put("state_dir", str(folder), "fuzz")
    # Clients may erase logs: not those of whoever runs this.
    settings.put("log_dir", str(folder / "logs"), "fuzz")
    day = folder / "logs" / "2026-01-01"
    day.mkdir(parents=True)
    for number in range(3):
        log = day / f"10_00_0{number}.mcap"
        log.write_bytes(bytes(range(256)) * (1 + 40 * number))
        os.utime(log, (LOGGED_S + number, LOGGED_S + number))
    session = open_sitl(settings, {}, log=False, now_s=LOGGED_S)
    if key is not None:
        ctx: Any = session.parts.server._dispatcher._ctx
        ctx.signing.set_key(key)
        ctx.key_changed()
    return session


def run_fuzz(messages: int, seed: int = 1, show: Callable[[Result], None] = lambda _: None) -> Result:
    """Throw ``messages`` at the service. A failure is kept and a fresh service goes on from there."""
    process = psutil.Process()
    guarded = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = "raise"
    try:
        return _run(messages, seed, show, process)
    finally:
        os.environ.pop(VARIABLE)
        if guarded is not None:
            os.environ[VARIABLE] = guarded


def _run(messages: int, seed: int, show: Callable[[Result], None], process: psutil.Process) -> Result:
    total = Result(seed=seed)
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        attempt = 0
        while total.messages < messages:
            fuzzer = Fuzzer(seed + 1000 * attempt, Path(folder) / str(attempt), signed=bool(attempt % 2))
            before = _counts_of(total)
            attempt += 1
            try:
                for _ in range(EPISODES):
                    if total.messages >= messages:
                        break
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")  # overflow in what is made of nonsense is no finding
                        able = fuzzer.episode()
                    _add(total, before, fuzzer.result)
                    total.seconds = time.monotonic() - began_s
                    total.rss_end_mb = process.memory_info().rss / 1e6
                    if not total.rss_start_mb and total.messages >= min(SETTLED_MESSAGES, messages // 2):
                        total.rss_start_mb = total.rss_end_mb
                    show(total)
                    if not able:
                        break
            except Exception as error:  # noqa: BLE001 - finding exceptions is what this is for
                _add(total, before, fuzzer.result)
                place = _place(error)
                total.failures.append(f"seed {fuzzer.result.seed} tick {fuzzer.result.ticks}: {place}: {error}"[:600])
                show(total)
            finally:
                fuzzer.close()
    total.seconds = time.monotonic() - began_s
    if total.rss_start_mb and total.rss_end_mb > total.rss_start_mb + GROWTH_MB:
        total.failures.append(f"memory has grown from {total.rss_start_mb:.0f} to {total.rss_end_mb:.0f} MB")
    return total


def _counts_of(total: Result) -> Result:
    """The counts as they are now."""
    return replace(
        total,
        accepted=Counter(total.accepted),
        handled=Counter(total.handled),
        moods=Counter(total.moods),
        failures=list(total.failures),
    )


def _add(total: Result, before: Result, now: Result) -> None:
    total.messages = before.messages + now.messages
    total.ticks = before.ticks + now.ticks
    total.samples = before.samples + now.samples
    total.armed_ticks = before.armed_ticks + now.armed_ticks
    total.accepted = before.accepted + now.accepted
    total.handled, total.moods = before.handled + now.handled, before.moods + now.moods
    total.least_m = min(before.least_m, now.least_m)


def _place(error: BaseException) -> str:
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} at {Path(frame.filename).name}:{frame.lineno} in {frame.name}"
