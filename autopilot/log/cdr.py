"""ROS 2 CDR (little endian) without a ROS installation: layouts of fixed-size types, a buffer for others, a decoder.

CDR aligns every primitive to its own size, counted from the byte after the four-byte encapsulation header. A
*fixed-size* type has no sequences and no strings but ``std_msgs/Header.frame_id``, whose length is constant per
channel: such a message is one :class:`struct.Struct` to write, and one numpy dtype to read a whole topic with.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from autopilot.core.errors import LogError

ENCAPSULATION = b"\x00\x01\x00\x00"
"""Plain CDR, little endian (RTPS 2.3, table 10.1)."""

SEQUENCE = -1
"""``Field.count`` of a sequence of any length."""

PRIMITIVES: dict[str, tuple[str, int]] = {
    "bool": ("?", 1),
    "byte": ("B", 1),
    "char": ("B", 1),
    "int8": ("b", 1),
    "uint8": ("B", 1),
    "int16": ("h", 2),
    "uint16": ("H", 2),
    "int32": ("i", 4),
    "uint32": ("I", 4),
    "int64": ("q", 8),
    "uint64": ("Q", 8),
    "float32": ("f", 4),
    "float64": ("d", 8),
}
"""ROS 2 primitive -> struct (and numpy) code and size in bytes."""


@dataclass(frozen=True, slots=True)
class CdrField:
    name: str
    type: str
    """A primitive, ``string`` or a message type ``package/Name``."""
    count: int | None
    """None = one value, n = array of n, SEQUENCE = any number."""


Types: TypeAlias = Mapping[str, tuple[CdrField, ...]]
"""Message type -> its fields, closed under the types that it uses."""


def parse_definition(name: str, text: str) -> dict[str, tuple[CdrField, ...]]:
    """The types in a ``ros2msg`` schema: the definition of ``name``, then ``===`` and ``MSG: other`` for each it uses.

    LogError when a line is not a field or a type is missing.
    """
    types: dict[str, tuple[CdrField, ...]] = {}
    current, fields = short_name(name), list[CdrField]()
    for raw in text.splitlines():
        line = raw.split("#", 1)[0].strip()
        if line.startswith("==="):
            types[current], fields = tuple(fields), []
        elif line.startswith("MSG:"):
            current = short_name(line[4:].strip())
        elif line and "=" not in line.replace("<=", ""):
            fields.append(_parse_field(line, current))
    types[current] = tuple(fields)
    for owner, members in types.items():
        for member in members:
            if member.type != "string" and member.type not in PRIMITIVES and member.type not in types:
                raise LogError(f"schema {name}: {owner}.{member.name} has the unknown type {member.type}")
    return types


def short_name(name: str) -> str:
    """``package/Name`` of ``package/msg/Name``."""
    return name.replace("/msg/", "/")


def _parse_field(line: str, owner: str) -> CdrField:
    parts = line.split()
    if len(parts) < 2:
        raise LogError(f"schema {owner}: {line!r} is not a field; the schema is damaged")
    kind, name = parts[0], parts[1]
    count: int | None = None
    if kind.endswith("]"):
        kind, _, size = kind[:-1].partition("[")
        count = int(size) if size.isdigit() else SEQUENCE
    kind = kind.split("<=")[0]
    if kind not in PRIMITIVES and kind != "string":
        kind = short_name(kind)
        if kind == "Header":
            kind = "std_msgs/Header"
        elif "/" not in kind:
            kind = f"{owner.split('/', maxsplit=1)[0]}/{kind}"
    return CdrField(name, kind, count)


@dataclass(frozen=True, slots=True)
class CdrLayout:
    """Bytes of a fixed-size message, the encapsulation header included."""

    packer: struct.Struct
    """Takes ENCAPSULATION and then every value in order; a header is sec, nanosec, length, b"frame\\0", and an array of
    bytes is one ``bytes``."""
    dtype: np.dtype[np.void]
    """Fields under their names (nested messages nested) with their offsets; ``packer.size`` bytes."""


class _NotFixed(Exception):
    """The type has a part whose size differs from message to message."""


def fixed_layout(types: Types, name: str, frame_id_bytes: int) -> CdrLayout | None:
    """Layout of ``name`` when its frame_id takes ``frame_id_bytes`` (with the closing NUL); None = not fixed-size."""
    codes = ["<4s"]
    try:
        dtype, size = _lay_out(types, short_name(name), frame_id_bytes, 0, len(ENCAPSULATION), codes)
    except _NotFixed:
        return None
    packer = struct.Struct("".join(codes))
    if packer.size != size:
        raise LogError(f"schema {name}: layout of {size} bytes packs to {packer.size}; the schema is not supported")
    return CdrLayout(packer, dtype)


def _lay_out(
    types: Types, name: str, frame_id_bytes: int, start: int, offset: int, codes: list[str]
) -> tuple[np.dtype[np.void], int]:
    """The dtype of ``name`` and where it ends. Its values begin at ``offset``, its own offsets count from ``start``."""
    names: list[str] = []
    formats: list[Any] = []
    offsets: list[int] = []
    for field in types[name]:
        if field.count == SEQUENCE or (
            field.type == "string" and (name, field.name) != ("std_msgs/Header", "frame_id")
        ):
            raise _NotFixed
        if field.type == "string":
            offset = _pad(offset, 4, codes)
            codes.append(f"I{frame_id_bytes}s")
            names += ["frame_id_length", "frame_id"]
            formats += ["<u4", f"S{frame_id_bytes}"]
            offsets += [offset - start, offset + 4 - start]
            offset += 4 + frame_id_bytes
        elif field.type in PRIMITIVES:
            code, size = PRIMITIVES[field.type]
            offset = _pad(offset, size, codes)
            count = 1 if field.count is None else field.count
            codes.append(f"{count}s" if code == "B" and field.count is not None else f"{count}{code}")
            names.append(field.name)
            formats.append("<" + _NUMPY[code] if field.count is None else ("<" + _NUMPY[code], (count,)))
            offsets.append(offset - start)
            offset += size * count
        elif field.count is None:
            offset = _pad(offset, _alignment(types, field.type), codes)
            nested, end = _lay_out(types, field.type, frame_id_bytes, offset, offset, codes)
            names.append(field.name)
            formats.append(nested)
            offsets.append(offset - start)
            offset = end
        else:
            raise _NotFixed
    dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": offset - start})
    return dtype, offset


_NUMPY = {
    "?": "?",
    "B": "u1",
    "b": "i1",
    "h": "i2",
    "H": "u2",
    "i": "i4",
    "I": "u4",
    "q": "i8",
    "Q": "u8",
    "f": "f4",
    "d": "f8",
}


def _alignment(types: Types, name: str) -> int:
    """Alignment of the first primitive of a message: padding in front of it belongs before the message."""
    first = types[name][0]
    if first.type == "string" or first.count == SEQUENCE:
        return 4
    return PRIMITIVES[first.type][1] if first.type in PRIMITIVES else _alignment(types, first.type)


def _pad(offset: int, size: int, codes: list[str]) -> int:
    gap = -(offset - len(ENCAPSULATION)) % size
    if gap:
        codes.append(f"{gap}x")
    return offset + gap


class CdrBuffer:
    """Writes one variable-size message, value after value."""

    __slots__ = ("_data",)

    def __init__(self) -> None:
        self._data = bytearray(ENCAPSULATION)

    def getvalue(self) -> bytes:
        return bytes(self._data)

    def put(self, kind: str, *values: float) -> None:
        """Primitives of one kind (a single value, or an array of constant length)."""
        code, size = PRIMITIVES[kind]
        self.align(size)
        self._data += struct.pack(f"<{len(values)}{code}", *values)

    def align(self, size: int) -> None:
        """Zeros up to the next multiple of ``size``."""
        self._data += b"\0" * (-(len(self._data) - len(ENCAPSULATION)) % size)

    def string(self, text: str) -> None:
        """A string with its length and NUL."""
        raw = text.encode("utf-8", "replace").replace(b"\0", b" ")
        self.put("uint32", len(raw) + 1)
        self._data += raw + b"\0"

    def blob(self, raw: bytes) -> None:
        self.put("uint32", len(raw))
        self._data += raw

    def header(self, stamp_ns: int, frame_id: str) -> None:
        self.stamp(stamp_ns)
        self.string(frame_id)

    def stamp(self, stamp_ns: int) -> None:
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        self.align(4)
        self._data += struct.pack("<iI", sec, nanosec)


def decode(types: Types, name: str, data: bytes) -> dict[str, Any]:
    """A message of any type as a dictionary (arrays of primitives as lists, bytes as bytes).

    LogError when the bytes end before the message does.
    """
    if data[:4] != ENCAPSULATION:
        raise LogError(f"message of type {name}: encapsulation {data[:4].hex()} is not little-endian CDR")
    try:
        value, _ = _decode_message(types, short_name(name), data, len(ENCAPSULATION))
    except (struct.error, UnicodeDecodeError, IndexError) as error:
        raise LogError(f"message of type {name}: {len(data)} bytes do not hold it ({error})") from error
    return value


def _decode_message(types: Types, name: str, data: bytes, offset: int) -> tuple[dict[str, Any], int]:
    out: dict[str, Any] = {}
    for field in types[name]:
        if field.count is None:
            out[field.name], offset = _decode_one(types, field.type, data, offset)
            continue
        count = field.count
        if count == SEQUENCE:
            count, offset = _decode_one(types, "uint32", data, offset)
        if count > len(data):
            raise IndexError(f"{field.name} claims {count} elements")
        out[field.name], offset = _decode_many(types, field.type, count, data, offset)
    return out, offset


def _decode_one(types: Types, kind: str, data: bytes, offset: int) -> tuple[Any, int]:
    if kind in PRIMITIVES:
        code, size = PRIMITIVES[kind]
        offset += -(offset - len(ENCAPSULATION)) % size
        return struct.unpack_from("<" + code, data, offset)[0], offset + size
    if kind == "string":
        length, offset = _decode_one(types, "uint32", data, offset)
        if offset + length > len(data):
            raise IndexError("string runs over the end")
        return data[offset : offset + max(length - 1, 0)].decode(), offset + length
    return _decode_message(types, kind, data, offset)


def _decode_many(types: Types, kind: str, count: int, data: bytes, offset: int) -> tuple[Any, int]:
    if kind not in PRIMITIVES:
        values = []
        for _ in range(count):
            value, offset = _decode_one(types, kind, data, offset)
            values.append(value)
        return values, offset
    code, size = PRIMITIVES[kind]
    if count:
        offset += -(offset - len(ENCAPSULATION)) % size
    end = offset + size * count
    if end > len(data):
        raise IndexError("array runs over the end")
    if kind in ("uint8", "byte", "char"):
        return data[offset:end], end
    return list(struct.unpack_from(f"<{count}{code}", data, offset)), end
