"""The events that the service sends, as events.json of the component metadata describes them.

Format: https://github.com/mavlink/libevents/blob/main/validation/schema.json; the health and arming check protocol:
the README there.
"""

import struct
from typing import Any

from autopilot.core.arming_reasons import HealthComponent, ModeGroup
from autopilot.mavlink.context import COMPID
from autopilot.mavlink.event_text import PIECES
from autopilot.mavlink.flight_modes import group_of
from autopilot.mavlink.profiles import Profile

_VERSION = 2
"""Of the format."""
ARMING_CHECK_SUMMARY, ARMING_REASON, HEALTH_SUMMARY = (COMPID << 24 | number for number in (1, 2, 3))
"""EVENT.id: the component in the highest byte."""
TEXT_CODES = 31
"""Pieces of text in one event: with more the placeholders of its message would exceed the schema's 120 characters."""
ARMING_CHECK_LAYOUT = struct.Struct("<BHHBB")
"""Chunk, components with errors and with warnings, mode groups that can be armed and that can run."""
REASON_LAYOUT = struct.Struct(f"<BB{TEXT_CODES}s")
"""Mode groups, component, text."""
HEALTH_LAYOUT = struct.Struct("<BHHH")
"""Chunk, components that are present, with errors and with warnings."""


def events_json(profile: Profile) -> dict[str, Any]:
    """Content of events.json under a profile, which numbers the modes."""
    component = {
        "namespace": "underwater_autopilot",
        "enums": {
            "health_component_t": _enum(
                "uint16_t", {1 << part: (part.name.lower(), _label(part)) for part in HealthComponent}, bits=True
            ),
            "navigation_mode_group_t": _enum(
                "uint8_t",
                {int(group): (str(group.name).lower(), str(group.name).capitalize()) for group in ModeGroup},
                bits=True,
            ),
            "text_t": _enum("uint8_t", {code: (f"t{code}", piece) for code, piece in PIECES.items()}, bits=False),
        },
        "event_groups": {
            "arming_check": {
                "events": {
                    _number(ARMING_CHECK_SUMMARY): {
                        "name": "arming_check_summary",
                        "message": "Arming check summary",
                        "type": "summary",
                        "arguments": _arguments(
                            ("uint8_t", "chunk_idx"),
                            ("health_component_t", "error"),
                            ("health_component_t", "warning"),
                            ("navigation_mode_group_t", "can_arm"),
                            ("navigation_mode_group_t", "can_run"),
                        ),
                    },
                    _number(ARMING_REASON): {
                        "name": "arming_reason",
                        "message": "".join(f"{{{3 + n}}}" for n in range(TEXT_CODES)),
                        "arguments": _arguments(
                            ("navigation_mode_group_t", "modes"),
                            ("uint8_t", "health_component_index"),
                            *(("text_t", f"text{n}") for n in range(TEXT_CODES)),
                        ),
                    },
                }
            },
            "health": {
                "events": {
                    _number(HEALTH_SUMMARY): {
                        "name": "health_summary",
                        "message": "Health summary",
                        "type": "summary",
                        "arguments": _arguments(
                            ("uint8_t", "chunk_idx"),
                            ("health_component_t", "is_present"),
                            ("health_component_t", "error"),
                            ("health_component_t", "warning"),
                        ),
                    }
                }
            },
        },
        "supported_protocols": ["health_and_arming_check"],
        "navigation_mode_groups": {"groups": _mode_groups(profile)},
    }
    return {"version": _VERSION, "components": {str(COMPID): component}}


def _mode_groups(profile: Profile) -> dict[str, list[int]]:
    """Index of each group's bit -> custom_mode numbers."""
    return {
        str(index): sorted({number for mode, number in profile.custom_modes.items() if group_of(mode) is group})
        for index, group in enumerate(ModeGroup)
    }


def _label(part: HealthComponent) -> str:
    return part.name if part is HealthComponent.AHRS else part.name.capitalize()


def _number(event: int) -> str:
    """Key of an event: the id without its component."""
    return str(event & 0xFF_FFFF)


def _enum(kind: str, entries: dict[int, tuple[str, str]], *, bits: bool) -> dict[str, Any]:
    described = {str(value): {"name": name, "description": text} for value, (name, text) in entries.items()}
    return {"type": kind, "is_bitfield": bits, "entries": described}


def _arguments(*rows: tuple[str, str]) -> list[dict[str, str]]:
    return [{"type": kind, "name": name} for kind, name in rows]
