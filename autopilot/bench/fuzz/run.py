"""The real service on the simulated vehicle, in lockstep, with traffic and samples that nobody should send.

After every tick the rules are looked at that hold whatever comes in: no exception, disarmed means neutral pulses,
pulses within the drive's range, a heartbeat every second, what is refused changes nothing.
"""

import os
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from pymavlink.dialects.v20 import development as mav

from autopilot.bench.fuzz.messages import Traffic
from autopilot.bench.fuzz.samples import Noise
from autopilot.command.service import Autopilot
from autopilot.core.guard import VARIABLE
from autopilot.core.messages import Event, Inputs, MavlinkFrame, Outputs
from autopilot.core.plan import PlanKind
from autopilot.mavlink.api import VehicleView
from autopilot.mavlink.server import MavlinkServer
from autopilot.mavlink.vehicle_commands import FORCE_ARM, FORCE_DISARM
from autopilot.run.config import gather, sitl_defaults
from autopilot.run.sitl_session import SitlSession, open_sitl

TICK_US = 10_000
LONGEST_GAP_US = 1_200_000
"""Between two heartbeats."""
EPISODE_TICKS = 600
"""So long one mood lasts: only messages, only samples, both, or quiet."""
PER_TICK = (1, 1, 4, 20)
"""Messages per tick, by mood."""
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
            ("answers", answers),
            ("exceptions and broken rules", str(len(self.failures))),
            ("memory", f"{self.rss_start_mb:.0f} MB warm, {self.rss_end_mb - self.rss_start_mb:+.0f} MB at the end"),
            *(("found", line) for line in dict.fromkeys(self.failures)),
        ]


class _Witness:
    """Stands before the MAVLink server and sees what a refused message has changed."""

    def __init__(self, session: SitlSession) -> None:
        self._server: MavlinkServer = session.parts.server
        self._session = session
        self._reader = mav.MAVLink(None)
        self._answers = mav.MAVLink(None)
        self._reader.robust_parsing = self._answers.robust_parsing = True
        self.accepted: Counter[str] = Counter()
        self.heard: list[Any] = []
        inside = self._server._dispatcher
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
        self.heard = [message for frame in sent for message in self._reader.parse_buffer(frame.data) or ()]
        for message in self.heard:
            self._count(message)
        return sent

    def _watched(self, handler: Callable[[Any, Any], None]) -> Callable[[Any, Any], None]:
        """A message's handler between two looks at the state: by its answers it is judged."""
        ctx = self._server._dispatcher._ctx

        def handle(peer: Any, message: Any) -> None:
            before, sent = self._state(), len(ctx.tx)
            handler(peer, message)
            answers = [a for frame in ctx.tx[sent:] for a in self._answers.parse_buffer(frame.data) or ()]
            after = self._state() if answers else before
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

    def __init__(self, seed: int, folder: Path) -> None:
        self.result = Result(seed=seed)
        self._rng = np.random.default_rng(seed)
        self._traffic, self._noise = Traffic(seed), Noise(seed)
        self.session = _session(seed, folder)
        self._witness = _Witness(self.session)
        parts: Any = replace(self.session.parts, server=self._witness)  # type: ignore[arg-type]
        self._service = Autopilot(parts)
        drive = self.session.vehicle.drive
        self._neutral = (drive.neutral_us,) * len(self.session.vehicle.thrusters)
        self._low_us, self._high_us = drive.neutral_us - drive.span_us, drive.neutral_us + drive.span_us
        self._beat_us = 0
        self._t_us = 0
        self.inputs: Inputs | None = None
        """Of the last tick, to reproduce what it did."""

    def close(self) -> None:
        """End threads."""
        self.session.runtime.close()

    def step(self, frames: Sequence[bytes], *, wild: bool) -> Outputs:
        """One tick with these frames, and with wild samples or without."""
        device = self.session.device
        self._t_us += TICK_US
        t_us = self._t_us
        device.advance(t_us)
        samples = tuple(device.poll(t_us))
        if wild:
            samples = self._noise.samples(t_us, samples)
        self.inputs = Inputs(
            t_us=t_us, samples=samples, mavlink_rx=tuple(MavlinkFrame(link=0, data=data) for data in frames)
        )
        outputs = self._service.step(self.inputs)
        device.write(t_us, outputs.command)
        result = self.result
        result.messages += len(frames)
        result.ticks += 1
        result.samples += len(samples)
        result.armed_ticks += outputs.mode.armed
        result.accepted = self._witness.accepted
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

    def episode(self, ticks: int = EPISODE_TICKS) -> None:
        """One mood: calm first, so that there is something to lose."""
        rng = self._rng
        wild, per_tick = bool(rng.random() < 0.4), int(rng.choice(PER_TICK))
        self._calm()
        for _ in range(ticks):
            frames = [self._traffic.frame() for _ in range(per_tick)]
            self.step(frames, wild=wild)

    def _calm(self) -> None:
        """An operator who puts things right again: parameters, plans, and (if the vehicle can) arming."""
        parts = self.session.parts
        for name in parts.params:
            parts.params.set(name, parts.params.spec(name).default)
        parts.params.set("ORIGIN_LAT", 37.9755)
        encoder = mav.MAVLink(None, srcSystem=250, srcComponent=190)
        wanted = (
            mav.MAVLink_command_long_message(1, 1, 400, 0, 0.0, FORCE_DISARM, 0.0, 0.0, 0.0, 0.0, 0.0),
            mav.MAVLink_mission_clear_all_message(1, 1, 255),
            mav.MAVLink_set_gps_global_origin_message(1, 379_755_000, 237_790_000, 0),
            mav.MAVLink_command_long_message(1, 1, 400, 0, 1.0, FORCE_ARM, 0.0, 0.0, 0.0, 0.0, 0.0),
        )
        for message in wanted:
            self.step([bytes(message.pack(encoder))], wild=False)
            encoder.seq = (encoder.seq + 1) & 0xFF
            for _ in range(20):
                self.step((), wild=False)


