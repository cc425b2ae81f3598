"""Log download: LOG_REQUEST_LIST, LOG_REQUEST_DATA, LOG_ERASE, LOG_REQUEST_END of common.xml.

Logs are numbered as in the last list sent to the client (from 1 under the ArduPilot profile, else from 0, as ground
stations expect). Times and sizes are those of the files. One request per client is served at a time, at the pace of
:mod:`autopilot.mavlink.budget`.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

from autopilot.core import operator_messages as notices
from autopilot.core.background import BackgroundTask
from autopilot.core.clock import TICK_US
from autopilot.core.log_directory import LogDirectory, LogDirectoryEntry
from autopilot.mavlink.bounded_table import LatestUsed
from autopilot.mavlink.budget import FILES, Pace
from autopilot.mavlink.context import Context, MavlinkPeer
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.files import OpenFile
from autopilot.mavlink.wire import Message, RawMessage

DATA_BYTES = 90
"""LOG_DATA.data."""
_LOG_DATA = struct.Struct(f"<IHB{DATA_BYTES}s")
"""Offset, number, count, data as on the wire."""
_CRC_EXTRA = mav.MAVLink_log_data_message.crc_extra
PART_TICKS = 8
"""The pace is reviewed after so many ticks of a request."""
ENTRIES_PER_TICK = 4
MAX_CLIENTS = 16
"""Clients whose lists are kept; beyond that the oldest is dropped."""

_LOG = ".mcap"
"""Numbered files; their companions are available by MAVFTP."""


@dataclass(slots=True)
class _LogClient:
    logs: tuple[LogDirectoryEntry, ...] | None = None
    """The list that defines the client's numbers, None before its first request."""
    listing: BackgroundTask[tuple[LogDirectoryEntry, ...]] | None = None
    entries: range = range(0)
    """Numbers of the entries that are still to be sent."""
    wanted: tuple[int, int, int] | None = None
    """Number, offset and bytes of the data that are still to be sent."""
    file: OpenFile | None = None
    pace: Pace = field(default_factory=Pace)
    sent_ticks: int = 0
    """Ticks of the request at its pace."""
    end: tuple[int, int] | None = None
    """Number and offset at which the last request was served whole, and the next one begins if all has arrived."""

    def stop(self) -> None:
        self.entries, self.wanted = range(0), None
        if self.listing is not None:
            self.listing.cancel()
            self.listing = None
        if self.file is not None:
            self.file.close()
            self.file = None


