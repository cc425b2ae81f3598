"""Links of the service: receive, send, wait, and notices about their state.

Nothing here blocks longer than its timeout, and nothing raises: a broken link is counted, reported once, and
reopened by its driver. An exception that no driver may raise is a fault for the guard as well.
"""

import select
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

from autopilot.core import operator_messages as notices
from autopilot.core.clients import EVERYONE, ClientRecord, Verbatim
from autopilot.core.errors import DriverError
from autopilot.core.guard import Guard
from autopilot.core.messages import Event, MavlinkFrame
from autopilot.drivers.protocols import Link, SharedLink

POLL_S = 0.002
"""Polling interval of links without a file descriptor."""
BEAT_S = 1.1
"""Real time after which a HEARTBEAT is due, whatever the vehicle's time (usually a second of it)."""
NOTICE_US = 5_000_000
"""Interval of reports of an intermittent link."""
LOOK_S = 0.05
"""A wait ends at least this often, for heartbeats."""
MAX_BETWEEN_BYTES = 16_384
"""Bytes accepted from one link between two ticks; more waits for the tick."""
MAX_BETWEEN_CALLS = 64
"""How often one link is read between two ticks."""

AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1: the component that is there from the start."""

_MAVLINK1, _MAVLINK2 = b"\xfe", b"\xfd"
"""First bytes of frames."""

T = TypeVar("T")


def _beat_of(frame: MavlinkFrame) -> int | None:
    """Component of a broadcast HEARTBEAT; None for any other frame. One that is sent to a single client, or
    forwarded for another component, does not keep other clients from timing out.
    """
    data = frame.data
    if isinstance(data, Verbatim) or frame.client != EVERYONE:
        return None
    if data[:1] == _MAVLINK2 and data[7:10] == b"\0\0\0":
        return data[6]
    if data[:1] == _MAVLINK1 and data[5] == 0:
        return data[4]
    return None


class Transport:
    """All links of a run. ``now_s`` is real time; ``guard`` keeps the faults of drivers."""

    def __init__(
        self, links: Sequence[Link], now_s: Callable[[], float] = time.monotonic, guard: Guard | None = None
    ) -> None:
        self._links = tuple(links)
        self._names = [link.name for link in self._links]
        self._guard = guard or Guard()
        self._now_s = now_s
        self._beats_s = dict.fromkeys(((index, AUTOPILOT) for index in range(len(self._links))), now_s())
        """When each link got the last HEARTBEAT of each of our components."""
        self._between_bytes = [0] * len(self._links)
        self._between_calls = [0] * len(self._links)
        self._problems: list[str | None] = [None] * len(self._links)
        self._silent_until_us = [0] * len(self._links)
        self._failed: list[dict[str, str]] = [{} for _ in self._links]
        """Unexpected exceptions of drivers, by operation; until the operation succeeds."""
        self.errors = 0
        """How often that happened."""
        self._shared = [(index, link) for index, link in enumerate(self._links) if isinstance(link, SharedLink)]
        self._news_us = [0] * len(self._links)
        """When who lost or found no place on a link may be named again."""

    def __len__(self) -> int:
        return len(self._links)

    def judge_by(self, standing: Callable[[int, int], ClientRecord]) -> None:
        """Set the priority function of clients, for links with limited slots."""
        for index, link in self._shared:
            link.standing = partial(standing, index)

    @property
    def beat_due(self) -> bool:
        """Whether a component's HEARTBEAT is overdue on a link."""
        return bool(self._beats_s) and self._now_s() - min(self._beats_s.values()) >= BEAT_S

    def receive(self, t_us: int) -> list[MavlinkFrame]:
        """Data of all links for a tick. The receive limit until the next tick starts anew."""
        self._between_bytes = [0] * len(self._links)
        self._between_calls = [0] * len(self._links)
        return [frame for index in range(len(self._links)) for frame in self._receive(index, t_us)]

    def wait(self, t_us: int, seconds: float) -> list[MavlinkFrame]:
        """Wait for the links, ``seconds`` at most; data received, or nothing on timeout."""
        open_links = [index for index in range(len(self._links)) if self._may_bring(index)]
        doors: dict[int, int] = {}
        polled = []
        for index in open_links:
            numbers = self._try(index, "wait", self._links[index].filenos, None)
            if numbers is None:
                continue
            doors.update(dict.fromkeys(numbers, index))
            if not numbers and self._problem(index) is None:
                polled.append(index)
        patience_s = min(seconds, POLL_S if polled else LOOK_S)
        try:
            ready, _, _ = select.select(list(doors), [], [], patience_s)
        except (OSError, ValueError):  # a descriptor just closed, or one beyond the limit of select
            time.sleep(patience_s)
            ready = []
        called = dict.fromkeys([doors[number] for number in ready] + polled)
        received = []
        for index in called:
            frames = self._receive(index, t_us)
            self._between_calls[index] += index not in polled
            self._between_bytes[index] += sum(len(frame.data) for frame in frames)
            received += frames
        return received

    def beat(self, frames: Sequence[MavlinkFrame]) -> None:
        """Send the HEARTBEATs that are due: a link or component without one among them gets none (a quiet link)."""
        self._beats_s.clear()
        self.send(frames)

    def send(self, frames: Sequence[MavlinkFrame]) -> None:
        for frame in frames:
            component = _beat_of(frame)
            if component is not None:
                self._beats_s[frame.link, component] = self._now_s()
        for index in range(len(self._links)):
            for frame in frames:
                if frame.link in (index, -1):
                    self._send(index, frame)

    def take_notices(self, t_us: int) -> tuple[Event, ...]:
        """Notices to operators about links since the last call: broken, or restored."""
        events: list[Event] = []
        for index in range(len(self._links)):
            problem, name = self._problem(index), self._names[index]
            if problem == self._problems[index] or t_us < self._silent_until_us[index]:
                continue
            self._problems[index], self._silent_until_us[index] = problem, t_us + NOTICE_US
            if problem is None:
                events.append(notices.LINK_BACK.event(t_us, name=name))
            else:
                events.append(notices.LINK_PROBLEM.event(t_us, name=name, problem=problem))
        for index, link in self._shared:
            news = None if t_us < self._news_us[index] else self._try(index, "tell", link.take_news, None)
            if news is not None:
                self._news_us[index] = t_us + NOTICE_US
                row = notices.LINK_WARNING if news[0] else notices.LINK_NEWS
                events.append(row.event(t_us, text=news[1]))
        return tuple(events)

    def close(self) -> None:
        for index, link in enumerate(self._links):
            self._try(index, "close", link.close, None)

    def _may_bring(self, index: int) -> bool:
        return self._between_bytes[index] < MAX_BETWEEN_BYTES and self._between_calls[index] < MAX_BETWEEN_CALLS

    def _receive(self, index: int, t_us: int) -> list[MavlinkFrame]:
        def work() -> list[MavlinkFrame]:
            received = self._links[index].recv(t_us)
            return [
                MavlinkFrame(link=index, data=got.data, client=got.client, sender=got.sender, reach=got.reach)
                for got in received
            ]

        self._guard.t_us = t_us
        return self._try(index, "receive", work, [])

    def _send(self, index: int, frame: MavlinkFrame) -> None:
        link = self._links[index]
        if frame.beside:
            self._try(index, "send", lambda: link.send(frame.data, frame.client, frame.beside), None)
        else:
            self._try(index, "send", lambda: link.send(frame.data, frame.client), None)

    def _problem(self, index: int) -> str | None:
        """Present fault of a link: its driver's exception, else its driver's own report."""
        problem = self._try(index, "tell", lambda: self._links[index].problem, None)
        return next(iter(self._failed[index].values()), problem)

    def _try(self, index: int, what: str, work: Callable[[], T], otherwise: T) -> T:
        """Use a link; no driver of a link ends the loop. A success takes back an earlier failure at the same."""
        try:
            result = work()
        except (DriverError, OSError) as error:
            text = str(error) or type(error).__name__
        except Exception as error:  # noqa: BLE001 - a driver's own fault: kept, or raised again where the guard is set to
            self._guard.note(f"link {self._names[index]}", error)
            text = f"internal fault ({type(error).__name__})"
        else:
            self._failed[index].pop(what, None)
            return result
        self.errors += 1
        self._failed[index][what] = text
        return otherwise
