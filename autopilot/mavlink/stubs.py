"""Parameters of other firmwares that QGroundControl's plug-ins require: read-only, with values true of this vehicle.

Without them QGroundControl opens popups ("Parameters are missing from firmware") at every connect and on its setup
pages. Those of a plug-in exist under its profile only. One row each: the value, and why it is true. A value that one
of our parameters decides follows it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from autopilot.core.params import ParamSpec, ParamType
from autopilot.mavlink.profiles import Profile

GROUP_OF_STUBS = "Read only (QGroundControl)"


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleFacts:
    """What is known of the vehicle beyond its parameters; 0 = unknown."""

    sysid: int = 1
    thrusters: int = 0
    full_v: float = 0.0
    empty_v: float = 0.0
    """Voltages of the battery at rest."""
    gripper: bool = False


Value = Callable[[Mapping[str, float], VehicleFacts], float]
"""From our parameters and the vehicle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stub:
    spec: ParamSpec
    value: Value
    follows: str = ""
    """Our parameter that decides the value, "" = none."""


@dataclass(frozen=True, slots=True)
class _Row:
    name: str
    value: float | Value
    why: str
    """Why the value is true, and the meanings of an enumeration's numbers (the plug-in's)."""
    kind: ParamType = ParamType.INT32
    highest: float = 0.0
    """Of a value that changes."""
    follows: str = ""


def _real(name: str, value: float | Value, why: str, highest: float = 0.0, follows: str = "") -> _Row:
    return _Row(name, value, why, ParamType.REAL32, highest, follows)


def _same(name: str) -> Value:
    return lambda params, vehicle: params[name]


def _action(name: str, *codes: int) -> Value:
    """The plug-in's number of each value of our parameter."""
    return lambda params, vehicle: codes[int(params[name])]


def _gripper(params: Mapping[str, float], vehicle: VehicleFacts) -> float:
    return float(vehicle.gripper)


_NO_RADIO = "No radio receiver: sticks come by MAVLink."
_NO_RECEIVER_SPAN = "No radio receiver, so the span of a servo pulse."

