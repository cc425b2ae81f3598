"""Message classes made from ``underwater.xml`` when the service starts, by pymavlink's own parser.

A class is what pymavlink's generator writes for a message (MAVLink serialization guide, "Field Reordering" and
"CRC_EXTRA"), so that the packaged decoder and :meth:`MAVLink_message._pack` work with it.
"""

import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from pymavlink.dialects.v20 import development as mav
from pymavlink.generator.mavgen_python import mavfmt
from pymavlink.generator.mavparse import MAVXML

DEFINITIONS = Path(__file__).with_name("underwater.xml")


class ExtraMessage(mav.MAVLink_message):  # type: ignore[misc]  # pymavlink is not typed
    """A message whose fields are described by its class: fields in the order of the definition, or by name."""

    id: int
    msgname: str
    fieldnames: tuple[str, ...]
    ordered_fieldnames: tuple[str, ...]
    fieldtypes: tuple[str, ...]
    field_defaults: dict[str, Any]
    crc_extra: int
    unpacker: struct.Struct

    def __init__(self, *values: Any, **named: Any) -> None:
        super().__init__(self.id, self.msgname)
        self._fieldnames = self.fieldnames
        given = self.field_defaults | dict(zip(self.fieldnames, values, strict=False)) | named
        if len(values) > len(self.fieldnames) or given.keys() != set(self.fieldnames):
            raise TypeError(f"{self.msgname}: needs the fields {', '.join(self.fieldnames)}")
        for name, kind in zip(self.fieldnames, self.fieldtypes, strict=True):
            value = given[name]
            if kind == "char":
                setattr(self, f"_{name}_raw", value)
                value = value.split(b"\0", 1)[0].decode("ascii", errors="replace")
            setattr(self, name, value)

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """The frame, by the sender state ``mav``."""
        flat: list[Any] = []
        for name in self.ordered_fieldnames:
            value = getattr(self, f"_{name}_raw", getattr(self, name))
            if isinstance(value, list | tuple):
                flat += value
            else:
                flat.append(value)
        packed: bytes = self._pack(mav, self.crc_extra, self.unpacker.pack(*flat), force_mavlink1=force_mavlink1)
        return packed


def message_class(definition: Any) -> type[ExtraMessage]:
    """The class of one message of a parsed definition file."""
    layout = "<" + "".join(mavfmt(field) for field in definition.ordered_fields)
    base = len(definition.fields) if definition.extensions_start is None else definition.extensions_start
    lengths = dict(zip(definition.fieldnames, definition.fieldlengths, strict=True))
    described = {
        "id": definition.id,
        "msgname": definition.name,
        "fieldnames": tuple(definition.fieldnames),
        "ordered_fieldnames": tuple(definition.ordered_fieldnames),
        "fieldtypes": tuple(definition.fieldtypes),
        "fielddisplays_by_name": {},
        "fieldenums_by_name": {field.name: field.enum for field in definition.fields if field.enum},
        "fieldunits_by_name": {field.name: field.units.strip("[]") for field in definition.fields if field.units},
        "field_defaults": dict.fromkeys(definition.fieldnames[base:], 0),
        "orders": [definition.ordered_fieldnames.index(name) for name in definition.fieldnames],
        "lengths": [lengths[name] for name in definition.ordered_fieldnames],
        "array_lengths": [field.array_length for field in definition.ordered_fields],
        "crc_extra": definition.crc_extra,
        "unpacker": struct.Struct(layout),
        "instance_field": None,
        "instance_offset": -1,
    }
    return type(f"MAVLink_{definition.name.lower()}_message", (ExtraMessage,), described)


def load() -> SimpleNamespace:
    """Classes, message ids and enum values under the names that pymavlink's dialects give them, and ``mavlink_map``."""
    parsed = MAVXML(str(DEFINITIONS), "2.0")
    kinds = [message_class(definition) for definition in parsed.message]
    return SimpleNamespace(
        mavlink_map={kind.id: kind for kind in kinds},
        **{kind.__name__: kind for kind in kinds},
        **{f"MAVLINK_MSG_ID_{kind.msgname}": kind.id for kind in kinds},
        **{entry.name: entry.value for enum in parsed.enum for entry in enum.entry},
    )
