"""The autopilot as one function: ``Outputs = Autopilot.step(Inputs)``, once per tick of 10 ms.

Order within a tick: estimate -> MAVLink -> decide -> control (every fifth tick) -> allocate. No clock, socket, file or
random number lives here; real vehicle, simulation and replay differ only in who makes the inputs.
"""

from dataclasses import dataclass

import numpy as np

from autopilot.commander import Commander, Decision
from autopilot.control.allocation import Allocation
from autopilot.control.controller import MotionController
from autopilot.control.tracks import Tracks
from autopilot.core.frames import FloatArray
from autopilot.core.messages import (
    AID_SENSORS,
    MAX_THRUSTERS,
    ControlOutput,
    EstimatorInputs,
    Event,
    Fallback,
    Goal,
    Inputs,
    ModeState,
    NavCounters,
    NavState,
    NmpcStatus,
    Outputs,
    SolveStatus,
    ThrusterCommand,
)
from autopilot.core.params import ParamSet
from autopilot.core.samples import ObstacleTrack, PowerSample
from autopilot.core.vehicle import Vehicle
from autopilot.failsafes import Conditions
from autopilot.latency import LatencyCare
from autopilot.mavlink.api import GeoPoint, VehicleView
from autopilot.mavlink.server import MavlinkServer
from autopilot.thrusters import ThrusterCare
from estimator.protocol import Estimator
from mission.geodesy import Origin
from mission.store import Plans

CONTROL_EVERY_TICKS = 5
"""The NMPC runs at 20 Hz: counted in ticks, not timed."""

COUNTERS_EVERY_TICKS = 100
"""The estimator's counts go to the log once per second."""

UNUSED_COUNTS = ("rejected", "late", "duplicate", "future", "malformed")
"""Counts of samples and measurements that were not used."""

BLIND_ASCENT_SHARE = 0.35
"""Share of the thrust limit that lifts a vehicle without a position: about 0.2 m/s for the LBV150."""

VERTICAL = 2
"""Index of the vertical thruster."""


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


