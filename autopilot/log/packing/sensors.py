"""What devices measured, exactly as the estimator got it, and the standard messages of it for viewers."""

import math
import struct

import numpy as np

from autopilot.core.frames import quat_from_rpy
from autopilot.core.samples import (
    MAX_SIGHTED,
    AhrsSample,
    DepthSample,
    ExternalPoseSample,
    HullSample,
    ImuSample,
    LaserSample,
    LeakSample,
    MarkerSighting,
    ObstacleTrack,
    PilotSample,
    PoseSample,
    PowerSample,
    VelocitySample,
)
from autopilot.log.cdr import ENCAPSULATION
from autopilot.log.packing.parts import FRD, NED, NS, UINT32, clip
from autopilot.log.schemas import layout

_depth_raw = layout("autopilot_msgs/DepthRaw").packer.pack
_velocity_raw = layout("autopilot_msgs/VelocityRaw").packer.pack
_external_pose = layout("autopilot_msgs/ExternalPose").packer.pack
_ahrs_raw = layout("autopilot_msgs/AhrsRaw").packer.pack
_imu_raw = layout("autopilot_msgs/ImuRaw").packer.pack
_imu = layout("sensor_msgs/Imu").packer.pack
_pose_fix = layout("autopilot_msgs/PoseFix").packer.pack
_obstacle_track = layout("autopilot_msgs/ObstacleTrack").packer.pack
_laser_raw = layout("autopilot_msgs/LaserRaw").packer.pack
_range = layout("sensor_msgs/Range").packer.pack
_leak_raw = layout("autopilot_msgs/LeakRaw").packer.pack
_hull_raw = layout("autopilot_msgs/HullRaw").packer.pack
_pilot_raw = layout("autopilot_msgs/PilotRaw").packer.pack
_power_raw = layout("autopilot_msgs/PowerRaw").packer.pack

_CAM = (4, b"cam\0")
_MARKERS = layout("autopilot_msgs/MarkerSighting")
_HEADER = struct.Struct("<4siII4sH")
_marker_offset = {name: entry[1] for name, entry in (_MARKERS.dtype.fields or {}).items()}
_ZERO9 = (0.0,) * 9

MAX_MARKERS = MAX_SIGHTED
"""Markers that one logged sighting holds; more are left out."""


def ahrs_raw(stamp_ns: int, sample: AhrsSample) -> bytes:
    """AhrsRaw: exactly what the estimator got."""
    return _ahrs_raw(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *FRD,
        *sample.rpy_rad.tolist(),
        *sample.rate_frd_rad_s.tolist(),
        *sample.accel_frd_m_s2.tolist(),
    )


def imu(stamp_ns: int, sample: AhrsSample) -> bytes:
    """sensor_msgs/Imu of the same sample, for viewers. Axes stay NED and FRD."""
    w, x, y, z = quat_from_rpy(sample.rpy_rad).tolist()
    return _imu(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *FRD,
        x,
        y,
        z,
        w,
        *_ZERO9,
        *sample.rate_frd_rad_s.tolist(),
        *_ZERO9,
        *sample.accel_frd_m_s2.tolist(),
        *_ZERO9,
    )


def imu_raw(stamp_ns: int, sample: ImuSample) -> bytes:
    """ImuRaw; without a magnetometer's reading zeros with ``mag_known`` 0."""
    return _imu_raw(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *FRD,
        *sample.rate_frd_rad_s.tolist(),
        *sample.accel_frd_m_s2.tolist(),
        int(sample.mag_frd is not None),
        *((0.0, 0.0, 0.0) if sample.mag_frd is None else sample.mag_frd.tolist()),
    )


