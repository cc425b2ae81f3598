"""Samples exactly as the estimator gets them, and as standard messages for viewers."""

import math
import struct

import numpy as np

from autopilot.core.frames import quat_from_rpy
from autopilot.core.samples import MAX_SIGHTED, AhrsSample, LaserSample, MarkerSighting
from autopilot.log.cdr import ENCAPSULATION
from autopilot.log.packing.parts import FRD, NS, UINT32, clip
from autopilot.log.packing.records import Pack
from autopilot.log.sample_table import SAMPLE_ROWS
from autopilot.log.schemas import layout

_imu = layout("sensor_msgs/Imu").packer.pack
_range = layout("sensor_msgs/Range").packer.pack

_CAM = (4, b"cam\0")
_MARKERS = layout("autopilot_msgs/MarkerSighting")
_HEADER = struct.Struct("<4siII4sH")
_marker_offset = {name: entry[1] for name, entry in (_MARKERS.dtype.fields or {}).items()}
_ZERO9 = (0.0,) * 9

MAX_MARKERS = MAX_SIGHTED
"""Markers that one logged sighting holds; more are left out."""


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
    struct.pack_into("<d", message, _marker_offset["stamp_sigma_s"], sighting.stamp_sigma_s)
    return bytes(message)


def laser_range(stamp_ns: int, sample: LaserSample) -> bytes:
    """sensor_msgs/Range of the same sample, for viewers."""
    variance = sample.sigma_m * sample.sigma_m
    return _range(ENCAPSULATION, *divmod(stamp_ns, NS), *FRD, 1, 0.0, 0.0, math.inf, sample.range_m, variance)


SAMPLE_TOPICS: dict[type, str] = {row.of: row.topic for row in SAMPLE_ROWS}
"""Class of a sample -> its topic: exactly what the estimator got."""
VIEWERS: dict[type, tuple[str, Pack]] = {AhrsSample: ("/in/ahrs", imu), LaserSample: ("/in/laser", laser_range)}
"""The same as a standard message, where there is one that viewers know."""
