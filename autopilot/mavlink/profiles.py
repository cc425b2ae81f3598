"""Identity profiles: MAV_AUTOPILOT, mode numbers and parameter encoding. Everything else is the same under all.

Ground stations choose buttons, mode numbers and parameter encoding by HEARTBEAT.autopilot. ``generic`` is the
accurate identity; ``px4`` and ``ardusub`` give full function in QGroundControl, MAVSDK and Cockpit. The real name
is in AUTOPILOT_VERSION and in a STATUSTEXT at first contact.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType

from autopilot.core.names import unknown
from autopilot.mavlink.flight_modes import MODE_ROWS, FlightMode, px4_mode

CUSTOM_MODE_FLAG = 1
"""MAV_MODE_FLAG_CUSTOM_MODE_ENABLED."""


class ParamEncoding(Enum):
    """How integer parameters travel in the float field of PARAM_VALUE and PARAM_SET."""

    BYTEWISE = "bytewise"
    """The four bytes of the integer, seen as a float."""
    C_CAST = "c_cast"
    """The integer converted to a float."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    name: str
    autopilot: int
    """MAV_AUTOPILOT in the heartbeat."""
    custom_modes: Mapping[FlightMode, int]
    mode_names: Mapping[FlightMode, str]
    split_modes: bool
    """DO_SET_MODE carries main and sub mode in param2 and param3 (PX4, MAVSDK) and not the whole number in param2."""
    param_encoding: ParamEncoding
    home_is_item_0: bool
    """Missions on the wire begin with the home position (ArduPilot)."""
    least_version: tuple[int, int, int]
    """Minimum of flight_sw_version: QGroundControl warns of PX4 older than 1.4.1, and for ArduSub older than 3.5
    it shows old pages and requests old parameters."""
    guided_in_hold: bool = False
    """Hold and set points are one mode, which set points by themselves begin and end (ArduPilot's GUIDED)."""
    note: str
    """Text sent to the operator at first contact."""

    @property
    def listed(self) -> tuple[FlightMode, ...]:
        """Modes with a number of their own, in the order of AVAILABLE_MODES.mode_index."""
        return tuple(mode for mode in MODE_ROWS if self.mode_of(self.custom_modes[mode]) is mode)

    def mode_of(self, custom_mode: int) -> FlightMode | None:
        """Mode of a custom_mode number, None if it is unknown."""
        return next((mode for mode, number in self.custom_modes.items() if number == custom_mode), None)

    def short_mode(self, custom_mode: int) -> int:
        """A custom_mode in the 16 bits of HIGH_LATENCY2: of PX4's numbers the upper half, in which all of them is."""
        return custom_mode >> 16 if self.split_modes else custom_mode & 0xFFFF

    def mode_of_command(self, main: float, sub: float) -> FlightMode | None:
        """Mode of DO_SET_MODE's param2 and param3, None if it is unknown."""
        if not (0.0 <= main < 2.0**32 and main == int(main)):
            return None
        if not self.split_modes or main > 255.0:
            return self.mode_of(int(main))
        if not (0.0 <= sub <= 255.0 and sub == int(sub)):
            return None
        return self.mode_of(px4_mode(int(main), int(sub)))


_PX4_MODES = MappingProxyType({mode: row.px4 for mode, row in MODE_ROWS.items()})
_LABELS = MappingProxyType({mode: row.label for mode, row in MODE_ROWS.items()})

PROFILES: Mapping[str, Profile] = MappingProxyType(
    {
        "generic": Profile(
            name="generic",
            autopilot=0,  # MAV_AUTOPILOT_GENERIC
            custom_modes=_PX4_MODES,  # MAVSDK sends PX4 numbers to a generic vehicle too
            mode_names=_LABELS,
            split_modes=True,
            param_encoding=ParamEncoding.BYTEWISE,
            home_is_item_0=False,
            least_version=(0, 0, 0),
            note="generic profile",
        ),
        "px4": Profile(
            name="px4",
            autopilot=12,  # MAV_AUTOPILOT_PX4
            custom_modes=_PX4_MODES,
            mode_names=MappingProxyType({mode: row.px4_label or row.label for mode, row in MODE_ROWS.items()}),
            split_modes=True,
            param_encoding=ParamEncoding.BYTEWISE,
            home_is_item_0=False,
            least_version=(1, 4, 1),
            note="px4 profile, not PX4",
        ),
        "ardusub": Profile(
            name="ardusub",
            autopilot=3,  # MAV_AUTOPILOT_ARDUPILOTMEGA
            custom_modes=MappingProxyType({mode: row.ardusub for mode, row in MODE_ROWS.items()}),
            mode_names=MappingProxyType({mode: row.ardusub_label or row.label for mode, row in MODE_ROWS.items()}),
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
    """Profile by name; ConfigError if it is unknown."""
    if name not in PROFILES:
        raise unknown("profile", name, tuple(PROFILES))
    return PROFILES[name]
