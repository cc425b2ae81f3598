"""Links of the service while the other modules are being loaded.

Loading takes a second or two of CPU time, ten times that on a busy machine; ground stations see the vehicle at
once, in MAV_STATE_BOOT. Vehicle time starts when loading is complete.
"""

import math
import sys
import threading
import time
import traceback
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from autopilot import __version__
from autopilot.core.errors import DriverError
from autopilot.core.messages import MavlinkFrame
from autopilot.core.params import ParamSet
from autopilot.drivers.links import open_link
from autopilot.drivers.protocols import Link, Received
from autopilot.mavlink.boot import BootLink, BootSigning
from autopilot.mavlink.boot_identity import BootIdentity
from autopilot.mavlink.context import NAME, VehicleIdentity
from autopilot.mavlink.profiles import profile_by_name
from autopilot.run.config import system_id, vehicle_uid
from autopilot.run.provenance import revision
from autopilot.run.signing_files import SigningFiles

HEARTBEAT_S = 1.0
TURN_S = 0.05
KEPT_S = 15.0
"""Time for which requests are kept for the service: a client that has waited longer has given up."""
MAX_KEPT = 256
"""Requests that are kept; one that is asked again takes the place of the one before."""


class BootLinks:
    """Answers on open links from ``with`` to its end; then they are the service's. An error closes them."""

    def __init__(
        self,
        links: Sequence[Link],
        sysid: int,
        profile: str,
        *,
        uid: int = 1,
        signing: BootSigning | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """``uid``: as the service has it; ``signing``: None without a key; ``now_s``: real time [s], from any
        beginning."""
        self.links = tuple(links)
        self._now_s = now_s
        known = BootIdentity(profile_by_name(profile), lambda: _identity(uid))
        self._boot = [BootLink(sysid, profile, known, signing, number) for number in range(len(self.links))]
        self._beat_s = [-math.inf] * len(self.links)
        """When each link got its last heartbeat."""
        self._spoken_to: set[int] = set()
        self._shown: set[int] = set()
        """Links whose fault has been reported."""
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
        """Requests of the last seconds that the service has to answer, without rejected actions."""
        now_s = self._now_s()
        frames = tuple(frame for kept_s, frame in self._kept.values() if now_s - kept_s < KEPT_S)
        self._kept.clear()
        return frames

    def _run(self) -> None:
        while not self._end.wait(TURN_S):
            self._turn()

    def _turn(self) -> None:
        for index in range(len(self.links)):
            try:
                self._attend(index, self._now_s())
            except (DriverError, OSError):  # reported by the service, which opens the same link in a moment
                continue
            except Exception:  # noqa: BLE001 - a driver's own fault: the other links go on
                self._show(index)

    def _attend(self, index: int, now_s: float) -> None:
        """A link's turn. Nothing that is received keeps the heartbeat back."""
        link, boot = self.links[index], self._boot[index]
        received = link.recv(0)  # vehicle time has not started
        for one in received:
            try:
                self._answer(index, one, now_s)
            except (DriverError, OSError):
                raise
            except Exception:  # noqa: BLE001 - a fault of ours costs the message that shows it
                self._show(index)
        for client, message in boot.tick(round(now_s * 1e6)):
            link.send(message, client)
        # A peer that listens on a port of ours gets the heartbeat at once when it has sent something.
        first_frame = bool(received) and index not in self._spoken_to
        if first_frame:
            self._spoken_to.add(index)
        if first_frame or now_s - self._beat_s[index] >= HEARTBEAT_S:
            self._beat_s[index] = now_s
            link.send(boot.heartbeat())

    def _answer(self, index: int, one: Received, now_s: float) -> None:
        data, client, sender, reach = one
        answers, left = self._boot[index].answer(data, client, reach)
        for request, message in left.items():
            self._keep(
                request, now_s, MavlinkFrame(link=index, client=client, sender=sender, reach=reach, data=message)
            )
        for answer in answers:
            self.links[index].send(answer, client)

    def _show(self, index: int) -> None:
        """The fault that is being handled, on the console, once per link."""
        if index not in self._shown:
            self._shown.add(index)
            print(f"link {index}:\n{traceback.format_exc()}", file=sys.stderr)

    def _keep(self, request: Hashable, now_s: float, frame: MavlinkFrame) -> None:
        key = (frame.link, frame.client, request)
        self._kept.pop(key, None)
        while len(self._kept) >= MAX_KEPT:
            del self._kept[next(iter(self._kept))]
        self._kept[key] = (now_s, frame)


def _identity(uid: int) -> VehicleIdentity:
    """As the service has it (:mod:`autopilot.run.compose`)."""
    return VehicleIdentity(name=NAME, version=__version__, git=revision(), uid=uid)


def open_boot_links(
    connections: Sequence[str], params: ParamSet, instance: int, profile: str, folder: Path
) -> BootLinks:
    """Open links; none is left open after an error. ``folder``: state folder of the vehicle. ConfigError,
    DriverError.
    """
    found = SigningFiles(folder).state
    signing = None
    if found.key is not None:
        signing = BootSigning(found.key, found.stamp, params["SIGN_LOCAL"] > 0.0)
    links: list[Link] = []
    try:
        links.extend(open_link(connection) for connection in connections)
        return BootLinks(links, system_id(params, instance), profile, uid=vehicle_uid(instance), signing=signing)
    except BaseException:
        for link in links:
            link.close()
        raise
