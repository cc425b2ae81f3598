"""The autopilot as one function: ``Outputs = Autopilot.step(Inputs)``, once per tick of 10 ms.

Order within a tick: estimate -> MAVLink -> decide -> control (every fifth tick) -> allocate. No clock, socket, file
or random number lives here; real vehicle, simulation and replay differ only in who makes the inputs. Every part runs
under a guard (:mod:`autopilot.core.guard`): what one that fails means for the others stands in
:mod:`autopilot.command.fault_care`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from autopilot.command.camera_care import CameraCare
from autopilot.command.commander import Commander
from autopilot.command.decision import Decision
from autopilot.command.failsafes import Conditions
from autopilot.command.fault_care import DeviceCare, FaultCare
from autopilot.control.controller import MotionController
from autopilot.control.fence.tracks import Tracks
from autopilot.control.thrust.allocation import Allocation
from autopilot.control.thrust.delay import LatencyCare
from autopilot.control.thrust.losses import ThrusterCare
from autopilot.core.desk import Desk
from autopilot.core.frames import FloatArray
from autopilot.core.guard import Fault, Guard
from autopilot.core.marks import LoopPart, Marks, NoMarks
from autopilot.core.messages import (
    AID_SENSORS,
    MAX_THRUSTERS,
    AidStatus,
    ControlOutput,
    DeviceRole,
    EstimatorInputs,
    Event,
    Failsafe,
    Fallback,
    Goal,
    Inputs,
    MavlinkFrame,
    MissionProgress,
    ModeState,
    NavCounters,
    NavDoubt,
    NavHealth,
    NavState,
    NmpcStatus,
    Outputs,
    ProgressState,
    Severity,
    ShadowStatus,
    SolveStatus,
    ThrusterCommand,
    ThrusterHealthState,
)
from autopilot.core.params import ParamSet
from autopilot.core.samples import ExternalPoseSample, ObstacleTrack, PowerSample, plausible
from autopilot.core.vehicle import Vehicle
from autopilot.mavlink.api import VehicleView
from autopilot.mavlink.server import MavlinkServer
from estimator.protocol import Estimator
from mission.store import Plans

CONTROL_EVERY_TICKS = 5
"""The NMPC runs at 20 Hz: counted in ticks, not timed."""

WARM_AT_TICK = 100
"""A second after the start, when the links are served, the controller has prepared what its first routes need."""

COUNTERS_EVERY_TICKS = 100
"""The estimator's counts go to the log once per second."""

GOOD_FRAMES = ("frames.ok", "frames.late", "frames.foggy")
"""Counts of pictures that are not of refused ones."""
UNUSED_COUNTS = ("rejected", "late", "duplicate", "future", "malformed")
"""Counts of samples and measurements that were not used."""

BLIND_ASCENT_SHARE = 0.35
"""Share of the thrust limit that lifts a vehicle without a position: about 0.2 m/s for the LBV150."""

VERTICAL = 2
"""Index of the vertical thruster."""

LAST_ESTIMATE_US = 200_000
"""So long the last estimate stands in for an estimator that fails; then there is none."""

