"""Plausibility checks of the battery monitor's readings, and messages about rejected ones."""

from autopilot.core import operator_messages as notices
from autopilot.core.messages import Event
from autopilot.core.operator_messages import OperatorText
from autopilot.core.samples import PowerSample, plausible
from autopilot.core.vehicle import BatteryLimits

SAY_EVERY_US = 60_000_000
"""Interval at which a continuing implausible reading is reported again."""

STALE_US = 3_000_000
"""Age beyond which a plausible reading followed by rejected ones only is no longer shown."""


class BatteryWatch:
    """The newest reading that this battery can have."""

    def __init__(self, limits: BatteryLimits) -> None:
        self._limits = limits
        self._good_us = 0
        self._refused_us: int | None = None
        """Time of the newest reading, if it was rejected."""
        self._reported_us: int | None = None
        self._events: list[Event] = []
        self.power: PowerSample | None = None
        self.refused = 0
        """Readings that no battery has, or that this one cannot have."""

    @property
    def shown(self) -> PowerSample | None:
        refused_us = self._refused_us
        return None if refused_us is not None and refused_us - self._good_us >= STALE_US else self.power

    def note(self, t_us: int, sample: PowerSample) -> bool:
        """Check a reading; whether it is plausible."""
        limits = self._limits
        if not plausible(sample):
            self._refuse(t_us, notices.BATTERY_IMPLAUSIBLE())
        elif not limits.can_be(sample.voltage_v):
            found = notices.BATTERY_VOLTAGE_IMPLAUSIBLE(
                voltage_v=sample.voltage_v, low_v=limits.min_v, high_v=limits.max_v
            )
            self._refuse(t_us, found)
        else:
            self.power, self._good_us, self._refused_us = sample, t_us, None
            return True
        return False

    def _refuse(self, t_us: int, text: OperatorText) -> None:
        self.refused += 1
        self._refused_us = t_us
        if self._reported_us is None or t_us - self._reported_us >= SAY_EVERY_US:
            self._reported_us = t_us
            self._events.append(text.event(t_us))

    def take_events(self) -> list[Event]:
        """Lines for the operator since the last call."""
        events, self._events = self._events, []
        return events
