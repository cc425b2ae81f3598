"""Identity and health: HEARTBEAT, SYS_STATUS, battery, version, modes."""

from collections.abc import Mapping

from pymavlink.dialects.v20 import development as mav

from autopilot.core.messages import Failsafe, NavDoubt, NavHealth
from autopilot.mavlink.context import Context, VehicleIdentity, i16, i32, limited, u16
from autopilot.mavlink.flight_modes import MODE_ROWS, PILOTED, FlightMode
from autopilot.mavlink.profiles import ParamEncoding, Profile
from autopilot.mavlink.telemetry import Builder
from autopilot.mavlink.wire import Message, RawMessage

MSG_ID_PROTOCOL_VERSION = 300
_PROTOCOL_VERSION_CRC_EXTRA = 217
"""common.xml; the message is not in the packaged dialect."""

VENDOR_ID = 0x4155
PRODUCT_ID = 0x4155
"""The letters "UA" (underwater autopilot) in the board ids: not PX4, not ArduPilot, not a registered USB id."""

MAVLINK_VERSION = 3
"""HEARTBEAT.mavlink_version (minimal.xml)."""

_OFFICIAL = 255
"""FIRMWARE_VERSION_TYPE_OFFICIAL."""

_SENSORS = (
    mav.MAV_SYS_STATUS_AHRS
    | mav.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mav.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mav.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mav.MAV_SYS_STATUS_SENSOR_VISION_POSITION
    | mav.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
    | mav.MAV_SYS_STATUS_SENSOR_YAW_POSITION
    | mav.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL
    | mav.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
    | mav.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mav.MAV_SYS_STATUS_GEOFENCE
    | mav.MAV_SYS_STATUS_SENSOR_BATTERY
    | mav.MAV_SYS_STATUS_PREARM_CHECK
)

_INERTIAL = (
    mav.MAV_SYS_STATUS_AHRS
    | mav.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mav.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mav.MAV_SYS_STATUS_SENSOR_3D_MAG
)
"""The AHRS and its sensors: MAVSDK requests the three one by one."""

_CAPABILITIES = (
    mav.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mav.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mav.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | mav.MAV_PROTOCOL_CAPABILITY_FTP
    | mav.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | mav.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
)
_ENCODING_BIT = {
    ParamEncoding.BYTEWISE: mav.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE,
    ParamEncoding.C_CAST: mav.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST,
}


def version_number(version: str, least: tuple[int, int, int]) -> int:
    """flight_sw_version: one byte each of major, minor, patch and type, never below ``least``."""
    digits = [int(part) if part.isdigit() else 0 for part in version.split("+")[0].split(".")[:3]]
    own = (*digits, 0, 0, 0)
    major, minor, patch = (min(n, 255) for n in max((own[0], own[1], own[2]), least))
    return (major << 24) | (minor << 16) | (patch << 8) | _OFFICIAL


def autopilot_version(identity: VehicleIdentity, profile: Profile) -> Message:
    """AUTOPILOT_VERSION: the true version in middleware_sw_version, the git revision in every custom version."""
    true_version = version_number(identity.version, (0, 0, 0))
    revision = identity.git[:8].encode("ascii", errors="replace").ljust(8, b"\0")
    return mav.MAVLink_autopilot_version_message(
        _CAPABILITIES | _ENCODING_BIT[profile.param_encoding],
        version_number(identity.version, profile.least_version),
        true_version,
        0,
        0,
        list(revision),
        list(revision),
        [0] * 8,
        VENDOR_ID,
        PRODUCT_ID,
        identity.uid & (2**64 - 1),
        list((identity.uid & (2**64 - 1)).to_bytes(18, "little")),
    )


def protocol_version() -> Message:
    """PROTOCOL_VERSION: MAVLink 2 out, 1 and 2 in."""
    versions = b"".join(n.to_bytes(2, "little") for n in (200, 100, 200))
    return RawMessage(MSG_ID_PROTOCOL_VERSION, _PROTOCOL_VERSION_CRC_EXTRA, versions + bytes(16))


