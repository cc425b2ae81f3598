"""Messages of dataclasses, samples among them: how to pack and read them, made from schema and annotations. Samples are
logged exactly as the estimator gets them, and as standard messages for viewers.

A field of the message holds the attribute of the same name. Counts are cut to what an unsigned field holds, arrays of
one value per thruster and tuples are filled up with zeros, a number that is None is NaN; whether an array is None
stands in a field of its own. What does not follow these rules is given as a function.
"""

import math
import struct
from collections.abc import Callable, Collection, Mapping
from enum import Enum
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from autopilot.core.frames import quat_from_rpy
from autopilot.core.messages import MAX_THRUSTERS
from autopilot.core.samples import MAX_SIGHTED, AhrsSample, LaserSample, MarkerSighting
from autopilot.log.cdr import ENCAPSULATION, CdrField
from autopilot.log.packing.parts import FRD, NS, UINT32, clip, padded
from autopilot.log.record_table import RECORD_ROWS, RecordRow
from autopilot.log.sample_table import SAMPLE_ROWS, MessageRow
from autopilot.log.schemas import layout, types_of
from autopilot.log.topics import type_of

Pack = Callable[[int, Any], bytes]
"""From the stamp [ns] and the object."""
LARGEST = {"uint8": 0xFF, "uint16": 0xFFFF, "uint32": 0xFFFFFFFF}
_imu = layout("sensor_msgs/Imu").packer.pack
_range = layout("sensor_msgs/Range").packer.pack

_CAM = (4, b"cam\0")
_MARKERS = layout("autopilot_msgs/MarkerSighting")
_HEADER = struct.Struct("<4siII4sH")
_marker_offset = {name: entry[1] for name, entry in (_MARKERS.dtype.fields or {}).items()}
_ZERO9 = (0.0,) * 9

MAX_MARKERS = MAX_SIGHTED
"""Markers that one logged sighting holds; more are left out."""


def packer_of(row: MessageRow) -> Pack:
    full = f"autopilot_msgs/{row.type}"
    hints: dict[str, Any] = {} if row.of is None else get_type_hints(row.of)
    scope: dict[str, Any] = {
        "pack": layout(full).packer.pack,
        "padded": padded,
        "clip": clip,
        "nan": math.nan,
        **{f"put_{field}": function for field, function in row.put.items()},
    }
    parts = [repr(ENCAPSULATION), f"*divmod(stamp_ns, {NS})", str(len(row.frame) + 1), repr(row.frame.encode() + b"\0")]
    values = row.values if isinstance(row, RecordRow) else None
    if values is not None:
        scope["values"] = values
        parts.append("*values(value)")
    for field in types_of(full)[full][1:] if values is None else ():
        if field.name in row.put:
            parts.append(f"{'*' if field.count else ''}put_{field.name}(value)")
        elif field.name in row.known:
            parts.append(f"int(value.{row.known[field.name]} is not None)")
        else:
            parts.append(_packed(field, hints.get(field.name) or _returned(row.of, field.name)))
    made: Pack = eval(f"lambda stamp_ns, value: pack({', '.join(parts)})", scope)
    return made


def reader_of(
    of: type,
    *,
    known: Mapping[str, str] | None = None,
    shapes: Mapping[str, tuple[int, ...]] | None = None,
    beside: Collection[str] = (),
) -> Callable[..., Any]:
    """Makes an ``of`` of a row of its topic; ``shapes`` are those of arrays that are not flat. What ``beside`` names is
    not read: it is given with the row, by name, or keeps its default."""
    flags = {attribute: flag for flag, attribute in (known or {}).items()}
    scope: dict[str, Any] = {"of": of, "absent": absent}
    parts = []
    for name, hint in get_type_hints(of).items():
        if name in beside:
            continue
        kind = _kind(hint)
        scope[f"kind_{name}"] = kind
        if kind in (int, float, bool):
            read = f"{kind.__name__}(row['{name}'])"
            read = f"absent({read})" if _optional(hint) else read
        elif isinstance(kind, type) and issubclass(kind, Enum):
            read = f"kind_{name}(int(row['{name}']))"
        else:
            shape = (shapes or {}).get(name)
            read = f"row['{name}']{'' if shape is None else f'.reshape{shape}'}.copy()"
            read = f"{read} if row['{flags[name]}'] else None" if name in flags else read
        parts.append(f"{name}={read}")
    made: Callable[..., Any] = eval(f"lambda row, **more: of({', '.join(parts)}, **more)", scope)
    return made


def absent(value: float) -> float | None:
    """NaN as None."""
    return None if math.isnan(value) else value


def _packed(field: CdrField, hint: Any) -> str:
    value, kind = f"value.{field.name}", _kind(hint)
    if field.count is not None:
        if _optional(hint):
            return f"*({(0.0,) * field.count} if {value} is None else {value}.ravel().tolist())"
        several = field.count == MAX_THRUSTERS or get_origin(hint) is tuple
        return f"*padded({value}, {field.count})" if several else f"*{value}.tolist()"
    if kind is int:
        return f"clip({value}, {LARGEST[field.type]})" if field.type in LARGEST else value
    if kind is float:
        return f"(nan if {value} is None else {value})" if _optional(hint) else value
    return f"int({value})"


def _returned(of: type | None, name: str) -> Any:
    """Return annotation of a property."""
    return get_type_hints(getattr(of, name).fget)["return"] if of is not None else None


def _optional(hint: Any) -> bool:
    return get_origin(hint) is UnionType and NoneType in get_args(hint)


def _kind(hint: Any) -> Any:
    """The type of a value that is there."""
    return next(arg for arg in get_args(hint) if arg is not NoneType) if _optional(hint) else hint


_PACKERS = {f"autopilot_msgs/{row.type}": packer_of(row) for row in RECORD_ROWS} | {
    f"autopilot_msgs/{row.type}": packer_of(row) for row in SAMPLE_ROWS if row.of is not MarkerSighting
}


def pack_record(topic: str, stamp_ns: int, value: Any) -> bytes:
    """A message of a topic with a type of ours (but for sightings of markers)."""
    return _PACKERS[type_of(topic)](stamp_ns, value)


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