NO_EVENTS: tuple[Event, ...] = ()
NO_POSES: tuple[ExternalPoseSample, ...] = ()
NO_FRAMES: tuple[MavlinkFrame, ...] = ()

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Parts:
    """Everything that the composition root puts together."""

    vehicle: Vehicle
    params: ParamSet
    plans: Plans
    estimator: Estimator
    controller: MotionController
    allocation: Allocation
    commander: Commander
    server: MavlinkServer
    guard: Guard
    desks: tuple[Desk, ...] = ()
    """Where slow work is asked for: while the loop waits there it attends to its links."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Estimated:
    """What the estimator said on this tick."""

    nav: NavState | None
    ahrs_us: int | None
    aids: tuple[AidStatus, ...] = ()
    shadow: ShadowStatus | None = None
    doubts: frozenset[NavDoubt] = frozenset()


class Autopilot:
    """The service. Not thread-safe: one caller, time never going back."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        self.marks: Marks = NoMarks()
        """Takes the time of the parts of a tick, for the loop's statistics; nothing in here looks at it."""
        self._tick = 0
        self._doubts: frozenset[NavDoubt] = frozenset()
        self._thrust_n: FloatArray = np.zeros(4)
        self._pulse_n: FloatArray = np.zeros(4)
        self._care = ThrusterCare(parts.vehicle, parts.params)
        self._latency = LatencyCare(parts.vehicle, parts.params)
        self._aid_ratio: dict[str, float] = {}
        self._nav_errors = (0, 0, 0, 0)
        self._power: PowerSample | None = None
        self._bad_power = 0
        self._tracks = Tracks()
        self._solver_failures = 0
        self._status: NmpcStatus | None = None
        self._way_left_m: float | None = None
        self._decision: Decision | None = None
        self._command: ThrusterCommand | None = None
        self._goal: Goal | None = None
        self._nav: NavState | None = None
        self._nav_us = 0
        self._ahrs_us: int | None = None
        self._events: tuple[Event, ...] = ()
        self._shown: VehicleView | None = None
        self._given: Inputs | None = None
        self._fault_care = FaultCare(parts.vehicle, parts.params)
        self._devices = DeviceCare()
        self._camera = CameraCare()
        self._faults: list[Fault] = []
        self._fault_events: list[Event] = []
        self._stopped = False
        """Disarmed by a fault though the commander does not know: for good."""

    @property
    def nav(self) -> NavState | None:
        """The estimate of the last tick (what the vision front end predicts from)."""
        return self._nav

    def serve(self, t_us: int, rx: Sequence[MavlinkFrame]) -> tuple[MavlinkFrame, ...]:
        """What is received between two ticks: plan transfers are answered at once, the rest waits for the next tick."""
        return self._run("mavlink", lambda: self._parts.server.serve(t_us, rx), NO_FRAMES, lambda: rx)

    def beat(self) -> tuple[MavlinkFrame, ...]:
        """A HEARTBEAT for every link, of the last tick's state; changes nothing."""
        return self._run("heartbeat", self._parts.server.beat, NO_FRAMES)

    def step(self, inputs: Inputs) -> Outputs:
        """One tick. Raises only where the guard is set to."""
        guard = self._parts.guard
        guard.t_us = inputs.t_us
        self._given = inputs
        outputs = guard.run("tick", lambda: self._step(inputs), None, lambda: inputs)
        self._tick += 1
        if outputs is None:
            outputs = self._without_parts(inputs.t_us)
        return replace(outputs, faults=self._take_faults()) if self._faults else outputs

    def _step(self, inputs: Inputs) -> Outputs:
        parts = self._parts
        t_us = inputs.t_us
        self._run("inputs", lambda: self._note(inputs), None)
        acting_n = self._run("thrusters", lambda: self._latency.send(t_us, self._pulse_n), np.zeros_like(self._pulse_n))
        poses = self._run("message", parts.server.take_samples, NO_POSES)
        given = EstimatorInputs(thrust_n=self._care.share * acting_n, samples=poses)
        estimated = self._estimate(inputs, given)
        nav = self._nav = estimated.nav
        self.marks.mark(LoopPart.ESTIMATE)
        counters = None
        if self._tick % COUNTERS_EVERY_TICKS == 0:
            counters = self._run("counters", lambda: self._counted(t_us, inputs.frame_counts), None)
        tx = self._serve(inputs, nav)
        self.marks.mark(LoopPart.MAVLINK)
        thrusters = self._watch_thrusters(t_us, nav, acting_n)
        decision = self._decide(t_us, estimated)
        self.marks.mark(LoopPart.DECIDE)
        if self._tick == WARM_AT_TICK:
            self._run("warming", lambda: parts.controller.warm(parts.params), None)
        control = self._run("controller", lambda: self._control(t_us, nav, decision), None, lambda: (nav, decision))
        self.marks.mark(LoopPart.CONTROL)
        self._judge_faults()
        if self._fault_care.holding:
            self._hold_station(t_us, nav)
        command = self._command_of(t_us, decision.armed)
        self._decision, self._command, self._goal = decision, command, decision.goal
        events = self._run("commander", parts.commander.drain_events, NO_EVENTS)
        events += self._run("controller", lambda: self._news(t_us), NO_EVENTS)
        self._judge_faults()
        self._events = (*events, *self._fault_events)
        self._fault_events = []
        return Outputs(
            t_us=t_us,
            command=command,
            nav=nav,
            mode=ModeState(
                t_us=t_us,
                armed=decision.armed and parts.commander.armed and not self._stopped,
                custom_mode=parts.server.custom_mode(decision.mode),
                failsafes=decision.failsafes,
            ),
            mavlink_tx=tx,
            aids=estimated.aids,
            estimated_from=given,
            counters=counters,
            shadow=estimated.shadow,
            goal=decision.goal,
            control=control,
            progress=decision.progress,
            thrusters=thrusters,
            events=inputs.notices + self._events + self._run("telemetry", parts.server.take_notices, NO_EVENTS),
        )

    # Parts of a tick, each under the guard

    def _run(self, part: str, work: Callable[[], T], otherwise: T, given: Callable[[], object] | None = None) -> T:
        return self._parts.guard.run(part, work, otherwise, given or self._inputs)

    def _news(self, t_us: int) -> tuple[Event, ...]:
        """What the controller tells the operator."""
        news = self._parts.controller.take_news()
        return tuple(Event(t_us=t_us, severity=severity, text=text) for severity, text in news)

    def _inputs(self) -> object:
        return self._given

    def _estimate(self, inputs: Inputs, given: EstimatorInputs) -> _Estimated:
        """Estimate of this tick; when the estimator fails the last one for a moment, then none that is valid."""

        def estimate() -> _Estimated:
            estimator = self._parts.estimator
            nav = estimator.step(inputs.t_us, inputs.samples + given.samples, given.thrust_n)
            self._nav_us = inputs.t_us
            self._doubts = estimator.doubts
            remarks = estimator.take_remarks()
            self._fault_events += [Event(t_us=inputs.t_us, severity=Severity.WARNING, text=text) for text in remarks]
            return _Estimated(
                nav=nav,
                ahrs_us=estimator.ahrs_us,
                aids=estimator.take_aids(),
                shadow=estimator.shadow,
                doubts=self._doubts,
            )

        last = self._nav
        if last is not None:
            stale = inputs.t_us - self._nav_us > LAST_ESTIMATE_US
            last = replace(last, t_us=inputs.t_us, health=NavHealth.INVALID if stale else last.health)
        otherwise = _Estimated(nav=last, ahrs_us=self._ahrs_us, doubts=self._doubts)
        estimated = self._run("estimator", estimate, otherwise, lambda: (inputs, given))
        self._ahrs_us = estimated.ahrs_us
        self._aid_ratio.update((aid.sensor, aid.test_ratio) for aid in estimated.aids)
        return estimated

    def _serve(self, inputs: Inputs, nav: NavState | None) -> tuple[MavlinkFrame, ...]:
        """Requests of clients and telemetry."""
        reached = () if self._decision is None else self._decision.reached
        self._shown = view = self._run("view", lambda: self._view(inputs, nav), self._shown)
        if view is None:
            return ()
        events = self._events + inputs.notices
        return self._run(
            "mavlink",
            lambda: self._parts.server.step(inputs.t_us, inputs.mavlink_rx, view, events, reached),
            NO_FRAMES,
        )

    def _watch_thrusters(self, t_us: int, nav: NavState | None, acting_n: FloatArray) -> ThrusterHealthState | None:
        """Late commands and lost thrust."""
        parts = self._parts

        def watch() -> ThrusterHealthState | None:
            capability_n = parts.allocation.capability_n(self._supply_v())
            armed = parts.commander.armed
            self._latency.step(t_us, nav, armed=armed)
            # What never reached the thrusters says nothing about them.
            prompt = armed and self._latency.prompt and not self._devices.thruster_problem
            return self._care.step(t_us, nav, acting_n, capability_n, self._goal, armed=prompt)

        return self._run("thrusters", watch, None, lambda: (nav, acting_n, self._goal))

    def _decide(self, t_us: int, estimated: _Estimated) -> Decision:
        parts, ahrs_us, shadow = self._parts, estimated.ahrs_us, estimated.shadow
        self._judge_faults()
        conditions = Conditions(
            t_us=t_us,
            nav=estimated.nav,
            power=self._power,
            ahrs_age_s=None if ahrs_us is None else (t_us - ahrs_us) * 1e-6,
            solver_failures=self._solver_failures,
            unreachable=parts.controller.unreachable,
            way_left_m=self._way_left_m,
            nav_disagrees=shadow is not None and shadow.disagrees,
            nav_doubts=estimated.doubts,
            thruster_share=tuple(self._care.share.tolist()),
            thruster_problem=self._devices.thruster_problem or self._care.problem,
            thrusters_unseen=self._care.unseen,
            command_delay_s=self._latency.delay_s,
            fault=self._fault_care.problem(t_us),
        )
        decision = self._run("commander", lambda: parts.commander.step(conditions), None, lambda: conditions)
        self._judge_faults()
        if decision is None:
            decision = self._undecided(t_us)
        self._fault_care.step(self._order(), armed=parts.commander.armed)
        return replace(decision, armed=False, goal=None, blind_ascent=False) if self._stopped else decision

    def _undecided(self, t_us: int) -> Decision:
        """Stands in for a commander that fails: hold, as far as the fallback does."""
        commander, last = self._parts.commander, self._decision
        blank = MissionProgress(t_us=t_us, current_seq=-1, reached_seq=-1, lap=0, state=ProgressState.UNKNOWN)
        return Decision(
            armed=commander.armed,
            mode=commander.mode,
            goal=self._goal if commander.armed else None,
            blind_ascent=False,
            progress=blank if last is None else replace(last.progress, t_us=t_us),
            reached=(),
            failsafes=(0 if last is None else last.failsafes) | 1 << Failsafe.FAULT,
        )

    def _command_of(self, t_us: int, armed: bool) -> ThrusterCommand:
        """Pulses for this tick; neutral when they cannot be made, or when something that failed has disarmed."""
        command = self._run(
            "allocation", lambda: self._allocate(t_us, armed), None, lambda: (self._thrust_n, self._power)
        )
        self._judge_faults()
        drives = self._parts.commander.armed and not self._stopped
        return command if command is not None and (not armed or drives) else self._neutral(t_us)

    # What faults mean

    def _order(self) -> tuple[object, ...]:
        commander = self._parts.commander
        return commander.mode, commander.orders

    def _judge_faults(self) -> None:
        """Act upon what has failed since the last call: hold, or disarm."""
        faults = self._parts.guard.take()
        if not faults:
            return
        care, commander, guard = self._fault_care, self._parts.commander, self._parts.guard
        self._faults += faults
        held = care.holding
        events, disarms = care.take(faults, armed=commander.armed)
        self._fault_events += events
        if disarms:
            text = f"Disarmed: {faults[-1].part} failed twice the same way"
            self._fault_events.append(Event(t_us=guard.t_us, severity=Severity.CRITICAL, text=text))
            guard.run("disarming", lambda: commander.disarm(True), None)
            self._stopped = commander.armed
        elif care.holding and not held:
            guard.run("holding", commander.fall_back, None)
            guard.run("controller", self._parts.controller.reset, None)
            self._solver_failures, self._status = 0, None
            care.ordered(self._order())

    def _hold_station(self, t_us: int, nav: NavState | None) -> None:
        """The fallback's thrust instead of the controller's."""
        self._thrust_n = np.zeros(4)
        limit_n = self._run("allocation", self._thrust_limit_n, np.zeros(4))
        self._thrust_n = self._run(
            "fallback", lambda: self._fault_care.thrust_n(t_us, nav, limit_n), np.zeros(4), lambda: nav
        )

    def _without_parts(self, t_us: int) -> Outputs:
        """A tick of which nothing can be used: thrusters neutral, everything else as it was."""
        guard = self._parts.guard
        self._thrust_n = np.zeros(4)
        guard.run("tick", self._judge_faults, None)
        events, self._fault_events = tuple(self._fault_events), []
        self._events = events
        last = self._decision
        return Outputs(
            t_us=t_us,
            command=self._neutral(t_us),
            nav=self._nav,
            mode=ModeState(
                t_us=t_us,
                armed=self._parts.commander.armed and not self._stopped,
                custom_mode=0 if last is None else self._parts.server.custom_mode(last.mode),
                failsafes=(0 if last is None else last.failsafes) | 1 << Failsafe.FAULT,
            ),
            events=events,
        )

    def _neutral(self, t_us: int) -> ThrusterCommand:
        """No thrust; needs nothing that could fail."""
        neutral_us, count = self._parts.allocation.neutral_us, len(self._pulse_n)
        self._pulse_n = np.zeros(count)
        return ThrusterCommand(
            t_us=t_us,
            thrust_n=np.zeros(MAX_THRUSTERS),
            pwm_us=neutral_us + (0,) * (MAX_THRUSTERS - count),
        )

    def _take_faults(self) -> tuple[Fault, ...]:
        faults, self._faults = tuple(self._faults), []
        return faults

    def _counted(self, t_us: int, frames: Mapping[str, int] | None) -> NavCounters:
        """The counts of estimator, pictures and devices, for the log and in short for ground stations."""
        counts = self._parts.estimator.counters()
        unused = {sensor: sum(counts.get(f"{sensor}.{what}", 0) for what in UNUSED_COUNTS) for sensor in AID_SENSORS}
        fixes = unused["markers"] + unused["external"]
        pictures = {} if frames is None else {**frames, "frames.foggy": self._camera.foggy}
        refused = sum(count for name, count in pictures.items() if name not in GOOD_FRAMES)
        self._nav_errors = (
            sum(counts.get(f"ahrs.{what}", 0) for what in (*UNUSED_COUNTS, "old", "stuck")),
            fixes + refused,
            sum(unused.values()) - fixes,
            counts.get("resets", 0),
        )
        faults = {f"faults.{part}": count for part, count in self._parts.guard.counts.items()}
        troubles = {f"devices.{role.name.lower()}": count for role, count in self._devices.counts.items() if count}
        power = {"power.malformed": self._bad_power} if self._bad_power else {}
        return NavCounters(t_us=t_us, counts={**counts, **pictures, **faults, **troubles, **power})

    def _note(self, inputs: Inputs) -> None:
        self._fault_events += self._devices.step(inputs.t_us, inputs.troubles)
        self._fault_events += self._camera.step(inputs.t_us, inputs.pictures, inputs.samples)
        if any(trouble.device is DeviceRole.THRUSTERS for trouble in inputs.troubles):
            self._pulse_n = np.zeros_like(self._pulse_n)  # the last command was not taken
        for sample in inputs.samples:
            if isinstance(sample, PowerSample):
                if plausible(sample):
                    self._power = sample
                else:
                    self._bad_power += 1
            elif isinstance(sample, ObstacleTrack):
                self._tracks.note(inputs.t_us, sample)

    def _control(self, t_us: int, nav: NavState | None, decision: Decision) -> ControlOutput | None:
        """Run the controller on its ticks, its inner loop in between; neutral when there is nothing to follow."""
        parts = self._parts
        if self._fault_care.holding:
            return None
        if decision.goal is None or nav is None:
            self._thrust_n = np.zeros(4)
            if decision.blind_ascent:
                self._thrust_n[VERTICAL] = -BLIND_ASCENT_SHARE * parts.params["THR_LIMIT"]
            if self._goal is not None:
                parts.controller.reset()
                self._solver_failures, self._status, self._way_left_m = 0, None, None
            return None
        nav = self._latency.believed(t_us, nav)
        if self._tick % CONTROL_EVERY_TICKS and self._goal is not None:
            between = parts.controller.tick(t_us, nav)
            self._thrust_n = self._thrust_n if between is None else between
            return None
        control = parts.controller.step(
            t_us,
            nav,
            decision.goal,
            parts.commander.fence,
            parts.params,
            self._thrust_limit_n(),
            self._tracks.at(t_us),
            delay_s=None if self._latency.doubtful else self._latency.delay_s,
        )
        solved = control.status.status is SolveStatus.OK and control.status.fallback is Fallback.NONE
        self._solver_failures = 0 if solved or self._latency.doubtful else self._solver_failures + 1
        self._thrust_n, self._status = control.thrust_n, control.status
        self._way_left_m = _length_m(control.route_ned_m)
        return control

    def _thrust_limit_n(self) -> FloatArray:
        """What the thrusters can give at the present supply: a sagging battery and losses lower the bounds."""
        return self._parts.allocation.capability_n(self._supply_v()) * self._care.share

    def _supply_v(self) -> float | None:
        return None if self._power is None else self._power.voltage_v

    def _allocate(self, t_us: int, armed: bool) -> ThrusterCommand:
        allocation, count = self._parts.allocation, len(self._thrust_n)
        thrust_n = np.zeros(MAX_THRUSTERS)
        unused = (0,) * (MAX_THRUSTERS - count)
        if not armed:
            self._pulse_n = np.zeros(count)
            return ThrusterCommand(t_us=t_us, thrust_n=thrust_n, pwm_us=allocation.neutral_us + unused)
        thrust_n[:count] = self._thrust_n
        supply_v, share = self._supply_v(), self._care.share
        pulses_us = allocation.pulses_us(self._thrust_n, supply_v, share)
        # What the pulses will give, deadband and saturation included: the estimator's model lives on it.
        self._pulse_n = allocation.thrusts_n(pulses_us, supply_v)
        return ThrusterCommand(t_us=t_us, thrust_n=thrust_n, pwm_us=pulses_us + unused)

    def _view(self, inputs: Inputs, nav: NavState | None) -> VehicleView:
        parts, commander = self._parts, self._parts.commander
        decision = self._decision
        return VehicleView(
            t_us=inputs.t_us,
            armed=commander.armed,
            mode=commander.mode,
            intended_mode=commander.intended_mode,
            nav=nav,
            power=self._power,
            command=self._command,
            progress=None if decision is None else decision.progress,
            target_ned_m=None if self._goal is None else self._goal.pos_ned_m,
            origin=parts.plans.origin,
            home=parts.plans.home,
            prearm_reasons=commander.readiness,
            failsafes=0 if decision is None else decision.failsafes,
            cpu_load=inputs.cpu_load,
            under_way=commander.under_way,
            dropped_rx=parts.server.dropped_rx,
            aid_ratio=self._aid_ratio,
            nav_errors=self._nav_errors,
            nav_doubts=self._doubts,
            control=self._status,
        )


def _length_m(way: FloatArray) -> float | None:
    """Of a polyline (m, 2), None when there is none."""
    return float(np.hypot(*np.diff(way, axis=0).T).sum()) if len(way) > 1 else None
