"""Failsafe rules: conditions -> bits, messages and the action that overrides the operator's mode.

One row per rule; the most severe action wins and never weakens until the vehicle is disarmed or the operator takes
over after the condition has gone.
"""

from dataclasses import dataclass
from typing import Literal, TypeAlias

from autopilot.core.messages import Below, Event, Failsafe, NavDoubt, NavHealth, NavState, Severity
from autopilot.core.params import ParamSet
from autopilot.core.samples import PowerSample

Action: TypeAlias = Literal["hold", "surface", "disarm"]

AHRS_TIMEOUT_S = 0.5
"""50 AHRS frames missing: attitude is no longer known."""

THRUSTER_TIMEOUT_S = 3.0
"""So long the thrusters must be too weak: the current that counts is an estimate."""

_RANK: dict[Action, int] = {"hold": 1, "surface": 2, "disarm": 3}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Conditions:
    """Facts of this tick that rules and arming look at."""

    t_us: int
    nav: NavState | None
    power: PowerSample | None
    ahrs_age_s: float | None
    """Since the last good sample (a frozen device sends none); None = nothing heard yet."""
    solver_failures: int
    """NMPC steps in a row without a solution."""
    unreachable: bool = False
    """The controller finds no way to its goal."""
    way_left_m: float | None = None
    """Length of the way to the goal as the controller flies it, None = it has none."""
    nav_doubts: frozenset[NavDoubt] = frozenset()
    """What speaks against the estimate or its sensors."""
    nav_disagrees: bool = False
    """The estimator in the shadow of the flown one has been somewhere else for a while."""
    thruster_share: tuple[float, ...] = ()
    """What each thruster gives of its thrust, in the order of the vehicle file; empty = not known."""
    thruster_problem: str = ""
    """What the thrusters that are left cannot do any more."""
    thrusters_unseen: tuple[str, ...] = ()
    """Those of which nobody would know had they lost half of their thrust."""
    command_delay_s: float = 0.0
    """So late commands reach the thrusters, beyond doubt."""
    fault: str = ""
    """What has failed inside the service of late."""
    below: Below | None = None
    """The flight controller below us, None without one."""
    refusals: tuple[str, ...] = ()
    """What devices have against arming."""
    wet: bool = False
    """The leak probe says so."""


class FailsafeRules:
    """State of all failsafes."""

    def __init__(self, params: ParamSet) -> None:
        self._params = params
        self._active: dict[Failsafe, tuple[str, Action | None]] = {}
        self._nav_good_us: int | None = None
        self._thrusters_good_us = 0
        self.action: Action | None = None
        """The most severe action since arming, None while nothing has happened."""

    @property
    def bits(self) -> int:
        """Active failsafes as bits of :class:`Failsafe`."""
        return sum(1 << int(rule) for rule in self._active)

    def describe(self) -> str:
        """Active conditions in one line."""
        return "; ".join(text for text, _ in self._active.values()) or "condition has gone"

    @property
    def acting(self) -> bool:
        """Whether a condition that asks for an action (not only a warning) holds."""
        return any(action is not None for _, action in self._active.values())

    def clear(self) -> None:
        """Forget past actions (on arming)."""
        self.action = None

    def prearm_reasons(self, conditions: Conditions) -> tuple[str, ...]:
        """Why the vehicle must not be armed."""
        reasons = []
        if conditions.ahrs_age_s is None or conditions.ahrs_age_s > AHRS_TIMEOUT_S:
            reasons.append("AHRS is silent or frozen: check cable and port")
        if conditions.nav is None:
            reasons.append("no position yet: markers must be in view")
        elif conditions.nav.health is not NavHealth.GOOD:
            reasons.append("position is not good: markers must be in view")
        if NavDoubt.ACCELEROMETER in conditions.nav_doubts or NavDoubt.GYRO in conditions.nav_doubts:
            reasons.append("AHRS readings are wrong: check range and mounting, restart it")
        if conditions.thruster_problem:
            reasons.append(f"{conditions.thruster_problem}: repair it, or correct THRn_HEALTH")
        if conditions.fault:
            reasons.append(f"{conditions.fault}: see the log, restart the service")
        reasons += conditions.refusals
        if conditions.wet:
            reasons.append("water in the hull: open and dry it")
        power = conditions.power
        if power is not None and power.remaining < self._params["FS_BATT_LOW"]:
            reasons.append(f"battery at {100.0 * power.remaining:.0f} %: charge it")
        return tuple(reasons)

    def update(self, conditions: Conditions, *, armed: bool) -> list[Event]:
        """Evaluate all rules; events report what began and what ended."""
        found = self._evaluate(conditions)
        if not found and not self._active:
            return []
        events = [
            Event(t_us=conditions.t_us, severity=Severity.CRITICAL, text=f"Failsafe: {text}")
            for rule, (text, _) in found.items()
            if rule not in self._active and armed
        ]
        events += [
            Event(t_us=conditions.t_us, severity=Severity.NOTICE, text=f"Failsafe over: {text}")
            for rule, (text, _) in self._active.items()
            if rule not in found and armed
        ]
        self._active = found
        if armed:
            for _, action in found.values():
                if action is not None and _RANK[action] > (0 if self.action is None else _RANK[self.action]):
                    self.action = action
        return events

    def _evaluate(self, conditions: Conditions) -> dict[Failsafe, tuple[str, Action | None]]:
        p = self._params
        found: dict[Failsafe, tuple[str, Action | None]] = {}
        nav = conditions.nav
        if nav is not None and nav.health is not NavHealth.INVALID:
            self._nav_good_us = conditions.t_us
        if self._nav_good_us is not None and conditions.t_us - self._nav_good_us > p["FS_NAV_TIMEOUT"] * 1e6:
            nav_actions: tuple[Action | None, ...] = (None, "disarm", "surface")
            found[Failsafe.NAV_LOST] = ("position lost", nav_actions[int(p["FS_NAV_ACT"])])
        if conditions.ahrs_age_s is not None and conditions.ahrs_age_s > AHRS_TIMEOUT_S:
            found[Failsafe.AHRS_STALE] = ("AHRS silent or frozen", "surface")
        if conditions.nav_disagrees:
            found[Failsafe.NAV_CHECK] = ("estimators disagree", None)
        soft_actions: tuple[Action | None, ...] = (None, "hold", "surface")
        if conditions.solver_failures >= p["FS_SOLVER_N"]:
            found[Failsafe.SOLVER] = ("controller finds no solution", soft_actions[int(p["FS_SOLVER_ACT"])])
        if not conditions.thruster_problem:
            self._thrusters_good_us = conditions.t_us
        elif conditions.t_us - self._thrusters_good_us > THRUSTER_TIMEOUT_S * 1e6:
            found[Failsafe.THRUSTER] = (conditions.thruster_problem, soft_actions[int(p["FS_THR_ACT"])])
        if conditions.command_delay_s > p["FS_LAT_MAX"]:
            found[Failsafe.LATENCY] = ("commands act too late", soft_actions[int(p["FS_LAT_ACT"])])
        if conditions.fault:
            found[Failsafe.FAULT] = (conditions.fault, None)
        if conditions.wet:
            found[Failsafe.LEAK] = ("water in the hull", soft_actions[int(p["FS_LEAK_ACT"])])
        power = conditions.power
        if power is not None and power.remaining < p["FS_BATT_LOW"]:
            text = f"battery below {100.0 * p['FS_BATT_LOW']:.0f} %"
            found[Failsafe.BATTERY] = (text, soft_actions[int(p["FS_BATT_ACT"])])
        return found
