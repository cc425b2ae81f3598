"""Device faults and recoveries: each is reported once and counted always."""

from collections.abc import Sequence

from autopilot.core import operator_messages as notices
from autopilot.core.messages import DeviceRole, DeviceTrouble, Event

SAY_EVERY_US = 5_000_000
"""Interval at which the same fault is reported again."""

DEVICE_OVER_US = 1_000_000
"""Time without fault after which a device counts as recovered."""

_DEVICE_NAMES = {
    DeviceRole.SENSORS: "Sensors",
    DeviceRole.CAMERA: "Camera",
    DeviceRole.THRUSTERS: "Thrusters",
    DeviceRole.WATCHDOG: "Thruster watchdog",
}
_SAID_ONCE = frozenset({DeviceRole.WATCHDOG})
"""Not reported again while it lasts: it has a failsafe of its own."""


class DeviceWatch:
    def __init__(self) -> None:
        self._reported_us: dict[DeviceRole, int] = {}
        self._last_us: dict[DeviceRole, int] = {}
        self.counts = dict.fromkeys(DeviceRole, 0)
        """Ticks on which a device could not be used."""
        self.watchdog_problem = ""
        """Fault of the watchdog process on this tick."""

    @property
    def thruster_problem(self) -> str:
        """Why commands do not reach the thrusters, "" while they do."""
        return "thruster output fails" if DeviceRole.THRUSTERS in self._last_us else ""

    def step(self, t_us: int, troubles: Sequence[DeviceTrouble]) -> list[Event]:
        events = []
        self.watchdog_problem = ""
        for trouble in troubles:
            device, name = trouble.device, _DEVICE_NAMES[trouble.device]
            self.counts[device] += 1
            if device is DeviceRole.WATCHDOG:
                self.watchdog_problem = trouble.text
            reported_us = self._last_us.get(device) if device in _SAID_ONCE else self._reported_us.get(device)
            if reported_us is None or t_us - reported_us >= SAY_EVERY_US:
                self._reported_us[device] = t_us
                events.append(notices.DEVICE_FAILED.event(t_us, device=name, reason=trouble.text))
            self._last_us[device] = t_us
        for device, last_us in tuple(self._last_us.items()):
            if t_us - last_us > DEVICE_OVER_US:
                del self._last_us[device]
                events.append(notices.DEVICE_WORKS.event(t_us, device=_DEVICE_NAMES[device]))
        return events
