"""Mission progress: MISSION_CURRENT, MISSION_ITEM_REACHED, and the choice of the current item."""

from collections.abc import Sequence

from autopilot.core import operator_messages as notices
from autopilot.core.messages import ProgressState
from autopilot.core.plan import PlanKind
from autopilot.mavlink import home_item
from autopilot.mavlink.api import CommandReply, CommandResult, FlightMode
from autopilot.mavlink.context import Context, MavlinkPeer
from autopilot.mavlink.dialect import extra, mav
from autopilot.mavlink.missions import Missions
from autopilot.mavlink.wire import Message

NO_MISSION_TOTAL = 0xFFFF
"""MISSION_CURRENT.total without a mission."""

MOVES_US = 100_000
"""Minimum interval between reports that only change the current item."""

REACHED_AT_ONCE = 20
REACHED_EVERY_US = 100_000
"""Token bucket of item reports: so many in a row at any rate, and one more per interval. Beyond that the newest is
reported as soon as possible, which implies those before it."""

_MODE_ACTIVE, _MODE_SUSPENDED = 1, 2
"""MISSION_CURRENT.mission_mode."""


class ProgressMessages:
    def __init__(self, ctx: Context, missions: Missions) -> None:
        self._ctx = ctx
        self._missions = missions
        self._shown: tuple[int, ProgressState, bool, int] | None = None
        self._chosen_us: int | None = None
        self._reported_us = 0
        self._reached: int | None = None
        """Wire number of an item reached but not yet reported."""
        self._spent_us = 0
        """Time up to which the token bucket is used."""

    def mission_current(self) -> Message:
        ctx, progress = self._ctx, self._ctx.view.progress
        items = ctx.plans.items(PlanKind.MISSION)
        total = len(items) - sum(item.is_home for item in items[:1])
        if not total:
            state = ProgressState.NO_MISSION
        elif progress is None or progress.state is ProgressState.NO_MISSION:
            state = ProgressState.NOT_STARTED
        else:
            state = progress.state
        return extra.MAVLink_mission_current_message(
            self.wire_seq,
            total or NO_MISSION_TOTAL,
            int(state),
            _MODE_ACTIVE if ctx.view.mode is FlightMode.MISSION else _MODE_SUSPENDED,
            *(ctx.plans.checksum(kind) for kind in (PlanKind.MISSION, PlanKind.FENCE, PlanKind.RALLY)),
        )

    @property
    def wire_seq(self) -> int:
        """The current item, numbered as on the wire."""
        progress = self._ctx.view.progress
        seq = 0 if progress is None else max(progress.current_seq, 0)
        return seq + home_item.shift(self._ctx, PlanKind.MISSION)

    def choose(self, wire_seq: float, *, reset: bool = False) -> CommandReply:
        """Make an item current, numbered as on the wire."""
        seq = wire_seq - home_item.shift(self._ctx, PlanKind.MISSION)
        seq = max(seq, 0.0) if wire_seq == 0.0 else seq
        if not 0.0 <= seq <= 65_535.0 or seq != int(seq):
            reason = f"mission item {wire_seq:g} does not exist: use a whole number of the plan"
            return CommandReply(result=CommandResult.DENIED, reason=reason)
        return self._ctx.vehicle.set_current_item(int(seq), reset=reset)

    def on_set_current(self, peer: MavlinkPeer, msg: Message) -> None:
        """MISSION_SET_CURRENT: answered by MISSION_CURRENT, a refusal by text."""
        answer = self.choose(float(msg.seq))
        if answer.result is CommandResult.ACCEPTED:
            self._chosen_us = self._ctx.t_us
        else:
            self._ctx.say(notices.REFUSED(reason=answer.reason or f"mission item {msg.seq} refused"), peer)

    def tick(self, reached: Sequence[int]) -> None:
        """Report items reached and changes on every link."""
        ctx = self._ctx
        self._report_reached(reached)
        progress = ctx.view.progress
        shown = (
            -1 if progress is None else progress.current_seq,
            ProgressState.UNKNOWN if progress is None else progress.state,
            ctx.view.mode is FlightMode.MISSION,
            self._missions.revision,
        )
        # Waypoints close together are passed a hundred times a second.
        moves = self._shown is not None and shown[1:] == self._shown[1:]
        if moves and not self._chosen_us and ctx.t_us - self._reported_us < MOVES_US:
            return
        # The vehicle's view shows a choice one tick later.
        answer_due = self._chosen_us is not None and ctx.t_us > self._chosen_us
        if shown != self._shown or answer_due:
            if answer_due:
                self._chosen_us = None
            self._shown, self._reported_us = shown, ctx.t_us
            self._missions.current_wire_seq = self.wire_seq
            ctx.broadcast(self.mission_current())

    def _report_reached(self, reached: Sequence[int]) -> None:
        """MISSION_ITEM_REACHED; waypoints close together are passed a hundred times a second."""
        if not reached and self._reached is None:
            return
        ctx, by = self._ctx, home_item.shift(self._ctx, PlanKind.MISSION)
        unreported = [max(seq, 0) + by for seq in reached]
        if not unreported and self._reached is not None:
            unreported = [self._reached]
        for number in unreported:
            self._spent_us = max(self._spent_us, ctx.t_us)
            late = self._spent_us - ctx.t_us > (REACHED_AT_ONCE - 1) * REACHED_EVERY_US
            self._reached = number if late else None
            if not late:
                self._spent_us += REACHED_EVERY_US
                ctx.broadcast(mav.MAVLink_mission_item_reached_message(number))
