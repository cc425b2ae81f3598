"""Mission protocol, client side: upload and download of one plan.

Protocol: https://mavlink.io/en/services/mission.html. With the five retries of that page one transfer of 160 items
is lost at 20 % datagram loss in both directions, so the limit here is a timeout and not a number of retries.
"""

import math
import struct
from collections.abc import Sequence

from pymavlink.dialects.v20 import development as mav

from autopilot.client.exchange import Exchange, ExchangeResult, Message, Timers, VehicleAddress
from autopilot.core.plan import MissionResult, PlanItem, PlanKind
from autopilot.core.plan_wire import item_message, item_of

MAX_RESTARTS = 3
"""Restarts of an upload that ended for no fault of the plan."""
_BROKEN_OFF = frozenset({MissionResult.ERROR, MissionResult.INVALID_SEQUENCE, MissionResult.OPERATION_CANCELLED})
"""Results after a late copy of an earlier datagram has disturbed the transfer."""


class PlanUpload(Exchange):
    """Replace one plan of the vehicle. The vehicle requests the items and ends with MISSION_ACK.

    Parameters
    ----------
    kind
        Type of the plan.
    items
        Items in wire units, numbered from 0.
    target
        Address of the vehicle, None = system 1, component 1.
    timers
        Timeouts, None = the defaults.
    """

    def __init__(
        self,
        kind: PlanKind,
        items: Sequence[PlanItem],
        target: VehicleAddress | None = None,
        timers: Timers | None = None,
    ) -> None:
        super().__init__(f"{kind.name.lower()} upload", target, timers)
        self._kind = kind
        self._items = tuple(items)
        self._last_sent: int | None = None
        self._highest = -1
        self._restarts = 0

    @property
    def progress(self) -> tuple[int, int]:
        """Items requested and items in all."""
        return self._highest + 1, len(self._items)

    @property
    def all_sent(self) -> bool:
        """Whether the vehicle has requested every item; only its MISSION_ACK is missing."""
        return self._highest == len(self._items) - 1

    def handle(self, message: Message, t_s: float) -> list[Message]:
        if not self._listens(message, t_s) or getattr(message, "mission_type", None) != self._kind:
            return []
        kind = message.get_type()
        if kind in ("MISSION_REQUEST_INT", "MISSION_REQUEST") and 0 <= message.seq < len(self._items):
            self._received_s = self._sent_s = t_s
            self._last_sent = message.seq
            self._highest = max(self._highest, message.seq)
            return [self._due()]
        if kind == "MISSION_ACK":
            self._received_s = t_s
            return self._on_ack(message.type, t_s)
        return []

    def _on_ack(self, result: int, t_s: float) -> list[Message]:
        """End or restart. An ACCEPTED before all items were requested is a late copy for an earlier upload."""
        if result == MissionResult.ACCEPTED:
            if self.all_sent:
                self.outcome = ExchangeResult(result=0, reason="")
            return []
        if result in _BROKEN_OFF and self._restarts < MAX_RESTARTS:
            self._restarts += 1
            self._last_sent, self._highest, self._sent_s = None, -1, t_s
            return [self._due()]
        self._refuse(result, t_s)
        return []

    def _due(self) -> Message:
        """MISSION_COUNT until the vehicle requests an item, then the last item sent until the next request."""
        seq, target, kind = self._last_sent, self._target, self._kind
        if seq is None:
            return mav.MAVLink_mission_count_message(target.system, target.component, len(self._items), int(kind))
        item, current = self._items[seq], seq == 0 and kind is PlanKind.MISSION
        return item_message(item, kind, system=target.system, component=target.component, current=current)


class PlanDownload(Exchange):
    """Read one plan of the vehicle: requests one item after the other and ends with MISSION_ACK.

    Parameters
    ----------
    kind
        Type of the plan.
    target
        Address of the vehicle, None = system 1, component 1.
    timers
        Timeouts, None = the defaults.
    """

    def __init__(self, kind: PlanKind, target: VehicleAddress | None = None, timers: Timers | None = None) -> None:
        super().__init__(f"{kind.name.lower()} download", target, timers)
        self._kind = kind
        self._count: int | None = None
        self._items: list[PlanItem] = []

    @property
    def progress(self) -> tuple[int, int]:
        """Items received and items in all (0 before that is known)."""
        return len(self._items), self._count or 0

    @property
    def items(self) -> tuple[PlanItem, ...]:
        """The plan, complete when the outcome is accepted."""
        return tuple(self._items)

    def handle(self, message: Message, t_s: float) -> list[Message]:
        if not self._listens(message, t_s) or getattr(message, "mission_type", None) != self._kind:
            return []
        kind = message.get_type()
        if kind == "MISSION_ACK" and message.type != MissionResult.ACCEPTED:
            self._refuse(message.type, t_s)
            return []
        if kind == "MISSION_COUNT" and self._count is None:
            self._count = message.count
        elif kind == "MISSION_ITEM_INT" and self._count is not None and message.seq == len(self._items):
            self._items.append(item_of(message))
        else:
            return []
        self._received_s = self._sent_s = t_s
        if len(self._items) < (self._count or 0):
            return [self._due()]
        self.outcome = ExchangeResult(result=0, reason="")
        target = self._target
        return [mav.MAVLink_mission_ack_message(target.system, target.component, 0, int(self._kind))]

    @property
    def _repeat_s(self) -> float:
        return self._timers.general_s if self._count is None else self._timers.item_s

    def _due(self) -> Message:
        target, kind = self._target, int(self._kind)
        if self._count is None:
            return mav.MAVLink_mission_request_list_message(target.system, target.component, kind)
        return mav.MAVLink_mission_request_int_message(target.system, target.component, len(self._items), kind)


def same_on_the_wire(a: Sequence[PlanItem], b: Sequence[PlanItem]) -> bool:
    """Whether two plans are the same MISSION_ITEM_INT messages (32-bit floats, NaN equal to NaN)."""
    return len(a) == len(b) and all(_wire(x) == _wire(y) for x, y in zip(a, b, strict=True))


def _wire(item: PlanItem) -> tuple[object, ...]:
    floats = (item.param1, item.param2, item.param3, item.param4, item.z)
    packed = tuple(None if math.isnan(v) else struct.pack("<f", v) for v in floats)
    return (item.seq, item.frame, item.command, item.x, item.y, item.autocontinue, packed)
