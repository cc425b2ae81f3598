"""Messages of variable size: paths, markers, transforms and images for viewers, and text."""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray, quat_from_rpy, rpy_from_r
from autopilot.core.messages import Event, NavState
from autopilot.core.samples import MarkerSighting, PowerSample
from autopilot.log.cdr import ENCAPSULATION, CdrBuffer
from autopilot.log.description import CameraView
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
_POSE = np.dtype([("sec", "<i4"), ("nanosec", "<u4"), ("frame", "V8"), ("place", "<f8", (3,)), ("turn", "<f8", (4,))])
"""As ``_NEXT_POSE``."""
# Of a transform in a TFMessage the doubles of the first need padding, those that follow do not.
_FIRST_TRANSFORM = struct.Struct("<iII4sI4s4x7d")
_NEXT_TRANSFORM = struct.Struct("<iII4sI4s7d")
_COUNT = struct.Struct("<4sI")

_CLOSED_LINE = 2
_DOT_PX, _LINE_PX, _TEXT_PX = 12.0, 2.0, 14.0
_OUTLINE, _DOT, _CLEAR = (0.1, 1.0, 0.3, 1.0), (1.0, 0.2, 0.2, 1.0), (0.0, 0.0, 0.0, 0.0)
"""Red, green, blue, opacity."""

ROS_LEVEL = (50, 50, 50, 40, 30, 20, 20, 10)
"""rcl_interfaces/Log level of each MAV_SEVERITY, emergency to debug."""
NODE = "autopilot"
"""``rcl_interfaces/Log.name`` of every event."""


class Posed(Protocol):
    """The estimate, or the simulated vehicle."""

    @property
    def pos_ned_m(self) -> FloatArray: ...
    @property
    def rpy_rad(self) -> FloatArray: ...


def _ros_quaternion(rpy_rad: FloatArray) -> tuple[float, float, float, float]:
    w, x, y, z = quat_from_rpy(rpy_rad).tolist()
    return x, y, z, w


def pose_stamped(stamp_ns: int, nav: Posed) -> bytes:
    """geometry_msgs/PoseStamped of the estimate, or of the truth, in ``ned``."""
    return _pose_stamped(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        4,
        b"ned\0",
        *nav.pos_ned_m.tolist(),
        *_ros_quaternion(nav.rpy_rad),
    )


def path(stamp_ns: int, points_ned_m: Sequence[Sequence[float]], after_s: Sequence[float] = ()) -> bytes:
    """nav_msgs/Path through points (n, 3) in ``ned``; orientations are left at identity.

    ``after_s`` (n,): when it is there, after the stamp (a prediction's own times); without, all at the stamp.
    """
    sec, nanosec = divmod(stamp_ns, _NS)
    parts = [_PATH_HEAD.pack(ENCAPSULATION, sec, nanosec, *_NED, len(points_ned_m))]
    pack = _FIRST_POSE.pack
    for index, (x, y, z) in enumerate(points_ned_m):
        if after_s:
            sec, nanosec = divmod(stamp_ns + round(1e9 * after_s[index]), _NS)
        parts.append(pack(sec, nanosec, *_NED, x, y, z, *_IDENTITY))
        pack = _NEXT_POSE.pack
    return b"".join(parts)


def read_path(data: bytes) -> tuple[FloatArray, FloatArray]:
    """(n,) Unix times [s] and (n, 3) points of a nav_msgs/Path that :func:`path` has packed. LogError if it has not."""
    count = int.from_bytes(data[_PATH_HEAD.size - 4 : _PATH_HEAD.size], "little") if len(data) >= _PATH_HEAD.size else 0
    first = _PATH_HEAD.size + _FIRST_POSE.size
    if len(data) != _PATH_HEAD.size + (count and _FIRST_POSE.size + (count - 1) * _NEXT_POSE.size):
        raise LogError(f"a path of {len(data)} bytes is not one that this program has written")
    if not count:
        return np.zeros(0), np.zeros((0, 3))
    sec, nanosec, _, _, x, y, z, *_ = _FIRST_POSE.unpack_from(data, _PATH_HEAD.size)
    rest = np.frombuffer(data, _POSE, count - 1, first)
    times = np.concatenate(([sec + 1e-9 * nanosec], rest["sec"] + 1e-9 * rest["nanosec"]))
    return times, np.concatenate(([[x, y, z]], rest["place"]))


