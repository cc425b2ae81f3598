"""Mission protocol for the three plan types: upload, download, clear. https://mavlink.io/en/services/mission.html

An upload is atomic: items are buffered, and the plan in force changes only when the last one has arrived and the
whole plan has been accepted. The store checks it in the background; MISSION_ACK is sent when the check is done and
the plan is on disk (if plans are stored), and no other transfer starts until then. Clients time out 1.5 s after
their last item, so that during a longer check the last item is requested again as a keep-alive. One upload at a
time; a second client is DENIED. Downloads read a snapshot, so that a plan that changes meanwhile cannot mix.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from autopilot.core import operator_messages as notices
from autopilot.core.plan import MAX_ITEMS, MissionResult, PlanChange, PlanItem, PlanKind, has_shapes
from autopilot.core.plan_wire import item_message, item_of
from autopilot.mavlink import home_item
from autopilot.mavlink.bounded_table import LatestUsed
from autopilot.mavlink.context import Context, MavlinkPeer
from autopilot.mavlink.dialect import extra, mav
from autopilot.mavlink.wire import Message

RETRY_US = 300_000
"""Timeout after which an item is requested again (clients wait 250 ms to 1.5 s)."""
WORKING_US = 500_000
"""Interval at which the last item is requested while a plan is being checked."""
GIVE_UP_US = 8_000_000
"""An upload without progress ends (ArduPilot's time)."""
MAX_WRONG_ITEMS = 20
"""Consecutive items out of sequence that end an upload: the client ignores requests."""
DOWNLOAD_US = 10_000_000
"""Time for which a download's snapshot is kept after the client's last request."""
REPEAT_US = 5_000_000
"""Time for which MISSION_ACK is repeated when the client sends its last item again."""
REPEAT_PAUSE_US = 200_000
"""Within this the guilty item is the answer to the request that came with MISSION_ACK."""
SLOW_DISK_US = 1_000_000
"""Maximum wait of a plan in force for the disk before it is acknowledged (a client's last retry comes after 1.5 s)."""
FENCE_AFTER_US = 2_000_000
"""Ground stations send the fence after its mission: one that has not begun this long after the last transfer is
missing."""
MAX_DOWNLOADS = 16
"""Snapshots kept at once; beyond that the oldest is dropped."""

_KINDS = {int(kind): kind for kind in PlanKind}
_LABELS = {PlanKind.MISSION: "item", PlanKind.FENCE: "fence item", PlanKind.RALLY: "rally point"}
CLEAR_ORDER = (PlanKind.MISSION, PlanKind.FENCE, PlanKind.RALLY)


@dataclass(slots=True)
class Upload:
    peer: MavlinkPeer
    kind: PlanKind
    count: int
    requested_us: int
    progress_us: int
    requested: int | None = None
    """The item that was asked for last."""
    wrong: int = 0
    items: list[PlanItem] = field(default_factory=list)
    """As the wire numbers them."""


@dataclass(slots=True)
class Checking:
    """A plan check that is pending."""

    peer: MavlinkPeer
    change: PlanChange
    kinds: tuple[PlanKind, ...]
    mission_type: int
    upload: Upload | None
    """None = these plans are cleared."""
    taken_us: int | None = None
    """Time since which the plans are in force and being written to the disk."""


@dataclass(slots=True)
class Finished:
    peer: MavlinkPeer
    kind: PlanKind
    count: int
    result: MissionResult
    plan_id: int
    at_us: int
    asked_us: int
    """For the guilty item."""
    guilty: int | None = None
    """The item of a refusal."""


@dataclass(slots=True)
class Download:
    items: tuple[PlanItem, ...]
    used_us: int


class Missions:
    def __init__(self, ctx: Context, keeps_out: Callable[[MavlinkPeer], bool] = lambda peer: False) -> None:
        """``keeps_out``: whether another client is in control."""
        self._ctx, self._keeps_out = ctx, keeps_out
        self._upload: Upload | None = None
        self._checking: Checking | None = None
        self._finished: Finished | None = None
        self._downloads: LatestUsed[tuple[MavlinkPeer, PlanKind], Download] = LatestUsed(MAX_DOWNLOADS)
        self.current_wire_seq = 0
        """Item that downloads mark as current."""
        self.revision = 0
        """Grows with every plan that is taken."""
        self._fence_due_us: int | None = None
        """Time of the check for a mission without a fence; None = done."""

    @property
    def uploading(self) -> bool:
        """Whether a transfer is open, or its plan being checked."""
        return self._upload is not None or self._checking is not None

    def concludes(self, peer: MavlinkPeer, msg: Message) -> bool:
        """Whether a message would end its client's upload, so that the plan in force could change."""
        kind, upload = msg.get_msgId(), self._upload
        if kind == mav.MAVLINK_MSG_ID_MISSION_COUNT:
            return bool(msg.count == 0)
        return (
            kind == mav.MAVLINK_MSG_ID_MISSION_ITEM_INT
            and upload is not None
            and upload.peer == peer
            and len(upload.items) == upload.count - 1
        )

    # Upload

    def on_count(self, peer: MavlinkPeer, msg: Message) -> None:
        """MISSION_COUNT: begin, restart, clear (0), or refuse."""
        ctx, kind = self._ctx, _KINDS.get(msg.mission_type)
        if kind is None:
            self._ack(peer, MissionResult.UNSUPPORTED, msg.mission_type)
            return
        if self._denied(peer, kind):
            return
        self._supersede(kind)
        self._finished = None
        most = MAX_ITEMS[kind]
        if msg.count > most + (kind is PlanKind.MISSION):
            self._ack(peer, MissionResult.NO_SPACE, kind)
            reason = f"{msg.count} items, at most {most} fit; send a shorter plan"
            ctx.say(notices.PLAN_REFUSED(kind=kind.name.capitalize(), reason=reason), peer)
            return
        self._upload = Upload(peer, kind, msg.count, ctx.t_us, ctx.t_us)
        if msg.count == 0:
            self._finish(self._upload)
        else:
            self._request_item(self._upload)

    def on_item(self, peer: MavlinkPeer, msg: Message) -> None:
        upload = self._upload
        if upload is None or upload.peer != peer:
            self._unasked_item(peer, msg)
            return
        if msg.mission_type != upload.kind or msg.seq != len(upload.items):
            self._item_out_of_turn(upload, msg)
            return
        ctx, now_us = self._ctx, self._ctx.t_us
        item = item_of(msg)
        if not home_item.may_be(ctx, upload.kind, item):
            refusal = ctx.plans.check_item(upload.kind, item)
            if refusal is not None:
                self._end(upload, refusal.result, refusal.reason, refusal.seq)
                return
        upload.items.append(item)
        upload.progress_us, upload.wrong = now_us, 0
        if len(upload.items) == upload.count:
            self._finish(upload)
        else:
            self._request_item(upload)

    def on_float_item(self, peer: MavlinkPeer, msg: Message) -> None:
        """MISSION_ITEM: its 32 bit degrees are a metre wide, too coarse for a vehicle among obstacles."""
        upload = self._upload
        reason = "MISSION_ITEM has coordinates rounded to about 1 m: send MISSION_ITEM_INT"
        if upload is not None and upload.peer == peer:
            self._end(upload, MissionResult.UNSUPPORTED, reason)
        else:
            self._ack(peer, MissionResult.UNSUPPORTED, msg.mission_type)
            self._ctx.say(notices.REFUSED(reason=reason), peer)

    def _item_out_of_turn(self, upload: Upload, msg: Message) -> None:
        """A repeated item is ignored, as is one of a transfer that this one has superseded; after a skipped one the
        missing item is requested again."""
        if msg.mission_type != upload.kind or msg.seq < len(upload.items):
            return
        upload.wrong += 1
        if upload.wrong > MAX_WRONG_ITEMS:
            self._end(
                upload,
                MissionResult.INVALID_SEQUENCE,
                f"{_LABELS[upload.kind]} {msg.seq} sent again and again, {len(upload.items)} was asked for",
            )
        elif upload.wrong == 1:
            self._request_item(upload)

    def _unasked_item(self, peer: MavlinkPeer, msg: Message) -> None:
        """An item outside an upload: a late one (repeat the answer, if there is one yet), or unrequested."""
        if self._checking is not None and self._checking.peer == peer:
            return
        done, now_us = self._finished, self._ctx.t_us
        late_us = REPEAT_US * self._ctx.patience
        if done is None or done.peer != peer or done.kind != msg.mission_type or now_us - done.at_us > late_us:
            self._ack(peer, MissionResult.ERROR, msg.mission_type)
            return
        if msg.seq == done.guilty and now_us - done.asked_us < REPEAT_PAUSE_US:
            return
        if msg.seq in (done.count - 1, done.guilty):
            done.asked_us = now_us
            if done.guilty is not None and done.guilty != msg.seq:
                self._request(peer, done.guilty, done.kind)
            self._ack(peer, done.result, done.kind, done.plan_id)

    def _request_item(self, upload: Upload, seq: int | None = None) -> None:
        """For the next item, or for ``seq``."""
        upload.requested_us, upload.requested = self._ctx.t_us, len(upload.items) if seq is None else seq
        self._request(upload.peer, upload.requested, upload.kind)

    def _request(self, peer: MavlinkPeer, seq: int, kind: PlanKind) -> None:
        self._ctx.send(peer, mav.MAVLink_mission_request_int_message(peer.sysid, peer.compid, seq, kind))

    def _finish(self, upload: Upload) -> None:
        """All items are there: hand the plan over."""
        items = home_item.received(self._ctx, upload.kind, upload.items)
        self._upload = None
        upload.requested_us = self._ctx.t_us
        self._check(upload.peer, {upload.kind: items}, upload.kind, upload)

    def _check(
        self, peer: MavlinkPeer, plans: dict[PlanKind, tuple[PlanItem, ...]], mission_type: int, upload: Upload | None
    ) -> None:
        """Submit plans to the store and forward its result."""
        change = self._ctx.plans.propose(plans)
        self._checking = Checking(peer, change, tuple(plans), mission_type, upload)
        self.answer()

    def _supersede(self, mission_type: int) -> None:
        """The client starts another transfer, of this type: an open one of another type gets its answer, one of the
        same type none, because it would be taken for that of the new one.
        """
        upload, self._upload = self._upload, None
        if upload is not None and upload.kind != mission_type:
            self._ack(upload.peer, MissionResult.OPERATION_CANCELLED, upload.kind)
        checking = self._checking
        taken = self._give_up_check()
        if checking is not None and checking.mission_type != mission_type:
            result = MissionResult.ACCEPTED if taken else MissionResult.OPERATION_CANCELLED
            self._ack(checking.peer, result, checking.mission_type)

    def _give_up_check(self) -> bool:
        """Cancel a pending check; whether its plan is in force by now (not on disk yet), which is reported by text."""
        checking, self._checking = self._checking, None
        if checking is None:
            return False
        checking.change.cancel()
        taken = checking.change.rejection is None
        if taken:
            self.revision += len(checking.kinds)
            for kind in checking.kinds:
                self._say_taken(kind)
        return taken

    def _say_taken(self, kind: PlanKind) -> None:
        items = self._ctx.plans.items(kind)
        home = ", 0 is home" if items and items[0].is_home else ""
        self._ctx.say(notices.PLAN_ACCEPTED(kind=kind.name.capitalize(), count=len(items), home=home))

    def answer(self) -> None:
        """Forward the store's result, if there is one, before other messages are handled: a plan in force is not
        revoked.
        """
        checking = self._checking
        if checking is None or not checking.change.done:
            return
        if checking.change.rejection is None and not self._on_disk(checking):
            return
        self._checking = None
        ctx, refusal, upload = self._ctx, checking.change.rejection, checking.upload
        if refusal is None:
            self.revision += len(checking.kinds)
            self._fence_due_us = self._fence_after()
        if upload is not None and refusal is not None:
            self._end(upload, refusal.result, refusal.reason, refusal.seq)
        elif upload is not None:
            self._end(upload, MissionResult.ACCEPTED, "")
            self._say_taken(upload.kind)
        else:
            names = ", ".join(kind.name.lower() for kind in checking.kinds)
            self._ack(
                checking.peer, MissionResult.ACCEPTED if refusal is None else refusal.result, checking.mission_type
            )
            if refusal is None:
                ctx.log(notices.PLAN_CLEARED(names=names))
            else:
                ctx.say(notices.PLAN_NOT_CLEARED(names=names, reason=refusal.reason), checking.peer)

    def _on_disk(self, checking: Checking) -> bool:
        """Whether acceptance can be acknowledged: an accepted plan must survive a power cut. A disk that does not
        answer is reported, for the plans are in force.
        """
        ctx = self._ctx
        if ctx.plans.kept:
            return True
        if checking.taken_us is None:
            checking.taken_us = ctx.t_us
        if ctx.t_us - checking.taken_us < SLOW_DISK_US * ctx.patience:
            return False
        ctx.say(notices.PLAN_NOT_ON_DISK())
        return True

    def _end(self, upload: Upload, result: MissionResult, reason: str, guilty: int | None = None) -> None:
        """Close the transfer with its answer; a refusal leaves the plan in force and names item ``guilty``."""
        now_us = self._ctx.t_us
        self._upload = None
        plan_id = self._ctx.plans.checksum(upload.kind) if result is MissionResult.ACCEPTED else 0
        self._finished = Finished(upload.peer, upload.kind, upload.count, result, plan_id, now_us, now_us, guilty)
        self._ctx.begin_anew()
        if guilty is not None and guilty != upload.requested and 0 <= guilty < upload.count:
            self._request_item(upload, guilty)
        self._ack(upload.peer, result, upload.kind, plan_id)
        if reason:
            text = notices.PLAN_REFUSED(kind=upload.kind.name.capitalize(), reason=reason)
            self._ctx.say(text, upload.peer, on_wire=True)

    def _denied(self, peer: MavlinkPeer, kind: PlanKind) -> bool:
        """Whether another client's open upload blocks this one; answers it with DENIED."""
        open_ = self._upload or self._checking
        if open_ is None or open_.peer == peer:
            return False
        self._ack(peer, MissionResult.DENIED, kind)
        client = f"{open_.peer.sysid}/{open_.peer.compid}"
        self._ctx.say(notices.PLAN_DENIED(kind=kind.name.capitalize(), client=client), peer)
        return True

    def _ack(self, peer: MavlinkPeer, result: MissionResult, mission_type: int, plan_id: int = 0) -> None:
        """``plan_id``: opaque id of the plan in force, after an accepted upload."""
        ack = extra.MAVLink_mission_ack_message(peer.sysid, peer.compid, int(result), int(mission_type), plan_id)
        self._ctx.send(peer, ack)

    # Clear

    def on_clear_all(self, peer: MavlinkPeer, msg: Message) -> None:
        """MISSION_CLEAR_ALL of one type or of all."""
        if msg.mission_type == mav.MAV_MISSION_TYPE_ALL:
            kinds: tuple[PlanKind, ...] = CLEAR_ORDER
        elif msg.mission_type in _KINDS:
            kinds = (_KINDS[msg.mission_type],)
        else:
            self._ack(peer, MissionResult.UNSUPPORTED, msg.mission_type)
            return
        if self._denied(peer, kinds[0]):
            return
        checking = self._checking
        if checking is not None and checking.upload is None and checking.mission_type == msg.mission_type:
            return  # retransmitted while the check is pending
        self._supersede(msg.mission_type)
        self._check(peer, dict.fromkeys(kinds, ()), msg.mission_type, None)

    # Download

    def on_request_list(self, peer: MavlinkPeer, msg: Message) -> None:
        """MISSION_REQUEST_LIST: send the count and take a snapshot for the download."""
        kind = _KINDS.get(msg.mission_type)
        if kind is None:
            self._ack(peer, MissionResult.UNSUPPORTED, msg.mission_type)
            return
        items = home_item.wire_plan(self._ctx, kind)
        self._downloads[peer, kind] = Download(items, self._ctx.t_us)
        plan_id = self._ctx.plans.checksum(kind)
        self._ctx.send(
            peer, extra.MAVLink_mission_count_message(peer.sysid, peer.compid, len(items), int(kind), plan_id)
        )

    def on_request(self, peer: MavlinkPeer, msg: Message) -> None:
        """MISSION_REQUEST_INT, and MISSION_REQUEST answered with MISSION_ITEM_INT too."""
        kind = _KINDS.get(msg.mission_type)
        if kind is None:
            self._ack(peer, MissionResult.UNSUPPORTED, msg.mission_type)
            return
        download = self._downloads.get((peer, kind))
        if download is None:
            items = home_item.wire_plan(self._ctx, kind)
        else:
            items, download.used_us = download.items, self._ctx.t_us
        if not msg.seq < len(items):
            self._ack(peer, MissionResult.INVALID_SEQUENCE, kind)
            return
        item = items[msg.seq]
        current = kind is PlanKind.MISSION and item.seq == self.current_wire_seq
        self._ctx.send(peer, item_message(item, kind, system=peer.sysid, component=peer.compid, current=current))

    def on_ack(self, peer: MavlinkPeer, msg: Message) -> None:
        """MISSION_ACK: the client has read everything, or gives a transfer up."""
        kind = _KINDS.get(msg.mission_type)
        if kind is None:
            return
        checking = self._checking
        if checking is not None and checking.peer == peer and checking.upload is not None:
            if checking.upload.kind is kind and msg.type != MissionResult.ACCEPTED:
                self._give_up_check()
                self._ctx.log(notices.UPLOAD_CANCELLED(kind=kind.name.lower()))
            return
        upload = self._upload
        if upload is not None and upload.peer == peer and upload.kind is kind:
            if msg.type != MissionResult.ACCEPTED:
                self._upload = None
                self._ctx.log(notices.UPLOAD_CANCELLED(kind=kind.name.lower()))
            return
        self._downloads.pop((peer, kind), None)

    def on_partial_list(self, peer: MavlinkPeer, msg: Message) -> None:
        """MISSION_WRITE_PARTIAL_LIST and MISSION_REQUEST_PARTIAL_LIST were never standardised."""
        self._ack(peer, MissionResult.UNSUPPORTED, msg.mission_type)

    def _fence_after(self) -> int:
        return self._ctx.t_us + round(FENCE_AFTER_US * self._ctx.patience)

    def _miss_fence(self) -> None:
        """Warn of a mission without a fence, after the time in which its fence would have followed."""
        due_us, ctx = self._fence_due_us, self._ctx
        if due_us is None:
            return
        if self.uploading:
            self._fence_due_us = self._fence_after()
        elif ctx.t_us >= due_us:
            self._fence_due_us = None
            if ctx.plans.items(PlanKind.MISSION) and not has_shapes(ctx.plans.items(PlanKind.FENCE)):
                ctx.say(notices.MISSION_UNFENCED(size=ctx.plans.size_text()))

    # Time

    def tick(self) -> None:
        self.answer()
        self._miss_fence()
        ctx, upload, now_us = self._ctx, self._upload, self._ctx.t_us
        if upload is not None:
            if self._keeps_out(upload.peer):
                self._end(upload, MissionResult.DENIED, "another client has taken control; the plan in force stays")
            elif now_us - upload.progress_us > GIVE_UP_US * ctx.patience:
                label = _LABELS[upload.kind]
                reason = f"{label} {len(upload.items)} of {upload.count} did not come; the plan in force stays"
                self._end(upload, MissionResult.OPERATION_CANCELLED, reason)
            elif now_us - upload.requested_us >= RETRY_US * ctx.patience:
                self._request_item(upload)
        checking = self._checking
        if checking is not None and checking.upload is not None:
            pending = checking.upload
            if now_us - pending.requested_us >= WORKING_US * ctx.patience:
                self._request_item(pending, pending.count - 1)
        if self._downloads:
            key = next(iter(self._downloads))
            if now_us - self._downloads[key].used_us > DOWNLOAD_US * ctx.patience:
                del self._downloads[key]
