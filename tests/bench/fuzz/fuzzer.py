"""The real service on the simulated vehicle, in lockstep, with traffic and samples that nobody should send.

After every tick the rules are looked at that hold whatever comes in: no exception, disarmed means neutral pulses,
pulses within the drive's range, a heartbeat every second (but on quiet links), what is refused changes nothing, no plan
changes without an accepted transfer, nothing is heard that a key in force has not signed, whoever is not in control
changes nothing, and a vehicle that flies with sound sensors stays inside its fence and touches nothing.

Every service flies several moods in turn. Services are without a key and with one by turns, packets are passed on
between clients of three links, some clients speak MAVLink 1.
"""

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.command.service import Autopilot
from autopilot.core.clients import Reach
from autopilot.core.clock import TICK_US
from autopilot.core.messages import Inputs, MavlinkFrame, Outputs
from autopilot.core.plan import PlanKind
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.vehicle_commands import FORCE_ARM, FORCE_DISARM
from autopilot.mission.fence import fence_clearance_m
from autopilot.mission.paper import paper_plan
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl
from tests.bench.fuzz.message_observer import BrokenRuleError, MessageObserver
from tests.bench.fuzz.messages import Sender, Traffic
from tests.bench.fuzz.result import Result
from tests.bench.fuzz.samples import Noise

LONGEST_GAP_US = 1_200_000
"""Between two heartbeats."""
EPISODE_TICKS = 600
"""So long one mood lasts."""
PER_TICK = (1, 10, 30, 40)
"""Messages per tick."""
OWNER = 250
"""System id of the operator who puts things right."""
DEEPEST_M = 0.03
"""So far a body may be beyond the fence: what the estimate does not know, and the optimiser's tolerance."""
SETTLE_TICKS = 800
"""So long a vehicle may take to come into its fence and fly: after wild moods it may be anywhere."""
BACKLOG_TICKS = 1000
"""In so many ticks at most every client's backlog is worked off."""
LOGGED_S = 1_767_261_600
"""Unix time of the first log that clients can ask for, and of the first signature: the same on every run."""


class Mood(StrEnum):
    """What is thrown at the service for a while."""

    ANYTHING = "anything"
    """Messages and, at times, samples, in flight and disarmed."""
    STRANGERS = "strangers"
    """Anything, of clients who are not in control, while the one who is flies a mission."""
    STEERING = "steering"
    """Sticks, set points and orders that move the vehicle."""


class Fuzzer:
    """One service and what is thrown at it."""

    def __init__(self, seed: int, folder: Path, *, signed: bool = False) -> None:
        """``signed``: the service has a key, and some of its clients do."""
        self.result = Result(seed=seed)
        self._rng = np.random.default_rng(seed)
        self._key = sha256(seed.to_bytes(8, "little")).digest() if signed else None
        self.session = _session(seed, folder, self._key)
        self._observer = MessageObserver(self.session)
        signing = self._observer._inside._ctx.signing
        self._traffic = Traffic(seed, _clients(self._key), lambda: int(signing.stamp))
        self._operator = Traffic(seed, (Sender(OWNER, link=2, client=1, key=self._key),), lambda: int(signing.stamp))
        self._noise = Noise(seed)
        parts: Any = replace(self.session.parts, server=self._observer)  # type: ignore[arg-type]
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
        self.session.parts.nondeterminism.take()
        device.write(t_us, outputs.command)
        result = self.result
        result.messages += len(frames)
        result.ticks += 1
        result.samples += len(samples)
        result.armed_ticks += outputs.mode.armed
        result.accepted, result.handled = self._observer.accepted, self._observer.handled
        self._check(outputs)
        return outputs

    def _check(self, outputs: Outputs) -> None:
        pulses = outputs.command.pwm_us[: len(self._neutral)]
        if not outputs.mode.armed and pulses != self._neutral:
            raise BrokenRuleError(f"disarmed, and pulses are {pulses}")
        if any(not isinstance(p, int) or not self._low_us <= p <= self._high_us for p in pulses):
            raise BrokenRuleError(f"pulses {pulses} are beyond the drive")
        ctx = self._observer._inside._ctx
        silent = ctx.quiet.issuperset(ctx.links)  # clients have asked for high latency on every link
        if silent or any(message.get_type() == "HEARTBEAT" for message in self._observer.inbox):
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

    def episode(self, ticks: int = EPISODE_TICKS, mood: Mood | None = None, *, most: float = math.inf) -> bool:
        """One mood, ended early when this service has had ``most`` messages: calm first, so that there is something to
        lose. False = with this vehicle it is not possible."""
        rng = self._rng
        mood = mood or (Mood.ANYTHING, Mood.ANYTHING, Mood.STRANGERS, Mood.STEERING)[rng.integers(4)]
        wild, per_tick = bool(rng.random() < 0.4) and mood is Mood.ANYTHING, int(rng.choice(PER_TICK))
        self._traffic.steering = mood is Mood.STEERING
        self._calm()
        if mood is not Mood.ANYTHING and not self._fly(owned=mood is Mood.STRANGERS):
            return False
        for tick in range(ticks):
            if self.result.messages >= most:
                break
            frames = [self._traffic.frame() for _ in range(per_tick)]
            if mood is Mood.STRANGERS and tick % 100 == 0:
                frames.append(self._order(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)))
            outputs = self.step(frames, wild=wild)
            if mood is Mood.STRANGERS and not outputs.mode.armed:
                texts = [event.text for event in outputs.events]
                raise BrokenRuleError(f"disarmed while its operator is in control: {outputs.mode}, {texts}")
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
        parts, inside = self.session.parts, self._observer._inside
        for _ in range(BACKLOG_TICKS):
            if not inside._intake._turns:
                break
            self.step((), wild=False)  # what floods have left would undo what is put right
        if inside._ctx.signing.key != self._key:
            inside._ctx.signing.set_key(self._key)
            inside._ctx.key_changed()
        inside._operators.owner = None
        for link in tuple(inside._ctx.quiet):
            inside._high_latency.end(link)
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
        self._observer.allow()
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
            if owned and self._observer._inside._operators.in_control != OWNER:
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
    settings = flight_settings(folder, {"scenario": "paper-tank", "sensors": "pose", "seed": seed})
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
        ctx: Any = session.parts.server._ctx
        ctx.signing.set_key(key)
        ctx.key_changed()
    return session
