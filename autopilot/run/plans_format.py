"""File format of stored plans: a line of JSON with format, version and checksum, and a line with the content."""

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import msgspec

from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import Origin
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.mission.sequencer import Position

FORMAT = "underwater-autopilot plans"
VERSION = 1
"""Of the content; one that differs is not read."""

_Number = float | str
"""JSON has no NaN and no infinity: they stand as text."""


class _PlansHead(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    format: str
    version: int
    crc32: int
    """Of the second line without its end."""


class _Item(msgspec.Struct, frozen=True, array_like=True):
    seq: int
    frame: int
    command: int
    params: tuple[_Number, _Number, _Number, _Number]
    x: int
    y: int
    z: _Number
    autocontinue: int
    is_home: bool = False


class _OriginEntry(msgspec.Struct, frozen=True, array_like=True):
    lat_deg: float
    lon_deg: float
    alt_m: float


class Content(msgspec.Struct, frozen=True, kw_only=True):
    configured_origin: _OriginEntry
    """Origin configured at the start of the service."""
    origin: _OriginEntry
    """In force when it was written."""
    home_ned_m: tuple[float, float, float]
    mission: tuple[_Item, ...]
    fence: tuple[_Item, ...]
    rally: tuple[_Item, ...]
    position: Position | None


def _text(value: float) -> _Number:
    return value if math.isfinite(value) else repr(value)


def stored_item(item: PlanItem) -> _Item:
    params = (_text(item.param1), _text(item.param2), _text(item.param3), _text(item.param4))
    return _Item(
        item.seq, item.frame, item.command, params, item.x, item.y, _text(item.z), item.autocontinue, item.is_home
    )


def plan_item(item: _Item) -> PlanItem:
    fields = msgspec.structs.asdict(item)
    params = {f"param{n}": float(value) for n, value in enumerate(fields.pop("params"), start=1)}
    return PlanItem(**{**fields, **params, "z": float(item.z)})


def place_of(origin: Origin) -> _OriginEntry:
    return _OriginEntry(origin.lat_deg, origin.lon_deg, origin.alt_m)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlansSnapshot:
    configured_origin: Origin
    origin: Origin
    home_ned_m: FloatArray
    items: Mapping[PlanKind, tuple[PlanItem, ...]]
    position: Position | None


def encode(now: PlansSnapshot) -> bytes:
    north, east, down = now.home_ned_m.tolist()
    mission, fence, rally = (tuple(stored_item(item) for item in now.items[kind]) for kind in PlanKind)
    content = Content(
        configured_origin=place_of(now.configured_origin),
        origin=place_of(now.origin),
        home_ned_m=(north, east, down),
        mission=mission,
        fence=fence,
        rally=rally,
        position=now.position,
    )
    body = msgspec.json.encode(content)
    return (
        msgspec.json.encode(_PlansHead(format=FORMAT, version=VERSION, crc32=zlib.crc32(body))) + b"\n" + body + b"\n"
    )


def decode(data: bytes) -> Content:
    """Content of a file. ValueError with the reason for an invalid one."""
    first, _, body = data.removesuffix(b"\n").partition(b"\n")
    try:
        head = msgspec.json.decode(first, type=_PlansHead)
        if head.format != FORMAT:
            raise ValueError(f"is not a file of plans but {head.format!r}")
        if head.version != VERSION:
            raise ValueError(f"is of version {head.version}, this service reads {VERSION}")
        if head.crc32 != zlib.crc32(body):
            raise ValueError("is damaged (checksum)")
        return msgspec.json.decode(body, type=Content)
    except msgspec.MsgspecError as error:
        raise ValueError(f"is damaged ({error})") from error
