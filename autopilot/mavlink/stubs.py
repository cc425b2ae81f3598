"""Stub parameters that QGroundControl's plug-ins require: fixed values without effect.

Without them QGroundControl opens popups at every connect and marks its setup page red ("Parameters are missing from
firmware"). Those of a plug-in exist under its profile only, are read-only, and their help text says that they are
stubs.
"""

from collections.abc import Mapping
from types import MappingProxyType

from autopilot.core.params import ParamSpec, ParamType
from autopilot.mavlink.profiles import Profile

HELP = "Does nothing: QGroundControl's plug-in asks for it. Read only."
GROUP_OF_STUBS = "Not used (QGroundControl)"

_PX4_INT32: Mapping[str, int] = {
    "SYS_AUTOSTART": 60_000,  # PX4's number of a generic underwater vehicle; 0 makes the airframe page complain
    "SYS_AUTOCONFIG": 0,
    "SYS_HAS_MAG": 0,  # else the sensors page requires the calibration of a compass
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
_PX4_REAL32: Mapping[str, float] = {
    "BAT1_V_EMPTY": 3.6,
    "BAT1_V_CHARGED": 4.05,
    "COM_RC_LOSS_T": 0.5,
    "RTL_LAND_DELAY": 0.0,
    "RTL_DESCEND_ALT": 0.0,
    "RTL_RETURN_ALT": 0.0,
}


_ARDUSUB_INT32: Mapping[str, int] = {
    "COMPASS_DEV_ID": 0,  # none is installed, else the sensors page requires its calibration
    "COMPASS_DEV_ID2": 0,
    "COMPASS_DEV_ID3": 0,
    "COMPASS_USE": 0,
    "COMPASS_USE2": 0,
    "COMPASS_USE3": 0,
    "BATT_CAPACITY": 3300,  # 0 makes the power page red; the vehicle file has the true one
    "BATT_MONITOR": 4,
    "BATT_FS_LOW_ACT": 0,
    "BATT_LOW_MAH": 0,
    "ARMING_CHECK": 1,
    "FS_EKF_ACTION": 0,
    "LEAK1_PIN": -1,
    "LEAK1_LOGIC": 0,
    "FRAME_CONFIG": 7,  # ArduSub's number of a frame that it does not know
    "MNT_RC_IN_TILT": 0,
    "MNT_RC_IN_ROLL": 0,
    "MNT_RC_IN_PAN": 0,
    **{f"SERVO{n}_FUNCTION": 0 for n in range(1, 17)},
}
_ARDUSUB_REAL32: Mapping[str, float] = {
    **{f"COMPASS_OFS{n}_{axis}": 0.0 for n in ("", "2", "3") for axis in "XYZ"},
    "COMPASS_DEC": 0.0,
    "INS_ACCOFFS_X": 0.001,  # "calibrated"
    "INS_ACCOFFS_Y": 0.001,
    "INS_ACCOFFS_Z": 0.001,
    "FS_EKF_THRESH": 0.8,
}


def _stub(name: str, value: float, kind: ParamType) -> ParamSpec:
    return ParamSpec(
        name=name, default=value, minimum=value, maximum=value, unit="", help=HELP, type=kind, family=GROUP_OF_STUBS
    )


def _stubs(whole: Mapping[str, int], real: Mapping[str, float]) -> Mapping[str, ParamSpec]:
    return MappingProxyType(
        {
            **{name: _stub(name, value, ParamType.INT32) for name, value in whole.items()},
            **{name: _stub(name, value, ParamType.REAL32) for name, value in real.items()},
        }
    )


STUBS: Mapping[str, Mapping[str, ParamSpec]] = MappingProxyType(
    {"px4": _stubs(_PX4_INT32, _PX4_REAL32), "ardusub": _stubs(_ARDUSUB_INT32, _ARDUSUB_REAL32)}
)
"""By profile."""


def stubs_of(profile: Profile) -> Mapping[str, ParamSpec]:
    """The stubs that exist under a profile, by name."""
    return STUBS.get(profile.name, {})
