"""Vehicle connection of a MAVLink client: runs exchanges over a link, by the wall clock.

Used by the system tests, the demo and ``autopilot mission``.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Self

from pymavlink.dialects.v20 import development as mav

from autopilot.client.client_links import ClientLink, open_link
from autopilot.client.command_client import CommandSend, Question, message_question, parameter_question
from autopilot.client.exchange import Exchange, ExchangeResult, Message, Timers, VehicleAddress
from autopilot.client.plan_client import PlanDownload, PlanUpload, same_on_the_wire
from autopilot.client.texts import TextCollector, VehicleText
from autopilot.core.errors import AutopilotError, DriverError, PlanError
from autopilot.core.messages import ProgressState
from autopilot.core.phrases import ARMING_CHECK, PLAN_REASON
from autopilot.core.plan import PlanItem, PlanKind

SYSTEM_ID, COMPONENT_ID = 254, 190
"""Ours: a ground station beside the usual 255, MAV_COMP_ID_MISSIONPLANNER."""
HEARTBEAT_S = 1.0
_POLL_S = 0.02
_SHOWN_S = 3.0
"""Vehicle time by which its telemetry may lag behind its answer to a command."""
SILENCE_S = 30.0
"""Silence after which a vehicle is given up."""
_ASK_S = 0.5
"""Silence after which it is asked whether the vehicle is at work; shorter than any silence that ends something."""
_STILL_S = 1.0
"""Time without a new time stamp after which the vehicle's clock stands still."""
_START_S = 300.0
"""Longest start of the vehicle that is waited for."""
_STANDSTILL_S = 300.0
"""Longest standstill of the vehicle's clock that its heartbeats excuse."""
_LATE_MS = 10_000
"""A time stamp older than the last one by less than this is a late datagram, by more a restarted vehicle."""
_FORCE_DISARM = 21196.0
_FORCE_ARM = 2989.0
"""Magic numbers of MAV_CMD_COMPONENT_ARM_DISARM param2 (common.xml)."""

_PLAN_CHECK = ARMING_CHECK + PLAN_REASON
"""How our vehicles begin what is wrong with plans that are stored, when they are asked."""

Progress = Callable[[int, int], None]
"""Called with items done and items in all."""


class CommandRefusedError(AutopilotError):
    """The vehicle refused a command or did not answer; one line with its reason."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleInfo:
    system: int
    component: int
    autopilot: int
    """MAV_AUTOPILOT."""
    armed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionStatus:
    """Progress of the vehicle's mission."""

    seq: int
    total: int
    state: ProgressState
    reached: tuple[int, ...]
    """Items reached so far, in order of arrival (an item of a loop more than once)."""
    armed: bool


