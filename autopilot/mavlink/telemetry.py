"""Navigation messages: position, attitude, velocity and goal."""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from pymavlink.dialects.v20 import development as mav

from autopilot.core.geodesy import GeodeticPosition, ned_from_geodetic, place_from_ned
from autopilot.core.messages import NavDoubt, NavHealth, NavState
from autopilot.mavlink.context import Context, f32, i16, i32, limited, u16
from autopilot.mavlink.wire import Message

Builder = Callable[[], Message | tuple[Message, ...] | None]
"""Builds one message of the present state or several of a kind, None or () without data."""

NAN = math.nan

SANE = 1e9
"""An estimate with a number beyond this (or NaN) has diverged: reported as no estimate."""

POSITION_ONLY_MASK = 0b110111111000
"""POSITION_TARGET_TYPEMASK: velocity, acceleration, yaw and yaw rate are not given."""

_FLAGS_GOOD = (
    mav.ESTIMATOR_ATTITUDE
    | mav.ESTIMATOR_VELOCITY_HORIZ
    | mav.ESTIMATOR_VELOCITY_VERT
    | mav.ESTIMATOR_POS_HORIZ_REL
    | mav.ESTIMATOR_POS_HORIZ_ABS
    | mav.ESTIMATOR_POS_VERT_ABS
    | mav.ESTIMATOR_PRED_POS_HORIZ_REL
    | mav.ESTIMATOR_PRED_POS_HORIZ_ABS
)
_FLAGS_DEAD_RECKONING = mav.ESTIMATOR_ATTITUDE | mav.ESTIMATOR_PRED_POS_HORIZ_REL | mav.ESTIMATOR_PRED_POS_HORIZ_ABS

_POSITION_DOUBTS = {NavDoubt.FIXES, NavDoubt.MAP, NavDoubt.CALIBRATION, NavDoubt.RESETS, NavDoubt.CAMERA}
"""Position fixes are suspect: GPS_GLITCH is the closest flag."""


class MotionNumbers(NamedTuple):
    """The estimate as plain numbers: NED metres and metres per second, radians."""

    north: float
    east: float
    down: float
    roll: float
    pitch: float
    yaw: float
    p: float
    q: float
    r: float
    vn: float
    ve: float
    vd: float
    water_speed: float
    heading_deg: float


def motion_of(nav: NavState) -> MotionNumbers | None:
    """Plain numbers of an estimate; None when it is invalid or not finite."""
    if nav.health is NavHealth.INVALID:
        return None
    numbers: list[float] = [
        *nav.pos_ned_m.tolist(),
        *nav.rpy_rad.tolist(),
        *nav.rate_frd_rad_s.tolist(),
        *nav.vel_frd_m_s.tolist(),
        *nav.vel_water_frd_m_s.tolist(),
    ]
    # Minimum and maximum ignore NaN, the sum does not.
    if not (max(numbers) < SANE and min(numbers) > -SANE and math.isfinite(sum(numbers))):
        return None
    north, east, down, roll, pitch, yaw, p, q, r, u, v, w, ur, vr, wr = numbers
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    # r_ned_from_frd row by row (Fossen 2011, eq. 2.18).
    vn = cy * cp * u + (cy * sp * sr - sy * cr) * v + (cy * sp * cr + sy * sr) * w
    ve = sy * cp * u + (sy * sp * sr + cy * cr) * v + (sy * sp * cr - cy * sr) * w
    vd = -sp * u + cp * sr * v + cp * cr * w
    water = math.sqrt(ur * ur + vr * vr + wr * wr)
    return MotionNumbers(north, east, down, roll, pitch, yaw, p, q, r, vn, ve, vd, water, math.degrees(yaw) % 360.0)