class LogDownload:
    def __init__(
        self, ctx: Context, log_directory: LogDirectory | None, load: Callable[[], float] = lambda: 1.0
    ) -> None:
        """``load``: of the loop, 0 to 1 (no time to spare)."""
        self._ctx, self._log_directory, self._load = ctx, log_directory, load
        self._first = 1 if ctx.profile.home_is_item_0 else 0
        self._clients: LatestUsed[MavlinkPeer, _LogClient] = LatestUsed(MAX_CLIENTS, _LogClient.stop)
        self._erasing: tuple[MavlinkPeer, BackgroundTask[int]] | None = None

    def on_request_list(self, peer: MavlinkPeer, msg: Message) -> None:
        """LOG_REQUEST_LIST: an entry for each number from start to end; one of log 0 when there are none."""
        client = self._clients.touch(peer, _LogClient)
        client.stop()
        client.logs, client.entries = None, range(msg.start, msg.end + 1)

    def on_request_data(self, peer: MavlinkPeer, msg: Message) -> None:
        """LOG_REQUEST_DATA: pieces of 90 bytes; a shorter one is the last of the log."""
        client = self._clients.touch(peer, _LogClient)
        if client.file is not None and client.wanted is not None and client.wanted[0] != msg.id:
            client.file.close()
            client.file = None
        if client.end == (msg.id, msg.ofs):
            client.pace.go_on(self._load(), self._ctx.t_us)
        else:
            client.pace.start()
        client.wanted, client.end, client.sent_ticks = (msg.id, msg.ofs, msg.count), None, 0

    def on_request_end(self, peer: MavlinkPeer) -> None:
        self._clients.touch(peer, _LogClient).stop()

    def on_erase(self, peer: MavlinkPeer) -> None:
        """LOG_ERASE: deletes all finished logs of a disarmed vehicle. The result is sent as text."""
        ctx = self._ctx
        if ctx.view.armed:
            ctx.say(notices.LOGS_ARMED(), peer)
        elif self._log_directory is None:
            ctx.say(notices.LOGS_NO_FOLDER(), peer)
        elif self._erasing is None:
            ctx.say(notices.LOGS_ERASING(client=peer.name))
            for client in self._clients.values():
                client.stop()
            self._erasing = peer, self._log_directory.erase(self._tick)

    @property
    def sending(self) -> bool:
        """Whether a client is waiting for entries or data."""
        return any(client.entries or client.wanted for client in self._clients.values())

    def tick(self) -> None:
        self._go_on_erasing()
        for peer, client in tuple(self._clients.items()):
            if peer.link not in self._ctx.links:
                client.stop()
                del self._clients[peer]
                continue
            if client.logs is None and client.listing is None and (client.entries or client.wanted):
                self._list(client)
            listed = None if client.listing is None else client.listing.poll(self._tick)
            if listed is not None:
                client.listing = None
                self._listed(client, listed.value or ())
            if client.logs is not None and client.listing is None:
                self._send_entries(peer, client, client.logs)
                self._send_data(peer, client, client.logs)

    @property
    def _tick(self) -> int:
        return self._ctx.t_us // TICK_US

    def _list(self, client: _LogClient) -> None:
        """For a list, or for data by a number from before a restart or of another link."""
        if self._log_directory is None:
            self._listed(client, ())
        else:
            client.listing = self._log_directory.list(self._tick)

    def _listed(self, client: _LogClient, files: tuple[LogDirectoryEntry, ...]) -> None:
        client.logs = tuple(file for file in files if file.path.endswith(_LOG))
        last = self._first + len(client.logs) - 1
        wanted = client.entries
        if not client.logs and wanted:
            client.entries = range(-1, 0)  # the single entry that means an empty list
        else:
            client.entries = range(max(wanted.start, self._first), min(wanted.stop, last + 1))

    def _send_entries(self, peer: MavlinkPeer, client: _LogClient, logs: tuple[LogDirectoryEntry, ...]) -> None:
        count, last = len(logs), self._first + len(logs) - 1
        for _ in range(min(ENTRIES_PER_TICK, len(client.entries))):
            if not self._ctx.has_capacity(peer.link, FILES):
                return
            number, client.entries = client.entries[0], client.entries[1:]
            if number < 0:
                self._ctx.send(peer, mav.MAVLink_log_entry_message(0, 0, 0, 0, 0))
                return
            log = logs[number - self._first]
            size = min(log.size, 0xFFFF_FFFF)
            self._ctx.send(peer, mav.MAVLink_log_entry_message(number, count, last, log.modified_s & 0xFFFF_FFFF, size))

    def _send_data(self, peer: MavlinkPeer, client: _LogClient, logs: tuple[LogDirectoryEntry, ...]) -> None:
        ctx = self._ctx
        client.sent_ticks += 1
        if client.sent_ticks % PART_TICKS == 0:
            client.pace.ease(self._load(), ctx.t_us)
        for _ in range(client.pace.packets):
            if client.wanted is None or not ctx.has_capacity(peer.link, FILES):
                return
            number, offset, count = client.wanted
            file = self._file(client, logs, number)
            if file is None:
                client.wanted = None
                ctx.say(notices.LOG_MISSING(number=number), peer)
                return
            data = file.data(self._tick, offset, min(count, DATA_BYTES))
            if data is None:
                return
            if file.failed and not data:
                client.wanted = client.file = None
                ctx.say(notices.LOG_UNREADABLE(number=number), peer)
                return
            payload = _LOG_DATA.pack(offset, number, len(data), data)
            ctx.send(peer, RawMessage(mav.MAVLINK_MSG_ID_LOG_DATA, _CRC_EXTRA, payload))
            left, end = count - len(data), offset + len(data)
            goes_on = left > 0 and len(data) == DATA_BYTES
            client.wanted = (number, end, left) if goes_on else None
            client.end = None if goes_on else (number, end)

    def _file(self, client: _LogClient, logs: tuple[LogDirectoryEntry, ...], number: int) -> OpenFile | None:
        """The log that a client reads, kept open between its requests."""
        index = number - self._first
        if not 0 <= index < len(logs):
            return None
        log = logs[index]
        if client.file is None or client.file.path != log.path:
            client.file = OpenFile(log.path, log.size, log_directory=self._log_directory)
        return client.file

    def _go_on_erasing(self) -> None:
        if self._erasing is None:
            return
        peer, task = self._erasing
        answer = task.poll(self._tick)
        if answer is None:
            return
        self._erasing = None
        if answer.error is not None:
            self._ctx.say(notices.LOGS_NOT_ERASED(error=answer.error), peer)
        else:
            self._ctx.say(notices.LOGS_ERASED(count=answer.value))
