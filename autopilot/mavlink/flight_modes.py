"""MAVLink view of the flight modes: numbers and names, one row per mode. Behaviour: :mod:`autopilot.command.modes`."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType

from autopilot.core.arming_reasons import ModeGroup


class FlightMode(IntEnum):
    """Flight modes. Numbers are internal; a profile maps them to its custom_mode."""

    HOLD = 0
    """Station keeping."""
    MISSION = 1
    RETURN = 2
    """Back to home, then hold."""
    SURFACE = 3
    """Up at the present position, then disarm."""
    MANUAL = 4
    """Sticks are thrust."""
    STABILIZE = 5
    """As MANUAL, heading held."""
    ALT_HOLD = 6
    """As STABILIZE, depth held."""
    POSHOLD = 7
    """Sticks are velocities; released, the vehicle holds its place."""
    GUIDED = 8
    """Set points of a client, one after the other."""
    CIRCLE = 9
    """Round a place."""
    TAKEOFF = 10
    """Dive to a depth, then hold: the take-off of an underwater vehicle."""
    SURFTRAK = 11
    """As ALT_HOLD, but the height over the floor is held."""


def px4_mode(main: int, sub: int = 0) -> int:
    """PX4's custom_mode (px4_custom_mode.h): main mode in byte 2, sub mode in byte 3."""
    return (main << 16) | (sub << 24)


_AUTO = 4
"""PX4's main mode of everything that flies by itself."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeRow:
    label: str
    px4: int
    """custom_mode of px4_custom_mode.h."""
    ardusub: int
    """custom_mode of ArduSub, or where it has none of ArduPilot's other vehicles."""
    px4_label: str = ""
    ardusub_label: str = ""
    """Where PX4 or ArduPilot has another: buttons of ground stations ask for a mode by its name there."""
    standard: int = 0
    """MAV_STANDARD_MODE, 0 = none. Position hold is the one with sticks. Only numbers that mean the same in common.xml
    of 2025 and in development.xml of 2022, which ground stations of that time go by: one that means one mode to this
    side and another to the other (7: land, or mission) would surface a vehicle that is to start."""
    button: int | None = None
    """Value of BTNn_FUNCTION that chooses it, as in ArduSub where it has one."""
    piloted: bool = False
    """A pilot steers."""


MODE_ROWS: Mapping[FlightMode, ModeRow] = MappingProxyType(
    {
        # ArduSub's GUIDED holds its place, takes go-to and set points; QGroundControl waits for it before a mission
        # start. The first of two with one number is what the number means.
        FlightMode.HOLD: ModeRow(label="Hold", px4=px4_mode(_AUTO, 3), ardusub=4, ardusub_label="Guided", button=14),
        FlightMode.MISSION: ModeRow(label="Mission", px4=px4_mode(_AUTO, 4), ardusub=3, button=9),
        FlightMode.RETURN: ModeRow(label="Return", px4=px4_mode(_AUTO, 5), ardusub=6, ardusub_label="RTL", button=15),
        FlightMode.SURFACE: ModeRow(label="Surface", px4=px4_mode(_AUTO, 6), px4_label="Land", ardusub=9, button=16),
        FlightMode.MANUAL: ModeRow(label="Manual", px4=px4_mode(1), ardusub=19, button=5, piloted=True),
        FlightMode.STABILIZE: ModeRow(label="Stabilize", px4=px4_mode(7), ardusub=0, button=6, piloted=True),
        FlightMode.ALT_HOLD: ModeRow(
            label="Depth hold", px4=px4_mode(2), ardusub=2, standard=4, button=7, piloted=True
        ),
        FlightMode.POSHOLD: ModeRow(label="Position", px4=px4_mode(3), ardusub=16, standard=1, button=8, piloted=True),
        FlightMode.GUIDED: ModeRow(label="Offboard", px4=px4_mode(6), ardusub=4, button=11),
        FlightMode.CIRCLE: ModeRow(
            label="Orbit", px4=px4_mode(3, 1), ardusub=7, ardusub_label="Circle", standard=2, button=10
        ),
        # Not "Takeoff", which QGroundControl 5.0 leaves out of its menu
        FlightMode.TAKEOFF: ModeRow(label="Dive", px4=px4_mode(_AUTO, 2), ardusub=13),
        # PX4 has no such mode: EXTERNAL1, of those for modes of one's own
        FlightMode.SURFTRAK: ModeRow(label="Surftrak", px4=px4_mode(_AUTO, 11), ardusub=21, button=13, piloted=True),
    }
)
"""In the order in which they are listed to operators."""

PILOTED = frozenset(mode for mode, row in MODE_ROWS.items() if row.piloted)
"""Modes in which a pilot steers."""

POSITIONLESS = PILOTED - {FlightMode.POSHOLD}
"""Modes in which a pilot without a position may arm and steer."""


def group_of(mode: FlightMode) -> ModeGroup:
    """The group to whose conditions of arming a mode belongs."""
    if mode is FlightMode.MISSION:
        return ModeGroup.MISSION
    return ModeGroup.POSITIONLESS if mode in POSITIONLESS else ModeGroup.POSITION


MODE_BUTTONS: Mapping[int, FlightMode] = MappingProxyType(
    {row.button: mode for mode, row in MODE_ROWS.items() if row.button is not None}
)
"""Values of BTNn_FUNCTION that choose a mode."""

STANDARD_MODES: Mapping[int, FlightMode] = MappingProxyType(
    {row.standard: mode for mode, row in MODE_ROWS.items() if row.standard}
)
"""The mode of each MAV_STANDARD_MODE that there is one for."""
