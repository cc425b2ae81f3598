"""Component metadata: general.json, parameters.json and events.json, xz-compressed.

https://mavlink.io/en/services/component_metadata.html; the CRC is that of the file as it is downloaded. The files
are made once, so that they stay equal to a ground station's cached copy.
"""

import json
import lzma
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from autopilot.core.crc import file_crc32
from autopilot.core.params import ParamSpec, ParamType
from autopilot.mavlink.context import COMPID, Context
from autopilot.mavlink.dialect import extra
from autopilot.mavlink.event_metadata import events_json
from autopilot.mavlink.profiles import Profile
from autopilot.mavlink.telemetry import Builder
from autopilot.mavlink.wire import Message

GENERAL, PARAMETERS_FILE, EVENTS_FILE = "general.json.xz", "parameters.json.xz", "events.json.xz"
_TYPES = {PARAMETERS_FILE: 1, EVENTS_FILE: 4}
"""COMP_METADATA_TYPE_PARAMETER and _EVENTS."""
_VERSION = 1
"""Of the formats of general.json and parameters.json."""
_DECIMALS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Metadata:
    """The files by name, and where the general one is."""

    files: dict[str, bytes]

    @property
    def general_crc(self) -> int:
        return file_crc32(self.files[GENERAL])


def make_metadata(specs: Iterable[ParamSpec], profile: Profile, *, name: str, version: str) -> Metadata:
    """The files for these parameters of this vehicle."""
    files = {
        PARAMETERS_FILE: _packed({"version": _VERSION, "parameters": [parameter_json(spec) for spec in specs]}),
        EVENTS_FILE: _packed(events_json(profile)),
    }
    general = {
        "version": _VERSION,
        "vendorName": name,
        "modelName": name,
        "firmwareVersion": version,
        "hardwareVersion": "",
        "metadataTypes": [
            {"type": _TYPES[file], "uri": uri_of(file), "fileCrc": file_crc32(content)}
            for file, content in files.items()
        ],
    }
    return Metadata(files={GENERAL: _packed(general), **files})


def uri_of(file: str) -> str:
    """Where a file is, as QGroundControl and MAVSDK read it."""
    return f"mftp://[;comp={COMPID}]/{file}"


def parameter_json(spec: ParamSpec) -> dict[str, Any]:
    """One parameter (https://github.com/mavlink/mavlink/blob/master/component_metadata/parameter.schema.json)."""
    whole = spec.type is ParamType.INT32
    number = (lambda x: int(x)) if whole else float
    entry: dict[str, Any] = {
        "name": spec.name,
        "type": "Int32" if whole else "Float",
        "shortDesc": spec.title,
        "longDesc": spec.help,
        "group": spec.group,
        "category": "Standard",
        "default": number(spec.default),
        "min": number(spec.minimum),
        "max": number(spec.maximum),
        "rebootRequired": spec.restart,
    }
    if spec.unit:
        entry["units"] = spec.unit
    if not whole:
        entry["decimalPlaces"] = _DECIMALS if spec.maximum < 1e4 else 1
    if spec.values:
        entry["values"] = [{"value": value, "description": text} for value, text in spec.values.items()]
    return entry


class ComponentMetadata:
    def __init__(self, ctx: Context, metadata: Metadata) -> None:
        self._ctx, self._metadata = ctx, metadata

    def builders(self) -> dict[int, Builder]:
        return {
            extra.MAVLINK_MSG_ID_COMPONENT_METADATA: self.component_metadata,
            extra.MAVLINK_MSG_ID_COMPONENT_INFORMATION: self.component_information,
        }

    def component_metadata(self) -> Message:
        return component_metadata(self._metadata, self._ctx.boot_ms)

    def component_information(self) -> Message:
        """COMPONENT_INFORMATION, for ground stations that know only this one."""
        return component_information(self._metadata, self._ctx.boot_ms)


def component_metadata(metadata: Metadata, boot_ms: int) -> Message:
    return extra.MAVLink_component_metadata_message(boot_ms, metadata.general_crc, uri_of(GENERAL).encode("ascii"))


def component_information(metadata: Metadata, boot_ms: int) -> Message:
    uri = uri_of(GENERAL).encode("ascii")
    return extra.MAVLink_component_information_message(boot_ms, metadata.general_crc, uri, 0, b"")


def _packed(content: dict[str, Any]) -> bytes:
    """JSON, packed as QGroundControl's and MAVSDK's unpackers read it."""
    return lzma.compress(
        json.dumps(content, separators=(",", ":")).encode(), format=lzma.FORMAT_XZ, check=lzma.CHECK_CRC32, preset=6
    )
