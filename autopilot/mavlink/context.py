"""State that the microservices share: outgoing queue, known peers, and the inputs of this tick."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

from autopilot.core.clients import EVERYONE
from autopilot.core.guard import Guard
from autopilot.core.item_numbers import counted
from autopilot.core.messages import Event, MavlinkFrame, Severity
from autopilot.core.operator_messages import OperatorText
from autopilot.core.params import ParamSaving, ParamSet
from autopilot.core.plan import PlanKind, PlanStore
from autopilot.core.samples import ExternalPoseSample
from autopilot.mavlink.api import VehicleCommands, VehicleView
from autopilot.mavlink.bounded_table import RecentKeys
from autopilot.mavlink.budget import Budget
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.profiles import Profile
from autopilot.mavlink.signing import Signing
from autopilot.mavlink.wire import LinkEncoder, Message

ANSWERS = frozenset((mav.MAVLINK_MSG_ID_PARAM_VALUE,))
"""Broadcast, and requested by clients that wait for it."""

NAME = "Underwater Autopilot"
"""The true name, whatever the profile."""

COMMANDS = frozenset((mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_COMMAND_INT))
COMPID: int = mav.MAV_COMP_ID_AUTOPILOT1
MISSION_COMPID: int = mav.MAV_COMP_ID_MISSIONPLANNER
"""Older clients address plans to it."""

MAX_TEXT_CHARS = 600
"""Longest text that is sent (12 chunks)."""
_CHUNK_CHARS = 50
"""STATUSTEXT.text."""
COPY_US = 250_000
"""The same datagram again within this time is a copy made by the network; later it is a client's repetition."""
SAME_TEXT_US = 5_000_000
"""The same text does not go out twice on a link within this time."""


class MavlinkPeer(NamedTuple):
    """A client: link, MAVLink address on it, and index among the senders on that link."""

    link: int
    sysid: int
    compid: int
    client: int = 0

    @property
    def name(self) -> str:
        """For operators: system and component id."""
        return f"{self.sysid}/{self.compid}"


