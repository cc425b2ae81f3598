"""The loop around ``Autopilot.step``: devices, links, log and pace. The same code at any speed.

A simulated vehicle is advanced to the time of the tick before it is asked for samples, which gives lockstep. With a
speed the loop waits for its clock and counts late ticks; without one it runs as fast as the machine allows, and
time is that of the ticks.
"""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

from autopilot.command.service import Autopilot
from autopilot.core.clients import Reach
from autopilot.core.clock import TICK_US, Clock
from autopilot.core.errors import DriverError
from autopilot.core.guard import Fault, Guard
from autopilot.core.marks import LoopPart, TickTimer
from autopilot.core.messages import (
    Between,
    DeviceRole,
    DeviceTrouble,
    Event,
    FlightControllerState,
    Inputs,
    MavlinkFrame,
    Outputs,
    Severity,
    ThrusterCommand,
)
from autopilot.core.nondeterminism import Note
from autopilot.core.samples import CameraFrame, Sample
from autopilot.core.stills import StoredStill
from autopilot.drivers.protocols import Link
from autopilot.estimator.vision_worker import VisionWorker
from autopilot.run.clocks import DayClock
from autopilot.run.loop_account import LoopAccount
from autopilot.run.outside import (
    Actuates,
    DisarmsFlightController,
    HandsBack,
    HasWatchdog,
    InProcessClient,
    Onlooker,
    Recorder,
    VehicleIo,
    WeightRelease,
)
from autopilot.run.still_files import StillStore
from autopilot.run.transport import Transport

SERVE_MARGIN_S = 0.0005
"""Serving ends this long before a tick."""

HOLD_S = 0.02
"""Interval at which links are served while the simulation is paused."""

SKIP_TICKS = 5
"""A loop on a real vehicle that is later than this skips to the present."""

STAND_DOWN_TICKS = 300
"""Timeout for the flight controller's confirmation of disarming at the end: twelve requests in 3 s."""
NOT_STOPPED = "Flight controller has not confirmed that it is disarmed: use its own switch"

NO_SAMPLES: Sequence[Sample] = ()
NO_PICTURES: Sequence[CameraFrame] = ()
NO_STILLS: tuple[StoredStill, ...] = ()

MAX_SHOWN_FAULTS = 20
"""Kinds of internal faults that are printed on the console; all are in the log."""

T = TypeVar("T")


