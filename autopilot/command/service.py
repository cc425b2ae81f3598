"""The autopilot as one function: ``Outputs = Autopilot.step(Inputs)``, once per tick of 10 ms.

The table in :meth:`Autopilot._stages_of_tick` lists the stages of a tick in order. There is no clock, socket, file
or random number here; real vehicle, simulation and replay differ only in the source of the inputs. Every stage runs
under a guard (:mod:`autopilot.core.guard`); :mod:`autopilot.command.fault_response` decides how a fault affects the
others.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import TypeAlias

from autopilot.command.command_tuning import SERVICE
from autopilot.command.control_step import ControlStep
from autopilot.command.decision import Decision
from autopilot.command.environment import Environment
from autopilot.command.estimation import Estimated, Estimation
from autopilot.command.fault_response import FaultResponse
from autopilot.command.gps_fixes import GpsFixes
from autopilot.command.payload_orders import PayloadOrders
from autopilot.command.service_parts import ServiceParts
from autopilot.core.clients import ClientRecord
from autopilot.core.clock import DECISION_TICKS
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
from autopilot.core.payload import PayloadState
from autopilot.core.samples import CameraTiltSample, ExternalPoseSample, PlanarFixSample
from autopilot.core.stills import StillRecord
from autopilot.mavlink.api import VehicleView


@dataclass(slots=True, eq=False)
class TickState:
    """Data passed between the stages of one tick. If a stage fails, the values here stay: none, or neutral."""

    inputs: Inputs
    scheduled: bool
    """A fifth tick: decisions are taken."""
    acting_n: FloatArray
    """(n,) what sound thrusters give of the thrust that acts now."""
    poses: tuple[ExternalPoseSample | PlanarFixSample, ...] = ()
    given: EstimatorInputs | None = None
    estimated: Estimated | None = None
    nav: NavState | None = None
    counters: NavCounters | None = None
    tx: tuple[MavlinkFrame, ...] = ()
    thrusters: ThrusterHealthState | None = None
    decides: bool | None = None
    decision: Decision | None = None
    """Of this tick, or the last one's without what happened on that tick only."""
    shots: tuple[int, ...] = ()
    stills: tuple[StillRecord, ...] = ()
    control: ControlOutput | None = None
    command: ThrusterCommand | None = None
    events: tuple[Event, ...] = ()
    payload: PayloadState | None = None
    notices: tuple[Event, ...] = ()


StageWork: TypeAlias = Callable[[TickState], None]


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    part: str
    """The guard's name for it, "" = not guarded here: its fault costs the whole tick."""
    work: StageWork
    mark: LoopPart | None = None
    """The loop's statistics count everything since the last mark as this part."""
    every: int = 1
    """Only on ticks that this divides."""
    when: Callable[[TickState], bool] | None = None
    """Only on ticks on which this holds."""
    given: Callable[[TickState], object] = attrgetter("inputs")
    """Input of a failing stage, for the description of its fault."""


