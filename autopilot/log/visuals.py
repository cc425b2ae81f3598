"""Messages of variable size: what viewers draw (paths, markers, transforms, images) and text."""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from autopilot.core.frames import FloatArray, quat_from_rpy
from autopilot.core.messages import Event, NavState
from autopilot.core.samples import PowerSample
from autopilot.log.cdr import ENCAPSULATION, CdrBuffer
from autopilot.log.schemas import layout

_pose_stamped = layout("geometry_msgs/PoseStamped").packer.pack
_NS = 1_000_000_000
_NED = (4, b"ned\0")
_IDENTITY = (0.0, 0.0, 0.0, 1.0)
"""Quaternion in ROS order x, y, z, w."""
_HALF_TURN = (1.0, 0.0, 0.0, 0.0)

# Header and sequence length end at byte 20 of the content: only the first pose needs padding in front of its doubles.
_PATH_HEAD = struct.Struct("<4siII4sI")
_FIRST_POSE = struct.Struct("<iII4s4x7d")
_NEXT_POSE = struct.Struct("<iII4s7d")
_TWO_TRANSFORMS = struct.Struct("<4sIiII4sI4s4x7diII4sI4s7d")

ROS_LEVEL = (50, 50, 50, 40, 30, 20, 20, 10)
"""rcl_interfaces/Log level of each MAV_SEVERITY, emergency to debug."""
NODE = "autopilot"
"""``rcl_interfaces/Log.name`` of every event."""


def _ros_quaternion(rpy_rad: FloatArray) -> tuple[float, float, float, float]:
    w, x, y, z = quat_from_rpy(rpy_rad).tolist()
    return x, y, z, w


def pose_stamped(stamp_ns: int, nav: NavState) -> bytes:
    """geometry_msgs/PoseStamped of the estimate in ``ned``."""
    return _pose_stamped(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        4,
        b"ned\0",
        *nav.pos_ned_m.tolist(),
        *_ros_quaternion(nav.rpy_rad),
    )


def path(stamp_ns: int, points_ned_m: Sequence[Sequence[float]]) -> bytes:
    """nav_msgs/Path through points (n, 3) in ``ned``; orientations are left at identity."""
    sec, nanosec = divmod(stamp_ns, _NS)
    parts = [_PATH_HEAD.pack(ENCAPSULATION, sec, nanosec, *_NED, len(points_ned_m))]
    pack = _FIRST_POSE.pack
    for x, y, z in points_ned_m:
        parts.append(pack(sec, nanosec, *_NED, x, y, z, *_IDENTITY))
        pack = _NEXT_POSE.pack
    return b"".join(parts)


def transforms(stamp_ns: int, nav: NavState) -> bytes:
    """tf2_msgs/TFMessage: ``map`` (z up, for viewers) -> ``ned`` (turned half a turn about north) -> ``frd``."""
    stamp = divmod(stamp_ns, _NS)
    return _TWO_TRANSFORMS.pack(
        ENCAPSULATION,
        2,
        *stamp,
        *(4, b"map\0"),
        *_NED,
        *(0.0, 0.0, 0.0),
        *_HALF_TURN,
        *stamp,
        *_NED,
        *(4, b"frd\0"),
        *nav.pos_ned_m.tolist(),
        *_ros_quaternion(nav.rpy_rad),
    )


def event(stamp_ns: int, value: Event) -> bytes:
    """rcl_interfaces/Log of an operator's line."""
    out = CdrBuffer()
    out.stamp(stamp_ns)
    out.put("uint8", ROS_LEVEL[min(max(value.severity, 0), 7)])
    out.string(NODE)
    out.string(value.text)
    out.string("")
    out.string("")
    out.put("uint32", 0)
    return out.getvalue()


def compressed_image(stamp_ns: int, data: bytes, kind: str = "jpeg") -> bytes:
    """sensor_msgs/CompressedImage holding a JPEG or PNG, frame ``cam``."""
    out = CdrBuffer()
    out.header(stamp_ns, "cam")
    out.string(kind)
    out.blob(data)
    return out.getvalue()


def battery_state(stamp_ns: int, sample: PowerSample) -> bytes:
    """sensor_msgs/BatteryState: what the sample does not know is NaN, as that message defines it."""
    out = CdrBuffer()
    out.header(stamp_ns, "frd")
    unknown = math.nan
    out.put("float32", sample.voltage_v, unknown, -sample.current_a, unknown, unknown, unknown, sample.remaining)
    out.put("uint8", 2, 0, 0)  # discharging, health and technology unknown
    out.put("bool", True)
    out.put("uint32", 0)
    out.put("uint32", 0)
    out.string("")
    out.string("")
    return out.getvalue()


@dataclass(frozen=True, slots=True, kw_only=True)
class Marker:
    """One visualization_msgs/Marker in ``ned``."""

    SPHERE = 2
    CYLINDER = 3
    LINE_STRIP = 4

    namespace: str
    number: int
    kind: int
    position_ned_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale_m: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Size along x, y, z; of a line, its width first."""
    color_rgba: tuple[float, float, float, float] = (0.5, 0.5, 0.5, 1.0)
    points_ned_m: tuple[tuple[float, float, float], ...] = ()


def marker_array(stamp_ns: int, markers: Sequence[Marker]) -> bytes:
    """visualization_msgs/MarkerArray that adds or replaces the markers."""
    out = CdrBuffer()
    out.put("uint32", len(markers))
    for marker in markers:
        out.header(stamp_ns, "ned")
        out.string(marker.namespace)
        out.put("int32", marker.number, marker.kind, 0)
        out.put("float64", *marker.position_ned_m, *_IDENTITY, *marker.scale_m)
        out.put("float32", *marker.color_rgba)
        out.put("int32", 0)
        out.put("uint32", 0)
        out.put("bool", False)
        out.put("uint32", len(marker.points_ned_m))
        for point in marker.points_ned_m:
            out.put("float64", *point)
        out.put("uint32", 0)  # colors
        out.string("")  # texture_resource
        out.header(0, "")  # texture
        out.string("")
        out.blob(b"")
        out.put("uint32", 0)  # uv_coordinates
        out.string("")  # text
        out.string("")  # mesh_resource
        out.string("")  # mesh_file
        out.blob(b"")
        out.put("bool", False)
    return out.getvalue()