Receiver: TypeAlias = int | MavlinkPeer
"""Destination: everyone on a link, or one client."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleIdentity:
    """Identity for AUTOPILOT_VERSION and the greeting."""

    name: str
    version: str
    """Dotted, as in the distribution."""
    git: str
    """Revision as hex digits, empty when unknown."""
    uid: int
    """64-bit unique id of this vehicle."""


@dataclass(slots=True)
class Context:
    """State of this tick and the outgoing queue. One per server."""

    sysid: int
    profile: Profile
    identity: VehicleIdentity
    params: ParamSet
    plans: PlanStore
    vehicle: VehicleCommands
    view: VehicleView
    patience: float
    """Factor on the time that protocol partners get (they live in real time, a fast simulation does not)."""
    guard: Guard
    saving: ParamSaving | None = None
    """Where parameters are kept, None = nowhere."""
    signing: Signing = field(default_factory=Signing)
    t_us: int = 0
    links: dict[int, LinkEncoder] = field(default_factory=dict)
    """Every open link's encoder: sequence numbers count per link."""
    others: dict[tuple[int, int], LinkEncoder] = field(default_factory=dict)
    """Of our other components, by link and component."""
    budgets: dict[int, Budget] = field(default_factory=dict)
    """Of slow links."""
    old: dict[int, frozenset[int]] = field(default_factory=dict)
    """Clients that use MAVLink 1, by link."""
    quiet: set[int] = field(default_factory=set)
    """Links on which only requests are answered (:mod:`autopilot.mavlink.high_latency`)."""
    tx: list[MavlinkFrame] = field(default_factory=list)
    notices: list[Event] = field(default_factory=list)
    samples: list[ExternalPoseSample] = field(default_factory=list)
    """Poses that clients sent, for the estimator."""
    received: int = 0
    """Good frames so far, all links."""
    announce_place: bool = False
    """Send origin and home on all links once the vehicle's view is fresh."""
    _recent_texts: RecentKeys[tuple[int, int, str]] = field(default_factory=lambda: RecentKeys(SAME_TEXT_US))
    """Texts of the last seconds by link and client."""
    _datagrams: RecentKeys[tuple[MavlinkPeer, int, int]] = field(init=False)
    """Those of the last moment that act once, by sender, sequence number and checksum."""
    _text_id: int = 0

    def __post_init__(self) -> None:
        self._datagrams = RecentKeys(COPY_US * self.patience)

    def is_copy(self, peer: MavlinkPeer, msg: Message) -> bool:
        """Whether the network has delivered this datagram before; notes it otherwise."""
        mark = (peer, msg.get_seq(), msg.get_crc())
        seen = self._datagrams.knows(mark, self.t_us)
        if not seen:
            self._datagrams.add(mark, self.t_us)
        return seen

    @property
    def boot_ms(self) -> int:
        return (self.t_us // 1000) & 0xFFFF_FFFF

    def add_link(self, index: int) -> None:
        if index not in self.links:
            self.links[index] = encoder = LinkEncoder(self.sysid, COMPID)
            self._sign_on(index, encoder)

    def _sign_on(self, index: int, encoder: LinkEncoder) -> None:
        signing = self.signing

        def sign(frame: bytes, crc_extra: int, counted: bool) -> bytes:
            return signing.sign(frame, crc_extra, index, counted=counted)

        encoder.sign = None if signing.key is None else sign

    def remove_link(self, index: int) -> None:
        self.links.pop(index, None)
        self.old.pop(index, None)
        for key in [key for key in self.others if key[0] == index]:
            del self.others[key]

    def _encoder(self, link: int, source: int) -> LinkEncoder:
        """Of an open link and one of our components."""
        if source == COMPID:
            return self.links[link]
        encoder = self.others.get((link, source))
        if encoder is None:
            encoder = self.others[link, source] = LinkEncoder(self.sysid, source)
            self._sign_on(link, encoder)
        return encoder

    def key_changed(self) -> None:
        """A signing key has been set or removed."""
        for index, encoder in self.links.items():
            self._sign_on(index, encoder)
        for (index, _), encoder in self.others.items():
            self._sign_on(index, encoder)

    def send(self, to: Receiver, message: Message, source: int = COMPID) -> None:
        """Queue a message to one client, or to all on one link. ``source``: our sending component."""
        link, client = (to, EVERYONE) if isinstance(to, int) else (to.link, to.client)
        if link in self.links:
            frames = list(self.frames(link, client, message, source=source))
            budget = self.budgets.get(link)
            if budget is not None:
                budget.spend(sum(len(frame.data) for frame in frames))
            self.tx += frames

    def has_capacity(self, link: int, fraction: float) -> bool:
        """Whether a link can carry a message that is less urgent than an answer (:mod:`autopilot.mavlink.budget`)."""
        budget = self.budgets.get(link)
        return budget is None or budget.has_capacity(fraction)

    def frames(
        self, link: int, client: int, message: Message, *, counted: bool = True, source: int = COMPID
    ) -> Iterator[MavlinkFrame]:
        """Encode a message for the clients of an open link, in MAVLink 1 where they use that."""
        encoder, old = self._encoder(link, source), self.old.get(link)
        if not old:
            yield MavlinkFrame(link=link, client=client, data=encoder.pack(message, counted=counted))
            return
        if client not in old and not (client == EVERYONE and EVERYONE in old):
            beside = old if client == EVERYONE else frozenset[int]()
            data = encoder.pack(message, counted=counted)
            yield MavlinkFrame(link=link, client=client, data=data, beside=beside)
        for other in sorted(old) if client == EVERYONE else (client,) if client in old else ():
            packed = encoder.pack_old(message, counted=counted)
            if packed is not None:
                yield MavlinkFrame(link=link, client=other, data=packed)

    def broadcast(self, message: Message, source: int = COMPID) -> None:
        """Queue a message on every link; on high latency links only if it may answer a request."""
        spoken = message.get_msgId() in ANSWERS
        for index in self.links:
            if spoken or index not in self.quiet:
                self.send(index, message, source)

    @property
    def wire_shift(self) -> int:
        """How many items the wire has before the first one of the mission in the store: ArduPilot's home."""
        items = self.plans.items(PlanKind.MISSION)
        return int(self.profile.home_is_item_0 and not (items and items[0].is_home))

    def say(self, text: OperatorText, to: Receiver | None = None, *, on_wire: bool = False) -> None:
        """Send a text to the operator (STATUSTEXT to a client, a link or all, and an entry in the log). ``on_wire``:
        it counts mission items as an upload does, not as the plan in force."""
        self.log(text)
        self.relay(text.severity, text.text, to, on_wire=on_wire)

    def log(self, text: OperatorText) -> None:
        self.notices.append(text.event(self.t_us))

    def text(self, message: OperatorText, to: Receiver | None = None) -> None:
        """STATUSTEXT, chunked if it is long. DEBUG goes to the log only; a repetition within 5 s is dropped."""
        self.relay(message.severity, message.text, to)

    def relay(self, severity: int, text: str, to: Receiver | None = None, *, on_wire: bool = False) -> None:
        """The same for an event of another part."""
        if severity >= Severity.DEBUG:
            return
        text = self.numbered(text, on_wire=on_wire)
        urgent = severity <= Severity.CRITICAL
        everywhere = [link for link in self.links if urgent or link not in self.quiet]
        receivers: Iterable[Receiver] = everywhere if to is None else (to,)
        news = [receiver for receiver in receivers if self._is_news(receiver, text)]
        for message in self._chunks(max(severity, 0), text) if news else ():
            for receiver in news:
                self.send(receiver, message)

    def numbered(self, text: str, *, on_wire: bool = False) -> str:
        """A text with the item numbers of ground stations: where home is item 0, those of the wire."""
        shift, ahead = 0 if on_wire else self.wire_shift, 0 if self.profile.home_is_item_0 else 1
        return counted(text, shift=shift, ahead=ahead)

    def _is_news(self, to: Receiver, text: str) -> bool:
        """Whether a receiver has not received this text lately, alone or with its whole link; marks it as sent."""
        link, client = (to, EVERYONE) if isinstance(to, int) else (to.link, to.client)
        if any(self._recent_texts.knows((link, who, text), self.t_us) for who in (client, EVERYONE)):
            return False
        self._recent_texts.add((link, client, text), self.t_us)
        return True

    def begin_anew(self) -> None:
        """Reset the duplicate filter after a new plan or request: repeated texts are sent again."""
        self._recent_texts.clear()

    def _chunks(self, severity: int, text: str) -> Iterable[Message]:
        data = text.replace("\0", " ")[:MAX_TEXT_CHARS].encode("ascii", errors="replace")
        if len(data) <= _CHUNK_CHARS:
            return [mav.MAVLink_statustext_message(severity, data)]
        self._text_id = self._text_id % 0xFFFF + 1
        # The end is marked by a chunk that is not full, so a text of whole chunks is followed by an empty one.
        return [
            mav.MAVLink_statustext_message(severity, data[start : start + _CHUNK_CHARS], self._text_id, number)
            for number, start in enumerate(range(0, len(data) + 1, _CHUNK_CHARS))
        ]


def limited(value: float, low: int, high: int) -> int:
    """``value`` rounded and clipped to an integer field's range; NaN becomes the value nearest 0."""
    if value != value:
        value = 0.0
    return round(min(max(value, low), high))


FLOAT32_MAX = 3.4028234e38
"""Nothing larger fits a float field."""


def f32(value: float) -> float:
    """For a float field: beyond its range the largest that fits; infinite and not-a-number are numbers there."""
    return value if not FLOAT32_MAX < abs(value) < math.inf else math.copysign(FLOAT32_MAX, value)


def u16(value: float) -> int:
    return limited(value, 0, 0xFFFF)


def i16(value: float) -> int:
    return limited(value, -0x8000, 0x7FFF)


def i32(value: float) -> int:
    return limited(value, -0x8000_0000, 0x7FFF_FFFF)
