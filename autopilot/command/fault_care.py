"""What becomes of the vehicle when something inside the service fails.

A fault in a part that the thrusters' command comes from takes the controller out: the vehicle keeps its station on
the simple law of :mod:`autopilot.control.robust.fallback` while the estimate holds, for FS_FAULT_TIME, and then the
thrusters are neutral. The controller is tried again when the operator (or a failsafe) gives another order, and a
second fault of the same kind within one arming disarms. A fault in what only serves clients (a message, telemetry)
costs that message.
"""

import math
from collections.abc import Hashable, Sequence

import numpy as np

from autopilot.control.robust.fallback import station_keeping_thrust
from autopilot.core.frames import FloatArray
from autopilot.core.guard import Fault
from autopilot.core.messages import DeviceRole, DeviceTrouble, Event, NavHealth, NavState, Severity
from autopilot.core.model4 import NX, YAW
from autopilot.core.params import ParamSet
from autopilot.core.sharing import Sharing
from autopilot.core.vehicle import Vehicle

FLIGHT_PARTS = frozenset(("estimator", "thrusters", "commander", "controller", "allocation", "tick"))
"""Parts that thrust comes from."""

SAY_EVERY_US = 5_000_000
"""The same fault is said again after so long; it is counted every time."""

SHOWN_US = 5_000_000
"""So long after the last fault that thrust depends on the failsafe bit stays, and arming is refused."""

MAX_KINDS = 64
"""Kinds of fault that are remembered; with more of them the oldest goes."""

DEVICE_OVER_US = 1_000_000
"""A device that has worked for so long works again."""

_DEVICE_NAMES = {
    DeviceRole.SENSORS: "Sensors",
    DeviceRole.CAMERA: "Camera",
    DeviceRole.THRUSTERS: "Thrusters",
}


class FaultCare:
    """Remembers faults and says what they mean."""

    def __init__(self, vehicle: Vehicle, params: ParamSet) -> None:
        self._sharing = Sharing.of(vehicle)
        self._params = params
        self._seen: set[tuple[str, str]] = set()
        self._said_us: dict[tuple[str, str], int] = {}
        self._last: Fault | None = None
        self._since_us: int | None = None
        self._order: Hashable = None
        self._place: FloatArray | None = None

    @property
    def holding(self) -> bool:
        """Whether the controller is out."""
        return self._since_us is not None

    def problem(self, t_us: int) -> str:
        """What has failed of late of what thrust comes from, "" when nothing has."""
        if self._last is None or (self._since_us is None and t_us - self._last.t_us > SHOWN_US):
            return ""
        return f"internal fault in {self._last.part}"

    def take(self, faults: Sequence[Fault], *, armed: bool) -> tuple[list[Event], bool]:
        """Take note of faults: lines for the operator, and whether they disarm."""
        events: list[Event] = []
        disarms = False
        for fault in faults:
            if fault.part in FLIGHT_PARTS:
                self._last = fault
            said_us = self._said_us.get(fault.key)
            if said_us is None or fault.t_us - said_us >= SAY_EVERY_US:
                self._said_us.pop(fault.key, None)
                while len(self._said_us) >= MAX_KINDS:
                    del self._said_us[next(iter(self._said_us))]
                self._said_us[fault.key] = fault.t_us
                events.append(Event(t_us=fault.t_us, severity=Severity.CRITICAL, text=fault.line))
            if not armed or fault.part not in FLIGHT_PARTS:
                continue
            disarms = disarms or fault.key in self._seen
            self._seen.add(fault.key)
            if self._since_us is None:
                self._since_us, self._place = fault.t_us, None
        return events, disarms

    def ordered(self, order: Hashable) -> None:
        """Orders as of now, once the vehicle has been told to hold: others let the controller try again."""
        self._order = order

    def step(self, order: Hashable, *, armed: bool) -> None:
        """Once per tick: disarming forgets, another order ends the fallback."""
        if not armed:
            self._seen.clear()
        if not armed or order != self._order:
            self._since_us = self._place = None

    def thrust_n(self, t_us: int, nav: NavState | None, limit_n: FloatArray) -> FloatArray:
        """Thrust (n,) while the controller is out."""
        since_us = t_us if self._since_us is None else self._since_us
        if nav is None or nav.health is NavHealth.INVALID or t_us - since_us >= self._params["FS_FAULT_TIME"] * 1e6:
            return np.zeros(len(limit_n))
        x = np.empty(NX)
        x[:3], x[YAW] = nav.pos_ned_m, nav.rpy_rad[2]
        x[4:7], x[7] = nav.vel_water_frd_m_s, nav.rate_frd_rad_s[2]
        current = nav.current_ned_m_s
        if not math.isfinite(float(x.sum() + current.sum())):
            return np.zeros(len(limit_n))
        if self._place is None:
            self._place = x.copy()
        return station_keeping_thrust(
            self._sharing, x, self._place, current, np.minimum(limit_n, self._params["THR_LIMIT"])
        )


class DeviceCare:
    """Says when a device fails and when it works again."""

    def __init__(self) -> None:
        self._said_us: dict[DeviceRole, int] = {}
        self._last_us: dict[DeviceRole, int] = {}
        self.counts = dict.fromkeys(DeviceRole, 0)
        """Ticks on which a device could not be used."""

    @property
    def thruster_problem(self) -> str:
        """Why commands do not reach the thrusters, "" while they do."""
        return "thruster output fails" if DeviceRole.THRUSTERS in self._last_us else ""

    def step(self, t_us: int, troubles: Sequence[DeviceTrouble]) -> list[Event]:
        """Lines for the operator."""
        events = []
        for trouble in troubles:
            device, name = trouble.device, _DEVICE_NAMES[trouble.device]
            self.counts[device] += 1
            said_us = self._said_us.get(device)
            if said_us is None or t_us - said_us >= SAY_EVERY_US:
                self._said_us[device] = t_us
                events.append(Event(t_us=t_us, severity=Severity.CRITICAL, text=f"{name} failed: {trouble.text}"))
            self._last_us[device] = t_us
        for device, last_us in tuple(self._last_us.items()):
            if t_us - last_us > DEVICE_OVER_US:
                del self._last_us[device]
                text = f"{_DEVICE_NAMES[device]}: working again"
                events.append(Event(t_us=t_us, severity=Severity.NOTICE, text=text))
        return events
