"""A ground station that reads events: the receiving side of https://mavlink.io/en/services/events.html, and reports of
arming checks by the metadata of the vehicle (README of libevents)."""

import re
import struct
from dataclasses import dataclass, field
from typing import Any

from mavlink_harness import Client

from autopilot.mavlink.dialect import extra

ASK_AGAIN_TICKS = 10
FORMATS = {"uint8_t": "B", "uint16_t": "H"}


def newer(number: int, than: int) -> bool:
    return 0 < (number - than) & 0xFFFF <= 0x7FFF


class EventReader:
    """Takes events in order, and asks for the first one that is missing."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self.latest: int | None = None
        self.current = 0
        self.events: list[Any] = []
        self.lost = 0
        self.asked = 0
        self._boot_ms = 0
        self._wait: int | None = None
        client.on_message = self._on

    def _ask(self) -> None:
        assert self.latest is not None
        number = (self.latest + 1) & 0xFFFF
        self.client.send(extra.MAVLink_request_event_message(1, 1, number, number))
        self.asked, self._wait = self.asked + 1, ASK_AGAIN_TICKS

    def tick(self) -> None:
        """Once per tick: the timer that repeats a request."""
        if self._wait is not None:
            self._wait -= 1
            if self._wait == 0:
                self._ask()

    def _on(self, message: Any) -> None:
        match message.get_type():
            case "EVENT":
                self._on_event(message)
            case "CURRENT_EVENT_SEQUENCE":
                if self.latest is None or message.flags & 1:
                    self.latest = message.sequence
                self.current = message.sequence
                if newer(message.sequence, self.latest):
                    self._ask()
            case "RESPONSE_EVENT_ERROR" if (message.target_system, message.target_component) == (
                self.client.sysid,
                self.client.compid,
            ):
                assert self.latest is not None
                if message.sequence == (self.latest + 1) & 0xFFFF:
                    self.lost += (message.sequence_oldest_available - self.latest - 1) & 0xFFFF
                    self.latest = (message.sequence_oldest_available - 1) & 0xFFFF
                    self._ask()

    def _on_event(self, event: Any) -> None:
        if self.latest is None or event.event_time_boot_ms + 10_000 < self._boot_ms:
            self.latest = (event.sequence - 1) & 0xFFFF
        expected = (self.latest + 1) & 0xFFFF
        if newer(event.sequence, expected):
            self._ask()
        elif event.sequence == expected:
            self.latest, self._boot_ms, self._wait = event.sequence, event.event_time_boot_ms, None
            self.events.append(event)
            if newer(self.current, self.latest):
                self._ask()


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
