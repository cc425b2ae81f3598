"""Evaluates the failsafe table (:data:`autopilot.command.failsafe_table.ROWS`) once per tick.

The most severe action wins and never weakens until the vehicle is disarmed or the operator takes over: by a mode
change after the condition has cleared, at once for the rows that FS_OVERRIDE names. Messages are made when a
failsafe is raised or cleared.
"""

import math
from collections.abc import Iterator, Mapping, Sequence

from autopilot.command.failsafe_inputs import FailsafeInputs
from autopilot.command.failsafe_table import RANK, ROWS, Bound, Effect, FailsafeRow
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.core import operator_messages as notices
from autopilot.core.arming_reasons import ALL_MODES, COMPONENT_OF, ArmingReason, HealthComponent, ModeGroup
from autopilot.core.messages import Event, Failsafe, NavDoubt, NavHealth, Severity
from autopilot.core.params import ParamSet
from autopilot.core.samples import PowerSample

AHRS_TIMEOUT_S = 0.5
"""50 AHRS frames missing: attitude is no longer known."""


POSE_REMEDY = "check the pose source"
MARKER_FACTS = {
    "fix_remedy": "go to markers",
    "suspect": "map or calibration suspect: check both",
    "rejected": "camera rejected: check its pictures",
    "struck": "camera",
}
"""What failsafes say of the source of the position where it is markers,"""
POSE_FACTS = {
    "fix_remedy": POSE_REMEDY,
    "suspect": "position source suspect: check it",
    "rejected": "poses rejected: check their source",
    "struck": "vehicle",
}
"""and where it is not."""


class _RowState:
    __slots__ = (
        *("action", "active", "enter", "enter_us", "hold_us", "leave", "leave_us"),
        *("level", "raised_us", "row", "sign", "since_us", "text", "waits"),
    )

    def __init__(self, row: FailsafeRow) -> None:
        self.row = row
        self.level = row.level
        self.sign = -1.0 if row.below else 1.0
        self.enter = self.leave = math.inf
        self.enter_us = self.hold_us = 0.0
        self.leave_us = row.leave_s * 1e6
        self.action: Effect = "off"
        self.waits = False
        """In HOLD, before its action."""
        self.raised_us = 0
        self.active = False
        self.since_us = -1
        """Since when it is about to change, -1 = it is not."""
        self.text = ""
        """Message of when it was raised."""

    def configure(self, params: Mapping[str, float]) -> None:
        row = self.row
        bound, self.enter_us = _value(row.enter, params), _value(row.enter_s, params) * 1e6
        self.hold_us = _value(row.hold_s, params) * 1e6
        self.action = row.effects[int(params[row.action])] if row.action else row.effects[0]
        off = self.action == "off" or (row.zero_is_off and bound == 0.0)
        self.enter = math.inf if off else self.sign * bound
        self.leave = self.enter - row.gap
        if int(params["FS_OVERRIDE"]) >> row.rule & 1 and RANK[self.action] > 0:
            self.action = "warn"

    @property
    def effect(self) -> Effect:
        """Of now."""
        return "hold" if self.waits and RANK[self.action] > RANK["hold"] else self.action

    def may_wait(self, status: VehicleStatus) -> bool:
        return status.t_us - self.raised_us < self.hold_us and self.row.hold_while(status)


