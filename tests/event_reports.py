"""Events by the vehicle's events.json: reports of arming checks as ground stations show them (libevents)."""

import re
import struct
from dataclasses import dataclass, field
from typing import Any

FORMATS = {"uint8_t": "B", "uint16_t": "H"}


@dataclass
class Report:
    """A report of arming checks: names instead of bits."""

    can_arm: set[str] = field(default_factory=set)
    can_run: set[str] = field(default_factory=set)
    wrong: set[str] = field(default_factory=set)
    """Components with reasons against arming."""
    reasons: list[tuple[str, str, set[str]]] = field(default_factory=list)
    """Message, component and mode groups."""
    present: set[str] = field(default_factory=set)
    failing: set[str] = field(default_factory=set)


class EventMetadata:
    """Reads events by the vehicle's events.json."""

    def __init__(self, content: dict[str, Any]) -> None:
        ((number, component),) = content["components"].items()
        self.enums = component["enums"]
        self.mode_groups = component["navigation_mode_groups"]["groups"]
        self.protocols = component["supported_protocols"]
        self.events = {
            int(number) << 24 | int(key): (group, event)
            for group, events in component["event_groups"].items()
            for key, event in events["events"].items()
        }

    def group_of(self, custom_mode: int) -> str:
        """Name of the mode group of a custom_mode."""
        (index,) = (int(key) for key, modes in self.mode_groups.items() if custom_mode in modes)
        name: str = self.enums["navigation_mode_group_t"]["entries"][str(1 << index)]["name"]
        return name

    def values(self, event: Any) -> dict[str, Any]:
        """Arguments by name; of bit sets the names."""
        rows = self.events[event.id][1]["arguments"]
        kinds = [self.enums[row["type"]]["type"] if row["type"] in self.enums else row["type"] for row in rows]
        layout = struct.Struct("<" + "".join(FORMATS[kind] for kind in kinds))
        raw = layout.unpack_from(bytes(event.arguments))
        return {row["name"]: self._shown(row["type"], value) for row, value in zip(rows, raw, strict=True)}

    def _shown(self, kind: str, value: int) -> Any:
        enum = self.enums.get(kind)
        if enum is None:
            return value
        if enum["is_bitfield"]:
            return {entry["name"] for bit, entry in enum["entries"].items() if value & int(bit)}
        return enum["entries"][str(value)]["description"]

    def message(self, event: Any) -> str:
        values = list(self.values(event).values())
        text = re.sub(r"\{(\d+)\}", lambda found: str(values[int(found[1]) - 1]), self.events[event.id][1]["message"])
        return text.strip()

    def reports(self, events: list[Any]) -> list[Report]:
        """All complete ones."""
        whole: list[Report] = []
        begun: Report | None = None
        for event in events:
            group, described = self.events[event.id]
            values, kind = self.values(event), (group, described.get("type", ""))
            if kind == ("arming_check", "summary"):
                begun = Report(can_arm=values["can_arm"], can_run=values["can_run"], wrong=values["error"])
                assert event.log_levels == 0x88
            elif begun is None:
                continue
            elif kind == ("health", "summary"):
                begun.present, begun.failing = values["is_present"], values["error"]
                whole.append(begun)
                begun = None
            else:
                component = self._shown("health_component_t", 1 << values["health_component_index"])
                begun.reasons.append((self.message(event), *component, values["modes"]))
                assert event.log_levels == 0x33
        return whole