def transforms(stamp_ns: int, nav: NavState, camera: CameraView | None = None) -> bytes:
    """tf2_msgs/TFMessage: ``map`` (z up, for viewers) -> ``ned`` (turned half a turn about north) -> ``frd`` ->
    ``cam``, if there is a camera."""
    found = [
        (b"map\0", b"ned\0", (0.0, 0.0, 0.0), _HALF_TURN),
        (b"ned\0", b"frd\0", nav.pos_ned_m.tolist(), _ros_quaternion(nav.rpy_rad)),
    ]
    if camera is not None:
        found.append((b"frd\0", b"cam\0", list(camera.position_frd_m), _ros_rotation(camera.r_frd_from_cam)))
    return _tf_message(stamp_ns, found)


def true_transform(stamp_ns: int, truth: Posed) -> bytes:
    """tf2_msgs/TFMessage: ``ned`` -> ``tru``, the simulated vehicle."""
    return _tf_message(stamp_ns, [(b"ned\0", b"tru\0", truth.pos_ned_m.tolist(), _ros_quaternion(truth.rpy_rad))])


def _tf_message(
    stamp_ns: int, found: Sequence[tuple[bytes, bytes, Sequence[float], tuple[float, float, float, float]]]
) -> bytes:
    stamp = divmod(stamp_ns, _NS)
    parts = [_COUNT.pack(ENCAPSULATION, len(found))]
    pack = _FIRST_TRANSFORM.pack
    for parent, child, position, turn in found:
        parts.append(pack(*stamp, 4, parent, 4, child, *position, *turn))
        pack = _NEXT_TRANSFORM.pack
    return b"".join(parts)


@lru_cache(maxsize=8)
def _ros_rotation(rows: tuple[float, ...]) -> tuple[float, float, float, float]:
    """Quaternion x, y, z, w of a rotation matrix (9,) by rows."""
    return _ros_quaternion(rpy_from_r(np.array(rows).reshape(3, 3)))


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


def camera_info(stamp_ns: int, camera: CameraView) -> bytes:
    """sensor_msgs/CameraInfo of the configured camera, without the refraction of a flat port."""
    (fx, fy), (cx, cy) = camera.focal_px, camera.center_px
    out = CdrBuffer()
    out.header(stamp_ns, "cam")
    out.put("uint32", camera.height_px, camera.width_px)
    out.string("equidistant" if camera.fisheye else "plumb_bob")
    out.put("uint32", len(camera.distortion))
    out.put("float64", *camera.distortion)
    out.put("float64", fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
    out.put("float64", 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    out.put("float64", fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0)
    out.put("uint32", 0, 0)
    out.put("uint32", 0, 0, 0, 0)
    out.put("bool", False)
    return out.getvalue()


def image_annotations(stamp_ns: int, sighting: MarkerSighting) -> bytes:
    """foxglove_msgs/ImageAnnotations: outlines and numbers of the markers found, the laser dot as a circle.

    There the corner of a picture is 0, with us the centre of its first pixel.
    """
    out = CdrBuffer()
    dots = [] if sighting.laser_px is None else [sighting.laser_px]
    out.put("uint32", len(dots))
    for dot in dots:
        out.stamp(stamp_ns)
        out.put("float64", *(dot + 0.5).tolist(), *(_DOT_PX, _LINE_PX), *_CLEAR, *_DOT)
    out.put("uint32", len(sighting.ids))
    for corners in sighting.corners_px:
        out.stamp(stamp_ns)
        out.put("uint8", _CLOSED_LINE)
        out.put("uint32", len(corners))
        out.put("float64", *(corners + 0.5).ravel().tolist(), *_OUTLINE)
        out.put("uint32", 0)
        out.put("float64", *_CLEAR, _LINE_PX)
    out.put("uint32", len(sighting.ids))
    for number, corners in zip(sighting.ids, sighting.corners_px, strict=True):
        out.stamp(stamp_ns)
        out.put("float64", *(corners.mean(axis=0) + 0.5).tolist())
        out.string(str(number))
        out.put("float64", _TEXT_PX, *_OUTLINE, *_CLEAR)
    return out.getvalue()


def battery_state(stamp_ns: int, sample: PowerSample) -> bytes:
    """sensor_msgs/BatteryState: unknown fields are NaN, as that message defines it."""
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
class VisualMarker:
    ARROW = 0
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
    frame: str = "ned"
    """Another one moves, and the marker with it."""


def marker_array(stamp_ns: int, markers: Sequence[VisualMarker]) -> bytes:
    """visualization_msgs/MarkerArray that adds or replaces the markers."""
    out = CdrBuffer()
    out.put("uint32", len(markers))
    for marker in markers:
        out.header(stamp_ns, marker.frame)
        out.string(marker.namespace)
        out.put("int32", marker.number, marker.kind, 0)
        out.put("float64", *marker.position_ned_m, *_IDENTITY, *marker.scale_m)
        out.put("float32", *marker.color_rgba)
        out.put("int32", 0)
        out.put("uint32", 0)
        out.put("bool", marker.frame != "ned")
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
