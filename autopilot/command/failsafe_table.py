"""The failsafes, one row each: condition, thresholds, action and message.

Data only. :mod:`autopilot.command.failsafes` evaluates it once per tick, docs/failsafes.md is generated from it
(``autopilot failsafes --write``), and every row has a fault scenario (:mod:`autopilot.campaign.fault_cases`). A row
checks one quantity. It is raised when the quantity has been at or beyond its bound for ``enter_s`` and cleared when
it has been inside by the hysteresis ``gap`` for ``leave_s``. NaN does neither: an unmeasured quantity raises
nothing.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

from autopilot.command.command_tuning import VEHICLE_STATUS
from autopilot.command.failsafe_inputs import FailsafeInputs
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.core.messages import Failsafe, NavDoubt, Severity

Effect: TypeAlias = Literal["off", "warn", "hold", "return", "surface", "drop", "hand back", "disarm"]

RANK: dict[Effect, int] = {
    "off": -1,
    "warn": 0,
    "hold": 1,
    "return": 2,
    "surface": 3,
    "drop": 4,
    "hand back": 5,
    "disarm": 6,
}
"""The most severe of several wins."""

EFFECTS: dict[Effect, str] = {
    "off": "not checked",
    "warn": "a message to the operator, nothing else",
    "hold": "mode HOLD: stops and keeps station",
    "return": "mode RETURN: home within the fence; HOLD where home is out of reach",
    "surface": "mode SURFACE: up within the constraints; without a position straight up",
    "drop": "as surface, and the drop weight is released (if the vehicle has one)",
    "hand back": "the flight controller below takes over; without one thrusters neutral, disarmed",
    "disarm": "thrusters neutral, disarmed",
}

ACTIONS: tuple[Effect, ...] = ("warn", "hold", "surface", "return", "disarm", "drop", "hand back")
"""Values of most FS_..._ACT parameters, from 0."""

Known: TypeAlias = Callable[[VehicleStatus], bool]
Level: TypeAlias = Callable[[VehicleStatus, FailsafeInputs], float]
Bound: TypeAlias = str | float
"""A parameter's name or a number."""

_NAN = math.nan
_DOUBTS = frozenset({NavDoubt.FIXES, NavDoubt.RANGE, NavDoubt.MAP, NavDoubt.CALIBRATION, NavDoubt.RESETS})
_AGAINST_PLACE = _DOUBTS | {NavDoubt.CAMERA}


@dataclass(frozen=True, slots=True, kw_only=True)
class FailsafeRow:
    rule: Failsafe
    condition: str
    """For people; parameters by name."""
    level: Level
    """Input, once per tick; makes no text."""
    enter: Bound = 1.0
    """Bound of the level; of one that is no quantity, 1 where it holds."""
    gap: float = 0.0
    """Hysteresis: cleared when the quantity is back by this."""
    below: bool = False
    """Low values are the bad ones."""
    zero_is_off: bool = False
    """A bound of 0 switches the row off."""
    enter_s: Bound = 0.0
    leave_s: float = 0.0
    action: str = ""
    """Parameter that chooses among ``effects``, "" = the only one."""
    effects: tuple[Effect, ...] = ACTIONS
    hold_s: Bound = 0.0
    """A stronger action waits so long in HOLD,"""
    hold_while: Known = lambda _: False
    """but only while this is so."""
    severity: Severity = Severity.CRITICAL
    """Severity of the message when it is raised."""
    text: str
    """Event and remedy. Names in braces are parameters and inputs, filled in when it is raised."""
    arming: str = ""
    """Why the vehicle must not be armed meanwhile, "" = it may."""
    flying: bool = False
    """Evaluated only while armed."""


def _age(t_us: int, since_us: float) -> float:
    return 1e-6 * (t_us - since_us)


def _placed(v: VehicleStatus) -> bool:
    """Whether the position is known without the AHRS: fixes agree with the estimate, and nothing speaks against it."""
    return v.estimate is not None and v.fixed and v.nav_doubts.isdisjoint(_AGAINST_PLACE)


