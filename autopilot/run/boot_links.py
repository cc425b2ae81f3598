"""The service's links while everything behind them is still being loaded.

Loading takes a second or two of CPU time, ten times that on a busy machine; a ground station sees the vehicle at once,
in MAV_STATE_BOOT. The vehicle's own time begins when all is there.
"""

import sys
import threading
import time
import traceback
from collections.abc import Hashable, Sequence
from types import TracebackType
from typing import Self

from autopilot.core.errors import DriverError
from autopilot.core.messages import MavlinkFrame
from autopilot.mavlink.boot import BootLink
from drivers.links import open_link
from drivers.protocols import Link

HEARTBEAT_S = 1.0
TURN_S = 0.05
KEPT_S = 15.0
"""Requests are kept for the service for so long: a client that has waited longer has given up."""
MAX_KEPT = 256
"""Requests that are kept; one that is asked again takes the place of the one before."""


class BootLinks:
    """Answers on open links from ``with`` to its end; then they are the service's. An error closes them."""

    def __init__(self, links: Sequence[Link], sysid: int, profile: str) -> None:
        self.links = tuple(links)
        self._boot = [BootLink(sysid, profile) for _ in self.links]
        self._beat_s = [-HEARTBEAT_S] * len(self.links)
        """When each link got its last heartbeat."""
        self._spoken_to: set[int] = set()
        self._shown: set[int] = set()
        """Links whose driver's fault has been shown."""
        self._kept: dict[Hashable, tuple[float, MavlinkFrame]] = {}
        """By link, client and what is asked, the oldest first."""
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="boot links", daemon=True)

    def __enter__(self) -> Self:
        """The first heartbeats are out when this returns."""
        self._turn()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop answering; after an error close the links."""
        self._end.set()
        self._thread.join()
        if kind is not None:
            for link in self.links:
                link.close()

    def take_unanswered(self) -> tuple[MavlinkFrame, ...]:
        """What the service has to answer: requests of the last seconds. Actions that were refused are not in them."""
        now_s = time.monotonic()
        frames = tuple(frame for kept_s, frame in self._kept.values() if now_s - kept_s < KEPT_S)
        self._kept.clear()
        return frames

    def _run(self) -> None:
        while not self._end.wait(TURN_S):
            self._turn()

    def _turn(self) -> None:
        for index in range(len(self.links)):
            try:
                self._attend(index, time.monotonic())
            except (DriverError, OSError):  # the service tells it, which asks the same link in a moment
                continue
            except Exception:  # noqa: BLE001 - a driver's own fault: the other links go on
                if index not in self._shown:
                    self._shown.add(index)
                    print(f"link {index}:\n{traceback.format_exc()}", file=sys.stderr)

    def _attend(self, index: int, now_s: float) -> None:
        """A link's turn."""
        link, boot = self.links[index], self._boot[index]
        received = link.recv(0)  # the vehicle's time has not begun
        for data, client, sender, reach in received:
            answers, left = boot.answer(data, client)
            for asked, message in left.items():
                self._keep(
                    asked, now_s, MavlinkFrame(link=index, client=client, sender=sender, reach=reach, data=message)
                )
            for answer in answers:
                link.send(answer, client)
        # Who listens for the vehicle on a port of ours hears it when he has spoken, and not a second later.
        first_word = bool(received) and index not in self._spoken_to
        if first_word:
            self._spoken_to.add(index)
        if first_word or now_s - self._beat_s[index] >= HEARTBEAT_S:
            self._beat_s[index] = now_s
            link.send(boot.heartbeat())

    def _keep(self, asked: Hashable, now_s: float, frame: MavlinkFrame) -> None:
        key = (frame.link, frame.client, asked)
        self._kept.pop(key, None)
        while len(self._kept) >= MAX_KEPT:
            del self._kept[next(iter(self._kept))]
        self._kept[key] = (now_s, frame)


def open_boot_links(connections: Sequence[str], sysid: int, profile: str) -> BootLinks:
    """Open links. DriverError names what is wrong; nothing is open then."""
    links: list[Link] = []
    try:
        links.extend(open_link(connection) for connection in connections)
        return BootLinks(links, sysid, profile)
    except BaseException:
        for link in links:
            link.close()
        raise
