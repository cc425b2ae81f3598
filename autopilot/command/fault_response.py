"""Response to faults inside the service.

A fault in a part of the thruster command path disables the controller: the vehicle keeps station on the fallback
law of :mod:`autopilot.control.robust.fallback` while the estimate is valid, for FS_FAULT_TIME, then the thrusters
are neutral. The controller is enabled again when the operator (or a failsafe) gives another order; a second fault
of the same kind within one arming disarms. A fault in a part that only serves clients (a message, telemetry) loses
that message.
"""

import math
from collections.abc import Hashable

import numpy as np

from autopilot.command.command_tuning import FAULT_RESPONSE
from autopilot.command.commander import Commander
from autopilot.command.control_step import ControlStep
from autopilot.control.robust.fallback import station_keeping_thrust
from autopilot.core import operator_messages as notices
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray
from autopilot.core.guard import Fault, Guard
from autopilot.core.messages import Event, NavHealth, NavState
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle

FLIGHT_PARTS = frozenset(("estimator", "thrusters", "commander", "controller", "allocation", "tick"))
"""Parts that thrust comes from."""


class FaultResponse:
    """Remembers faults, and acts upon them: a station that is held without the controller, or neutral thrusters."""

    def __init__(
        self, vehicle: Vehicle, params: ParamSet, guard: Guard, commander: Commander, motion: ControlStep
    ) -> None:
        self._allocator = ControlAllocator.of(vehicle)
        self._params = params
        self._guard = guard
        self._commander = commander
        self._motion = motion
        self._seen: set[tuple[str, str]] = set()
        self._reported_us: dict[tuple[str, str], int] = {}
        self._last: Fault | None = None
        self._since_us: int | None = None
        self._order: Hashable = None
        self._place: FloatArray | None = None
        self._faults: list[Fault] = []
        self._events: list[Event] = []
        self.stopped = False
        """Disarmed by a fault though the commander does not know: for good."""

    @property
    def holding(self) -> bool:
        """Whether the controller is disabled."""
        return self._since_us is not None

    @property
    def drives(self) -> bool:
        return self._commander.armed and not self.stopped

    def problem(self, t_us: int) -> str:
        """Recent fault in the thruster command path, "" if none."""
        if self._last is None or (self._since_us is None and t_us - self._last.t_us > FAULT_RESPONSE.shown_us):
            return ""
        return f"internal fault in {self._last.part}"

    def judge(self) -> None:
        """Respond to faults since the last call: hold, or disarm."""
        faults = self._guard.take()
        if not faults:
            return
        commander, guard = self._commander, self._guard
        self._faults += faults
        held = self.holding
        if self._take(faults, armed=commander.armed):
            self._events.append(notices.FAULT_DISARMED.event(guard.t_us, part=faults[-1].part))
            guard.run("disarming", lambda: commander.disarm(True), None)
            self.stopped = commander.armed
        elif self.holding and not held:
            guard.run("holding", commander.fall_back, None)
            guard.run("controller", self._motion.reset, None)
            # Orders as of now: others let the controller try again.
            self._order = self._given_order()

    def step(self) -> None:
        """Once per tick: disarming forgets, another order ends the fallback."""
        if not self._commander.armed:
            self._seen.clear()
        if not self._commander.armed or self._given_order() != self._order:
            self._since_us = self._place = None

    def take_faults(self) -> tuple[Fault, ...]:
        """Faults since the last call, for the log."""
        faults, self._faults = tuple(self._faults), []
        return faults

    def take_events(self) -> list[Event]:
        """Lines for the operator since the last call."""
        events, self._events = self._events, []
        return events

    def _given_order(self) -> Hashable:
        return self._commander.mode, self._commander.orders

    def _take(self, faults: tuple[Fault, ...], *, armed: bool) -> bool:
        """Take note of faults; whether they disarm."""
        disarms = False
        for fault in faults:
            if fault.part in FLIGHT_PARTS:
                self._last = fault
            self._say(fault)
            if not armed or fault.part not in FLIGHT_PARTS:
                continue
            disarms = disarms or fault.key in self._seen
            self._seen.add(fault.key)
            if self._since_us is None:
                self._since_us, self._place = fault.t_us, None
        return disarms

    def _say(self, fault: Fault) -> None:
        reported_us = self._reported_us.get(fault.key)
        if reported_us is not None and fault.t_us - reported_us < FAULT_RESPONSE.say_every_us:
            return
        self._reported_us.pop(fault.key, None)
        while len(self._reported_us) >= FAULT_RESPONSE.max_kinds:
            del self._reported_us[next(iter(self._reported_us))]
        self._reported_us[fault.key] = fault.t_us
        self._events.append(notices.FAULT.event(fault.t_us, line=fault.line))

    def thrust_n(self, t_us: int, nav: NavState | None, limit_n: FloatArray) -> FloatArray:
        """Thrust (n,) while the controller is out."""
        since_us = t_us if self._since_us is None else self._since_us
        if nav is None or nav.health is NavHealth.INVALID or t_us - since_us >= self._params["FS_FAULT_TIME"] * 1e6:
            return np.zeros(len(limit_n))
        x = nav.in_level_frame().model4_state()
        current = nav.current_ned_m_s
        if not math.isfinite(float(x.sum() + current.sum())):
            return np.zeros(len(limit_n))
        if self._place is None:
            self._place = x.copy()
        return station_keeping_thrust(self._allocator, x, self._place, current, limit_n)