ROWS: tuple[FailsafeRow, ...] = (
    FailsafeRow(
        rule=Failsafe.NAV_LOST,
        condition="no valid estimate for `FS_NAV_TIMEOUT`, once known or armed",
        level=lambda v, f: f.nav_lost,
        enter_s="FS_NAV_TIMEOUT",
        action="FS_NAV_ACT",
        effects=("warn", "disarm", "surface", "drop", "hand back"),
        text="position lost",
    ),
    FailsafeRow(
        rule=Failsafe.SOLVER,
        condition="`FS_SOLVER_N` control steps in a row without a solution, fallbacks included",
        level=lambda v, f: v.solver_failures,
        enter="FS_SOLVER_N",
        action="FS_SOLVER_ACT",
        text="controller finds no solution",
    ),
    FailsafeRow(
        rule=Failsafe.BATTERY,
        condition="charge below `FS_BATT_LOW`, or voltage below `BATT_LOW_VOLT` for `BATT_LOW_TIMER`",
        level=lambda v, f: _NAN if v.power is None else min(v.power.remaining, f.low_voltage),
        enter="FS_BATT_LOW",
        below=True,
        gap=0.02,
        action="FS_BATT_ACT",
        text="battery {battery_low}",
        arming="battery {battery_now}: charge it",
    ),
    FailsafeRow(
        rule=Failsafe.AHRS_STALE,
        condition="no new AHRS sample for 0.5 s; HOLD for `FS_AHRS_TIME` first, while fixes agree with the estimate",
        level=lambda v, f: _NAN if v.ahrs_age_s is None else v.ahrs_age_s,
        enter=0.5,
        action="FS_AHRS_ACT",
        hold_s="FS_AHRS_TIME",
        hold_while=_placed,
        text="AHRS silent or frozen",
    ),
    FailsafeRow(
        rule=Failsafe.THRUSTER,
        condition="the working thrusters cannot hold depth, heading or place, or commands do not reach them, for 3 s",
        level=lambda v, f: 1.0 if v.thruster_problem else 0.0,
        enter_s=3.0,
        action="FS_THR_ACT",
        text="{thruster_problem}",
        arming="{thruster_problem}: repair it, or correct THRn_HEALTH",
    ),
    FailsafeRow(
        rule=Failsafe.LATENCY,
        condition="command latency above `FS_LAT_MAX`",
        level=lambda v, f: v.command_delay_s,
        enter="FS_LAT_MAX",
        action="FS_LAT_ACT",
        text="command latency high: check the tether",
    ),
    FailsafeRow(
        rule=Failsafe.NAV_CHECK,
        condition="the two estimators disagree about the position",
        level=lambda v, f: v.nav_disagrees,
        effects=("warn",),
        text="estimators disagree",
    ),
    FailsafeRow(
        rule=Failsafe.FAULT,
        condition="internal fault within the last 5 s ([reliability.md](reliability.md))",
        level=lambda v, f: 1.0 if v.fault else 0.0,
        effects=("warn",),
        text="{fault}",
        arming="{fault}: see the log, restart the service",
    ),
    FailsafeRow(
        rule=Failsafe.GCS,
        condition="no HEARTBEAT of a ground station for `FS_GCS_TIMEOUT`, after there was one",
        level=lambda v, f: _age(v.t_us, v.gcs_us),
        enter="FS_GCS_TIMEOUT",
        action="FS_GCS_ENABLE",
        effects=("off", "warn", "disarm", "hold", "surface", "return"),
        severity=Severity.WARNING,
        text="ground station lost: check the link",
    ),
    FailsafeRow(
        rule=Failsafe.PILOT,
        condition="no input for `FS_PILOT_TIMEOUT` of a pilot who has steered since arming",
        level=lambda v, f: _age(v.t_us, v.pilot_us) if v.pilot_us >= f.armed_us else _NAN,
        enter="FS_PILOT_TIMEOUT",
        action="FS_PILOT_INPUT",
        effects=("off", "warn", "disarm", "hold"),
        severity=Severity.WARNING,
        text="pilot input lost: check the joystick",
        flying=True,
    ),
    FailsafeRow(
        rule=Failsafe.DEAD_RECKONING,
        condition="no position fix for `FS_DR_TIME`",
        level=lambda v, f: f.no_fix_s,
        enter="FS_DR_TIME",
        action="FS_DR_ACT",
        severity=Severity.WARNING,
        text="no fix for {FS_DR_TIME:.0f} s: {fix_remedy}",
        flying=True,
    ),
    FailsafeRow(
        rule=Failsafe.SENSOR,
        condition="depth sensor, DVL, power monitor, leak probe or hull sensor silent, frozen or implausible "
        "for `FS_SENS_TIME`, after it has worked; range to the floor frozen",
        level=lambda v, f: f.silent_s,
        enter="FS_SENS_TIME",
        action="FS_SENS_ACT",
        severity=Severity.WARNING,
        text="{silent_sensor} {silence}",
        arming="{silent_sensor} {silence}: check its cable",
    ),
    FailsafeRow(
        rule=Failsafe.DOUBT,
        condition="fixes, range, map or calibration contradict each other for 1 s ([estimation.md](estimation.md))",
        level=lambda v, f: 0.0 if v.nav_doubts.isdisjoint(_DOUBTS) else 1.0,
        enter_s=1.0,
        leave_s=1.0,
        action="FS_DOUBT_ACT",
        severity=Severity.WARNING,
        text="{suspect}",
        flying=True,
    ),
    FailsafeRow(
        rule=Failsafe.BATTERY_CRITICAL,
        condition="charge below `FS_BATT_CRT`, or voltage below `BATT_CRT_VOLT` for `BATT_LOW_TIMER`",
        level=lambda v, f: _NAN if v.power is None else min(v.power.remaining, f.critical_voltage),
        enter="FS_BATT_CRT",
        below=True,
        gap=0.02,
        action="FS_BATT_CRT_ACT",
        text="battery critical: surface",
    ),
    FailsafeRow(
        rule=Failsafe.ENERGY,
        condition="predicted charge at the end of the plan below `FS_ENRG_RES` for 5 s",
        level=lambda v, f: f.energy_lack,
        enter=0.0,
        gap=0.02,
        enter_s=5.0,
        action="FS_ENRG_ACT",
        severity=Severity.WARNING,
        text="battery too low for the plan: shorten it",
        flying=True,
    ),
    FailsafeRow(
        rule=Failsafe.LEAK,
        condition=f"leak probe wet within the last {VEHICLE_STATUS.latched_us // 10**6} s",
        level=lambda v, f: v.wet_us + VEHICLE_STATUS.latched_us >= v.t_us,
        action="FS_LEAK_ENABLE",
        effects=("off", "warn", "surface", "drop"),
        text="water in the hull",
        arming="water in the hull: open and dry it",
    ),
    FailsafeRow(
        rule=Failsafe.PRESSURE,
        condition="hull pressure above `FS_PRESS_MAX` for 2 s",
        level=lambda v, f: v.hull_pa,
        enter="FS_PRESS_MAX",
        gap=500.0,
        enter_s=2.0,
        action="FS_PRESS_ENABLE",
        effects=("off", "warn", "surface"),
        severity=Severity.WARNING,
        text="hull pressure high: check for leaks",
        arming="hull pressure high: check seals, vent the hull",
    ),
    FailsafeRow(
        rule=Failsafe.TEMPERATURE,
        condition="hull temperature above `FS_TEMP_MAX` for 2 s",
        level=lambda v, f: v.hull_c,
        enter="FS_TEMP_MAX",
        gap=2.0,
        enter_s=2.0,
        action="FS_TEMP_ENABLE",
        effects=("off", "warn", "surface"),
        severity=Severity.WARNING,
        text="hull too hot: let it cool in water",
        arming="hull too hot: let it cool in water",
    ),
    FailsafeRow(
        rule=Failsafe.CAGE_SOFT,
        condition="vehicle beyond fence or depth band by `FS_CAGE_SOFT` for 0.5 s",
        level=lambda v, f: f.beyond_m,
        enter="FS_CAGE_SOFT",
        gap=0.05,
        enter_s=0.5,
        effects=("warn",),
        severity=Severity.WARNING,
        text="beyond fence or depth band",
        flying=True,
    ),
    FailsafeRow(
        rule=Failsafe.CAGE_HARD,
        condition="vehicle beyond fence or depth band by `FS_CAGE_HARD` for 0.5 s",
        level=lambda v, f: f.beyond_m,
        enter="FS_CAGE_HARD",
        gap=0.05,
        enter_s=0.5,
        action="FS_CAGE_ACT",
        text="far beyond fence or depth band",
        flying=True,
    ),
    FailsafeRow(
        rule=Failsafe.TILT,
        condition="tilt above `FS_CRASH_ANGLE` for 2 s",
        level=lambda v, f: f.tilt_deg,
        enter="FS_CRASH_ANGLE",
        gap=5.0,
        enter_s=2.0,
        action="FS_CRASH_CHECK",
        effects=("off", "warn", "disarm", "hold", "surface"),
        text="tilt beyond {FS_CRASH_ANGLE:.0f} deg: check vehicle",
        flying=True,
    ),
    FailsafeRow(
        rule=Failsafe.COLLISION,
        condition="acceleration peak above `FS_COLL_ACC` that thrust does not explain; "
        f"shown for {VEHICLE_STATUS.shown_us // 10**6} s",
        level=lambda v, f: v.collided_us + VEHICLE_STATUS.shown_us >= v.t_us,
        action="FS_COLL_ACT",
        severity=Severity.WARNING,
        text="collision detected: check the {struck}",
        flying=True,
    ),
    FailsafeRow(
        rule=Failsafe.STUCK,
        condition="under way, a thruster above a third of `THR_LIMIT`, slower than 0.05 m/s and no 0.15 m nearer for "
        "`FS_STUCK_TIME`",
        level=lambda v, f: f.stuck_s,
        enter="FS_STUCK_TIME",
        action="FS_STUCK_ACT",
        severity=Severity.WARNING,
        text="stuck, thrust without motion: back off",
        flying=True,
    ),
    FailsafeRow(
        rule=Failsafe.TETHER,
        condition="tether paid out to `TETHER_LEN` (counted by `TETHER_COUNT`)",
        level=lambda v, f: f.tether_m,
        enter="TETHER_LEN",
        gap=0.2,
        zero_is_off=True,
        action="FS_TETHER_ACT",
        text="tether fully paid out: come back",
        flying=True,
    ),
    FailsafeRow(
        rule=Failsafe.LOOP,
        condition="fraction of late ticks above `FS_LOOP_MAX` for 3 s",
        level=lambda v, f: v.late_fraction,
        enter="FS_LOOP_MAX",
        enter_s=3.0,
        leave_s=2.0,
        action="FS_LOOP_ACT",
        severity=Severity.WARNING,
        text="control loop late: reduce the CPU load",
    ),
    FailsafeRow(
        rule=Failsafe.LOG,
        condition="log not written: disk full, missing or read-only",
        level=lambda v, f: v.log_lost,
        action="FS_LOG_ACT",
        severity=Severity.WARNING,
        text="not logging: free disk space",
        flying=True,
    ),
    FailsafeRow(
        rule=Failsafe.CLOCK,
        condition=f"clock of day jumped by 0.5 s or more; shown for {VEHICLE_STATUS.shown_us // 10**6} s",
        level=lambda v, f: v.jumped_us + VEHICLE_STATUS.shown_us >= v.t_us,
        action="FS_CLOCK_ACT",
        severity=Severity.WARNING,
        text="clock jumped: check time source",
    ),
    FailsafeRow(
        rule=Failsafe.ASCENT,
        condition="surfacing without a position for `FS_ASCENT_TIME`",
        level=lambda v, f: f.blind_s,
        enter="FS_ASCENT_TIME",
        action="FS_ASCENT_ACT",
        text="ascent too slow: haul in the tether",
        flying=True,
    ),
    FailsafeRow(
        rule=Failsafe.WATCHDOG,
        condition="thruster watchdog process missing or hanging for 3 s ([reliability.md](reliability.md))",
        level=lambda v, f: 1.0 if v.watchdog_problem else 0.0,
        enter_s=3.0,
        action="FS_WDOG_ACT",
        text="thruster watchdog {watchdog_problem}: surface",
        arming="thruster watchdog {watchdog_problem}: restart the service",
    ),
    FailsafeRow(
        rule=Failsafe.CAMERA,
        condition="images jump, or contradict gyro and vehicle model ([estimation.md](estimation.md))",
        level=lambda v, f: 1.0 if NavDoubt.CAMERA in v.nav_doubts else 0.0,
        leave_s=1.0,
        action="FS_CAM_ACT",
        text="{rejected}",
        flying=True,
    ),
    FailsafeRow(
        rule=Failsafe.SENDER,
        condition="the flight controller's outputs show another sender's commands, within 15 reports (0.3 s)",
        level=lambda v, f: _NAN if v.below is None else float(v.below.rival),
        action="FS_SENDER_ACT",
        text="another sender on the thrusters: stop it",
        flying=True,
    ),
)
