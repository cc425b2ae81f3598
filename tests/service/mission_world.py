"""A vehicle that is sent missions over MAVLink, as ground stations do it, and flies them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from piloted_world import PilotedWorld
from pymavlink.dialects.v20 import development as mav

from autopilot.core.plan import PlanItem, PlanKind
from autopilot.core.plan_wire import item_message
from tests.plan_items import local

MISSION = (4 << 16) | (4 << 24)


def placed(seq: int, command: int, x: float, y: float, depth: float, *params: float) -> PlanItem:
    """An item at local metres."""
    return local(seq, command, x, y, depth, (*params, *(0.0,) * (4 - len(params))))


class MissionWorld(PilotedWorld):
    """Uploads by bytes, and remembers what was reached and said."""

    def upload(self, items: Sequence[PlanItem], kind: int = 0) -> Any:
        """COUNT, items as they are asked for; the final MISSION_ACK."""
        self.inbox.clear()
        rx = [self.pack(mav.MAVLink_mission_count_message(1, 1, len(items), kind))]
        for _ in range(100 + 3 * len(items)):
            self.tick(rx)
            rx, news = [], list(self.inbox)
            self.inbox.clear()
            for message in news:
                if message.get_type() == "MISSION_ACK":
                    self.inbox.extend(news)
                    self.run(0.03)
                    return message
                if message.get_type() == "MISSION_REQUEST_INT":
                    item = items[message.seq]
                    rx.append(self.pack(item_message(item, PlanKind(kind), current=item.seq == 0)))
        raise AssertionError("no MISSION_ACK")

    def fly(self, items: Sequence[PlanItem], seconds: float) -> None:
        """Upload, arm, start, run."""
        ack = self.upload(items)
        assert ack.type == 0, self.texts()
        self.arm()
        assert self.command(300, 0.0, 0.0) == 0, self.texts()
        self.inbox.clear()
        self.run(seconds)

    @property
    def reached(self) -> list[int]:
        """MISSION_ITEM_REACHED since the start."""
        return [m.seq for m in self.inbox if m.get_type() == "MISSION_ITEM_REACHED"]

    def since(self, seconds: float) -> Any:
        """The track (n, 8) of the last seconds."""
        return np.array(self.track[-round(100 * seconds) :])
