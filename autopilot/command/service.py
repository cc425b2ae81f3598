"""The autopilot as one function: ``Outputs = Autopilot.step(Inputs)``, once per tick of 10 ms.

Order within a tick: estimate -> MAVLink -> decide -> control (every fifth tick) -> allocate. No clock, socket, file
or random number lives here; real vehicle, simulation and replay differ only in who makes the inputs. Every part runs
under a guard (:mod:`autopilot.core.guard`): what one that fails means for the others stands in
:mod:`autopilot.command.fault_response`.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeVar

from autopilot.command.command_tuning import SERVICE
from autopilot.command.conditions import TickInputs
from autopilot.command.control_step import ControlStep
from autopilot.command.decision import Decision
from autopilot.command.estimation import Estimated, Estimation
from autopilot.command.facts import VehicleStatus
from autopilot.command.fault_response import FaultResponse
from autopilot.command.payload_orders import PayloadOrders
from autopilot.command.service_parts import Parts
from autopilot.command.surroundings import Environment
from autopilot.command.view import vehicle_view
from autopilot.core.clients import ClientRecord
from autopilot.core.frames import FloatArray
from autopilot.core.marks import LoopPart, Marks, NoMarks
from autopilot.core.messages import (
    ControlOutput,
    DeviceRole,
    EstimatorInputs,
    Event,
    Failsafe,
    Goal,
    Inputs,
    MavlinkFrame,
    MissionProgress,
    ModeState,
    NavCounters,
    NavState,
    Outputs,
    ProgressState,
    ThrusterCommand,
    ThrusterHealthState,
)
from autopilot.core.samples import ExternalPoseSample
from autopilot.core.stills import StillRecord
from autopilot.mavlink.api import VehicleView

NO_EVENTS: tuple[Event, ...] = ()
NO_POSES: tuple[ExternalPoseSample, ...] = ()
NO_FRAMES: tuple[MavlinkFrame, ...] = ()
NO_STILLS: tuple[tuple[int, ...], tuple[StillRecord, ...]] = ((), ())

T = TypeVar("T")


class Autopilot:
    """The service. Not thread-safe: one caller, time never going back."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        parts.params.take_changes()  # what was set before the first tick is in the log's description
        self.marks: Marks = NoMarks()
        """Takes the time of the parts of a tick, for the loop's statistics; nothing in here looks at it."""
        self._tick = 0
        self._actuation = parts.actuation
        self._surroundings = Environment(parts.vehicle, parts.params)
        self._estimation = Estimation(parts.estimator, parts.guard)
        self._motion = ControlStep(
            parts.vehicle, parts.controller, parts.actuation, parts.params, self._surroundings.tracks
        )
        self._motion.felt = self._surroundings.facts.felt
        self._faults = FaultResponse(parts.vehicle, parts.params, parts.guard, parts.commander, self._motion)
        self._orders = PayloadOrders(parts.equipment, parts.photographer)
        parts.plans.order_check = self._orders.refusal
        self._told: list[Event] = []
        """What became of orders to the equipment, for the operator."""
        self._given: Inputs | None = None
        self._shown: VehicleView | None = None
        # Of the last tick:
        self._decision: Decision | None = None
        self._command: ThrusterCommand | None = None
        self._events: tuple[Event, ...] = ()

    @property
    def nav(self) -> NavState | None:
        """The estimate of the last tick (what the vision front end predicts from)."""
        return self._estimation.nav

    def serve(self, t_us: int, rx: Sequence[MavlinkFrame]) -> tuple[MavlinkFrame, ...]:
        """What is received between two ticks: plan transfers are answered at once, the rest waits for the next tick."""
        return self._run("mavlink", lambda: self._parts.server.serve(t_us, rx), NO_FRAMES, lambda: rx)

    def beat(self) -> tuple[MavlinkFrame, ...]:
        """A HEARTBEAT for every link, of the last tick's state; changes nothing."""
        return self._run("heartbeat", self._parts.server.beat, NO_FRAMES)

    def standing(self, link: int, client: int) -> ClientRecord:
        """What a client of a link has shown of itself so far: who keeps its place where there are too few."""
        return self._parts.server.standing(link, client)

    def step(self, inputs: Inputs) -> Outputs:
        """One tick. Raises only where the guard is set to."""
        guard = self._parts.guard
        guard.t_us = inputs.t_us
        self._given = inputs
        outputs = guard.run("tick", lambda: self._step(inputs), None, lambda: inputs)
        self._tick += 1
        if outputs is None:
            outputs = self._without_parts(inputs.t_us)
        faults = self._faults.take_faults()
        return replace(outputs, faults=faults) if faults else outputs

    def _step(self, inputs: Inputs) -> Outputs:
        parts, actuation, t_us = self._parts, self._actuation, inputs.t_us
        self._run("inputs", lambda: self._note(inputs), None)
        if parts.photographer is not None:
            self._run("camera", partial(parts.photographer.note, inputs), None)
        acting_n = self._run("thrusters", lambda: actuation.send(t_us), actuation.nothing())
        poses = self._run("message", parts.server.take_samples, NO_POSES)
        self._run("message", lambda: self._note_others(t_us), None)
        given = EstimatorInputs(thrust_n=actuation.share * acting_n, samples=poses)
        estimated = self._estimation.step(inputs, given)
        nav = estimated.nav
        self.marks.mark(LoopPart.ESTIMATE)
        counters = None
        if self._tick % SERVICE.counters_every_ticks == 0:
            counters = self._run("counters", lambda: self._counted(inputs), None)
        tx = self._serve(inputs, nav)
        self.marks.mark(LoopPart.MAVLINK)
        thrusters = self._watch_thrusters(t_us, nav, acting_n)
        decision = self._decide(t_us, estimated)
        self.marks.mark(LoopPart.DECIDE)
        if self._tick == SERVICE.warm_at_tick:
            self._run("warming", lambda: parts.controller.warm(parts.params), None)
        if decision.orders:
            self._told += self._run("payload", lambda: self._orders.carry_out(t_us, decision.orders), [])
        shots, stills = self._photograph(t_us, nav, armed=decision.armed)
        control = self._run("controller", lambda: self._control(t_us, nav, decision), None, lambda: (nav, decision))
        self.marks.mark(LoopPart.CONTROL)
        self._faults.judge()
        if self._faults.holding:
            self._hold_station(t_us, nav)
        command = self._command_of(t_us, decision.armed)
        self._decision, self._command = decision, command
        events = self._run("commander", parts.commander.drain_events, NO_EVENTS)
        events += self._run("controller", lambda: self._news(t_us), NO_EVENTS)
        self._faults.judge()
        self._events = (*events, *self._take_events())
        return Outputs(
            t_us=t_us,
            command=command,
            nav=nav,
            mode=self._mode_state(t_us, armed=decision.armed and self._faults.drives, decision=decision),
            mavlink_tx=tx,
            aids=estimated.aids,
            estimated_from=given,
            counters=counters,
            shadow=estimated.shadow,
            goal=decision.goal,
            control=control,
            progress=decision.progress,
            thrusters=thrusters,
            drop_weight=decision.drop_weight,
            hand_back=decision.hand_back,
            stop_below=decision.stop_below,
            payload=self._run("payload", lambda: parts.equipment.step(t_us), None),
            shots=shots,
            stills=stills,
            run_end=parts.commander.run_end,
            events=inputs.notices + self._events + self._run("telemetry", parts.server.take_notices, NO_EVENTS),
            parameters=parts.params.take_changes(),
        )

    def _without_parts(self, t_us: int) -> Outputs:
        """A tick of which nothing can be used: thrusters neutral, everything else as it was."""
        self._motion.thrust_n = self._actuation.nothing()
        self._parts.guard.run("tick", self._faults.judge, None)
        self._events = tuple(self._take_events())
        return Outputs(
            t_us=t_us,
            command=self._actuation.neutral(t_us),
            nav=self.nav,
            mode=self._mode_state(t_us, armed=self._faults.drives, decision=self._decision, fault=True),
            drop_weight=self._decision is not None and self._decision.drop_weight,
            hand_back=self._decision is not None and self._decision.hand_back,
            stop_below=self._parts.commander.stops_below,
            events=self._events,
        )

    # Parts of a tick, each under the guard

    def _run(self, part: str, work: Callable[[], T], otherwise: T, given: Callable[[], object] | None = None) -> T:
        return self._parts.guard.run(part, work, otherwise, given or self._inputs)

    def _inputs(self) -> object:
        return self._given

    def _note(self, inputs: Inputs) -> None:
        """What comes in beside the estimator's samples."""
        if any(trouble.device is DeviceRole.THRUSTERS for trouble in inputs.troubles):
            self._actuation.not_taken()
        self._surroundings.note(inputs)
        self._actuation.supply_v = self._surroundings.supply_v
        below = inputs.below
        if below is not None and (below.rival or not below.acts):
            self._actuation.taken(below.pulses_us)

    def _counted(self, inputs: Inputs) -> NavCounters:
        """The counts of estimator, pictures, faults and devices."""
        pictures = self._surroundings.pictures(inputs.frame_counts)
        faults = {f"faults.{part}": count for part, count in self._parts.guard.counts.items()}
        counts = {**self._estimation.counts(pictures), **faults, **self._surroundings.counts()}
        return NavCounters(t_us=inputs.t_us, counts=counts)

    def _note_others(self, t_us: int) -> None:
        """Obstacles and vehicles that clients told of."""
        tracks, gone = self._parts.server.take_tracks()
        if tracks or gone:
            self._surroundings.note_others(t_us, tracks, gone, self._parts.commander.fence)

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

        def watch() -> ThrusterHealthState | None:
            reached = self._surroundings.acts
            armed = self._parts.commander.armed
            alone = self._surroundings.alone
            return self._actuation.learn(t_us, nav, acting_n, self._goal, armed=armed, reached=reached, alone=alone)

        return self._run("thrusters", watch, None, lambda: (nav, acting_n, self._goal))

    def _decide(self, t_us: int, estimated: Estimated) -> Decision:
        commander, faults = self._parts.commander, self._faults
        faults.judge()
        conditions = self._conditions(t_us, estimated)
        decision = self._run("commander", lambda: commander.step(conditions), None, lambda: conditions)
        faults.judge()
        if decision is None:
            decision = self._undecided(t_us)
        faults.step()
        if not faults.stopped:
            return decision
        return replace(
            decision, armed=False, stop_below=True, goal=None, blind_ascent=False, by_hand=None, motor_test=None
        )

    def _conditions(self, t_us: int, estimated: Estimated) -> TickInputs:
        actuation, motion, shadow = self._actuation, self._motion, estimated.shadow
        return TickInputs(
            t_us=t_us,
            nav=estimated.nav,
            power=self._surroundings.power,
            ahrs_age_s=None if estimated.ahrs_us is None else (t_us - estimated.ahrs_us) * 1e-6,
            solver_failures=motion.solver_failures,
            unreachable=self._parts.controller.unreachable,
            way_left_m=motion.way_left_m,
            nav_disagrees=shadow is not None and shadow.disagrees,
            nav_doubts=estimated.doubts,
            thruster_share=actuation.shares,
            thrusters_doubtful=actuation.doubtful_thrusters,
            thruster_problem=self._surroundings.thruster_problem or actuation.problem,
            watchdog_problem=self._surroundings.devices.watchdog_problem,
            thrusters_unseen=actuation.unseen,
            command_delay_s=actuation.delay_s,
            fault=self._faults.problem(t_us),
            below=self._surroundings.below,
            refusals=self._surroundings.refusals,
            sticks=self._parts.server.sticks,
            facts=self._facts(),
        )

    def _facts(self) -> VehicleStatus:
        """What has been heard, with what the links and the controller know."""
        server, facts = self._parts.server, self._surroundings.facts
        if server.last_gcs_t_us is not None:
            facts.gcs_us = server.last_gcs_t_us
        if server.last_pilot_t_us is not None:
            facts.pilot_us = server.last_pilot_t_us
        facts.thrust_n = self._motion.thrust_n
        return facts

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
            failsafes=_with_fault(last),
            drop_weight=last is not None and last.drop_weight,
            hand_back=last is not None and last.hand_back,
            stop_below=commander.stops_below,
        )

    def _photograph(
        self, t_us: int, nav: NavState | None, *, armed: bool
    ) -> tuple[tuple[int, ...], tuple[StillRecord, ...]]:
        """Stills to be taken, and what became of earlier ones."""
        photographer = self._parts.photographer
        if photographer is None:
            return NO_STILLS
        return self._run("camera", lambda: photographer.step(t_us, nav, armed=armed), NO_STILLS, lambda: nav)

    def _control(self, t_us: int, nav: NavState | None, decision: Decision) -> ControlOutput | None:
        """Run the controller on its ticks; neutral when there is nothing to follow."""
        if self._faults.holding:
            return None
        due = self._tick % SERVICE.control_every_ticks == 0
        return self._motion.step(t_us, nav, decision, self._goal, self._parts.commander.fence, due=due)

    def _news(self, t_us: int) -> tuple[Event, ...]:
        """What the controller tells the operator."""
        news = self._parts.controller.take_news()
        return tuple(Event(t_us=t_us, severity=severity, text=text) for severity, text in news)

    def _hold_station(self, t_us: int, nav: NavState | None) -> None:
        """The fallback's thrust instead of the controller's."""
        motion, nothing = self._motion, self._actuation.nothing()
        motion.thrust_n = nothing
        limit_n = self._run("allocation", lambda: self._actuation.limit_n, nothing)
        motion.thrust_n = self._run("fallback", lambda: self._faults.thrust_n(t_us, nav, limit_n), nothing, lambda: nav)

    def _command_of(self, t_us: int, armed: bool) -> ThrusterCommand:
        """Pulses for this tick; neutral when they cannot be made, or when something that failed has disarmed."""
        thrust_n = self._motion.thrust_n
        command = self._run(
            "allocation",
            lambda: self._actuation.command(t_us, thrust_n, armed=armed),
            None,
            lambda: (thrust_n, self._surroundings.power),
        )
        self._faults.judge()
        return command if command is not None and (not armed or self._faults.drives) else self._actuation.neutral(t_us)

    # What is told

    def _view(self, inputs: Inputs, nav: NavState | None) -> VehicleView:
        surroundings, motion = self._surroundings, self._motion
        return vehicle_view(
            self._parts,
            inputs,
            nav,
            self._estimation,
            surroundings.power_watch.shown,
            motion.status,
            motion.ahead,
            surroundings.sensed,
            self._decision,
            self._command,
        )

    @property
    def _goal(self) -> Goal | None:
        """Of the last tick."""
        return None if self._decision is None else self._decision.goal

    def _take_events(self) -> list[Event]:
        """Lines for the operator that are not the commander's."""
        photographer = self._parts.photographer
        told, self._told = self._told, []
        told += () if photographer is None else photographer.take_events()
        return told + self._surroundings.take_events() + self._estimation.take_remarks() + self._faults.take_events()

    def _mode_state(self, t_us: int, *, armed: bool, decision: Decision | None, fault: bool = False) -> ModeState:
        return ModeState(
            t_us=t_us,
            armed=armed,
            custom_mode=0 if decision is None else self._parts.server.custom_mode(decision.mode),
            failsafes=_with_fault(decision) if fault or decision is None else decision.failsafes,
        )


def _with_fault(last: Decision | None) -> int:
    """Failsafe bits of the last decision, and that of an internal fault."""
    return (0 if last is None else last.failsafes) | 1 << Failsafe.FAULT