def available_mode(profile: Profile, index: int) -> Message:
    """AVAILABLE_MODES of one mode, ``index`` from 1."""
    mode = profile.listed[index - 1]
    return mav.MAVLink_available_modes_message(
        len(profile.listed),
        index,
        MODE_ROWS[mode].standard,
        profile.custom_modes[mode],
        0,
        profile.mode_names[mode].encode("ascii"),
    )


class StatusMessages:
    def __init__(self, ctx: Context) -> None:
        self._ctx = ctx

    def builders(self) -> Mapping[int, Builder]:
        return {
            mav.MAVLINK_MSG_ID_HEARTBEAT: self.heartbeat,
            mav.MAVLINK_MSG_ID_SYS_STATUS: self.sys_status,
            mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self.extended_sys_state,
            mav.MAVLINK_MSG_ID_BATTERY_STATUS: self.battery_status,
            mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION: lambda: autopilot_version(self._ctx.identity, self._ctx.profile),
            mav.MAVLINK_MSG_ID_CURRENT_MODE: self.current_mode,
            mav.MAVLINK_MSG_ID_AVAILABLE_MODES_MONITOR: lambda: mav.MAVLink_available_modes_monitor_message(
                0
            ),  # the list never changes
            MSG_ID_PROTOCOL_VERSION: protocol_version,
        }

    def heartbeat(self) -> Message:
        ctx, view = self._ctx, self._ctx.view
        base_mode = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if view.mode is not FlightMode.MANUAL:
            base_mode |= mav.MAV_MODE_FLAG_STABILIZE_ENABLED
        if view.mode in PILOTED:
            base_mode |= mav.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        else:
            base_mode |= mav.MAV_MODE_FLAG_GUIDED_ENABLED
            if view.mode is not FlightMode.HOLD:
                base_mode |= mav.MAV_MODE_FLAG_AUTO_ENABLED
        if view.armed:
            base_mode |= mav.MAV_MODE_FLAG_SAFETY_ARMED
            state = mav.MAV_STATE_CRITICAL if view.failsafes else mav.MAV_STATE_ACTIVE
        else:
            state = mav.MAV_STATE_STANDBY
        return mav.MAVLink_heartbeat_message(
            mav.MAV_TYPE_SUBMARINE,
            ctx.profile.autopilot,
            base_mode,
            ctx.profile.custom_modes[view.mode],
            state,
            MAVLINK_VERSION,
        )

    def sys_status(self) -> Message | None:
        """SYS_STATUS: PREARM_CHECK is healthy when arming would be accepted now.

        errors_count1 to 4: AHRS samples refused, pictures and fixes, other measurements not used, estimator resets."""
        ctx, view = self._ctx, self._ctx.view
        health = _SENSORS
        nav_health = NavHealth.INVALID if view.nav is None else view.nav.health
        if view.nav is None or view.failsafes >> Failsafe.AHRS_STALE & 1:
            health &= ~_INERTIAL
        if NavDoubt.ACCELEROMETER in view.nav_doubts:
            health &= ~(mav.MAV_SYS_STATUS_AHRS | mav.MAV_SYS_STATUS_SENSOR_3D_ACCEL)
        if NavDoubt.GYRO in view.nav_doubts:
            health &= ~(mav.MAV_SYS_STATUS_AHRS | mav.MAV_SYS_STATUS_SENSOR_3D_GYRO)
        if nav_health is not NavHealth.GOOD or view.failsafes >> Failsafe.NAV_CHECK & 1:
            health &= ~mav.MAV_SYS_STATUS_SENSOR_VISION_POSITION
        if nav_health is NavHealth.INVALID:
            health &= ~(mav.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL | mav.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL)
        if view.prearm_reasons:
            health &= ~mav.MAV_SYS_STATUS_PREARM_CHECK
        power = view.power
        voltage_mv, current_ca, remaining = 0xFFFF, -1, -1
        if power is not None:
            voltage_mv, current_ca = u16(power.voltage_v * 1e3), limited(power.current_a * 100.0, 0, 0x7FFF)
            remaining = limited(power.remaining * 100.0, 0, 100)
            if power.remaining < ctx.params["FS_BATT_LOW"]:
                health &= ~mav.MAV_SYS_STATUS_SENSOR_BATTERY
        else:
            health &= ~mav.MAV_SYS_STATUS_SENSOR_BATTERY
        present = enabled = _SENSORS
        if not view.fenced:  # "disabled" to ground stations; a fault where arming needs one
            health &= ~mav.MAV_SYS_STATUS_GEOFENCE
            if not ctx.params["FENCE_REQUIRED"]:
                enabled &= ~mav.MAV_SYS_STATUS_GEOFENCE
        if nav_health is NavHealth.GOOD:
            # As GPS_RAW_INT does: MAVSDK's global position is ok by this bit alone. Only then, for without it
            # QGroundControl offers to set the origin.
            present |= mav.MAV_SYS_STATUS_SENSOR_GPS
            enabled |= mav.MAV_SYS_STATUS_SENSOR_GPS
            health |= mav.MAV_SYS_STATUS_SENSOR_GPS
        drop_rate = 1e4 * view.dropped_rx / max(ctx.received + view.dropped_rx, 1)
        return mav.MAVLink_sys_status_message(
            present,
            enabled,
            health,
            limited(view.cpu_load * 1e3, 0, 1000),
            voltage_mv,
            current_ca,
            remaining,
            u16(drop_rate),
            u16(view.dropped_rx),
            *(u16(count) for count in view.nav_errors),
        )

    def extended_sys_state(self) -> Message | None:
        """EXTENDED_SYS_STATE: "on the ground" until the vehicle is sent somewhere, however deep it is.

        Ground stations offer arm, disarm and start of the mission on the ground, pause, go-to and return in the air.
        """
        view = self._ctx.view
        state = mav.MAV_LANDED_STATE_ON_GROUND
        if view.armed and view.mode is FlightMode.SURFACE:
            state = mav.MAV_LANDED_STATE_LANDING
        elif view.under_way:
            state = mav.MAV_LANDED_STATE_IN_AIR
        return mav.MAVLink_extended_sys_state_message(mav.MAV_VTOL_STATE_UNDEFINED, state)

    def battery_status(self) -> Message | None:
        """BATTERY_STATUS of the single pack: its voltage as that of the first cell (cells are not measured)."""
        power = self._ctx.view.power
        if power is None:
            return None
        low = power.remaining < self._ctx.params["FS_BATT_LOW"]
        return mav.MAVLink_battery_status_message(
            0,
            mav.MAV_BATTERY_FUNCTION_ALL,
            mav.MAV_BATTERY_TYPE_LION,
            0x7FFF,
            [limited(power.voltage_v * 1e3, 0, 0xFFFE)] + [0xFFFF] * 9,
            i16(power.current_a * 100.0),
            -1,
            i32(power.energy_used_j / 100.0),
            limited(power.remaining * 100.0, 0, 100),
            self._time_left_s(),
            mav.MAV_BATTERY_CHARGE_STATE_LOW if low else mav.MAV_BATTERY_CHARGE_STATE_OK,
        )

    def _time_left_s(self) -> int:
        """At the power of the last half minute; 0 = not known."""
        left_j, power_w = self._ctx.view.energy_left_j, self._ctx.view.sensed.power_w
        if left_j is None or power_w is None or not power_w > 0.0:
            return 0
        return limited(left_j / power_w, 1, 0x7FFF_FFFF)

    def current_mode(self) -> Message | None:
        """CURRENT_MODE: mode in force and mode requested by the operator."""
        view, modes = self._ctx.view, self._ctx.profile.custom_modes
        return mav.MAVLink_current_mode_message(
            MODE_ROWS[view.mode].standard, modes[view.mode], modes[view.intended_mode]
        )