class Autopilot:
    """The service. Not thread-safe: one caller, time never going back."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        self._tick = 0
        self._thrust_n: FloatArray = np.zeros(4)
        self._pulse_n: FloatArray = np.zeros(4)
        self._care = ThrusterCare(parts.vehicle, parts.params)
        self._latency = LatencyCare(parts.vehicle, parts.params)
        self._aid_ratio: dict[str, float] = {}
        self._nav_errors = (0, 0, 0, 0)
        self._power: PowerSample | None = None
        self._tracks = Tracks()
        self._solver_failures = 0
        self._status: NmpcStatus | None = None
        self._decision: Decision | None = None
        self._command: ThrusterCommand | None = None
        self._goal: Goal | None = None
        self._nav: NavState | None = None
        self._events: tuple[Event, ...] = ()

    @property
    def nav(self) -> NavState | None:
        """The estimate of the last tick (what the vision front end predicts from)."""
        return self._nav

    def step(self, inputs: Inputs) -> Outputs:
        """One tick."""
        parts = self._parts
        t_us = inputs.t_us
        self._note(inputs)
        acting_n = self._latency.send(t_us, self._pulse_n)
        given = EstimatorInputs(thrust_n=self._care.share * acting_n, samples=parts.server.take_samples())
        nav = parts.estimator.step(t_us, inputs.samples + given.samples, given.thrust_n)
        self._nav = nav
        ahrs_us, aids, shadow = parts.estimator.ahrs_us, parts.estimator.take_aids(), parts.estimator.shadow
        self._aid_ratio.update((aid.sensor, aid.test_ratio) for aid in aids)
        counters = self._counted(t_us) if self._tick % COUNTERS_EVERY_TICKS == 0 else None
        tx = parts.server.step(
            t_us,
            inputs.mavlink_rx,
            self._view(inputs, nav),
            self._events,
            () if self._decision is None else self._decision.reached,
        )
        capability_n = parts.allocation.capability_n(self._supply_v())
        armed = parts.commander.armed
        self._latency.step(t_us, nav, armed=armed)
        thrusters = self._care.step(
            t_us,
            nav,
            acting_n,
            capability_n,
            self._goal,
            armed=armed and self._latency.prompt,
        )
        decision = parts.commander.step(
            Conditions(
                t_us=t_us,
                nav=nav,
                power=self._power,
                ahrs_age_s=None if ahrs_us is None else (t_us - ahrs_us) * 1e-6,
                solver_failures=self._solver_failures,
                unreachable=parts.controller.unreachable,
                nav_disagrees=shadow is not None and shadow.disagrees,
                thruster_share=tuple(self._care.share.tolist()),
                thruster_problem=self._care.problem,
                command_delay_s=self._latency.delay_s,
            )
        )
        control = self._control(t_us, nav, decision)
        command = self._allocate(t_us, decision.armed)
        self._decision, self._command, self._goal = decision, command, decision.goal
        self._events = parts.commander.drain_events() + tuple(
            Event(t_us=t_us, severity=severity, text=text) for severity, text in parts.controller.take_news()
        )
        self._tick += 1
        return Outputs(
            t_us=t_us,
            command=command,
            nav=nav,
            mode=ModeState(
                t_us=t_us,
                armed=decision.armed,
                custom_mode=parts.server.custom_mode(decision.mode),
                failsafes=decision.failsafes,
            ),
            mavlink_tx=tx,
            aids=aids,
            estimated_from=given,
            counters=counters,
            shadow=shadow,
            goal=decision.goal,
            control=control,
            progress=decision.progress,
            thrusters=thrusters,
            events=self._events + parts.server.take_notices(),
        )

    def _counted(self, t_us: int) -> NavCounters:
        """The estimator's counts, for the log and in short for ground stations."""
        counts = self._parts.estimator.counters()
        unused = {sensor: sum(counts.get(f"{sensor}.{what}", 0) for what in UNUSED_COUNTS) for sensor in AID_SENSORS}
        fixes = unused["markers"] + unused["external"]
        self._nav_errors = (
            sum(counts.get(f"ahrs.{what}", 0) for what in (*UNUSED_COUNTS, "old", "stuck")),
            fixes,
            sum(unused.values()) - fixes,
            counts.get("resets", 0),
        )
        return NavCounters(t_us=t_us, counts=counts)

    def _note(self, inputs: Inputs) -> None:
        for sample in inputs.samples:
            if isinstance(sample, PowerSample):
                self._power = sample
            elif isinstance(sample, ObstacleTrack):
                self._tracks.note(inputs.t_us, sample)

    def _control(self, t_us: int, nav: NavState | None, decision: Decision) -> ControlOutput | None:
        """Run the controller on its ticks, its inner loop in between; neutral when there is nothing to follow."""
        parts = self._parts
        if decision.goal is None or nav is None:
            self._thrust_n = np.zeros(4)
            if decision.blind_ascent:
                self._thrust_n[VERTICAL] = -BLIND_ASCENT_SHARE * parts.params["THR_LIMIT"]
            if self._goal is not None:
                parts.controller.reset()
                self._solver_failures, self._status = 0, None
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
            return ThrusterCommand(t_us=t_us, thrust_n=thrust_n, pwm_us=allocation.neutral(count) + unused)
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
            origin=_geo(parts.plans.origin),
            home=_geo(parts.plans.home),
            prearm_reasons=commander.readiness,
            failsafes=0 if decision is None else decision.failsafes,
            cpu_load=inputs.cpu_load,
            submerged=commander.submerged,
            dropped_rx=parts.server.dropped_rx,
            aid_ratio=self._aid_ratio,
            nav_errors=self._nav_errors,
            control=self._status,
        )


def _geo(point: Origin) -> GeoPoint:
    return GeoPoint(lat_deg=point.lat_deg, lon_deg=point.lon_deg, alt_m=point.alt_m)