def _session(seed: int, folder: Path) -> SitlSession:
    settings = gather(sitl_defaults(0), {"scenario": "paper-tank", "speed": 0.0, "sensors": "pose", "seed": seed}, {})
    settings.put("connect", (), "fuzz")
    settings.put("state_dir", str(folder), "fuzz")
    return open_sitl(settings, {}, log=False)


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
            fuzzer = Fuzzer(seed + 1000 * attempt, Path(folder) / str(attempt))
            before = _counts_of(total)
            attempt += 1
            try:
                while total.messages < messages:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")  # overflow in what is made of nonsense is no finding
                        fuzzer.episode()
                    _add(total, before, fuzzer.result)
                    total.seconds = time.monotonic() - began_s
                    total.rss_end_mb = process.memory_info().rss / 1e6
                    if not total.rss_start_mb and total.messages >= min(SETTLED_MESSAGES, messages // 2):
                        total.rss_start_mb = total.rss_end_mb
                    show(total)
            except Exception as error:  # noqa: BLE001 - finding exceptions is what this is for
                _add(total, before, fuzzer.result)
                place = _place(error)
                total.failures.append(f"seed {fuzzer.result.seed} tick {fuzzer.result.ticks}: {place}: {error}"[:600])
                show(total)
            finally:
                fuzzer.close()
    total.seconds = time.monotonic() - began_s
    return total


def _counts_of(total: Result) -> Result:
    """The counts as they are now."""
    return replace(total, accepted=Counter(total.accepted), failures=list(total.failures))


def _add(total: Result, before: Result, now: Result) -> None:
    total.messages = before.messages + now.messages
    total.ticks = before.ticks + now.ticks
    total.samples = before.samples + now.samples
    total.armed_ticks = before.armed_ticks + now.armed_ticks
    total.accepted = before.accepted + now.accepted


def _place(error: BaseException) -> str:
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} at {Path(frame.filename).name}:{frame.lineno} in {frame.name}"