class NavigationMessages:
    def __init__(self, ctx: Context) -> None:
        self._ctx = ctx
        self._nav: NavState | None = None
        self._motion: MotionNumbers | None = None

    def builders(self) -> Mapping[int, Builder]:
        return {
            mav.MAVLINK_MSG_ID_ATTITUDE: self.attitude,
            mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self.attitude_quaternion,
            mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self.local_position_ned,
            mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self.global_position_int,
            mav.MAVLINK_MSG_ID_VFR_HUD: self.vfr_hud,
            mav.MAVLINK_MSG_ID_ALTITUDE: self.altitude,
            mav.MAVLINK_MSG_ID_ESTIMATOR_STATUS: self.estimator_status,
            mav.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: self.position_target_local_ned,
            mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: self.nav_controller_output,
            mav.MAVLINK_MSG_ID_HOME_POSITION: self.home_position,
            mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self.gps_global_origin,
            mav.MAVLINK_MSG_ID_WIND_COV: self.wind_cov,
            mav.MAVLINK_MSG_ID_DEBUG_VECT: self.debug_vect,
        }

    def motion(self) -> MotionNumbers | None:
        """The present estimate as plain numbers, None without one."""
        nav = self._ctx.view.nav
        if nav is not self._nav:
            self._nav = nav
            self._motion = None if nav is None else motion_of(nav)
        return self._motion

    def here(self) -> GeodeticPosition | None:
        """The present geodetic position, None without an estimate."""
        m = self.motion()
        return None if m is None else place_from_ned(self._ctx.view.origin, m.north, m.east, m.down)

    def attitude(self) -> Message | None:
        m = self.motion()
        if m is None:
            return None
        return mav.MAVLink_attitude_message(self._ctx.boot_ms, m.roll, m.pitch, m.yaw, m.p, m.q, m.r)

    def attitude_quaternion(self) -> Message | None:
        """ATTITUDE_QUATERNION (Hamilton, w first, body to world)."""
        m = self.motion()
        if m is None:
            return None
        cr, sr = math.cos(0.5 * m.roll), math.sin(0.5 * m.roll)
        cp, sp = math.cos(0.5 * m.pitch), math.sin(0.5 * m.pitch)
        cy, sy = math.cos(0.5 * m.yaw), math.sin(0.5 * m.yaw)
        return mav.MAVLink_attitude_quaternion_message(
            self._ctx.boot_ms,
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            m.p,
            m.q,
            m.r,
        )

    def local_position_ned(self) -> Message | None:
        """LOCAL_POSITION_NED: z is depth, velocity over ground."""
        m = self.motion()
        if m is None:
            return None
        return mav.MAVLink_local_position_ned_message(self._ctx.boot_ms, m.north, m.east, m.down, m.vn, m.ve, m.vd)

    def global_position_int(self) -> Message | None:
        """GLOBAL_POSITION_INT; relative_alt counts from the water surface, negative under water."""
        m, here = self.motion(), self.here()
        if m is None or here is None:
            return None
        return mav.MAVLink_global_position_int_message(
            self._ctx.boot_ms,
            i32(here.lat_deg * 1e7),
            i32(here.lon_deg * 1e7),
            i32(here.alt_m * 1e3),
            i32(-m.down * 1e3),
            i16(m.vn * 100.0),
            i16(m.ve * 100.0),
            i16(m.vd * 100.0),
            limited(m.heading_deg * 100.0, 0, 35_999),
        )

    def vfr_hud(self) -> Message | None:
        """VFR_HUD: airspeed = speed through the water, throttle = mean share of the thrust limit."""
        m, view = self.motion(), self._ctx.view
        if m is None:
            return None
        return mav.MAVLink_vfr_hud_message(
            m.water_speed,
            math.hypot(m.vn, m.ve),
            limited(m.heading_deg, 0, 360) % 360,
            self.throttle_percent(),
            f32(view.origin.alt_m - m.down),
            -m.vd,
        )

    def throttle_percent(self) -> int:
        """Mean share of the thrust limit of the thrusters that turn."""
        view = self._ctx.view
        if view.command is None or not view.armed:
            return 0
        thrust_n = [abs(x) for x in view.command.thrust_n.tolist() if x]
        return limited(100.0 * sum(thrust_n) / (max(len(thrust_n), 1) * self._ctx.params["THR_LIMIT"]), 0, 100)

    def altitude(self) -> Message | None:
        """ALTITUDE: relative and local count from the water surface."""
        m = self.motion()
        if m is None:
            return None
        return mav.MAVLink_altitude_message(
            self._ctx.t_us, -m.down, f32(self._ctx.view.origin.alt_m - m.down), -m.down, -m.down, NAN, NAN
        )

    def estimator_status(self) -> Message | None:
        """ESTIMATOR_STATUS: valid outputs, one sigma of position, test ratios (0 without a measurement)."""
        nav = self._ctx.view.nav
        if nav is None:
            return None
        flags, horizontal_m, vertical_m = 0, NAN, NAN
        if self.motion() is not None:
            flags = _FLAGS_GOOD if nav.health is NavHealth.GOOD else _FLAGS_DEAD_RECKONING
            if NavDoubt.ACCELEROMETER in self._ctx.view.nav_doubts:
                flags |= mav.ESTIMATOR_ACCEL_ERROR
            if _POSITION_DOUBTS & self._ctx.view.nav_doubts:
                flags |= mav.ESTIMATOR_GPS_GLITCH
            var = [min(max(x, 0.0), SANE) for x in nav.variance[:3].tolist()]
            horizontal_m, vertical_m = math.sqrt(var[0] + var[1]), math.sqrt(var[2])
        return mav.MAVLink_estimator_status_message(
            self._ctx.t_us, flags, *self._test_ratios(), horizontal_m, vertical_m
        )

    def _test_ratios(self) -> tuple[float, float, float, float, float, float]:
        """Velocity, horizontal and vertical position, magnetic heading, height over ground, airspeed."""
        ratio = self._ctx.view.aid_ratio
        fix = ratio.get("markers", ratio.get("external", 0.0))
        found = (ratio.get("velocity", 0.0), fix, ratio.get("depth", fix), ratio.get("heading", 0.0))
        vel, horizontal, vertical, mag, above = (f32(min(value, SANE)) for value in (*found, ratio.get("laser", 0.0)))
        return vel, horizontal, vertical, mag, above, 0.0

    def position_target_local_ned(self) -> Message | None:
        """POSITION_TARGET_LOCAL_NED: where the vehicle is going."""
        target = self._ctx.view.target_ned_m
        if target is None:
            return None
        return mav.MAVLink_position_target_local_ned_message(
            self._ctx.boot_ms, mav.MAV_FRAME_LOCAL_NED, POSITION_ONLY_MASK, *map(f32, target.tolist()), *(0.0,) * 8
        )

    def nav_controller_output(self) -> Message | None:
        """NAV_CONTROLLER_OUTPUT: bearing and distance to the target; alt_error > 0 = the target is above."""
        m, target = self.motion(), self._ctx.view.target_ned_m
        if m is None or target is None:
            return None
        north, east, down = target.tolist()
        bearing_deg = math.degrees(math.atan2(east - m.east, north - m.north)) % 360.0
        return mav.MAVLink_nav_controller_output_message(
            math.degrees(m.roll),
            math.degrees(m.pitch),
            limited(m.heading_deg, 0, 360) % 360,
            limited(bearing_deg, 0, 360) % 360,
            u16(math.hypot(east - m.east, north - m.north)),
            f32(m.down - down),
            0.0,
            0.0,
        )

    def home_position(self) -> Message | None:
        """HOME_POSITION, also in local metres."""
        home = self._ctx.view.home
        origin = self._ctx.view.origin
        north, east, down = ned_from_geodetic(origin, home.lat_deg, home.lon_deg, home.alt_m).tolist()
        return mav.MAVLink_home_position_message(
            i32(home.lat_deg * 1e7),
            i32(home.lon_deg * 1e7),
            i32(home.alt_m * 1e3),
            f32(north),
            f32(east),
            f32(down),
            [1.0, 0.0, 0.0, 0.0],
            NAN,
            NAN,
            NAN,
            self._ctx.t_us,
        )

    def gps_global_origin(self) -> Message | None:
        """GPS_GLOBAL_ORIGIN: where the local frame begins (altitude = water surface)."""
        origin = self._ctx.view.origin
        return mav.MAVLink_gps_global_origin_message(
            i32(origin.lat_deg * 1e7), i32(origin.lon_deg * 1e7), i32(origin.alt_m * 1e3), self._ctx.t_us
        )

    def wind_cov(self) -> Message | None:
        """WIND_COV carries the water current: the vector as it flows, north, east, down."""
        nav, m = self._ctx.view.nav, self.motion()
        if nav is None or m is None:
            return None
        variance = [min(max(x, 0.0), SANE) for x in nav.variance[9:12].tolist()]
        current = nav.current_ned_m_s.tolist()
        if not all(abs(x) < SANE for x in current):
            return None
        return mav.MAVLink_wind_cov_message(
            self._ctx.t_us,
            *current,
            0.5 * (variance[0] + variance[1]),
            variance[2],
            f32(self._ctx.view.origin.alt_m - m.down),
            NAN,
            NAN,
        )

    def debug_vect(self) -> Message | None:
        """DEBUG_VECT "margin": clearance beyond the margin [m], margin [m], use of the penalties (1 = all)."""
        control = self._ctx.view.control
        if control is None:
            return None
        return mav.MAVLink_debug_vect_message(
            b"margin", self._ctx.t_us, f32(control.margin_m), f32(control.tube_m), f32(control.penalty_use)
        )