class VehicleConnection:
    """One connection to one vehicle; use as a context manager.

    Timeouts follow the vehicle's clock (``time_boot_ms`` of its telemetry): while it runs slower than the wall
    clock, because its machine is busy, only vehicle time counts.

    Parameters
    ----------
    connection
        Connection string (:mod:`autopilot.client.client_links`) or an open link.
    timers
        Timeouts and retransmission intervals.
    clock_s
        Monotonic clock [s].
    at_work
        For a vehicle in a child process: whether that process uses CPU time; while it does, silence does not count.

    Raises
    ------
    DriverError
        The link cannot be opened.
    """

    def __init__(
        self,
        connection: str | ClientLink,
        timers: Timers | None = None,
        clock_s: Callable[[], float] = time.monotonic,
        at_work: Callable[[], bool] | None = None,
    ) -> None:
        self._link = open_link(connection) if isinstance(connection, str) else connection
        self._name = connection if isinstance(connection, str) else "link"
        self._timers = timers or Timers()
        self._clock_s = clock_s
        self._at_work = at_work
        self._received_s = clock_s()
        self._polled_s = self._received_s
        """When messages were last looked for: silence and timeouts are judged by it, not by what passed since."""
        self._stamp: tuple[int, float] | None = None
        """The vehicle's last time_boot_ms and its time of arrival."""
        self._held_up_s = self._stood_s = 0.0
        self.vehicle_s = 0.0
        """Vehicle time observed so far [s]; stays 0 for a vehicle that does not send it."""
        self._codec = mav.MAVLink(None, srcSystem=SYSTEM_ID, srcComponent=COMPONENT_ID)
        self._codec.robust_parsing = True
        self._beat_s = -math.inf
        self._collector = TextCollector()
        self._target: VehicleAddress | None = None
        self._reached: list[int] = []
        self._reached_marks: set[tuple[int, int]] = set()
        self._current: Message | None = None
        self.vehicle: VehicleInfo | None = None
        self.on_text: Callable[[VehicleText], None] | None = None
        """Called with every STATUSTEXT."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self._link.close()

    def connect(self, timeout_s: float = 10.0, system: int | None = None) -> VehicleInfo:
        """Wait for the heartbeat of an autopilot (component 1) that has started.

        Parameters
        ----------
        timeout_s
            Longest wait [s]; for a vehicle in MAV_STATE_BOOT five minutes more.
        system
            MAVLink system id to wait for, None = the first autopilot.

        Returns
        -------
        VehicleInfo
            Whose heartbeat it was; all other methods are about this vehicle.

        Raises
        ------
        DriverError
            No heartbeat came.
        """
        end_s = self._clock_s() + timeout_s
        latest_s, starting = end_s + _START_S, False
        while self._polled_s < end_s:
            for message in self.poll():
                is_autopilot = message.get_type() == "HEARTBEAT" and message.autopilot != mav.MAV_AUTOPILOT_INVALID
                if is_autopilot and message.get_srcComponent() == 1 and system in (None, message.get_srcSystem()):
                    if message.system_status == mav.MAV_STATE_BOOT:
                        end_s, starting = min(self._clock_s() + timeout_s, latest_s), True
                        continue
                    self._target = VehicleAddress(system=message.get_srcSystem(), component=1)
                    return self._note_heartbeat(message)
            end_s += self._take_held_up()
        if starting:
            raise DriverError(f"the vehicle on {self._name} starts and does not get ready; look at its own messages")
        raise DriverError(f"no vehicle heard on {self._name} within {timeout_s:g} s; is it running and reachable?")

    def poll(self, wait_s: float = _POLL_S) -> list[Message]:
        """Receive messages and send our heartbeat when it is due.

        Parameters
        ----------
        wait_s
            Longest wait for the first message [s].

        Returns
        -------
        list of Message
            Messages for us; of our vehicle only, once :meth:`connect` has found it.
        """
        now_s = self._clock_s()
        if now_s - self._beat_s >= HEARTBEAT_S:
            self._beat_s = now_s
            self.send(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))
        messages: list[Message] = []
        data = self._link.receive(wait_s)
        while data:
            messages += [m for m in self._codec.parse_buffer(data) or [] if self._is_for_us(m)]
            data = self._link.receive(0.0)
        self._note_life(messages)
        for message in messages:
            self._note(message, now_s)
        if self.on_text is not None:
            for text in self._collector.flush(now_s):
                self.on_text(text)
        return messages

    def _note_life(self, messages: Sequence[Message]) -> None:
        """Update the time of the last message, the vehicle's clock and the time it was held up."""
        now_s = self._polled_s = self._clock_s()
        if messages:
            self._received_s = now_s
        elif self._at_work is not None and now_s - self._received_s > _ASK_S and self._at_work():
            silent_s = now_s - self._received_s
            self._received_s = now_s
            self._held_up_s += silent_s
            if self._stamp is not None:
                self._stamp = (self._stamp[0], self._stamp[1] + silent_s)
        for message in messages:
            boot_ms = getattr(message, "time_boot_ms", None)
            if boot_ms is None or self._target is None:
                continue
            last = self._stamp
            if last is not None and last[0] - _LATE_MS < boot_ms <= last[0]:
                continue
            if last is not None and boot_ms > last[0]:
                passed_s = (boot_ms - last[0]) * 1e-3
                self.vehicle_s += passed_s
                self._held_up_s += max(0.0, now_s - last[1] - passed_s)
            self._stamp, self._stood_s = (boot_ms, now_s), 0.0
        self._note_standstill(bool(messages), now_s)

    def _note_standstill(self, received: bool, now_s: float) -> None:
        """A clock that stands still while messages arrive counts as held up, for at most ``_STANDSTILL_S``."""
        last = self._stamp
        if received and last is not None and now_s - last[1] > _STILL_S and self._stood_s < _STANDSTILL_S:
            self._stood_s += now_s - last[1]
            self._held_up_s += now_s - last[1]
            self._stamp = (last[0], now_s)

    def _take_held_up(self) -> float:
        """Time since the last call in which the vehicle made no progress [s]."""
        held_up_s, self._held_up_s = self._held_up_s, 0.0
        return held_up_s

    def _since(self, vehicle_s: float, clock_s: float) -> float:
        """Time since a start time [s]: in vehicle time if it is known, else in wall time."""
        return self._clock_s() - clock_s if self._stamp is None else self.vehicle_s - vehicle_s

    @property
    def vehicle_clock_s(self) -> float | None:
        """The vehicle's time since boot in its last message [s], None before the first."""
        return None if self._stamp is None else 1e-3 * self._stamp[0]

    @property
    def _silent_s(self) -> float:
        """Silence that the last poll found [s]: one of a vehicle at work is 0 there, however late it is read."""
        return self._polled_s - self._received_s

    def _note(self, message: Message, now_s: float) -> None:
        """Handle messages that may arrive at any time: heartbeats, progress, texts."""
        kind = message.get_type()
        if kind == "HEARTBEAT" and self._target is not None:
            self._note_heartbeat(message)
        elif kind == "TIMESYNC" and message.tc1 == 0:
            self.send(mav.MAVLink_timesync_message(max(int(1e9 * now_s), 1), message.ts1))
        elif kind == "MISSION_CURRENT":
            self._current = message
        elif kind == "MISSION_ITEM_REACHED":
            mark = (message.get_seq(), message.seq)
            if mark not in self._reached_marks:
                # The same packet number with the same item is a copy made by the network.
                self._reached_marks = {m for m in self._reached_marks if (mark[0] - m[0]) % 256 < 128} | {mark}
                self._reached.append(message.seq)
        elif kind == "STATUSTEXT" and self.on_text is not None:
            for text in self._collector.feed(message, now_s):
                self.on_text(text)

    def send(self, message: Message) -> None:
        self._link.send(bytes(message.pack(self._codec)))
        self._codec.seq = (self._codec.seq + 1) & 0xFF  # the same again is another message, not a copy of the network's

    def _is_for_us(self, message: Message) -> bool:
        if message.get_type() == "BAD_DATA":
            return False
        if getattr(message, "target_system", 0) not in (0, SYSTEM_ID):
            return False
        target = self._target
        return target is None or (message.get_srcSystem(), message.get_srcComponent()) == (
            target.system,
            target.component,
        )

    def _note_heartbeat(self, message: Message) -> VehicleInfo:
        vehicle = VehicleInfo(
            system=message.get_srcSystem(),
            component=message.get_srcComponent(),
            autopilot=message.autopilot,
            armed=bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED),
        )
        self.vehicle = vehicle
        return vehicle

    def _address(self) -> VehicleAddress:
        """Address of the vehicle; waits for its heartbeat if none has arrived yet."""
        if self._target is not None:
            return self._target
        return VehicleAddress(system=self.connect().system)

    def run(self, exchange: Exchange, on_progress: Progress | None = None) -> ExchangeResult:
        """Run an exchange until it ends.

        Parameters
        ----------
        exchange
            State machine of the protocol (:class:`autopilot.client.exchange.Exchange`).
        on_progress
            Called with items done and items in all whenever they change.

        Returns
        -------
        ExchangeResult
            Accepted, or the reason for the failure.
        """
        self._take_held_up()
        pending = exchange.begin(self._clock_s())
        shown: tuple[int, int] | None = None
        while True:
            for message in pending:
                self.send(message)
            if on_progress is not None and exchange.progress != shown:
                shown = exchange.progress
                on_progress(*shown)
            if exchange.outcome is not None:
                return exchange.outcome
            pending = [answer for m in self.poll() for answer in exchange.handle(m, self._clock_s())]
            exchange.grant(self._take_held_up())
            pending += exchange.tick(self._polled_s)

    @property
    def _home_is_item_0(self) -> bool:
        """ArduPilot's convention: item 0 of a mission on the wire is home."""
        return self.vehicle is not None and self.vehicle.autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA

    def upload(self, kind: PlanKind, items: Sequence[PlanItem], on_progress: Progress | None = None) -> None:
        """Replace a plan (mission, fence or rally points).

        Parameters
        ----------
        kind
            Type of the plan.
        items
            Items in wire units (:class:`autopilot.core.plan.PlanItem`).
        on_progress
            Called with items done and items in all.

        Raises
        ------
        PlanError
            The vehicle's reason for refusing; its old plan is in force then.
        """
        target = self._address()
        wire = tuple(items)
        plain = wire
        if wire and wire[0].is_home and self._home_is_item_0:
            plain = tuple(_renumbered(item, -1) for item in wire[1:])
        elif wire and kind is PlanKind.MISSION and self._home_is_item_0:
            wire = (_home_placeholder(wire[0]), *(_renumbered(item, 1) for item in wire))
        upload = PlanUpload(kind, wire, target, self._timers)
        outcome = self.run(upload, on_progress)
        if outcome.result is None and upload.all_sent and same_on_the_wire(self.download(kind), plain):
            return
        if not outcome.accepted:
            raise PlanError(outcome.reason)

    def plan_problem(self) -> str:
        """Reason why the vehicle does not fly its stored plans.

        Sends MAV_CMD_RUN_PREARM_CHECKS. An armed vehicle refuses that command, and reports problems of its plans
        all the same.

        Returns
        -------
        str
            The vehicle's message, "" if it reports no problem.
        """
        show, self.on_text = self.on_text, None
        try:
            check = CommandSend(mav.MAV_CMD_RUN_PREARM_CHECKS, (), self._address(), self._timers)
            self.run(check)
            end_s = self._clock_s() + self._timers.reason_s
            while check.hears_half_a_text and self._clock_s() < end_s:
                for message in self.poll():
                    check.handle(message, self._clock_s())
                check.tick(self._clock_s())
        finally:
            self.on_text = show
        return next((t.removeprefix(_PLAN_CHECK) for t in check.complaints if t.startswith(_PLAN_CHECK)), "")

    def download(self, kind: PlanKind, on_progress: Progress | None = None) -> tuple[PlanItem, ...]:
        """Read a plan.

        Returns
        -------
        tuple of PlanItem
            In the order of their numbers, without a home item.

        Raises
        ------
        PlanError
            The vehicle does not send it.
        """
        download = PlanDownload(kind, self._address(), self._timers)
        outcome = self.run(download, on_progress)
        if not outcome.accepted:
            raise PlanError(outcome.reason)
        if kind is PlanKind.MISSION and self._home_is_item_0:
            return tuple(_renumbered(item, -1) for item in download.items[1:])
        return download.items

    def command(self, command: int, *params: float) -> None:
        """Send a command until it is answered.

        Parameters
        ----------
        command
            MAV_CMD.
        params
            Up to seven, in MAVLink's units; the rest is 0.

        Raises
        ------
        CommandRefusedError
            The vehicle's reason, or that it does not answer.
        """
        outcome = self.run(CommandSend(command, params, self._address(), self._timers))
        if not outcome.accepted:
            raise CommandRefusedError(outcome.reason)

    def parameter(self, name: str) -> float:
        """Read a real parameter.

        Raises
        ------
        CommandRefusedError
            The vehicle does not send it.
        """
        return float(self._ask(parameter_question(name, self._address(), self._timers)).param_value)

    def message(self, message_id: int) -> Message:
        """Ask for one message by its number.

        Raises
        ------
        CommandRefusedError
            The vehicle's reason, or that it does not answer.
        """
        return self._ask(message_question(message_id, self._address(), self._timers))

    def _ask(self, question: Question) -> Message:
        outcome = self.run(question)
        if not outcome.accepted:
            raise CommandRefusedError(outcome.reason)
        return question.answer

    def arm(self, force: bool = False) -> None:
        """Arm and wait until the heartbeat shows it.

        Parameters
        ----------
        force
            Without the arming checks.

        Raises
        ------
        CommandRefusedError
            The reasons why the vehicle is not ready.
        """
        self.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, _FORCE_ARM if force else 0.0)
        begun = self.vehicle_s, self._clock_s()
        while not (self.vehicle is not None and self.vehicle.armed) and self._since(*begun) < _SHOWN_S:
            if self._silent_s > self._timers.give_up_s:
                return
            self.poll()

    def disarm(self, force: bool = False) -> None:
        """Disarm.

        Parameters
        ----------
        force
            Emergency stop: also under way (magic number 21196 in param2).

        Raises
        ------
        CommandRefusedError
            The vehicle refused, with its reason.
        """
        self.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, _FORCE_DISARM if force else 0.0)

    def start_mission(self, first_seq: int = 0) -> None:
        """Start the mission and reset the list of items reached.

        Parameters
        ----------
        first_seq
            Item to start at, 0 = the current one.

        Raises
        ------
        CommandRefusedError
            The vehicle refused, with its reason.
        """
        self._reached, self._current = [], None
        self.command(mav.MAV_CMD_MISSION_START, float(first_seq), 0.0)

    def watch_mission(
        self,
        on_status: Callable[[MissionStatus], None] | None = None,
        timeout_s: float = math.inf,
        silence_s: float = SILENCE_S,
    ) -> MissionStatus:
        """Watch until the mission is complete or the vehicle is disarmed.

        Parameters
        ----------
        on_status
            Called with every status that differs from the one before.
        timeout_s
            Longest mission, of the vehicle's time [s].
        silence_s
            Silence after which the vehicle is given up [s].

        Returns
        -------
        MissionStatus
            The last one.

        Raises
        ------
        DriverError
            The vehicle falls silent, or the mission takes longer.
        """
        self._address()
        since = self.vehicle_s, self._clock_s()
        self._received_s = since[1]
        shown: MissionStatus | None = None
        begun = False
        while True:
            self.poll()
            passed_s = self._since(*since)
            current = self._current
            seq, total = (0, 0) if current is None else (current.seq, current.total)
            state = ProgressState.UNKNOWN if current is None else _state(current.mission_state)
            armed = self.vehicle is not None and self.vehicle.armed
            status = MissionStatus(seq=seq, total=total, state=state, reached=tuple(self._reached), armed=armed)
            if status != shown and on_status is not None:
                on_status(status)
            shown = status
            # A state from before the start counts only if it persists.
            begun |= state in (ProgressState.ACTIVE, ProgressState.PAUSED) or passed_s > _SHOWN_S
            if begun and (state is ProgressState.COMPLETE or not armed):
                return status
            if self._silent_s > silence_s:
                raise DriverError(f"the vehicle on {self._name} has been silent for {silence_s:g} s; check the link")
            if passed_s > timeout_s:
                raise DriverError(f"the mission is at item {seq} after {timeout_s:g} s; give it more time (--timeout)")

    def wait_disarmed(self, timeout_s: float) -> None:
        """Wait until the vehicle is disarmed, at most ``timeout_s`` [s] of its time.

        Raises
        ------
        DriverError
            It stays armed, or falls silent.
        """
        since = self.vehicle_s, self._clock_s()
        while self.vehicle is not None and self.vehicle.armed:
            self.poll()
            if self._since(*since) > timeout_s or self._silent_s > SILENCE_S:
                raise DriverError(f"the vehicle on {self._name} is still armed after {timeout_s:g} s; look after it")


def _state(value: int) -> ProgressState:
    return ProgressState(value) if value in list(ProgressState) else ProgressState.UNKNOWN


def _renumbered(item: PlanItem, by: int) -> PlanItem:
    """The item with its number, and the target of a jump, shifted."""
    jump = item.command == mav.MAV_CMD_DO_JUMP
    return replace(item, seq=item.seq + by, param1=item.param1 + by if jump else item.param1)


def _home_placeholder(first: PlanItem) -> PlanItem:
    """Item 0 for vehicles that keep home there; they put their own home into it."""
    return PlanItem(seq=0, frame=0, command=mav.MAV_CMD_NAV_WAYPOINT, param4=0.0, x=first.x, y=first.y, z=0.0)
