"""Identity profiles: what kind of autopilot the vehicle says it is. Everything else is the same under all three.

Ground stations choose buttons, mode numbers and parameter encoding by HEARTBEAT.autopilot. ``generic`` tells the plain
truth, ``px4`` and ``ardusub`` speak the dialect that QGroundControl, MAVSDK and Cockpit are complete with. The true
name stands in AUTOPILOT_VERSION and in a STATUSTEXT at first contact.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType

from autopilot.core.errors import ConfigError
from autopilot.mavlink.api import FlightMode

STANDARD_MODES_2025: Mapping[int, str] = MappingProxyType(
    {
        1: "POSITION_HOLD",
        2: "ORBIT",
        3: "CRUISE",
        4: "ALTITUDE_HOLD",
        5: "SAFE_RECOVERY",
        6: "MISSION",
        7: "LAND",
        8: "TAKEOFF",
    }
)
"""MAV_STANDARD_MODE of common.xml since January 2025."""

STANDARD_MODES_2022: Mapping[int, str] = MappingProxyType(
    {
        1: "POSITION_HOLD",
        2: "ORBIT",
        3: "CRUISE",
        4: "ALTITUDE_HOLD",
        5: "RETURN_HOME",
        6: "SAFE_RECOVERY",
        7: "MISSION",
        8: "LAND",
        9: "TAKEOFF",
    }
)
"""The same in development.xml from 2022 to then; ground stations of that time go by it."""

_STANDARD_NAMES: Mapping[str, FlightMode] = MappingProxyType(
    {"POSITION_HOLD": FlightMode.POSHOLD, "ORBIT": FlightMode.CIRCLE, "ALTITUDE_HOLD": FlightMode.ALT_HOLD}
)
"""Position hold is the one with sticks. Other modes go by name and custom mode: a number that means one mode to this
side and another to the other (7: land, or mission) would surface a vehicle that is to start."""

STANDARD_MODES: Mapping[int, FlightMode] = MappingProxyType(
    {
        number: _STANDARD_NAMES[name]
        for number, name in STANDARD_MODES_2025.items()
        if name in _STANDARD_NAMES and STANDARD_MODES_2022.get(number) == name
    }
)
"""MAV_STANDARD_MODE numbers that mean the same in both numberings, and the modes that they are."""

NON_STANDARD = 0
"""MAV_STANDARD_MODE_NON_STANDARD."""

STANDARD_MODE_OF: Mapping[FlightMode, int] = MappingProxyType({mode: n for n, mode in STANDARD_MODES.items()})

MODES = (
    FlightMode.HOLD,
    FlightMode.MISSION,
    FlightMode.RETURN,
    FlightMode.SURFACE,
    FlightMode.MANUAL,
    FlightMode.STABILIZE,
    FlightMode.ALT_HOLD,
    FlightMode.POSHOLD,
    FlightMode.GUIDED,
    FlightMode.CIRCLE,
    FlightMode.TAKEOFF,
)
"""In the order in which operators are told of them."""

CUSTOM_MODE_FLAG = 1
"""MAV_MODE_FLAG_CUSTOM_MODE_ENABLED."""


class ParamEncoding(Enum):
    """How integer parameters travel in the float field of PARAM_VALUE and PARAM_SET."""

    BYTEWISE = "bytewise"
    """The four bytes of the integer, seen as a float."""
    C_CAST = "c_cast"
    """The integer converted to a float."""


def px4_mode(main: int, sub: int) -> int:
    """PX4's custom_mode (px4_custom_mode.h): main mode in byte 2, sub mode in byte 3."""
    return (main << 16) | (sub << 24)


