"""What stands before the MAVLink server of a fuzzed service and sees what a message has changed that must not."""

from collections import Counter
from collections.abc import Callable, Sequence
from hashlib import sha256
from typing import Any

from autopilot.core.messages import Event, MavlinkFrame
from autopilot.core.plan import PlanKind
from autopilot.mavlink.api import CommandResult, VehicleView
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.server import MavlinkServer
from autopilot.mavlink.signing import UNSIGNABLE
from autopilot.run.sitl_session import SitlSession

WAITING_US = 2_000_000
"""What was let in before a key came into force may wait so long for its turn."""


class BrokenRuleError(AssertionError):
    """A rule that holds whatever comes in did not."""


class MessageObserver:
    """Stands before the MAVLink server and sees what a message has changed that must not."""

    def __init__(self, session: SitlSession) -> None:
        self._server: MavlinkServer = session.parts.server
        self._session = session
        self._inside: Any = self._server
        self._stamps: set[tuple[tuple[int, int, int], int]] = set()
        self._key: bytes | None = None
        self._key_us = 0
        self._plans = self._plans_now()
        self.handled: Counter[str] = Counter()
        self._reader = mav.MAVLink(None)
        self._answers = mav.MAVLink(None)
        self._reader.robust_parsing = self._answers.robust_parsing = True
        self.accepted: Counter[str] = Counter()
        self.inbox: list[Any] = []
        """Of this tick and since the one before."""
        self._served: list[Any] = []
        inside = self._inside
        inside._handlers = {number: self._watched(handler) for number, handler in inside._handlers.items()}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._server, name)

    def step(
        self,
        t_us: int,
        rx: Sequence[MavlinkFrame],
        view: VehicleView,
        events: Sequence[Event] = (),
        reached: Sequence[int] = (),
    ) -> tuple[MavlinkFrame, ...]:
        """As the server's; what it sends is read."""
        sent = self._server.step(t_us, rx, view, events, reached)
        self.inbox, self._served = self._served + self._read(sent), []
        for message in self.inbox:
            self._count(message)
        self._check_plans()
        return sent

    def serve(self, t_us: int, rx: Sequence[MavlinkFrame]) -> tuple[MavlinkFrame, ...]:
        sent = self._server.serve(t_us, rx)
        self._served += self._read(sent)
        return sent

    def _read(self, sent: Sequence[MavlinkFrame]) -> list[Any]:
        """What the vehicle says; what is passed on of others is no word of its."""
        messages = [message for frame in sent for message in self._reader.parse_buffer(frame.data) or ()]
        return [m for m in messages if (m.get_srcSystem(), m.get_srcComponent()) == (1, 1)]

    def _plans_now(self) -> dict[PlanKind, object]:
        return {kind: self._session.parts.plans.items(kind) for kind in PlanKind}

    def allow(self) -> None:
        """The plans are as they are for a reason that no client gave."""
        self._plans = self._plans_now()

    def _check_plans(self) -> None:
        """A plan is another one only if its transfer or its removal has been accepted on this tick."""
        now, before = self._plans_now(), self._plans
        self._plans = now
        messages = [m for m in self.inbox if m.get_type() in ("MISSION_ACK", "STATUSTEXT")]
        taken = {m.mission_type for m in messages if m.get_type() == "MISSION_ACK" and m.type == 0}
        text = "".join(m.text for m in messages if m.get_type() == "STATUSTEXT")
        for kind in PlanKind:
            reported = f"{kind.name.capitalize()} plan accepted" in text
            if now[kind] != before[kind] and not reported and not taken & {int(kind), mav.MAV_MISSION_TYPE_ALL}:
                raise BrokenRuleError(f"the {kind.name.lower()} has changed, and no transfer was accepted")

    def _check_sender(self, message: Any) -> None:
        """A frame is heard only with the signature that is in force, and once."""
        frame, key, t_us = bytes(message.get_msgbuf()), self._inside._ctx.signing.key, self._inside._ctx.t_us
        if key != self._key:
            self._key, self._key_us = key, t_us
        signed = frame[0] == 0xFD and bool(frame[2] & 1)
        self.handled["MAVLink 1" if frame[0] == 0xFE else "signed" if signed else "MAVLink 2"] += 1
        if not signed:
            if key is not None and t_us > self._key_us + WAITING_US and message.get_msgId() not in UNSIGNABLE:
                raise BrokenRuleError(f"{message} is not signed, and was heard")
            return
        if t_us > self._key_us + WAITING_US and (key is None or sha256(key + frame[:-6]).digest()[:6] != frame[-6:]):
            raise BrokenRuleError(f"{message} is signed with another key, and was heard")
        stream, stamp = (frame[-13], frame[5], frame[6]), int.from_bytes(frame[-12:-6], "little")
        if (stream, stamp) in self._stamps:
            raise BrokenRuleError(f"{message} was heard a second time")
        self._stamps.add((stream, stamp))

    def _watched(self, handler: Callable[[Any, Any], None]) -> Callable[[Any, Any], None]:
        """A message's handler between two looks at the state: by its answers it is judged."""
        ctx = self._server._ctx

        operators = self._inside._operators

        def handle(peer: Any, message: Any) -> None:
            self._check_sender(message)
            before, sent, kept_out = self._state(), len(ctx.tx), operators.keeps_out(peer)
            handler(peer, message)
            answers = [a for frame in ctx.tx[sent:] for a in self._answers.parse_buffer(frame.data) or ()]
            after = self._state() if answers or kept_out else before
            if kept_out and after != before:
                changed = [name for name in before if before[name] != after[name]]
                raise BrokenRuleError(f"{message} of system {peer.sysid}, not in control, has changed {changed}")
            for answer in answers:
                self._judge(message, answer, before, after)

        return handle

    def _state(self) -> dict[str, object]:
        parts = self._session.parts
        plans, commander = parts.plans, parts.commander
        return {
            "params": tuple(parts.params.values()),
            "mission": plans.items(PlanKind.MISSION),
            "fence": plans.items(PlanKind.FENCE),
            "rally": plans.items(PlanKind.RALLY),
            "home": plans.home_ned_m.tolist(),
            "origin": plans.origin,
            "armed": commander.armed,
            "mode": commander.intended_mode,
            "key": self._inside._ctx.signing.key,
            "sticks": self._inside.pilot.sticks,
            "owner": self._inside._operators.in_control,
        }

    def _count(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "COMMAND_ACK":
            self.accepted[f"command {'accepted' if message.result == 0 else 'refused'}"] += 1
        elif kind == "MISSION_ACK":
            self.accepted[f"plan {'accepted' if message.type == 0 else 'refused'}"] += 1
        elif kind in ("PARAM_ERROR", "PARAM_VALUE"):
            self.accepted[f"parameter {'refused' if kind == 'PARAM_ERROR' else 'told'}"] += 1

    def _judge(self, message: Any, answer: Any, before: dict[str, object], after: dict[str, object]) -> None:
        kind = answer.get_type()
        # CANCELLED is no refusal: the mode has changed because a client asked for that (COMMAND_CANCEL).
        refused = (kind == "COMMAND_ACK" and answer.result not in (0, 5, CommandResult.CANCELLED)) or (
            kind == "MISSION_ACK" and answer.type
        )
        if refused or kind == "PARAM_ERROR":
            changed = [name for name in before if before[name] != after[name]]
            if changed:
                raise BrokenRuleError(f"{message} is refused by {answer}, and yet it has changed {changed}")