class FailsafeRules:
    def __init__(self, params: ParamSet, inputs: FailsafeInputs) -> None:
        self._params = params
        self._failsafe_inputs = inputs
        self._watches = tuple(_RowState(row) for row in ROWS)
        self._grounded = tuple(watch for watch in self._watches if not watch.row.flying)
        self._revision = -1
        self._overridden = self._reported_override = 0
        self._armed = False
        self._judge = True
        """Whether what acts may have changed."""
        self.bits = 0
        """Active failsafes as bits of :class:`Failsafe`."""
        self.action: Effect | None = None
        """The most severe action since arming, None while nothing has happened."""

    def describe(self) -> str:
        """Active conditions in one line, those that act before those that warn."""
        active = sorted((watch for watch in self._watches if watch.active), key=lambda watch: -RANK[watch.effect])
        return "; ".join(watch.text for watch in active) or "condition has gone"

    @property
    def acting(self) -> bool:
        """Whether a failsafe with an action (not only a warning) is active."""
        return any(watch.active and RANK[watch.effect] > 0 for watch in self._watches)

    def acts_beside(self, rule: Failsafe) -> bool:
        """Whether another failsafe with an action is active."""
        return any(watch.active and RANK[watch.effect] > 0 and watch.row.rule is not rule for watch in self._watches)

    def clear(self) -> None:
        """Forget past actions (on arming, and when the operator takes over)."""
        self.action = None
        self._judge = True

    def prearm_reasons(self, status: VehicleStatus) -> list[ArmingReason]:
        """Why the vehicle must not be armed."""
        reasons = []
        if status.ahrs_age_s is None or status.ahrs_age_s > AHRS_TIMEOUT_S:
            reasons.append(ArmingReason("AHRS is silent or frozen: check cable and port", HealthComponent.AHRS))
        if status.nav is None or status.nav.health is not NavHealth.GOOD:
            remedy = "markers must be in view" if self._failsafe_inputs.has_markers else POSE_REMEDY
            remedy = status.camera_problem or remedy
            text = f"{'no position yet' if status.nav is None else 'position is not good'}: {remedy}"
            reasons.append(ArmingReason(text, HealthComponent.POSITION, ALL_MODES & ~ModeGroup.POSITIONLESS))
        if NavDoubt.ACCELEROMETER in status.nav_doubts or NavDoubt.GYRO in status.nav_doubts:
            wrong = "AHRS readings are wrong: check range and mounting, restart it"
            reasons.append(ArmingReason(wrong, HealthComponent.AHRS))
        reasons += [ArmingReason(text, HealthComponent.DEVICES) for text in status.refusals]
        self._configure()
        text_values = _TextValues(self._params, status, self._failsafe_inputs)
        for watch in self._watches:
            arming = watch.row.arming
            if arming and watch.sign * watch.level(status, self._failsafe_inputs) >= watch.enter:
                reasons.append(ArmingReason(text_values.put_in(arming), COMPONENT_OF[watch.row.rule]))
        return reasons

    def update(self, status: VehicleStatus, *, armed: bool) -> Sequence[Event]:
        """Evaluate all rows; events report failsafes raised and cleared."""
        if self._params.revision != self._revision:
            self._configure()
        events: list[Event] = []
        if armed is not self._armed:
            self._armed, self._judge = armed, True
            if not armed:
                self._land()
        if self._reported_override != self._overridden and armed:
            self._reported_override = self._overridden
            events.append(_override_event(status.t_us, self._overridden))
        elif not armed:
            self._reported_override = 0
        t_us, inputs = status.t_us, self._failsafe_inputs
        for watch in self._watches if armed else self._grounded:
            level = watch.sign * watch.level(status, inputs)
            if watch.active:
                if watch.waits and not watch.may_wait(status):
                    watch.waits, self._judge = False, True
                if level >= watch.leave:
                    watch.since_us = -1
                    continue
                delay_us = watch.leave_us
            elif level >= watch.enter:
                delay_us = watch.enter_us
            else:
                watch.since_us = -1
                continue
            if watch.since_us < 0:
                watch.since_us = t_us
            if t_us - watch.since_us >= delay_us:
                self._turn(watch, status, events)
        if self._judge and armed:
            self._judge = False
            worst = self._worst()
            if worst is not None and (self.action is None or RANK[worst] > RANK[self.action]):
                self.action = worst
        return events

    def _worst(self) -> Effect | None:
        effects = [watch.effect for watch in self._watches if watch.active and RANK[watch.effect] > 0]
        return max(effects, key=RANK.__getitem__, default=None)

    def _turn(self, watch: _RowState, status: VehicleStatus, events: list[Event]) -> None:
        watch.active, watch.since_us, watch.raised_us = not watch.active, -1, status.t_us
        watch.waits = watch.active and watch.may_wait(status)
        self.bits ^= 1 << watch.row.rule
        self._judge = True
        if watch.active:
            watch.text = _TextValues(self._params, status, self._failsafe_inputs).put_in(watch.row.text)
        if self._armed:
            row = notices.FAILSAFE_OVER
            if watch.active:
                urgent = RANK[watch.effect] > 0 or watch.row.severity is Severity.CRITICAL
                row = notices.FAILSAFE_ACTS if urgent else notices.FAILSAFE_WARNS
            events.append(row.event(status.t_us, condition=watch.text))

    def _land(self) -> None:
        """Disarmed: clear the failsafes that apply in flight only."""
        for watch in self._watches:
            if watch.row.flying:
                watch.since_us = -1
                if watch.active:
                    watch.active = False
                    self.bits &= ~(1 << watch.row.rule)

    def _configure(self) -> None:
        """Take over parameters. Overridden failsafes stop acting; only that weakens an action."""
        params = self._params
        if params.revision == self._revision:
            return
        self._revision = params.revision
        for watch in self._watches:
            watch.configure(params)
        self._judge = True
        overridden = int(params["FS_OVERRIDE"])
        if overridden & ~self._overridden:
            self.action = self._worst()
        self._overridden = overridden


class _TextValues(Mapping[str, object]):
    """Values of the placeholders in messages: parameters and inputs of the tick."""

    def __init__(self, params: ParamSet, status: VehicleStatus, inputs: FailsafeInputs) -> None:
        power = status.power
        self._facts = {
            "thruster_problem": status.thruster_problem,
            "watchdog_problem": status.watchdog_problem,
            "fault": status.fault,
            "silent_sensor": inputs.silent_sensor,
            "silence": inputs.silent_how,
            **(MARKER_FACTS if inputs.has_markers else POSE_FACTS),
            "battery_now": _battery(power, inputs, "at {remaining:.0%}"),
            "battery_low": _battery(power, inputs, f"below {params['FS_BATT_LOW']:.0%}"),
        }
        self._params = params

    def __getitem__(self, name: str) -> object:
        return self._facts[name] if name in self._facts else self._params[name]

    def __iter__(self) -> Iterator[str]:
        return iter((*self._facts, *self._params))

    def __len__(self) -> int:
        return len(self._facts) + len(self._params)

    def put_in(self, text: str) -> str:
        return text.format_map(self).replace("%", " %").replace("  %", " %")


def _battery(power: PowerSample | None, inputs: FailsafeInputs, template: str) -> str:
    """Which battery quantity is low: voltage or state of charge."""
    if power is None:
        return "unknown"
    if inputs.low_voltage < 0.0:
        return f"at {power.voltage_v:.1f} V"
    return template.format(remaining=power.remaining)


def _override_event(t_us: int, bits: int) -> Event:
    names = ", ".join(rule.name for rule in Failsafe if bits >> rule & 1)
    if not names:
        return notices.FAILSAFE_OVERRIDE_ENDED.event(t_us)
    return notices.FAILSAFES_OVERRIDDEN.event(t_us, names=names)


def _value(bound: Bound, params: Mapping[str, float]) -> float:
    return params[bound] if isinstance(bound, str) else bound