_PX4 = (
    _Row("SYS_AUTOSTART", 60_000, "PX4's number of a generic underwater vehicle."),
    _Row("SYS_AUTOCONFIG", 0, "No parameters are reset at start."),
    _Row("SYS_HAS_MAG", 0, "No magnetometer of its own: heading comes from the AHRS."),
    _Row("MAV_SYS_ID", lambda params, vehicle: vehicle.sysid, "System id in use.", highest=255),
    _Row(
        "FRAME_CONFIG",
        lambda params, vehicle: {3: 4, 4: 5, 5: 6, 6: 1, 8: 2}.get(vehicle.thrusters, 7),
        "ArduSub's frame with as many thrusters, by which the motor page counts them: 1 = six, 2 = eight, 4 = three, "
        "5 = four, 6 = five, 7 = another number.",
        highest=7,
    ),
    # Sensors: calibrated on board
    _Row("CAL_GYRO0_ID", 1, "One gyroscope, that of the AHRS, calibrated by its maker."),
    _Row("CAL_ACC0_ID", 1, "One accelerometer, that of the AHRS, calibrated by its maker."),
    _Row("CAL_MAG0_ID", 1, "One heading sensor, the AHRS, which corrects its compass itself."),
    _Row("CAL_MAG1_ID", 0, "No second compass."),
    _Row("CAL_MAG2_ID", 0, "No third compass."),
    *(_Row(f"CAL_MAG{n}_ROT", -1, "No external compass whose mounting could be set.") for n in range(3)),
    _Row("SENS_BOARD_ROT", 0, "Mounting angles are in the vehicle file and corrected on board."),
    *(
        _real(f"SENS_BOARD_{axis}_OFF", 0.0, "Mounting angles are in the vehicle file and corrected on board.")
        for axis in "XYZ"
    ),
    _real("SENS_DPRES_OFF", 0.0, "No airspeed sensor."),
    # Radio and flight modes
    _Row("COM_RC_IN_MODE", 1, "Joystick only."),
    _Row("RC_CHAN_CNT", 0, _NO_RADIO),
    *(
        _Row(f"RC_MAP_{name}", 0, _NO_RADIO)
        for name in (
            *("ROLL", "PITCH", "YAW", "THROTTLE", "FLAPS", "FLTMODE"),
            *(f"AUX{n}" for n in range(1, 7)),
            *(f"PARAM{n}" for n in range(1, 4)),
            *(f"{switch}_SW" for switch in ("ARM", "GEAR", "KILL", "LOITER", "OFFB", "RETURN", "TRANS")),
        )
    ),
    *(
        _real(f"RC_{name}_TH", 0.0, _NO_RADIO)
        for name in ("ARMSWITCH", "GEAR", "KILLSWITCH", "LOITER", "OFFB", "RETURN", "TRANS")
    ),
    *(
        _real(f"RC{n}_{name}", value, _NO_RECEIVER_SPAN)
        for n in range(1, 19)
        for name, value in (("MIN", 1000.0), ("TRIM", 1500.0), ("MAX", 2000.0), ("REV", 1.0))
    ),
    *(_Row(f"COM_FLTMODE{n}", -1, "No mode switch: modes are chosen in the menu.") for n in range(1, 7)),
    # Power
    _Row("BAT1_SOURCE", 1, "Voltage comes from the vehicle's driver."),
    _Row("BAT1_N_CELLS", 1, "The vehicle file gives voltages of the whole battery, counted as one cell."),
    _real("BAT1_V_CHARGED", lambda params, vehicle: vehicle.full_v, "Of the whole battery, full, at rest.", 1000.0),
    _real("BAT1_V_EMPTY", lambda params, vehicle: vehicle.empty_v, "Of the whole battery, empty, at rest.", 1000.0),
    _real("BAT1_V_LOAD_DROP", 0.0, "Charge is counted from energy, not from voltage under load."),
    # Safety
    _Row(
        "COM_LOW_BAT_ACT",
        _action("FS_BATT_ACT", 0, 4, 2, 1, 4, 2, 4),
        "FS_BATT_ACT: 0 = warning, 1 = return, 2 = surface, 3 = return, then surface, 4 = another.",
        highest=4,
        follows="FS_BATT_ACT",
    ),
    _real("BAT_LOW_THR", _same("FS_BATT_LOW"), "FS_BATT_LOW: there is no earlier warning.", 1.0, "FS_BATT_LOW"),
    _real("BAT_CRIT_THR", _same("FS_BATT_LOW"), "FS_BATT_LOW, at which FS_BATT_ACT acts.", 1.0, "FS_BATT_LOW"),
    _real("BAT_EMERGEN_THR", _same("FS_BATT_CRT"), "FS_BATT_CRT, at which FS_BATT_CRT_ACT acts.", 1.0, "FS_BATT_CRT"),
    _Row(
        "NAV_DLL_ACT",
        _action("FS_GCS_ENABLE", 0, 0, 6, 1, 3, 2),
        "FS_GCS_ENABLE: 0 = none, 1 = hold, 2 = return, 3 = surface, 4 = another, 5 = terminate, 6 = disarm.",
        highest=6,
        follows="FS_GCS_ENABLE",
    ),
    _Row(
        "COM_DL_LOSS_T",
        lambda params, vehicle: round(params["FS_GCS_TIMEOUT"]),
        "FS_GCS_TIMEOUT in whole seconds.",
        highest=3600,
        follows="FS_GCS_TIMEOUT",
    ),
    _Row(
        "NAV_RCL_ACT",
        _action("FS_PILOT_INPUT", 0, 0, 6, 1),
        "FS_PILOT_INPUT: 0 = none, 1 = hold, 2 = return, 3 = surface, 4 = another, 5 = terminate, 6 = disarm.",
        highest=6,
        follows="FS_PILOT_INPUT",
    ),
    _real("COM_RC_LOSS_T", _same("FS_PILOT_TIMEOUT"), "FS_PILOT_TIMEOUT.", 60.0, "FS_PILOT_TIMEOUT"),
    _Row(
        "GF_ACTION",
        _action("FS_CAGE_ACT", 1, 2, 5, 3, 4, 5, 1),
        "FS_CAGE_ACT: 0 = none, 1 = warning, 2 = hold, 3 = return, 4 = disarm, 5 = surface.",
        highest=5,
        follows="FS_CAGE_ACT",
    ),
    _real("GF_MAX_HOR_DIST", 0.0, "The fence is a plan; there is no other radius."),
    _real("GF_MAX_VER_DIST", 0.0, "Depth is bounded by DEPTH_MIN and DEPTH_MAX."),
    _real("RTL_RETURN_ALT", 0.0, "Return keeps the present depth."),
    _real("RTL_DESCEND_ALT", 0.0, "Return keeps the present depth."),
    _real("RTL_LAND_DELAY", -1.0, "Return holds at home and does not surface."),
    _real("COM_DISARM_LAND", 0.1, "Surface disarms there at once; 0 would mean never."),
    _real("CP_DIST", _same("MPC_MARGIN"), "MPC_MARGIN, kept from fence and obstacles.", 1.0, "MPC_MARGIN"),
    _Row("COM_OBS_AVOID", 0, "Obstacles are avoided on board, without a companion computer."),
    _Row("SDLOG_MODE", 0, "A log per arming, to disarming."),
    # Buttons that are shown by a parameter
    _real(
        "MPC_XY_VEL_MAX",
        _same("SPD_PLANAR_MAX"),
        "SPD_PLANAR_MAX, the highest speed to change to.",
        3.0,
        "SPD_PLANAR_MAX",
    ),
    _Row("PD_GRIPPER_EN", _gripper, "1 = the vehicle file has a gripper.", highest=1),
)