class Runtime:
    """Owns the outside world of one service."""

    def __init__(
        self,
        service: Autopilot,
        device: VehicleIo,
        vision: VisionWorker | None,
        links: Sequence[Link],
        recorder: Recorder,
        clock: Clock,
        *,
        peers: Sequence[InProcessClient] = (),
        on_tick: Callable[[Outputs], None] = lambda _: None,
        paced: bool = False,
        notices: Callable[[], Sequence[tuple[Severity, str]]] = lambda: (),
        below: Callable[[int], FlightControllerState | None] = lambda _: None,
        refusals: Callable[[int], tuple[str, ...]] = lambda _: (),
        skips: bool = False,
        onlooker: Onlooker | None = None,
        hold: Callable[[int], bool] = lambda _: False,
        stills: StillStore | None = None,
        answers: Callable[[], tuple[Note, ...]] = tuple,
        mishaps: Callable[[Inputs], Inputs] = lambda inputs: inputs,
    ) -> None:
        """``notices``: messages to operators about devices and links (severity, text), called once per tick.
        ``below``: state of the flight controller, if there is one; ``refusals``: the devices' reasons against
        arming. ``skips``: ticks that are far too late are skipped (real world). ``hold``: called before every
        tick with the time of the last: whether the simulation is paused. ``stills``: storage of stills, None
        without a camera. ``answers``: recorded nondeterministic results, called once per tick after its step.
        ``mishaps``: adds injected faults to the inputs (simulation).
        """
        self._stills = stills
        self._answers = answers
        self._mishaps = mishaps
        self._refusals = refusals
        self._skips = skips
        self._onlooker = onlooker
        self._hold = hold
        self._below = below
        self._notices = notices
        self._service = service
        self._step: Callable[[Inputs], Outputs] = service.step
        self._device = device
        # Optional capabilities of the device (isinstance with a protocol is slow).
        self._release = device if isinstance(device, WeightRelease) else None
        self._carries = device if isinstance(device, Actuates) else None
        self._below_us = device if isinstance(device, HandsBack) else None
        self._watchdog = device if isinstance(device, HasWatchdog) else None
        self._stopped_by = device if isinstance(device, DisarmsFlightController) else None
        self._vision = vision
        self._outside: tuple[Fault, ...] = ()
        """Exceptions of drivers on this tick."""
        self._between: list[Between] = []
        self._between_rx: list[MavlinkFrame] = []
        self._between_tx: list[MavlinkFrame] = []
        self._recorder = recorder
        self._clock = clock
        self._peers = tuple(peers)
        self._on_tick = on_tick
        self._paced = paced
        self._day = DayClock()
        self._troubles: list[DeviceTrouble] = []
        self._guard = Guard()
        self._transport = Transport(links, guard=self._guard)
        self._transport.judge_by(lambda link, client: service.standing(link, client))
        self._shown_faults: set[tuple[str, str]] = set()
        self._rest: ThrusterCommand | None = None
        self._peer_rx: list[MavlinkFrame] = []
        self.watch = TickTimer()
        """Time of the stages of the present tick so far."""
        service.marks = self.watch
        self._spent = LoopAccount(paced=paced)
        self.counters = self._spent.counters

    def take_over(self, frames: Sequence[MavlinkFrame]) -> None:
        """Bytes received before the first tick; handed over with that tick."""
        self._peer_rx += frames

    def wrap_step(self, step: Callable[[Inputs], Outputs]) -> None:
        """Put something round ``Autopilot.step`` (benchmarks that time it)."""
        self._step = step

    def run(self, *, duration_s: float | None, stop: Callable[[], bool]) -> None:
        """Tick until ``duration_s`` of vehicle time have passed or ``stop`` returns True; then close everything."""
        end_tick = None if duration_s is None else round(duration_s * 1e6 / TICK_US)
        tick = 0
        try:
            while not stop() and (end_tick is None or tick < end_tick):
                if self._hold(tick * TICK_US):
                    self._serve((tick + 1) * TICK_US, HOLD_S)
                    self.attend()
                    continue
                tick += 1 + self.late_ticks(tick + 1)
                self.tick(tick * TICK_US)
        finally:
            try:
                self._stand_down(tick)
            finally:
                self.close()

    def _stand_down(self, tick: int) -> None:
        """Disarm the flight controller at the end, if there is one that is ours to disarm."""
        device = self._stopped_by
        if device is None or tick == 0:
            return
        for later in range(tick + 1, tick + 1 + STAND_DOWN_TICKS):
            t_us = self._clock.wait_until(later * TICK_US) if self._paced else later * TICK_US
            if self._try(t_us, DeviceRole.THRUSTERS, partial(device.stand_down, t_us), False):
                return
            self.attend()
        _show(NOT_STOPPED)

    def late_ticks(self, tick: int) -> int:
        """Number of ticks to skip: run in a burst, they would get measurements taken since."""
        late = (self._clock.now_us() - tick * TICK_US) // TICK_US if self._skips else 0
        if late <= SKIP_TICKS:
            return 0
        self.counters.overruns += late
        self.counters.skipped += late
        return late

    def tick(self, t_us: int) -> Outputs:
        """One tick: wait, gather, step, act, record."""
        in_time = self._clock.now_us() <= t_us
        late_us = self._wait(t_us) - t_us
        if late_us > TICK_US:
            self.counters.overruns += 1
        watch, self._guard.t_us = self.watch, t_us
        watch.begin(1e-6 * late_us if in_time else 0.0)
        self._try(t_us, DeviceRole.SENSORS, lambda: self._device.advance(t_us), None)
        problem = "" if self._watchdog is None else self._watchdog.watchdog(t_us)
        if problem:
            self._troubles.append(DeviceTrouble(t_us=t_us, device=DeviceRole.WATCHDOG, text=problem))
        self.attend()
        frames = self._try(t_us, DeviceRole.CAMERA, lambda: self._device.frames(t_us), NO_PICTURES)
        samples = list(self._try(t_us, DeviceRole.SENSORS, lambda: self._device.poll(t_us), NO_SAMPLES))
        watch.mark(LoopPart.DEVICE)
        if self._vision is not None:
            samples += self._try(
                t_us, DeviceRole.CAMERA, partial(self._detect_markers, self._vision, t_us, frames), NO_SAMPLES
            )
            watch.mark(LoopPart.VISION)
        inputs = Inputs(
            t_us=t_us,
            samples=tuple(samples),
            mavlink_rx=self._receive(t_us),
            overruns=self.counters.overruns,
            cpu_load=self.counters.cpu_load,
            log_lost=self._recorder.lost,
            clock_jump_s=self._day.jump_s() if self._paced else 0.0,
            troubles=tuple(self._troubles),
            pictures=() if self._vision is None else self._vision.take_reports(),
            frame_counts=None if self._vision is None else self._vision.counters(),
            notices=(
                *self._transport.take_notices(t_us),
                *(Event(t_us=t_us, severity=severity, text=text) for severity, text in self._notices()),
            ),
            refusals=self._refusals(t_us),
            below=self._try(t_us, DeviceRole.THRUSTERS, lambda: self._below(t_us), None),
            **self._stills_of(t_us, frames),
        )
        self._troubles = []
        watch.mark(LoopPart.RECEIVE)
        inputs = self._mishaps(inputs)
        outputs = self._step(inputs)
        watch.mark(LoopPart.ALLOCATE)
        self._drive(t_us, outputs)
        if self._stills is not None and outputs.shots:
            self._stills.request(t_us, outputs.shots)
        watch.mark(LoopPart.WRITE)
        outputs = self._with_faults(outputs)
        self._send(t_us, outputs.mavlink_tx)
        watch.mark(LoopPart.SEND)
        guard = self._guard
        guard.run("log", lambda: self._recorder.record(*self._with_between(inputs, outputs), frames), None)
        guard.run("outside", lambda: self._on_tick(outputs), None)
        onlooker = self._onlooker
        if onlooker is not None:
            guard.run("view", lambda: onlooker.tick(inputs, outputs, frames), None)
        watch.mark(LoopPart.RECORD)
        self._account(t_us)
        return outputs

    def close(self) -> None:
        """Thrusters neutral first, then links and threads."""
        try:
            self._device.close()
        finally:
            if self._vision is not None:
                self._vision.close()
            self._transport.close()

    # Devices

    def _detect_markers(self, vision: VisionWorker, t_us: int, frames: Sequence[CameraFrame]) -> list[Sample]:
        """Sightings that are there, and the new pictures handed in."""
        failed = vision.failed
        found: list[Sample] = [*vision.collect(t_us)]
        if vision.failed > failed:
            text = "detection fails at its pictures"
            self._troubles.append(DeviceTrouble(t_us=t_us, device=DeviceRole.CAMERA, text=text))
        for frame in frames:
            vision.submit(t_us, frame, self._service.nav)
        return found

    def _stills_of(self, t_us: int, frames: Sequence[CameraFrame]) -> dict[str, Any]:
        """Results of the still camera as fields of ``Inputs``."""
        stills = self._stills
        if stills is None:
            return {}
        stored = self._guard.run("camera", lambda: stills.take(t_us, frames), NO_STILLS)
        return {"camera": self._guard.run("camera", stills.report, None), "stills": stored}

    def _try(self, t_us: int, device: DeviceRole, work: Callable[[], T], otherwise: T) -> T:
        """Call a device; a failure is reported to the service on the next tick, which continues without it."""
        try:
            return work()
        except (DriverError, OSError) as error:
            text = str(error)
        except Exception as error:  # noqa: BLE001 - a driver's own fault: kept, or raised again where the guard is set to
            self._guard.note(f"device {device.name.lower()}", error)
            text = f"internal fault ({type(error).__name__})"
        self._troubles.append(DeviceTrouble(t_us=t_us, device=device, text=text))
        return otherwise

    def _drive(self, t_us: int, outputs: Outputs) -> None:
        """Command the thrusters; when that fails, neutral at least is tried."""
        if not outputs.mode.armed:
            self._rest = outputs.command
        before = len(self._troubles)
        self._try(t_us, DeviceRole.THRUSTERS, lambda: self._device.write(t_us, outputs.command), None)
        rest = self._rest
        if len(self._troubles) > before and rest is not None:
            still = replace(rest, armed=outputs.command.armed)  # to stand is not to disarm a vehicle below
            self._try(t_us, DeviceRole.THRUSTERS, lambda: self._device.write(t_us, still), None)
            del self._troubles[before + 1 :]
        if outputs.drop_weight and self._release is not None:
            self._try(t_us, DeviceRole.THRUSTERS, partial(self._release.release_weight, t_us), None)
        if outputs.payload is not None and self._carries is not None:
            self._try(t_us, DeviceRole.THRUSTERS, partial(self._carries.actuate, t_us, outputs.payload), None)
        if outputs.disarm_flight_controller and self._stopped_by is not None:
            self._try(t_us, DeviceRole.THRUSTERS, partial(self._stopped_by.disarm_flight_controller, t_us), None)
        if outputs.hand_back and self._below_us is not None:
            self._try(t_us, DeviceRole.THRUSTERS, partial(self._below_us.hand_back, t_us), None)

    def _with_faults(self, outputs: Outputs) -> Outputs:
        """Add driver faults to the service's; the first of each kind is printed on the console."""
        self._outside = self._guard.take() + (() if self._vision is None else self._vision.guard.take())
        faults = outputs.faults + self._outside
        for fault in faults:
            if fault.key not in self._shown_faults and len(self._shown_faults) < MAX_SHOWN_FAULTS:
                self._shown_faults.add(fault.key)
                _show(f"{fault.line}\n{fault.traceback}")
        return replace(outputs, faults=faults) if faults else outputs

    # Links

    def attend(self) -> None:
        """Keep-alive while the loop waits: a HEARTBEAT, when none has been sent for too long in real time."""
        if self._transport.beat_due:
            beat = self._service.beat()
            self._transport.beat(beat)
            if self._paced:  # else the log would depend on how fast the machine is
                self._between_tx += beat
                self._between.append(Between(t_us=None))

    def _wait(self, t_us: int) -> int:
        """Wait for the tick. In real time, messages received meanwhile are served."""
        self.attend()
        if self._paced:
            while (left_s := self._clock.left_s(t_us) - SERVE_MARGIN_S) > 0.0:
                self._serve(t_us, left_s)
                self.attend()
        return self._clock.wait_until(t_us)

    def _serve(self, t_us: int, left_s: float) -> None:
        """Wait for the links and let the service answer urgent messages; logged with the following tick."""
        received = self._transport.wait(t_us, left_s)
        if not received:
            return
        begin_s = time.perf_counter()
        now_us = min(max(self._clock.now_us(), t_us - TICK_US), t_us - 1)
        answers = self._service.serve(now_us, received)
        self._transport.send(answers)
        self._between_rx += received
        self._between.append(Between(t_us=now_us, frames=len(received)))
        self._between_tx += answers
        self._spent.busy(time.perf_counter() - begin_s)

    def _receive(self, t_us: int) -> tuple[MavlinkFrame, ...]:
        received = self._transport.receive(t_us) + self._peer_rx
        self._peer_rx = []
        return tuple(received)

    def _send(self, t_us: int, frames: Sequence[MavlinkFrame]) -> None:
        self._transport.send(frames)
        for offset, peer in enumerate(self._peers):
            index = len(self._transport) + offset
            mine = [frame.data for frame in (*self._between_tx, *frames) if frame.link in (index, -1)]
            self._peer_rx += [
                MavlinkFrame(link=index, data=data, reach=Reach.PROCESS) for data in peer.step(t_us, mine)
            ]

    def _with_between(self, inputs: Inputs, outputs: Outputs) -> tuple[Inputs, Outputs]:
        """A tick for the log, with messages received and sent since the previous tick."""
        rx, tx, self._between_rx, self._between_tx = self._between_rx, self._between_tx, [], []
        calls, self._between, answers = tuple(self._between), [], self._answers()
        if calls or answers or self._outside:
            received = (*rx, *inputs.mavlink_rx)
            inputs = replace(inputs, mavlink_rx=received, between=calls, answers=answers, faults=self._outside)
        if tx:
            outputs = replace(outputs, mavlink_tx=(*tx, *outputs.mavlink_tx))
        return inputs, outputs

    def _account(self, t_us: int) -> None:
        dropped_frames = 0 if self._vision is None else self._vision.dropped
        recorder = self._recorder
        stats = self._spent.tick(
            t_us,
            self.watch,
            dropped_log=recorder.dropped,
            dropped_frames=dropped_frames,
            queued=recorder.queued,
        )
        if stats is not None:
            recorder.loop_stats(stats)
            if self._onlooker is not None:
                self._onlooker.loop_stats(stats)


def _show(text: str) -> None:
    """Print from a thread: a paused terminal or an unread pipe must not stop the loop."""

    def write() -> None:
        with contextlib.suppress(OSError, ValueError):
            print(text, file=sys.stderr)

    threading.Thread(target=write, name="fault", daemon=True).start()
