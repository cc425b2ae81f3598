"""Receive queues: fair between clients, bounded per tick, in order per client.

Every client (an address or connection of a link) has a queue and a parser of its own, so that corrupt bytes of one
do not affect another. A tick has a work budget (:mod:`autopilot.mavlink.wire`), shared round-robin; the rest stays
in a bounded backlog. Overflow is dropped and reported with the client's name. Between ticks urgent read-only
messages are handled at once, up to the first message that is not.
"""

from collections import deque
from collections.abc import Callable, Container
from dataclasses import dataclass, field

from autopilot.core.clients import Reach
from autopilot.core.messages import MavlinkFrame
from autopilot.mavlink.bounded_table import LatestUsed
from autopilot.mavlink.wire import LinkParser, Message, Work

HANDLE_WORK = 30
"""Work of handling a message."""
HEAVY_WORK = 120
"""The same of one that makes the vehicle check itself or write."""
TURN_WORK = 100
"""A client's turn: about two messages."""
CLIENT_WORK = 500
"""Most that one client gets of a tick: 12 messages, or 500 bytes of junk."""
TICK_WORK = 1500
"""Most that all clients get of a tick: about 2 ms."""
SERVE_WORK = 500
"""Most that one client gets between two ticks: another 12 messages. All together get TICK_WORK."""
FLOOD_AGAIN_US = 5_000_000
"""Interval at which a flooding client is reported again."""
MAX_INBOXES = 64
"""Clients that are remembered; beyond that the one silent for longest is dropped."""

Address = tuple[int, int]
"""Link and client."""
Handle = Callable[[Address, Message], None]


@dataclass(slots=True)
class Inbox:
    """Queue of one client."""

    address: Address
    parser: LinkParser
    sender: str = ""
    """Name of the client in messages to operators."""
    reach: Reach = Reach.NETWORK
    head: Message | None = None
    """A message that has been cut out and not been handled."""
    spent: int = 0
    """Work of this tick."""
    served: int = 0
    """Work since the last tick."""
    waiting: bool = False
    """Whether it has asked for a turn."""
    reported: int = 0
    """Lost bytes reported to operators."""
    reported_us: int | None = None
    """When."""

    def next(self, work: Work) -> Message | None:
        """The next message in order, None when the queue or the work budget is exhausted."""
        if self.head is None:
            self.head = self.parser.take(work)
        return self.head


@dataclass(frozen=True, slots=True)
class Flood:
    """A client that sends more than is taken."""

    sender: str
    link: int
    dropped: int
    """Bytes since it was last named."""
    dropped_total: int


@dataclass(slots=True)
class MessageInbox:
    """All inboxes. ``wanted`` are the messages that have a handler, ``heavy`` those of them that cost more."""

    wanted: Container[int]
    heavy: Container[int]
    handle: Handle
    admits: Callable[[bytes, Reach], bool] = lambda frame, reach: True
    """Whether valid frames are accepted from that distance."""
    on_frame: Callable[[Address, bytes], None] = lambda address, frame: None
    """Every good frame that is."""
    _inboxes: LatestUsed[Address, Inbox] = field(init=False)
    _turns: deque[Inbox] = field(default_factory=deque)
    _served: int = 0
    _dropped_closed: int = 0
    _received_closed: int = 0

    def __post_init__(self) -> None:
        self._inboxes = LatestUsed(MAX_INBOXES, self._let_go)

    @property
    def dropped(self) -> int:
        """Damaged stretches of input so far."""
        return self._dropped_closed + sum(inbox.parser.dropped for inbox in self._inboxes.values())

    @property
    def received(self) -> int:
        return self._received_closed + sum(inbox.parser.received for inbox in self._inboxes.values())

    def push(self, frame: MavlinkFrame) -> Inbox:
        address = (frame.link, frame.client)
        inbox = self._inboxes.touch(address, lambda: self._inbox(address, frame))
        if inbox.parser.push(frame.data) and not inbox.waiting:
            inbox.waiting = True
            self._turns.append(inbox)
        return inbox

    def __contains__(self, address: Address) -> bool:
        return address in self._inboxes

    def reach(self, address: Address) -> Reach:
        inbox = self._inboxes.get(address)
        return Reach.NETWORK if inbox is None else inbox.reach

    def forget_link(self, link: int) -> None:
        for address in [address for address in self._inboxes if address[0] == link]:
            self._let_go(self._inboxes.pop(address))

    @property
    def waiting(self) -> bool:
        """Whether messages are left for the next tick."""
        return bool(self._turns)

    def work(self) -> None:
        """A tick: turn by turn, until everything is handled or the tick's work is done."""
        for inbox in self._inboxes.values():
            inbox.spent = inbox.served = 0
        left, self._served = TICK_WORK, 0
        later: list[Inbox] = []
        while self._turns and left > 0:
            inbox = self._turns.popleft()
            work = Work(min(TURN_WORK, CLIENT_WORK - inbox.spent))
            given = work.left
            while work.left > 0 and (message := inbox.next(work)) is not None:
                self._handle(inbox, message, work)
            done = work.left > 0
            inbox.spent += given - work.left
            left -= given - work.left
            if done:
                inbox.waiting = False
            elif inbox.spent < CLIENT_WORK:
                self._turns.append(inbox)
            else:
                later.append(inbox)
        self._turns.extend(later)

    def serve(self, inbox: Inbox, urgent: Callable[[Address, Message], bool]) -> None:
        """Between ticks: handle urgent messages, up to the first that is not."""
        work = Work(min(SERVE_WORK - inbox.served, TICK_WORK - self._served))
        given = work.left
        while work.left > 0 and (message := inbox.next(work)) is not None and urgent(inbox.address, message):
            self._handle(inbox, message, work)
        inbox.served += given - work.left
        self._served += given - work.left

    def take_flood(self, t_us: int) -> Flood | None:
        """Of the clients not named lately the one that has lost most since; None if none has lost anything."""
        worst, dropped = None, 0
        for inbox in self._inboxes.values():
            since = inbox.parser.overflow - inbox.reported
            if since > dropped and (inbox.reported_us is None or t_us - inbox.reported_us >= FLOOD_AGAIN_US):
                worst, dropped = inbox, since
        if worst is None:
            return None
        worst.reported, worst.reported_us = worst.parser.overflow, t_us
        return Flood(worst.sender, worst.address[0], dropped, worst.parser.overflow)

    def _handle(self, inbox: Inbox, message: Message, work: Work) -> None:
        inbox.head = None
        work.left -= HEAVY_WORK if message.get_msgId() in self.heavy else HANDLE_WORK
        self.handle(inbox.address, message)

    def _inbox(self, address: Address, frame: MavlinkFrame) -> Inbox:
        reach = frame.reach
        parser = LinkParser(self.wanted, lambda data: self._admit(address, reach, data))
        return Inbox(address, parser, frame.sender or f"client {frame.client}", reach)

    def _admit(self, address: Address, reach: Reach, frame: bytes) -> bool:
        if not self.admits(frame, reach):
            return False
        self.on_frame(address, frame)
        return True

    def _let_go(self, closed: Inbox) -> None:
        self._dropped_closed += closed.parser.dropped
        self._received_closed += closed.parser.received
        if closed.waiting:
            self._turns.remove(closed)
