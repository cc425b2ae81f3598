"""Parameters that QGroundControl's PX4 plug-in cannot do without: there, with a fixed value, and used by nothing.

Without them it opens two popups at every connect and paints its setup page red ("Parameters are missing from
firmware"). They exist under the px4 profile alone, cannot be set, and say what they are in their help.
"""

from collections.abc import Mapping
from types import MappingProxyType

from autopilot.core.params import ParamSpec, ParamType
from autopilot.mavlink.profiles import Profile

HELP = "Does nothing: QGroundControl's PX4 plug-in asks for it. Read only."
GROUP_OF_STUBS = "Not used (QGroundControl)"

_INT32_STUBS: Mapping[str, int] = {
    "SYS_AUTOSTART": 60_000,  # PX4's number of a generic underwater vehicle; 0 makes the airframe page complain
    "SYS_AUTOCONFIG": 0,
    "SYS_HAS_MAG": 0,  # else the sensors page wants a compass calibrated that PX4 does not have here
    "MAV_SYS_ID": 1,
    "CAL_GYRO0_ID": 1,  # "calibrated"
    "CAL_ACC0_ID": 1,
    "CAL_MAG0_ID": 0,
    "CAL_MAG1_ID": 0,
    "CAL_MAG2_ID": 0,
    "COM_RC_IN_MODE": 1,  # joystick only: no radio page
    "COM_FLTMODE1": -1,
    "COM_FLTMODE2": -1,
    "COM_FLTMODE3": -1,
    "COM_FLTMODE4": -1,
    "COM_FLTMODE5": -1,
    "COM_FLTMODE6": -1,
    "COM_LOW_BAT_ACT": 0,
    "NAV_DLL_ACT": 0,
    "NAV_RCL_ACT": 0,
    "RC_MAP_ROLL": 0,
    "RC_MAP_PITCH": 0,
    "RC_MAP_YAW": 0,
    "RC_MAP_THROTTLE": 0,
    "RC_MAP_FLAPS": 0,
    "RC_MAP_AUX1": 0,
    "RC_MAP_AUX2": 0,
    "BAT1_N_CELLS": 0,
}
_REAL32_STUBS: Mapping[str, float] = {
    "BAT1_V_EMPTY": 3.6,
    "BAT1_V_CHARGED": 4.05,
    "COM_RC_LOSS_T": 0.5,
    "RTL_LAND_DELAY": 0.0,
    "RTL_DESCEND_ALT": 0.0,
    "RTL_RETURN_ALT": 0.0,
}


def _stub(name: str, value: float, kind: ParamType) -> ParamSpec:
    return ParamSpec(
        name=name, default=value, minimum=value, maximum=value, unit="", help=HELP, type=kind, family=GROUP_OF_STUBS
    )


STUBS: Mapping[str, ParamSpec] = MappingProxyType(
    {
        **{name: _stub(name, value, ParamType.INT32) for name, value in _INT32_STUBS.items()},
        **{name: _stub(name, value, ParamType.REAL32) for name, value in _REAL32_STUBS.items()},
    }
)


def stubs_of(profile: Profile) -> Mapping[str, ParamSpec]:
    """The stubs that exist under a profile, by name."""
    return STUBS if profile.name == "px4" else {}
