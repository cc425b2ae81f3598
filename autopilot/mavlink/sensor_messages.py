"""Sensor messages, and messages that clients require although the vehicle lacks the sensor.

GPS_RAW_INT is such a substitute: there is no satellite navigation under water. It carries the estimate, so that
clients that wait for a "3D fix" proceed: fix type 3 with a good estimate, 2 with dead reckoning, 1 without;
satellites and their dilution are unknown (QGroundControl shows "Count 0"), h_acc and v_acc are the estimate's.
"""

import math
from collections.abc import Mapping

import numpy as np

from autopilot.core.messages import Failsafe, NavHealth
from autopilot.core.model4 import YAW
from autopilot.core.samples import AltimeterSample, DepthSample, HullSample, LaserSample
from autopilot.mavlink.context import Context, f32, i16, i32, limited, u16
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.telemetry import NAN, SANE, Builder, NavigationMessages
from autopilot.mavlink.wire import Message

G_M_S2 = 9.80665
"""Unit of SCALED_IMU: thousandths of it."""
SURFACE_PA, WATER_N_M3 = 101_325.0, 1000.0 * G_M_S2
"""Pressure at the surface, and its growth with depth in fresh water (sea water: 2.5 % more)."""
STALE_US = 3_000_000
"""Validity of a sensor's reading."""
WAYPOINTS = 5
"""Points of TRAJECTORY_REPRESENTATION_WAYPOINTS."""

_ACCEL_AND_GYRO = 0b111111
"""HIGHRES_IMU.fields_updated."""
_NO_SATELLITES_COUNTED, _UNKNOWN_DILUTION = 0xFF, 0xFFFF
_COVARIANCE_DIAGONAL = (0, 6, 11, 15, 18, 20)
"""Places of x, y, z, roll, pitch, yaw in the upper triangle of a 6 x 6 matrix."""
_CAGE = 1 << Failsafe.CAGE_SOFT | 1 << Failsafe.CAGE_HARD
_RANGES: tuple[tuple[type[LaserSample | AltimeterSample], int, int, int], ...] = (
    (LaserSample, 5, 1000, mav.MAV_DISTANCE_SENSOR_LASER),
    (AltimeterSample, 30, 10_000, mav.MAV_DISTANCE_SENSOR_ULTRASOUND),
)
"""Range sensors to the floor: least and largest range [cm] and MAV_DISTANCE_SENSOR; the index is the id."""