_AUTO = 4
_PX4_MODES = {
    FlightMode.MANUAL: px4_mode(1, 0),  # MANUAL
    FlightMode.STABILIZE: px4_mode(7, 0),  # STABILIZED
    FlightMode.ALT_HOLD: px4_mode(2, 0),  # ALTCTL
    FlightMode.POSHOLD: px4_mode(3, 0),  # POSCTL
    FlightMode.GUIDED: px4_mode(6, 0),  # OFFBOARD
    FlightMode.CIRCLE: px4_mode(3, 1),  # POSCTL.ORBIT
    FlightMode.TAKEOFF: px4_mode(_AUTO, 2),  # AUTO.TAKEOFF
    FlightMode.HOLD: px4_mode(_AUTO, 3),  # AUTO.LOITER
    FlightMode.MISSION: px4_mode(_AUTO, 4),  # AUTO.MISSION
    FlightMode.RETURN: px4_mode(_AUTO, 5),  # AUTO.RTL
    FlightMode.SURFACE: px4_mode(_AUTO, 6),  # AUTO.LAND
}
_ARDUSUB_MODES = {
    FlightMode.MANUAL: 19,
    FlightMode.STABILIZE: 0,
    FlightMode.ALT_HOLD: 2,
    FlightMode.POSHOLD: 16,
    FlightMode.CIRCLE: 7,
    FlightMode.TAKEOFF: 13,  # free in ArduSub's table, TAKEOFF in ArduPilot's Plane
    # GUIDED: holds its place, takes go-to and set points; QGroundControl waits for it before a mission start
    FlightMode.HOLD: 4,
    FlightMode.GUIDED: 4,
    FlightMode.MISSION: 3,  # AUTO
    FlightMode.RETURN: 6,  # free in ArduSub's table, RTL in ArduPilot's other vehicles
    FlightMode.SURFACE: 9,  # SURFACE
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """One identity."""

    name: str
    autopilot: int
    """MAV_AUTOPILOT in the heartbeat."""
    custom_modes: Mapping[FlightMode, int]
    mode_names: Mapping[FlightMode, str]
    mode_aliases: Mapping[int, FlightMode]
    """Further custom_mode numbers that are understood."""
    split_modes: bool
    """DO_SET_MODE carries main and sub mode in param2 and param3 (PX4, MAVSDK) and not the whole number in param2."""
    param_encoding: ParamEncoding
    home_is_item_0: bool
    """Missions on the wire begin with the home position (ArduPilot)."""
    least_version: tuple[int, int, int]
    """flight_sw_version is never below this: QGroundControl warns of PX4 older than 1.4.1, and to an ArduSub older than
    3.5 it shows the pages and asks for the parameters of that time."""
    guided_in_hold: bool = False
    """Hold and set points are one mode, which set points by themselves begin and end (ArduPilot's GUIDED)."""
    note: str
    """What the operator is told at first contact."""

    @property
    def listed(self) -> tuple[FlightMode, ...]:
        """Modes with a number of their own, in the order of AVAILABLE_MODES.mode_index."""
        return tuple(mode for mode in MODES if self.mode_of(self.custom_modes[mode]) is mode)

    def mode_of(self, custom_mode: int) -> FlightMode | None:
        """The mode of a custom_mode number, None if there is none."""
        for mode, number in self.custom_modes.items():
            if number == custom_mode:
                return mode
        return self.mode_aliases.get(custom_mode)

    def short_mode(self, custom_mode: int) -> int:
        """A custom_mode in the 16 bits of HIGH_LATENCY2: of PX4's numbers the upper half, in which all of them is."""
        return custom_mode >> 16 if self.split_modes else custom_mode & 0xFFFF

    def mode_of_command(self, main: float, sub: float) -> FlightMode | None:
        """The mode that DO_SET_MODE's param2 and param3 mean, None if there is none."""
        if not (0.0 <= main < 2.0**32 and main == int(main)):
            return None
        if not self.split_modes or main > 255.0:
            return self.mode_of(int(main))
        if not (0.0 <= sub <= 255.0 and sub == int(sub)):
            return None
        return self.mode_of(px4_mode(int(main), int(sub)))


_NAMES = {
    FlightMode.HOLD: "Hold",
    FlightMode.MISSION: "Mission",
    FlightMode.RETURN: "Return",
    FlightMode.SURFACE: "Surface",
    FlightMode.MANUAL: "Manual",
    FlightMode.STABILIZE: "Stabilize",
    FlightMode.ALT_HOLD: "Depth hold",
    FlightMode.POSHOLD: "Position",
    FlightMode.GUIDED: "Offboard",
    FlightMode.CIRCLE: "Orbit",
    FlightMode.TAKEOFF: "Takeoff",
}

PROFILES: Mapping[str, Profile] = MappingProxyType(
    {
        "generic": Profile(
            name="generic",
            autopilot=0,  # MAV_AUTOPILOT_GENERIC
            custom_modes=MappingProxyType(_PX4_MODES),  # MAVSDK sends PX4 numbers to a generic vehicle too
            mode_names=MappingProxyType(_NAMES),
            mode_aliases=MappingProxyType({}),
            split_modes=True,
            param_encoding=ParamEncoding.BYTEWISE,
            home_is_item_0=False,
            least_version=(0, 0, 0),
            note="generic profile",
        ),
        "px4": Profile(
            name="px4",
            autopilot=12,  # MAV_AUTOPILOT_PX4
            custom_modes=MappingProxyType(_PX4_MODES),
            mode_names=MappingProxyType(_NAMES),
            mode_aliases=MappingProxyType({}),
            split_modes=True,
            param_encoding=ParamEncoding.BYTEWISE,
            home_is_item_0=False,
            least_version=(1, 4, 1),
            note="px4 profile, not PX4",
        ),
        "ardusub": Profile(
            name="ardusub",
            autopilot=3,  # MAV_AUTOPILOT_ARDUPILOTMEGA
            custom_modes=MappingProxyType(_ARDUSUB_MODES),
            mode_names=MappingProxyType({**_NAMES, FlightMode.HOLD: "Guided", FlightMode.CIRCLE: "Circle"}),
            mode_aliases=MappingProxyType({}),
            guided_in_hold=True,
            split_modes=False,
            param_encoding=ParamEncoding.C_CAST,
            home_is_item_0=True,
            least_version=(4, 1, 0),
            note="ardusub profile",
        ),
    }
)


def profile_by_name(name: str) -> Profile:
    """The profile of that name; ConfigError if there is none."""
    if name not in PROFILES:
        raise ConfigError(f"profile {name!r} does not exist; use one of {', '.join(PROFILES)}")
    return PROFILES[name]