_ARDUSUB = (
    *(_Row(f"COMPASS_DEV_ID{n}", 0, "No compass of its own: heading comes from the AHRS.") for n in ("", "2", "3")),
    *(_Row(f"COMPASS_USE{n}", 0, "No compass of its own: heading comes from the AHRS.") for n in ("", "2", "3")),
    *(
        _real(f"COMPASS_OFS{n}_{axis}", 0.0, "No compass of its own: heading comes from the AHRS.")
        for n in ("", "2", "3")
        for axis in "XYZ"
    ),
    _real("COMPASS_DEC", 0.0, "Declination is corrected by the AHRS."),
    *(
        _real(f"INS_ACCOFFS_{axis}", 0.001, "The AHRS is calibrated by its maker; 0 would mean: not calibrated.")
        for axis in "XYZ"
    ),
    _Row("BATT_CAPACITY", 3300, "The vehicle file has the true one; 0 would mark the power page."),
    _Row("BATT_MONITOR", 4, "Voltage and current are measured."),
    _Row("BATT_FS_LOW_ACT", 0, "FS_BATT_ACT decides."),
    _Row("BATT_LOW_MAH", 0, "FS_BATT_LOW decides."),
    _Row("ARMING_CHECK", 1, "All checks are made."),
    _Row("FS_EKF_ACTION", 0, "FS_NAV_ACT decides."),
    _real("FS_EKF_THRESH", 0.8, "FS_NAV_TIMEOUT decides."),
    _Row("LEAK1_PIN", -1, "No pin: leaks come from the vehicle's driver."),
    _Row("LEAK1_LOGIC", 0, "No pin: leaks come from the vehicle's driver."),
    _Row("FRAME_CONFIG", 7, "ArduSub's number of a frame that it does not know."),
    *(_Row(f"MNT_RC_IN_{axis}", 0, "The camera is fixed.") for axis in ("TILT", "ROLL", "PAN")),
    *(_Row(f"SERVO{n}_FUNCTION", 0, "Outputs are in the vehicle file.") for n in range(1, 17)),
    _real(
        "WPNAV_SPEED",
        lambda params, vehicle: 100.0 * params["SPD_PLANAR_MAX"],
        "SPD_PLANAR_MAX in cm/s, the highest speed to change to.",
        300.0,
        "SPD_PLANAR_MAX",
    ),
    _Row("GRIP_ENABLE", _gripper, "1 = the vehicle file has a gripper.", highest=1),
)


def _stub(row: _Row) -> Stub:
    value = row.value
    if callable(value):
        default, low, high, given = 0.0, 0.0, row.highest, value
    else:
        default = low = high = fixed = float(value)

        def given(params: Mapping[str, float], vehicle: VehicleFacts) -> float:
            return fixed

    spec = ParamSpec(
        name=row.name,
        default=default,
        minimum=low,
        maximum=high,
        unit="",
        help=f"{row.why} Read only.",
        type=row.kind,
        family=GROUP_OF_STUBS,
    )
    return Stub(spec=spec, value=given, follows=row.follows)


STUBS: Mapping[str, Mapping[str, Stub]] = MappingProxyType(
    {
        profile: MappingProxyType({row.name: _stub(row) for row in rows})
        for profile, rows in (("px4", _PX4), ("ardusub", _ARDUSUB))
    }
)
"""By profile and name."""


@dataclass(frozen=True, slots=True)
class Stubs:
    """Those of one profile, with their values."""

    profile: Profile
    params: Mapping[str, float]
    vehicle: VehicleFacts
    table: Mapping[str, Stub] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "table", stubs_of(self.profile))

    def value(self, name: str) -> float:
        stub = self.table[name]
        return float(stub.value(self.params, self.vehicle))

    def followers(self, name: str) -> list[str]:
        """Those whose value one of our parameters decides."""
        return [stub for stub, row in self.table.items() if row.follows == name]


def stubs_of(profile: Profile) -> Mapping[str, Stub]:
    """The stubs that exist under a profile, by name."""
    return STUBS.get(profile.name, {})