class Autopilot:
    """The service. Not thread-safe: one caller, time never going back."""

    def __init__(self, parts: ServiceParts) -> None:
        self._parts = parts
        parts.params.take_changes()  # what was set before the first tick is in the log's description
        self.marks: Marks = NoMarks()
        """Times the stages of a tick, for the loop's statistics only."""
        self._tick = 0
        self._actuation = parts.actuation
        self._environment = Environment(parts.vehicle, parts.params)
        self._status = self._environment.status
        self._estimation = Estimation(parts.estimator, parts.guard)
        self._motion = ControlStep(
            parts.vehicle, parts.controller, parts.actuation, parts.params, self._environment.tracks
        )
        self._motion.measured = self._status.measured
        self._faults = FaultResponse(parts.vehicle, parts.params, parts.guard, parts.commander, self._motion)
        self._orders = PayloadOrders(parts.equipment, parts.photographer)
        parts.plans.order_check = self._orders.refusal
        self._gps = GpsFixes(parts.commander.set_origin)
        self._order_events: list[Event] = []
        """Results of payload orders, for the operator."""
        self._given: Inputs | None = None
        self._view: VehicleView | None = None
        # Of the last tick:
        self._decision: Decision | None = None
        self._command: ThrusterCommand | None = None
        self._events: tuple[Event, ...] = ()
        self._unsent: tuple[Event, ...] = ()
        """Of the ticks since clients were last served, as :attr:`_reached`."""
        self._reached: tuple[int, ...] = ()
        self._decided_orders: Hashable = None
        """:meth:`_given_orders` of the last decision."""
        self._stages = self._stages_of_tick()

    def _stages_of_tick(self) -> tuple[Stage, ...]:
        """Stages of a tick, in order. What needs the rate of the inertial sensors and of the inner loop runs on every
        tick; decisions on every fifth, as the NMPC in the stage ``controller``, and clients on another fifth, or when
        they cannot wait. The monitors of the thrusters need every tick: with a fifth of them half a thruster is not
        found.
        """
        serves, decides = self._serves, self._decides
        return (
            Stage("inputs", self._take_inputs),
            Stage("camera", self._note_exposures),
            Stage("thrusters", self._send_thrust),
            Stage("message", self._take_poses),
            Stage("message", self._take_tracks),
            Stage("", self._estimate, LoopPart.ESTIMATE),
            Stage("counters", self._count, every=SERVICE.counters_every_ticks),
            Stage("view", self._refresh_view, when=serves),
            Stage("mavlink", self._serve_clients, LoopPart.MAVLINK, when=serves),
            Stage("thrusters", self._watch_thrusters, given=attrgetter("nav", "acting_n")),
            Stage("plans", self._take_verdicts),
            Stage("", self._update_status, when=decides),
            Stage("commander", self._decide, when=decides, given=lambda _: self._status),
            Stage("", self._respond_to_faults, LoopPart.DECIDE),
            Stage("warming", self._warm_controller, every=SERVICE.warm_at_tick),
            Stage("payload", self._carry_out_orders, when=decides, given=attrgetter("decision")),
            Stage("camera", self._photograph, given=attrgetter("nav")),
            Stage("controller", self._control, LoopPart.CONTROL, given=attrgetter("nav", "decision")),
            Stage("", self._hold_station_after_fault),
            Stage("allocation", self._allocate, given=lambda _: (self._motion.thrust_n, self._status.power)),
            Stage("", self._neutral_after_fault),
            Stage("commander", self._take_commander_events),
            Stage("controller", self._take_controller_events, when=decides),
            Stage("", self._collect_events),
            Stage("payload", self._step_equipment),
            Stage("telemetry", self._take_notices),
        )

    @property
    def nav(self) -> NavState | None:
        """Estimate of the last tick (for the prediction of the vision front end)."""
        return self._estimation.nav

    def serve(self, t_us: int, rx: Sequence[MavlinkFrame]) -> tuple[MavlinkFrame, ...]:
        """Handle messages received between ticks: plan transfers at once, the rest on the next tick."""
        return self._parts.guard.run("mavlink", lambda: self._parts.server.serve(t_us, rx), (), lambda: rx)

    def beat(self) -> tuple[MavlinkFrame, ...]:
        """A HEARTBEAT for every link, of the last tick's state; changes nothing."""
        return self._parts.guard.run("heartbeat", self._parts.server.beat, (), lambda: self._given)

    def standing(self, link: int, client: int) -> ClientRecord:
        """Priority of a client on a link, for keeping its slot when there are too few."""
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
        number, run_guarded, marks = self._tick, self._run_guarded, self.marks
        tick = TickState(inputs, number % DECISION_TICKS == 0, self._actuation.nothing(), decision=self._decision)
        for stage in self._stages:
            if stage.every > 1 and number % stage.every:
                continue
            if stage.when is not None and not stage.when(tick):
                continue
            if stage.part:
                run_guarded(stage, tick)
            else:
                stage.work(tick)
            if stage.mark is not None:
                marks.mark(stage.mark)
        return self._outputs(tick)

    def _serves(self, tick: TickState) -> bool:
        """Whether clients are served: a message, a notice or a transfer under way does not wait."""
        news = tick.inputs.mavlink_rx or tick.inputs.notices or self._unsent
        scheduled = self._tick % DECISION_TICKS == SERVICE.serve_after_ticks
        return scheduled or bool(news) or self._parts.server.busy

    def _decides(self, tick: TickState) -> bool:
        """Whether decisions are taken: a client's order or a device that fails does not wait. Traffic alone does not
        change when: a flight is the same with it."""
        if tick.decides is None:
            news = tick.inputs.troubles or self._given_orders(tick.inputs) != self._decided_orders
            tick.decides = tick.scheduled or self._decision is None or bool(news)
        return tick.decides

    def _given_orders(self, inputs: Inputs) -> Hashable:
        """By clients, and by a pilot through the flight controller."""
        commander, below = self._parts.commander, inputs.below
        pilot = None if below is None else (below.authority, below.acts, below.armed, below.text, below.rival)
        return commander.armed, commander.mode, commander.orders, self._parts.plans.revision, pilot

    def _run_guarded(self, stage: Stage, tick: TickState) -> None:
        self._parts.guard.run(stage.part, lambda: stage.work(tick), None, lambda: stage.given(tick))

    def _outputs(self, tick: TickState) -> Outputs:
        parts, inputs, decision, estimated = self._parts, tick.inputs, tick.decision, tick.estimated
        assert decision is not None and estimated is not None and tick.command is not None
        t_us = inputs.t_us
        return Outputs(
            t_us=t_us,
            command=tick.command,
            nav=tick.nav,
            mode=self._mode_state(t_us, armed=decision.armed and self._faults.drives, decision=decision),
            mavlink_tx=tick.tx,
            aids=estimated.aids,
            estimated_from=tick.given,
            counters=tick.counters,
            shadow=estimated.shadow,
            goal=decision.goal,
            control=tick.control,
            progress=decision.progress,
            thrusters=tick.thrusters,
            drop_weight=decision.drop_weight,
            hand_back=decision.hand_back,
            disarm_flight_controller=decision.disarm_flight_controller,
            payload=tick.payload,
            shots=tick.shots,
            stills=tick.stills,
            run_end=parts.commander.run_end,
            events=inputs.notices + self._events + tick.notices,
            parameters=parts.params.take_changes(),
        )

    def _without_parts(self, t_us: int) -> Outputs:
        """A tick of which nothing can be used: thrusters neutral, everything else as it was."""
        self._motion.thrust_n = self._actuation.nothing()
        self._parts.guard.run("tick", self._faults.judge, None)
        self._events = tuple(self._take_events())
        self._unsent += self._events
        return Outputs(
            t_us=t_us,
            command=self._actuation.neutral(t_us),
            nav=self.nav,
            mode=self._mode_state(t_us, armed=self._faults.drives, decision=self._decision, fault=True),
            drop_weight=self._decision is not None and self._decision.drop_weight,
            hand_back=self._decision is not None and self._decision.hand_back,
            disarm_flight_controller=self._parts.commander.disarms_flight_controller,
            events=self._events,
        )

    # Stages: inputs and estimate

    def _take_inputs(self, tick: TickState) -> None:
        inputs = tick.inputs
        if any(trouble.device is DeviceRole.THRUSTERS for trouble in inputs.troubles):
            self._actuation.not_taken()
        self._environment.note(inputs)
        self._actuation.supply_v = self._environment.supply_v
        below = inputs.below
        if below is not None and (below.rival or not below.acts):
            self._actuation.taken(below.pulses_us)

    def _note_exposures(self, tick: TickState) -> None:
        if self._parts.photographer is not None:
            self._parts.photographer.note(tick.inputs)

    def _send_thrust(self, tick: TickState) -> None:
        tick.acting_n = self._actuation.send(tick.inputs.t_us)

    def _take_poses(self, tick: TickState) -> None:
        inputs, commander = tick.inputs, self._parts.commander
        surface = self._gps.take(inputs.samples, self._parts.plans.origin, self.nav, armed=commander.armed)
        tick.poses = (*self._parts.server.take_samples(), *surface)

    def _take_tracks(self, tick: TickState) -> None:
        """Obstacles and vehicles that clients have reported."""
        tracks, removed = self._parts.server.take_tracks()
        if tracks or removed:
            self._environment.note_others(tick.inputs.t_us, tracks, removed, self._parts.commander.fence)

    def _estimate(self, tick: TickState) -> None:
        tick.given = EstimatorInputs(thrust_n=self._actuation.losses.effectiveness * tick.acting_n, samples=tick.poses)
        tick.estimated = self._estimation.step(tick.inputs, tick.given)
        tick.nav = tick.estimated.nav

    def _count(self, tick: TickState) -> None:
        """The counts of estimator, pictures, faults and devices."""
        pictures = self._environment.pictures(tick.inputs.frame_counts)
        faults = {f"faults.{part}": count for part, count in self._parts.guard.counts.items()}
        counts = {**self._estimation.counts(pictures), **faults, **self._environment.counts()}
        tick.counters = NavCounters(t_us=tick.inputs.t_us, counts=counts)

    # Stages: MAVLink

    def _refresh_view(self, tick: TickState) -> None:
        """Data for telemetry: estimate of this tick, decision and command of the last one."""
        parts, motion, environment, decision = self._parts, self._motion, self._environment, self._decision
        inputs, commander, power = tick.inputs, parts.commander, self._environment.power_watch.shown
        goal = None if decision is None else decision.goal
        self._view = VehicleView(
            t_us=inputs.t_us,
            armed=commander.shows_armed,
            mode=commander.mode,
            intended_mode=commander.intended_mode,
            nav=tick.nav,
            power=power,
            command=self._command,
            progress=None if decision is None else decision.progress,
            target_ned_m=None if goal is None else goal.pos_ned_m,
            origin=parts.plans.origin,
            home=parts.plans.home,
            arming_reasons=commander.arming_reasons,
            refusals=inputs.refusals,
            fenced=commander.fenced,
            failsafes=0 if decision is None else decision.failsafes,
            cpu_load=inputs.cpu_load,
            under_way=commander.under_way,
            dropped_rx=parts.server.dropped_rx,
            aid_ratio=self._estimation.aid_ratio,
            nav_errors=self._estimation.errors,
            nav_doubts=self._estimation.doubts,
            control=motion.status,
            ahead=motion.ahead,
            sensed=environment.sensed,
            energy_left_j=None if power is None else power.remaining * parts.vehicle.battery.capacity_j,
        )

    def _serve_clients(self, tick: TickState) -> None:
        inputs, view = tick.inputs, self._view
        if view is None:
            return
        reached, self._reached = self._reached, ()
        events, self._unsent = self._unsent + inputs.notices, ()
        tick.tx = self._parts.server.step(inputs.t_us, inputs.mavlink_rx, view, events, reached)

    # Stages: decision

    def _watch_thrusters(self, tick: TickState) -> None:
        environment = self._environment
        tick.thrusters = self._actuation.learn(
            tick.inputs.t_us,
            tick.nav,
            tick.acting_n,
            self._goal,
            armed=self._parts.commander.armed,
            reached=environment.acts,
            alone=environment.alone,
        )

    def _update_status(self, tick: TickState) -> None:
        """Update the status read by modes, failsafes and arming checks."""
        self._faults.judge()
        status, t_us, estimated = self._status, tick.inputs.t_us, tick.estimated
        actuation, motion, environment, server = self._actuation, self._motion, self._environment, self._parts.server
        assert estimated is not None
        shadow = estimated.shadow
        status.t_us = t_us
        status.nav = estimated.nav
        status.power = environment.power
        status.ahrs_age_s = None if estimated.ahrs_us is None else (t_us - estimated.ahrs_us) * 1e-6
        fix_us = self._estimation.fix_us
        status.fixed = fix_us is not None and t_us - fix_us < SERVICE.fixed_us
        status.solver_failures = motion.solver_failures
        status.unreachable = self._parts.controller.unreachable
        status.shortfall = self._parts.controller.shortfall
        status.path_left_m = motion.path_left_m
        status.nav_disagrees = shadow is not None and shadow.disagrees
        status.nav_doubts = estimated.doubts
        tilted = environment.tilt_problem
        status.camera_problem = "" if tilted is None else tilted.text
        status.thruster_effectiveness = actuation.losses.effectiveness_values
        status.thrusters_doubtful = actuation.losses.doubtful
        status.thruster_problem = environment.thruster_problem or actuation.losses.problem
        status.watchdog_problem = environment.devices.watchdog_problem
        status.thrusters_unseen = actuation.losses.unseen
        status.command_delay_s = actuation.delay.delay_s
        status.fault = self._faults.problem(t_us)
        status.below = environment.below
        status.refusals = environment.refusals
        status.sticks = server.pilot.sticks
        if server.last_gcs_t_us is not None:
            status.gcs_us = server.last_gcs_t_us
        if server.pilot.last_us is not None:
            status.pilot_us = server.pilot.last_us
        status.thrust_n = motion.thrust_n

    def _take_verdicts(self, _: TickState) -> None:
        self._parts.plans.tick()

    def _decide(self, tick: TickState) -> None:
        tick.decision, self._decided_orders = None, self._given_orders(tick.inputs)
        tick.decision = self._parts.commander.step(self._status)
        self._reached += tick.decision.reached

    def _respond_to_faults(self, tick: TickState) -> None:
        """A commander that fails holds; a fault may have stopped the vehicle for good."""
        self._faults.judge()
        decision = self._undecided(tick.inputs.t_us) if tick.decision is None else tick.decision
        self._faults.step()
        if self._faults.stopped:
            decision = replace(
                decision,
                armed=False,
                disarm_flight_controller=True,
                goal=None,
                blind_ascent=False,
                by_hand=None,
                motor_test=None,
            )
        tick.decision = decision

    def _undecided(self, t_us: int) -> Decision:
        """Decision after a fault of the commander: hold, by the fallback law."""
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
            disarm_flight_controller=commander.disarms_flight_controller,
        )

    def _carry_out_orders(self, tick: TickState) -> None:
        """Execute payload items of the mission passed on this tick."""
        assert tick.decision is not None
        if tick.decision.orders:
            self._order_events += self._orders.carry_out(tick.inputs.t_us, tick.decision.orders)

    def _photograph(self, tick: TickState) -> None:
        photographer, decision = self._parts.photographer, tick.decision
        assert decision is not None
        if photographer is not None:
            tick.shots, tick.stills = photographer.step(tick.inputs.t_us, tick.nav, armed=decision.armed)

    # Stages: thrust

    def _warm_controller(self, _: TickState) -> None:
        if self._tick == SERVICE.warm_at_tick:
            self._parts.controller.warm(self._parts.params)

    def _control(self, tick: TickState) -> None:
        """Run the controller on its ticks; neutral without a goal."""
        decision = tick.decision
        if self._faults.holding or decision is None:
            return
        due = self._tick % DECISION_TICKS == 0
        fence = self._parts.commander.fence
        tick.control = self._motion.step(tick.inputs.t_us, tick.nav, decision, self._goal, fence, due=due)

    def _hold_station_after_fault(self, tick: TickState) -> None:
        """The fallback's thrust instead of that of a controller that has failed."""
        self._faults.judge()
        if not self._faults.holding:
            return
        motion, nothing, guard, nav = self._motion, self._actuation.nothing(), self._parts.guard, tick.nav
        motion.thrust_n = nothing
        limit_n = guard.run("allocation", lambda: self._actuation.command_limit_n, nothing, lambda: tick.inputs)
        motion.thrust_n = guard.run(
            "fallback", lambda: self._faults.thrust_n(tick.inputs.t_us, nav, limit_n), nothing, lambda: nav
        )

    def _allocate(self, tick: TickState) -> None:
        decision = tick.decision
        assert decision is not None
        tick.command = self._actuation.command(
            tick.inputs.t_us, self._motion.thrust_n, armed=decision.armed, levels=decision.motor_test is None
        )

    def _neutral_after_fault(self, tick: TickState) -> None:
        """Neutral when pulses could not be made, or when something that failed has disarmed."""
        assert tick.decision is not None
        self._faults.judge()
        if tick.command is None or (tick.decision.armed and not self._faults.drives):
            tick.command = self._actuation.neutral(tick.inputs.t_us)
        self._decision, self._command = tick.decision.lasting, tick.command

    # Stages: notices to operators

    def _take_commander_events(self, tick: TickState) -> None:
        tick.events = self._parts.commander.drain_events()

    def _take_controller_events(self, tick: TickState) -> None:
        t_us, news = tick.inputs.t_us, self._parts.controller.take_news()
        tick.events += tuple(Event(t_us=t_us, severity=severity, text=text) for severity, text in news)

    def _collect_events(self, tick: TickState) -> None:
        self._faults.judge()
        self._events = (*tick.events, *self._take_events())
        self._unsent += self._events

    def _step_equipment(self, tick: TickState) -> None:
        equipment, shown = self._parts.equipment, self._environment.sensed.of(CameraTiltSample)
        equipment.note_tilt(None if shown is None else shown.angle_rad)
        tick.payload = equipment.step(tick.inputs.t_us)

    def _take_notices(self, tick: TickState) -> None:
        tick.notices = self._parts.server.take_notices()

    # Of the last tick

    @property
    def _goal(self) -> Goal | None:
        """The goal of the last tick."""
        return None if self._decision is None else self._decision.goal

    def _take_events(self) -> list[Event]:
        """Lines for the operator that are not the commander's."""
        photographer = self._parts.photographer
        events, self._order_events = self._order_events, []
        events += () if photographer is None else photographer.take_events()
        events += self._gps.take_events()
        return events + self._environment.take_events() + self._estimation.take_remarks() + self._faults.take_events()

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