class SensorMessages:
    def __init__(self, ctx: Context, telemetry: NavigationMessages) -> None:
        self._ctx, self._telemetry = ctx, telemetry
        self._breached = False
        self._breaches, self._breach_ms = 0, 0

    def builders(self) -> Mapping[int, Builder]:
        return {
            mav.MAVLINK_MSG_ID_RAW_IMU: self.raw_imu,
            mav.MAVLINK_MSG_ID_SCALED_IMU: self.scaled_imu,
            mav.MAVLINK_MSG_ID_HIGHRES_IMU: self.highres_imu,
            mav.MAVLINK_MSG_ID_SCALED_PRESSURE: self.scaled_pressure,
            mav.MAVLINK_MSG_ID_SCALED_PRESSURE2: self.scaled_pressure2,
            mav.MAVLINK_MSG_ID_DISTANCE_SENSOR: self.distance_sensor,
            mav.MAVLINK_MSG_ID_ODOMETRY: self.odometry,
            mav.MAVLINK_MSG_ID_GPS_RAW_INT: self.gps_raw_int,
            mav.MAVLINK_MSG_ID_VIBRATION: self.vibration,
            mav.MAVLINK_MSG_ID_FENCE_STATUS: self.fence_status,
            mav.MAVLINK_MSG_ID_TRAJECTORY_REPRESENTATION_WAYPOINTS: self.trajectory,
        }

    def tick(self) -> None:
        breached = self._is_breached()
        if breached and not self._breached:
            self._breaches = min(self._breaches + 1, 0xFFFF)
            self._breach_ms = self._ctx.boot_ms
        self._breached = breached

    def _inertial(self) -> tuple[list[float], list[float]] | None:
        """Specific force [m/s2] and rate [rad/s] of the newest frame, None without a sane one."""
        sample = self._ctx.view.sensed.inertial
        if sample is None or self._ctx.t_us - sample.t_us > STALE_US:
            return None
        accel, rate = sample.accel_frd_m_s2.tolist(), sample.rate_frd_rad_s.tolist()
        return (accel, rate) if all(abs(x) < SANE for x in (*accel, *rate)) else None

    def _milli(self) -> list[int] | None:
        """Thousandths of g and of rad/s, and no magnetic field."""
        found = self._inertial()
        if found is None:
            return None
        accel, rate = found
        return [*(i16(1e3 * x / G_M_S2) for x in accel), *(i16(1e3 * x) for x in rate), 0, 0, 0]

    def raw_imu(self) -> Message | None:
        """RAW_IMU in the units of SCALED_IMU: the AHRS delivers scaled values."""
        milli = self._milli()
        return None if milli is None else mav.MAVLink_raw_imu_message(self._ctx.t_us, *milli)

    def scaled_imu(self) -> Message | None:
        milli = self._milli()
        return None if milli is None else mav.MAVLink_scaled_imu_message(self._ctx.boot_ms, *milli)

    def highres_imu(self) -> Message | None:
        """HIGHRES_IMU: acceleration and rates; other fields are marked as not given."""
        found = self._inertial()
        if found is None:
            return None
        nothing = (NAN,) * 3, (NAN,) * 4
        return mav.MAVLink_highres_imu_message(
            self._ctx.t_us, *map(f32, (*found[0], *found[1])), *nothing[0], *nothing[1], _ACCEL_AND_GYRO
        )

    def scaled_pressure(self) -> Message | None:
        """SCALED_PRESSURE: the air in the hull, as ArduSub has it."""
        hull = self._ctx.view.sensed.of(HullSample)
        if hull is None or hull.pressure_pa is None or self._ctx.t_us - hull.t_us > STALE_US:
            return None
        warm_c = 0.0 if hull.temperature_c is None else hull.temperature_c
        return mav.MAVLink_scaled_pressure_message(
            self._ctx.boot_ms, f32(hull.pressure_pa / 100.0), 0.0, i16(100.0 * warm_c)
        )

    def scaled_pressure2(self) -> Message | None:
        """SCALED_PRESSURE2: the water at the depth sensor."""
        depth = self._ctx.view.sensed.of(DepthSample)
        if depth is None or self._ctx.t_us - depth.t_us > STALE_US or not abs(depth.depth_m) < SANE:
            return None
        over_pa = WATER_N_M3 * depth.depth_m
        return mav.MAVLink_scaled_pressure2_message(
            self._ctx.boot_ms, f32((SURFACE_PA + over_pa) / 100.0), f32(over_pa / 100.0), 0
        )

    def distance_sensor(self) -> Message | None:
        """DISTANCE_SENSOR: range to the floor by altimeter, or else by laser."""
        sensed = self._ctx.view.sensed
        for number, (kind, least_cm, most_cm, mav_type) in reversed([*enumerate(_RANGES)]):
            sample = sensed.of(kind)
            if sample is not None and self._ctx.t_us - sample.t_us <= STALE_US:
                return mav.MAVLink_distance_sensor_message(
                    self._ctx.boot_ms,
                    least_cm,
                    most_cm,
                    u16(100.0 * sample.range_m),
                    mav_type,
                    number,
                    mav.MAV_SENSOR_ROTATION_PITCH_270,
                    limited(1e4 * min(abs(sample.sigma_m), 1.0) ** 2, 0, 254),
                )
        return None

    def odometry(self) -> Message | None:
        """ODOMETRY: pose in the local frame, velocity over ground in the body's."""
        nav, m = self._ctx.view.nav, self._telemetry.motion()
        if nav is None or m is None:
            return None
        sigma2 = [min(max(x, 0.0), SANE) for x in nav.variance[:6].tolist()]
        pose, velocity = [0.0] * 21, [0.0] * 21
        for place, value in zip(_COVARIANCE_DIAGONAL, sigma2, strict=True):
            pose[place] = value
        velocity[0] = NAN  # that of the velocity over ground is not known
        cr, sr = math.cos(0.5 * m.roll), math.sin(0.5 * m.roll)
        cp, sp = math.cos(0.5 * m.pitch), math.sin(0.5 * m.pitch)
        cy, sy = math.cos(0.5 * m.yaw), math.sin(0.5 * m.yaw)
        quat = [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
        return mav.MAVLink_odometry_message(
            self._ctx.t_us,
            mav.MAV_FRAME_LOCAL_NED,
            mav.MAV_FRAME_BODY_FRD,
            m.north,
            m.east,
            m.down,
            quat,
            *nav.vel_frd_m_s.tolist(),
            m.p,
            m.q,
            m.r,
            pose,
            velocity,
            limited(self._ctx.view.nav_errors[3] % 256, 0, 255),
            mav.MAV_ESTIMATOR_TYPE_VISION,
        )

    def gps_raw_int(self) -> Message | None:
        """GPS_RAW_INT: the estimate as a fix."""
        nav, m, here = self._ctx.view.nav, self._telemetry.motion(), self._telemetry.here()
        if nav is None or m is None or here is None:
            return mav.MAVLink_gps_raw_int_message(
                self._ctx.t_us, mav.GPS_FIX_TYPE_NO_FIX, 0, 0, 0, 0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF, 0
            )
        good = nav.health is NavHealth.GOOD
        var = [min(max(x, 0.0), SANE) for x in nav.variance[:3].tolist()]
        across_m, deep_m = math.sqrt(var[0] + var[1]), math.sqrt(var[2])
        course_deg = math.degrees(math.atan2(m.ve, m.vn)) % 360.0
        return mav.MAVLink_gps_raw_int_message(
            self._ctx.t_us,
            mav.GPS_FIX_TYPE_3D_FIX if good else mav.GPS_FIX_TYPE_2D_FIX,
            i32(here.lat_deg * 1e7),
            i32(here.lon_deg * 1e7),
            i32(here.alt_m * 1e3),
            _UNKNOWN_DILUTION,
            _UNKNOWN_DILUTION,
            u16(100.0 * math.hypot(m.vn, m.ve)),
            limited(100.0 * course_deg, 0, 35_999),
            _NO_SATELLITES_COUNTED,
            i32(here.alt_m * 1e3),
            limited(1e3 * across_m, 0, 0xFFFF_FFFF),
            limited(1e3 * deep_m, 0, 0xFFFF_FFFF),
        )

    def vibration(self) -> Message | None:
        if self._inertial() is None:
            return None
        shakes = map(f32, self._ctx.view.sensed.vibration.rms_m_s2)
        return mav.MAVLink_vibration_message(self._ctx.t_us, *shakes, 0, 0, 0)

    def _is_breached(self) -> bool:
        return bool(self._ctx.view.failsafes & _CAGE)

    def fence_status(self) -> Message | None:
        """FENCE_STATUS from the failsafes on fence and depth band."""
        ctx, m = self._ctx, self._telemetry.motion()
        kind = mav.FENCE_BREACH_NONE
        if self._is_breached():
            kind = mav.FENCE_BREACH_BOUNDARY
            if m is not None and m.down > ctx.params["DEPTH_MAX"]:
                kind = mav.FENCE_BREACH_MINALT
            elif m is not None and m.down < ctx.params["DEPTH_MIN"]:
                kind = mav.FENCE_BREACH_MAXALT
        return mav.MAVLink_fence_status_message(
            int(self._is_breached()), self._breaches, kind, self._breach_ms, mav.FENCE_MITIGATE_NONE
        )

    def trajectory(self) -> Message | None:
        """TRAJECTORY_REPRESENTATION_WAYPOINTS: five points of the controller's prediction, evenly spaced in time."""
        ahead = self._ctx.view.ahead
        if ahead is None or not np.isfinite(ahead).all():
            return None
        rows = ahead[np.linspace(0, len(ahead) - 1, min(WAYPOINTS, len(ahead))).round().astype(int)]
        count = len(rows)

        def column(values: list[float]) -> list[float]:
            return [f32(x) for x in values] + [NAN] * (WAYPOINTS - count)

        none = [NAN] * WAYPOINTS
        places = [column(rows[:, axis].tolist()) for axis in range(3)]
        return mav.MAVLink_trajectory_representation_waypoints_message(
            self._ctx.t_us, count, *places, *([none] * 6), column(rows[:, YAW].tolist()), none, [0xFFFF] * WAYPOINTS
        )