def marker_sighting(stamp_ns: int, sighting: MarkerSighting) -> bytes:
    """MarkerSighting: the first MAX_MARKERS markers."""
    count = min(len(sighting.ids), MAX_MARKERS)
    message = bytearray(_MARKERS.packer.size)
    _HEADER.pack_into(message, 0, ENCAPSULATION, *divmod(stamp_ns, NS), *_CAM, count)
    struct.pack_into(f"<{count}H", message, _marker_offset["ids"], *sighting.ids[:count])
    corners = np.ascontiguousarray(sighting.corners_px[:count], dtype="<f4").tobytes()
    message[_marker_offset["corners_px"] : _marker_offset["corners_px"] + len(corners)] = corners
    if sighting.sigma_px is not None:
        sigmas = np.ascontiguousarray(sighting.sigma_px[:count], dtype="<f4").tobytes()
        message[_marker_offset["sigma_px"] : _marker_offset["sigma_px"] + len(sigmas)] = sigmas
    if sighting.laser_px is not None:
        message[_marker_offset["laser_found"]] = 1
        struct.pack_into("<2d", message, _marker_offset["laser_px"], *sighting.laser_px.tolist())
    struct.pack_into("<I", message, _marker_offset["decode_us"], clip(sighting.decode_us, UINT32))
    return bytes(message)


def pose_fix(stamp_ns: int, sample: PoseSample) -> bytes:
    """PoseFix."""
    return _pose_fix(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *NED,
        *sample.pos_ned_m.tolist(),
        sample.yaw_rad,
        *sample.sigma_pos_m.tolist(),
        sample.sigma_yaw_rad,
    )


def laser_raw(stamp_ns: int, sample: LaserSample) -> bytes:
    """LaserRaw: exactly what the estimator got."""
    return _laser_raw(ENCAPSULATION, *divmod(stamp_ns, NS), *FRD, sample.range_m, sample.sigma_m)


def laser_range(stamp_ns: int, sample: LaserSample) -> bytes:
    """sensor_msgs/Range of the same sample, for viewers."""
    variance = sample.sigma_m * sample.sigma_m
    return _range(ENCAPSULATION, *divmod(stamp_ns, NS), *FRD, 1, 0.0, 0.0, math.inf, sample.range_m, variance)


def depth_raw(stamp_ns: int, sample: DepthSample) -> bytes:
    """DepthRaw."""
    return _depth_raw(ENCAPSULATION, *divmod(stamp_ns, NS), *FRD, sample.depth_m, sample.sigma_m)


def velocity_raw(stamp_ns: int, sample: VelocitySample) -> bytes:
    """VelocityRaw."""
    return _velocity_raw(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *FRD,
        *sample.vel_frd_m_s.tolist(),
        *sample.sigma_m_s.tolist(),
        int(sample.lock),
    )


def external_pose(stamp_ns: int, sample: ExternalPoseSample) -> bytes:
    """ExternalPose; an unknown covariance is zeros with ``covariance_known`` 0."""
    known = sample.covariance is not None
    return _external_pose(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *NED,
        *sample.pos_m.tolist(),
        sample.yaw_rad,
        int(known),
        *([0.0] * 16 if sample.covariance is None else sample.covariance.ravel().tolist()),
        int(sample.frame),
        clip(sample.reset_counter, UINT32),
    )


def obstacle_track(stamp_ns: int, track: ObstacleTrack) -> bytes:
    """ObstacleTrack."""
    return _obstacle_track(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *NED,
        *track.pos_ned_m.tolist(),
        *track.vel_ned_m_s.tolist(),
        track.radius_m,
        clip(track.track_id, UINT32),
    )


def leak_raw(stamp_ns: int, sample: LeakSample) -> bytes:
    """LeakRaw."""
    return _leak_raw(ENCAPSULATION, *divmod(stamp_ns, NS), *FRD, int(sample.wet))


def power_raw(stamp_ns: int, sample: PowerSample) -> bytes:
    """PowerRaw."""
    return _power_raw(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *FRD,
        sample.voltage_v,
        sample.current_a,
        sample.energy_used_j,
        sample.remaining,
    )


def hull_raw(stamp_ns: int, sample: HullSample) -> bytes:
    """HullRaw."""
    pressure_pa, temperature_c = sample.pressure_pa, sample.temperature_c
    return _hull_raw(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *FRD,
        math.nan if pressure_pa is None else pressure_pa,
        math.nan if temperature_c is None else temperature_c,
    )


def pilot_raw(stamp_ns: int, sample: PilotSample) -> bytes:
    """PilotRaw."""
    return _pilot_raw(ENCAPSULATION, *divmod(stamp_ns, NS), *FRD, 1)
