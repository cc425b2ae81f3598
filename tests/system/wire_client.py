"""Clients that speak raw MAVLink in the vehicle's own time, for sessions in this process."""

import functools
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

from pymavlink.dialects.v20 import development as mav

from autopilot.bench.live_service import Station
from autopilot.core.clock import TICK_US
from autopilot.core.messages import Outputs
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.core.plan_wire import item_message, item_of
from autopilot.run.runtime import Runtime
from autopilot.run.sitl_session import SitlSession

_CHUNK_CHARS = 50
"""STATUSTEXT.text; a chunk that is not full ends a text."""


REMEDIES = ("move", "use", "give", "send", "widen", "try again", "make", "set", "split", "put", "ask for")
"""One of them is in what a refusal says."""


class WireClient:
    """A ground station of a few lines: sends what it is told, keeps everything that it hears."""

    def __init__(self, sysid: int = 255, compid: int = 190) -> None:
        self._mav = mav.MAVLink(None, srcSystem=sysid, srcComponent=compid)
        self._outbox: list[bytes] = []
        self.inbox: list[Any] = []

    def step(self, _t_us: int, received: Sequence[bytes]) -> list[bytes]:
        for data in received:
            self.inbox += self._mav.parse_buffer(data) or ()
        outbox, self._outbox = self._outbox, []
        return outbox

    def send(self, message: Any) -> None:
        self._outbox.append(bytes(message.pack(self._mav)))
        self._mav.seq = (self._mav.seq + 1) & 0xFF

    def send_bytes(self, data: bytes) -> None:
        self._outbox.append(data)

    def received(self, *names: str) -> list[Any]:
        return [message for message in self.inbox if message.get_type() in names]

    def texts(self, worst: int = 0, least: int = mav.MAV_SEVERITY_WARNING) -> list[str]:
        """Whole texts of these severities, chunks put together, in order."""
        whole: list[str] = []
        parts: dict[int, str] = defaultdict(str)
        for message in self.received("STATUSTEXT"):
            if not worst <= message.severity <= least:
                continue
            if message.id == 0:
                whole.append(message.text)
                continue
            parts[message.id] += message.text
            if len(message.text) < _CHUNK_CHARS:
                whole.append(parts.pop(message.id))
        assert not parts, "a text without its end"
        return whole


class ArmingSchedule(WireClient):
    """Arms (1) and disarms (0) at given times [s], and does what is to be done before; keeps when texts came."""

    def __init__(self, times_s: dict[float, int], before: dict[float, Callable[[], object]] | None = None) -> None:
        super().__init__()
        arm, actions = mav.MAV_CMD_COMPONENT_ARM_DISARM, before or {}
        orders = {t_s: mav.MAVLink_command_long_message(1, 1, arm, 0, on, *[0.0] * 6) for t_s, on in times_s.items()}
        self._todo = sorted(
            [(round(t_s * 1e6), 0, action) for t_s, action in actions.items()]
            + [(round(t_s * 1e6), 1, functools.partial(self.send, order)) for t_s, order in orders.items()],
            key=lambda entry: entry[:2],
        )
        self._texts: list[tuple[float, int, str]] = []

    def step(self, t_us: int, received: Sequence[bytes]) -> list[bytes]:
        while self._todo and self._todo[0][0] <= t_us:
            self._todo.pop(0)[2]()
        known = len(self.inbox)
        outbox = super().step(t_us, received)
        self._texts += [(t_us * 1e-6, m.severity, m.text) for m in self.inbox[known:] if m.get_type() == "STATUSTEXT"]
        return outbox

    def texts_from(self, start: str) -> list[tuple[float, int, str]]:
        """Time [s], severity and text of those that begin so."""
        return [text for text in self._texts if text[2].startswith(start)]


def hear_all(station: Station) -> list[Any]:
    """What has come to a station on a socket."""
    found: list[Any] = []
    while more := station.receive(0.0):
        found += more
    return found


class Harbour:
    """A session and the time in it."""

    def __init__(self, session: SitlSession, runtime: Runtime | None = None) -> None:
        """``runtime`` instead of the session's own."""
        self.session = session
        self._runtime = runtime or session.runtime
        self.ticks = 0
        """So many so far."""

    def tick(self) -> Outputs:
        self.ticks += 1
        return self._runtime.tick(self.ticks * TICK_US)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e6 / TICK_US)):
            self.tick()

    def until(self, done: Callable[[], bool], timeout_s: float = 5.0) -> None:
        for _ in range(round(timeout_s * 1e6 / TICK_US)):
            if done():
                return
            self.tick()
        raise AssertionError(f"nothing came in {timeout_s:g} s")

    def _hear(self, client: WireClient, count: int, *names: str) -> None:
        self.until(lambda: len(client.received(*names)) >= count)

    # Exchanges that every client has

    def command(self, client: WireClient, command: int, *params: float) -> int:
        client.inbox.clear()
        filled = (*params, *(0.0,) * (7 - len(params)))
        client.send(mav.MAVLink_command_long_message(1, 1, command, 0, *filled))

        def answers() -> list[int]:
            return [m.result for m in client.received("COMMAND_ACK") if m.command == command]

        self.until(lambda: bool(answers()))
        return answers()[0]

    def offer(self, client: WireClient, kind: PlanKind, items: Sequence[PlanItem], count: int | None = None) -> int:
        """Upload as a client would; the MAV_MISSION_RESULT. ``count`` announces another number of items."""
        client.inbox.clear()
        client.send(mav.MAVLink_mission_count_message(1, 1, len(items) if count is None else count, int(kind)))
        answered = 0
        while not (acks := client.received("MISSION_ACK")):
            self._hear(client, answered + 1, "MISSION_REQUEST_INT", "MISSION_ACK")
            for request in client.received("MISSION_REQUEST_INT")[answered:]:
                client.send(item_message(items[request.seq], kind))
                answered += 1
        self.run(0.3)  # more than one answer, or a text late
        assert len(client.received("MISSION_ACK")) == 1
        assert acks[0].mission_type == kind
        return int(acks[0].type)

    def download(self, client: WireClient, kind: PlanKind) -> list[PlanItem]:
        client.inbox.clear()
        client.send(mav.MAVLink_mission_request_list_message(1, 1, int(kind)))
        self._hear(client, 1, "MISSION_COUNT")
        count = client.received("MISSION_COUNT")[0].count
        for seq in range(count):
            client.send(mav.MAVLink_mission_request_int_message(1, 1, seq, int(kind)))
            self._hear(client, seq + 1, "MISSION_ITEM_INT")
        client.send(mav.MAVLink_mission_ack_message(1, 1, mav.MAV_MISSION_ACCEPTED, int(kind)))
        self.tick()
        return [item_of(message) for message in client.received("MISSION_ITEM_INT")]
