"""Parameters: values that an operator can change over MAVLink. One table gives name, default, unit, range and help.

Names have at most 16 characters (MAVLink). Values are held by a :class:`ParamSet`; an invalid change is refused with a
reason, not clamped. Files: :mod:`autopilot.core.param_file`.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import Protocol

from autopilot.core.errors import ConfigError
from autopilot.core.names import unknown


class ParamType(Enum):
    """Kinds of parameter that the MAVLink server offers."""

    INT32 = "int32"
    REAL32 = "real32"


@dataclass(frozen=True, slots=True, kw_only=True)
class ParamSpec:
    name: str
    default: float
    minimum: float
    maximum: float
    unit: str
    help: str
    type: ParamType = ParamType.REAL32
    family: str = ""
    """What operators find it under, "" = by its name."""
    kept: bool = True
    """Whether a value that an operator sets outlives the run."""

    @property
    def values(self) -> Mapping[int, str]:
        """Labels of the values of an enumeration, parsed from ``help``; empty for other parameters."""
        if self.type is not ParamType.INT32 or self.maximum > MAX_CHOICES:
            return {}
        meanings = {int(number): text.strip() for number, text in _MEANING.findall(self.help)}
        return {number: meanings[number] for number in sorted(meanings)} if len(meanings) > 1 else {}

    @property
    def restart(self) -> bool:
        """Whether a change takes effect at the next start only."""
        return "(restart)" in self.help

    @property
    def group(self) -> str:
        named = (group for start, group in _GROUPS.items() if self.name.startswith(start))
        return self.family or next(named, self.name.split("_")[0].capitalize())

    @property
    def title(self) -> str:
        """Short form of ``help``: its first clause, without the labels of single values."""
        clause = _CLAUSE_END.split(self.help.replace(" (restart)", ""), maxsplit=1)[0].rstrip(".")
        return clause if clause and not clause[0].isdigit() else self.help.rstrip(".")


MAX_CHOICES = 16
"""A whole number with a larger range is a number and no choice."""
_MEANING = re.compile(r"(?<![\w.])(\d+) = ([^,.:;()]+)")
_CLAUSE_END = re.compile(r": |; |, (?=\d+ = )| \(")
_GROUPS: Mapping[str, str] = {
    "AVD_": "Traffic",
    "BATT_": "Battery",
    "BTN": "Pilot",
    "DEPTH_": "Limits",
    "EST_": "Estimation",
    "FENCE_": "Fence",
    "FS_": "Failsafes",
    "LAT_": "Thrusters",
    "MAV_": "MAVLink",
    "MPC_": "Control",
    "OFFB_": "Pilot",
    "ORIGIN_": "Place",
    "PILOT_": "Pilot",
    "SIGN_": "MAVLink",
    "SPD_": "Limits",
    "SYSID_": "MAVLink",
    "TETHER_": "Failsafes",
    "THR": "Thrusters",
    "WP_": "Mission",
}
"""Group by the first letters of the name; a family of names without a line here is a group of its own."""


def _real(name: str, default: float, minimum: float, maximum: float, unit: str, text: str) -> ParamSpec:
    return ParamSpec(name=name, default=default, minimum=minimum, maximum=maximum, unit=unit, help=text)


def _int(name: str, default: int, minimum: int, maximum: int, text: str) -> ParamSpec:
    return ParamSpec(
        name=name, default=default, minimum=minimum, maximum=maximum, unit="", help=text, type=ParamType.INT32
    )


ORIGIN_REST_MAX = 1000
"""Of ORIGIN_LAT_REST and ORIGIN_LON_REST: many times what a 32-bit float of degrees leaves out (76 of them)."""

_ACTIONS = "0 = warn, 1 = hold, 2 = surface, 3 = return, 4 = disarm, 5 = surface and drop the weight, 6 = hand back"
"""What most failsafes can do; the order is :data:`autopilot.command.failsafe_table.ACTIONS`."""

PARAMETERS: tuple[ParamSpec, ...] = (
    _real("AVD_HEIGHT", 2.0, 0.0, 1000.0, "m", "Vehicles farther above or below are not avoided."),
    _real(
        "AVD_RADIUS", 0.35, 0.0, 100.0, "m", "Radius kept from vehicles that broadcast their position, 0 = not avoided."
    ),
    _real("DEPTH_MAX", 1.2, 0.1, 6000.0, "m", "Greatest depth of the vehicle's centre."),
    _real("DEPTH_MIN", 0.05, 0.0, 100.0, "m", "Least depth of the vehicle's centre."),
    *(
        _int(f"BTN{n}_FUNCTION", 0, 0, 53, f"Function of joystick button {n} (docs/piloting.md), 0 = none.")
        for n in range(16)
    ),
    _real("CIRCLE_RADIUS", 0.8, 0.1, 1000.0, "m", "Radius of mode CIRCLE without one in the command."),
    _real("CIRCLE_SPEED", 0.15, -3.0, 3.0, "m/s", "Speed along the circle, negative = to port."),
    _int("EST_CURRENT_3D", 0, 0, 1, "Vertical current: 0 = taken as zero, 1 = estimated (restart)."),
    _real("EST_EXT_DELAY", 0.0, 0.0, 0.5, "s", "Age on arrival of external poses stamped by another clock."),
    _real(
        "EST_SIGMA_MAX",
        0.25,
        0.05,
        10.0,
        "m",
        "Standard deviation beyond which a position is none; above that of GPS to use it (restart).",
    ),
    _int(
        "EST_SHADOW",
        1,
        0,
        1,
        "Second estimator for comparison: 0 = off, 1 = on (restart).",
    ),
    _int(
        "FENCE_ARMED_CHG",
        0,
        0,
        1,
        "Removing the fence while armed, or one that vehicle or mission would break: 0 = denied, 1 = allowed.",
    ),
    _int("FENCE_GAP_CHK", 1, 0, 1, "Gap in the fence narrower than the vehicle: 0 = not reported, 1 = warn."),
    _int("FENCE_REQUIRED", 0, 0, 1, "Without a fence: 0 = warn, 1 = no arming."),
    _int("FS_AHRS_ACT", 2, 0, 6, f"AHRS silent or frozen: {_ACTIONS}."),
    _real("FS_AHRS_TIME", 5.0, 0.0, 600.0, "s", "Time in HOLD before FS_AHRS_ACT, while fixes agree."),
    _int("FS_ASCENT_ACT", 0, 0, 6, f"Surfacing without a position for FS_ASCENT_TIME: {_ACTIONS}."),
    _real("FS_ASCENT_TIME", 300.0, 1.0, 7200.0, "s", "Longest ascent without a position."),
    _int("FS_BATT_ACT", 2, 0, 6, f"Battery below FS_BATT_LOW or BATT_LOW_VOLT: {_ACTIONS}."),
    _real("FS_BATT_CRT", 0.04, 0.0, 1.0, "", "Charge, 0 to 1, for FS_BATT_CRT_ACT."),
    _int("FS_BATT_CRT_ACT", 2, 0, 6, f"Battery below FS_BATT_CRT or BATT_CRT_VOLT: {_ACTIONS}."),
    _real("FS_BATT_LOW", 0.1, 0.0, 1.0, "", "Charge, 0 to 1, for FS_BATT_ACT."),
    _real("BATT_CRT_VOLT", 0.0, 0.0, 1000.0, "V", "Voltage for FS_BATT_CRT_ACT, 0 = the vehicle file's."),
    _real("BATT_LOW_VOLT", 0.0, 0.0, 1000.0, "V", "Voltage for FS_BATT_ACT, 0 = the vehicle file's."),
    _real("BATT_LOW_TIMER", 10.0, 0.0, 120.0, "s", "Time below these voltages before they count."),
    _int("FS_CAGE_ACT", 2, 0, 6, f"Beyond fence or depth band by FS_CAGE_HARD: {_ACTIONS}."),
    _real("FS_CAGE_HARD", 0.5, 0.01, 100.0, "m", "Distance beyond fence or depth band for FS_CAGE_ACT."),
    _real("FS_CAGE_SOFT", 0.15, 0.01, 100.0, "m", "Distance beyond fence or depth band for a warning."),
    _int("FS_CAM_ACT", 1, 0, 6, f"Camera rejected: {_ACTIONS}."),
    _int("FS_CLOCK_ACT", 0, 0, 6, f"Clock of day jumped by 0.5 s: {_ACTIONS}."),
    _real("FS_COLL_ACC", 3.0, 0.5, 100.0, "m/s2", "Horizontal acceleration beyond thrust that counts as collision."),
    _int("FS_COLL_ACT", 0, 0, 6, f"Collision: {_ACTIONS}."),
    _real("FS_CRASH_ANGLE", 30.0, 5.0, 180.0, "deg", "Tilt for FS_CRASH_CHECK, after 2 s."),
    _int(
        "FS_CRASH_CHECK", 1, 0, 4, "Tilt beyond FS_CRASH_ANGLE: 0 = off, 1 = warn, 2 = disarm, 3 = hold, 4 = surface."
    ),
    _int("FS_DOUBT_ACT", 0, 0, 6, f"Map, calibration or fixes suspect: {_ACTIONS}."),
    _int("FS_DR_ACT", 0, 0, 6, f"Dead reckoning for FS_DR_TIME: {_ACTIONS}."),
    _real("FS_DR_TIME", 30.0, 0.5, 3600.0, "s", "Longest dead reckoning without a position fix."),
    _int("FS_ENRG_ACT", 0, 0, 6, f"Energy left is too little for the plan: {_ACTIONS}."),
    _real("FS_ENRG_RES", 0.05, 0.0, 0.9, "", "Charge, 0 to 1, to be left at the end of the plan."),
    _real("FS_FAULT_TIME", 10.0, 0.0, 300.0, "s", "Station keeping after an internal fault; then neutral."),
    _int(
        "FS_GCS_ENABLE",
        1,
        0,
        5,
        "Ground station silent: 0 = off, 1 = warn, 2 = disarm, 3 = hold, 4 = surface, 5 = return.",
    ),
    _real("FS_GCS_TIMEOUT", 5.0, 1.0, 3600.0, "s", "Time without a ground station's HEARTBEAT."),
    _int("FS_LAT_ACT", 1, 0, 6, f"Command latency above FS_LAT_MAX: {_ACTIONS}."),
    _real("FS_LAT_MAX", 0.4, 0.0, 1.5, "s", "Command latency for FS_LAT_ACT."),
    _int("FS_LEAK_ENABLE", 2, 0, 3, "Leak: 0 = off, 1 = warn, 2 = surface, 3 = surface and drop the weight."),
    _int("FS_LOG_ACT", 0, 0, 6, f"Log cannot be written: {_ACTIONS}."),
    _int("FS_LOOP_ACT", 0, 0, 6, f"Control loop late for 3 s: {_ACTIONS}."),
    _real("FS_LOOP_MAX", 0.2, 0.01, 1.0, "", "Fraction of late ticks in a second for FS_LOOP_ACT."),
    _int(
        "FS_NAV_ACT",
        2,
        0,
        4,
        "Estimate invalid for FS_NAV_TIMEOUT: 0 = warn, 1 = disarm, 2 = surface, 3 = surface and drop the weight,"
        " 4 = hand back.",
    ),
    _real("FS_NAV_TIMEOUT", 5.0, 0.5, 60.0, "s", "Time without a valid estimate for FS_NAV_ACT."),
    _int("FS_OVERRIDE", 0, 0, 2**31 - 1, "Failsafes that may only warn: sum of 2^bit (docs/failsafes.md), 0 = none."),
    _int("FS_PILOT_INPUT", 1, 0, 3, "Pilot input lost: 0 = off, 1 = warn, 2 = disarm, 3 = hold."),
    _real("FS_PILOT_TIMEOUT", 3.0, 0.1, 60.0, "s", "Time without input of a pilot who has steered."),
    _int("FS_PRESS_ENABLE", 1, 0, 2, "Hull pressure above FS_PRESS_MAX: 0 = off, 1 = warn, 2 = surface."),
    _real("FS_PRESS_MAX", 105000.0, 0.0, 1e7, "Pa", "Hull pressure for FS_PRESS_ENABLE."),
    _int("FS_SENDER_ACT", 1, 0, 6, f"Another sender commands the thrusters: {_ACTIONS}."),
    _int("FS_SENS_ACT", 0, 0, 6, f"A sensor silent or frozen for FS_SENS_TIME: {_ACTIONS}."),
    _real("FS_SENS_TIME", 3.0, 0.5, 600.0, "s", "Time without data of a sensor that has worked."),
    _int("FS_SOLVER_ACT", 2, 0, 6, f"No solution for FS_SOLVER_N steps: {_ACTIONS}."),
    _int("FS_SOLVER_N", 40, 5, 1000, "Control steps in a row without a solution."),
    _int("FS_STUCK_ACT", 0, 0, 6, f"Thrust without motion for FS_STUCK_TIME: {_ACTIONS}."),
    _real("FS_STUCK_TIME", 20.0, 1.0, 3600.0, "s", "Time of thrust without motion."),
    _int("FS_TEMP_ENABLE", 1, 0, 2, "Hull temperature above FS_TEMP_MAX: 0 = off, 1 = warn, 2 = surface."),
    _real("FS_TEMP_MAX", 62.0, -50.0, 200.0, "degC", "Hull temperature for FS_TEMP_ENABLE."),
    _int("FS_TETHER_ACT", 1, 0, 6, f"Tether paid out to TETHER_LEN: {_ACTIONS}."),
    _int("FS_WDOG_ACT", 1, 0, 6, f"Thruster watchdog gone for 3 s: {_ACTIONS}."),
    _int("FS_THR_ACT", 2, 0, 6, f"Depth, heading or hover cannot be held: {_ACTIONS}."),
    _int("TETHER_COUNT", 0, 0, 1, "Tether paid out: 0 = distance from home, 1 = path length since arming."),
    _real("TETHER_LEN", 0.0, 0.0, 10000.0, "m", "Tether that may be paid out, 0 = not checked."),
    _int("LAT_DETECT", 1, 0, 1, "Command latency: 0 = ignored, 1 = estimated from the motion and compensated."),
    _int("MPC_COST", 1, 0, 1, "Controller minimises: 0 = distance and effort at cruise speed, 1 = energy."),
    _int(
        "MAV_CTRL_NEEDED",
        0,
        0,
        1,
        "Erasing logs, restart, keys, parameter reset: 0 = as all else, 1 = only for who is in control.",
    ),
    _int("MAV_FORWARD", 0, 0, 1, "Messages between clients and links: 0 = not passed on, 1 = passed on."),
    _real("MPC_MARGIN", 0.03, 0.0, 1.0, "m", "Least distance kept beyond the body radius."),
    _real("MPC_SPEED_MARGIN", 0.08, 0.0, 0.5, "m/s", "Planar speed margin of unknown drag; more above 0.5 m/s."),
    _real("MPC_Q_POS", 20.0, 0.0, 1e4, "", "NMPC weight on planar position error."),
    _real("MPC_Q_YAW", 3.0, 0.0, 1e4, "", "NMPC weight on heading error."),
    _real("MPC_Q_Z", 40.0, 0.0, 1e4, "", "NMPC weight on depth error."),
    _real(
        "MPC_R_CHANGE",
        0.2,
        0.0,
        1e3,
        "",
        "NMPC weight on the change of thrust per step (with MPC_COST 0).",
    ),
    _real("MPC_R_THRUST", 0.02, 1e-6, 1e3, "", "NMPC weight on thrust."),
    _int(
        "MPC_TIGHTEN",
        1,
        0,
        2,
        "Margins along the prediction: 0 = fixed, 1 = tube, 2 = Lipschitz growth.",
    ),
    _real("MPC_W_CURRENT", 0.02, 0.0, 1.0, "m/s", "Bound on the current's error beyond the estimator's."),
    _real("MPC_W_FORCE", 1.0, 0.0, 100.0, "N", "Bound on unmodelled force per axis."),
    _real("MPC_W_MOMENT", 0.1, 0.0, 50.0, "N m", "Bound on unmodelled yaw moment."),
    _real("ORIGIN_ALT", 0.0, -500.0, 9000.0, "m", "Altitude AMSL of the water surface (restart)."),
    _real(
        "ORIGIN_LAT",
        37.9755,
        -89.0,
        89.0,
        "deg",
        "Latitude of the local origin until a message sets one (restart).",
    ),
    _int(
        "ORIGIN_LAT_REST",
        0,
        -ORIGIN_REST_MAX,
        ORIGIN_REST_MAX,
        "Added to ORIGIN_LAT, in 1e-7 deg (restart).",
    ),
    _real("ORIGIN_LON", 23.7790, -180.0, 180.0, "deg", "Longitude of the local origin (restart)."),
    _int("ORIGIN_LON_REST", 0, -ORIGIN_REST_MAX, ORIGIN_REST_MAX, "Added to ORIGIN_LON, in 1e-7 deg (restart)."),
    _real(
        "SPD_CRUISE",
        0.35,
        0.02,
        2.0,
        "m/s",
        "Cruise speed over ground; with MPC_COST 1 its bound.",
    ),
    _real("SPD_GROUND_MIN", 0.01, 0.001, 1.0, "m/s", "Slower approaches make a goal out of reach."),
    _real("SPD_HEAVE_MAX", 0.25, 0.02, 2.0, "m/s", "Limit of heave speed relative to the water."),
    _real("SPD_PLANAR_MAX", 0.5, 0.05, 3.0, "m/s", "Limit of planar speed relative to the water."),
    _real("SPD_YAW_MAX", 1.0, 0.05, 3.0, "rad/s", "Limit of yaw rate."),
    _int("SYSID_THISMAV", 1, 1, 250, "MAVLink system id; instance N adds N (restart)."),
    _real("THR_LIMIT", 12.0, 0.5, 200.0, "N", "Limit of every thruster's thrust."),
    _real("OFFB_TIMEOUT", 1.0, 0.1, 60.0, "s", "Time without set points, then HOLD."),
    _real("PILOT_GAIN", 0.5, 0.1, 1.0, "", "Joystick gain; buttons change it until restart."),
    _real("PILOT_RATE_YAW", 0.8, 0.05, 3.0, "rad/s", "Yaw rate of a full stick, within SPD_YAW_MAX."),
    _real("PILOT_SPD", 0.5, 0.02, 3.0, "m/s", "Speed over ground of a full stick in POSHOLD, within SPD_PLANAR_MAX."),
    _real("PILOT_SPD_Z", 0.3, 0.02, 2.0, "m/s", "Climb rate of a full stick where depth is held, within limits."),
    _int(
        "PILOT_Z",
        0,
        0,
        1,
        "Vertical stick of MANUAL_CONTROL: 0 = 0 to 1000, neutral 500, 1 = -1000 to 1000, neutral 0.",
    ),
    _int("PILOT_BACK", 0, 0, 1, "After a pilot hands back control: 0 = hold, 1 = resume the mission."),
    _int("SIGN_LOCAL", 0, 0, 1, "With a signing key, programs of this machine: 0 = must sign, 1 = need not."),
    ParamSpec(
        name="STATE_ACCEPT",
        default=0,
        minimum=0,
        maximum=1000,
        unit="",
        help="Number in the arming refusal: accepts lost parameters or plans for this run.",
        type=ParamType.INT32,
        family="Safety",
        kept=False,
    ),
    _int("THR_DETECT", 1, 0, 1, "Thrust losses: 0 = only by THRn_HEALTH, 1 = detected from the motion."),
    *(
        _real(f"THR{i}_HEALTH", 1.0, 0.0, 1.0, "", f"Known effectiveness, 0 to 1, of thruster {i}.")
        for i in range(1, 9)
    ),
    _real("TKOFF_DEPTH", 0.5, 0.05, 6000.0, "m", "Depth of NAV_TAKEOFF without one in the command."),
    _real("WP_ACCEPT_RADIUS", 0.3, 0.02, 50.0, "m", "Acceptance radius where an item gives none."),
    _real("WP_ACCEPT_YAW", 0.15, 0.01, 3.15, "rad", "Heading band where an item gives a heading."),
    _int(
        "WP_STUCK_ACT",
        2,
        0,
        3,
        "Mission item out of reach: 0 = warn, 1 = hold, 2 = skip it, 3 = hold, and no start if the current says so.",
    ),
    _real("WP_STUCK_TIME", 60.0, 10.0, 3600.0, "s", "Time without progress after which an item is out of reach."),
)


class ParamSet(Mapping[str, float]):
    """Current values by name, in the fixed order of the table. Changed only through :meth:`set`."""

    def __init__(self, overrides: Mapping[str, float] | None = None) -> None:
        self._specs = {spec.name: spec for spec in sorted(PARAMETERS, key=lambda s: s.name)}
        self._values = {name: float(spec.default) for name, spec in self._specs.items()}
        self.revision = 0
        self._changes: dict[str, float] = {}
        for name, value in (overrides or {}).items():
            self.set(name, value)
        self._changes.clear()

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    @property
    def live(self) -> Mapping[str, float]:
        """A view of the present values, for code that reads many of them at every tick."""
        return MappingProxyType(self._values)

    def spec(self, name: str) -> ParamSpec:
        """Declaration of a parameter. ConfigError if there is none of that name."""
        if name not in self._specs:
            raise unknown("parameter", name, tuple(self._specs), list_by="`autopilot params list` shows all names")
        return self._specs[name]

    def set(self, name: str, value: float) -> None:
        """Change a value.

        Raises
        ------
        ConfigError
            Unknown name, or a value that is not finite, out of range, or not an integer; nothing is changed.
        """
        spec = self.spec(name)
        if not math.isfinite(value):
            raise ConfigError(
                f"parameter {name} = {value} is not a finite number; give {spec.minimum:g} to {spec.maximum:g}"
            )
        if not spec.minimum <= value <= spec.maximum:
            span = f"{spec.minimum:g} to {spec.maximum:g} {spec.unit}".rstrip()
            raise ConfigError(f"parameter {name} = {value:g} is out of range; use {span}")
        if spec.type is ParamType.INT32 and value != int(value):
            raise ConfigError(f"parameter {name} = {value:g} is not whole; give a whole number")
        if self._values[name] != value:
            self._values[name] = self._changes[name] = float(value)
            self.revision += 1

    def take_changes(self) -> dict[str, float]:
        """Values changed since the last call (construction counts as a change), for the log."""
        if not self._changes:
            return {}
        changes, self._changes = self._changes, {}
        return changes


@dataclass(frozen=True, slots=True, kw_only=True)
class Saved:
    """Result of a request to store parameters."""

    number: int
    """Every request up to this one is settled."""
    failure: str
    """Why they are not on disk, in two or three words; "" when they are."""


class ParamSaving(Protocol):
    """Storage of parameters. Never blocks on a disk."""

    def save(self, tick: int, name: str) -> int | None:
        """Store the present value; the number of the request, None if there is nothing to wait for."""
        ...

    def saved(self, tick: int) -> Saved | None: ...
