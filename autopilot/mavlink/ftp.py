"""MAVFTP: clients read metadata and logs. https://mavlink.io/en/services/ftp.html

Read-only. One open file per client; a retransmitted request (the same bytes) gets the same answer. A burst has
a pace and pauses while the link's budget is used up (:mod:`autopilot.mavlink.budget`). It ends until the client
requests more, so that a client that has left is not sent a whole log.
"""

import struct
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Protocol

from autopilot.core.background import BackgroundTask
from autopilot.core.clock import TICK_US
from autopilot.core.crc import file_crc32
from autopilot.core.log_directory import LogDirectory, LogDirectoryEntry
from autopilot.mavlink.bounded_table import LatestUsed
from autopilot.mavlink.budget import FILES, Pace
from autopilot.mavlink.context import MavlinkPeer
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.files import LOGS, FolderEntry, OpenFile, folder_entries, parts_of
from autopilot.mavlink.wire import Message, RawMessage

BURST_PACKETS, BURST_TICKS = 256, 8
"""Packets per burst (60 kB), but at least so many ticks of them; the client requests the next one."""
MAX_CLIENTS = 16
"""Clients whose files are kept open; beyond that the oldest is closed."""
MAX_DATA = 239

_HEADER = struct.Struct("<HBBBBBxI")
"""Sequence number, session, opcode, size, opcode asked for, end of a burst, offset."""
_PAYLOAD_BYTES = 251
_CRC_EXTRA = mav.MAVLink_file_transfer_protocol_message.crc_extra


class Outlet(Protocol):
    """Interface to the clients: :class:`autopilot.mavlink.context.Context`, or a service that is starting."""

    @property
    def t_us(self) -> int: ...

    @property
    def links(self) -> Container[int]: ...

    def send(self, to: MavlinkPeer, message: Message) -> None: ...

    def has_capacity(self, link: int, fraction: float) -> bool:
        """Whether a link can carry low-priority messages."""
        ...


class Op(IntEnum):
    NONE = 0
    TERMINATE = 1
    RESET = 2
    LIST = 3
    OPEN_READ = 4
    READ = 5
    CREATE = 6
    WRITE = 7
    REMOVE = 8
    MAKE_FOLDER = 9
    REMOVE_FOLDER = 10
    OPEN_WRITE = 11
    TRUNCATE = 12
    RENAME = 13
    CRC32 = 14
    BURST = 15
    ACK = 128
    NAK = 129


class Error(IntEnum):
    """NAK error codes of MAVLink FTP (https://mavlink.io/en/services/ftp.html)."""

    FAIL = 1
    INVALID_SIZE = 3
    INVALID_SESSION = 4
    EOF = 6
    UNKNOWN_COMMAND = 7
    PROTECTED = 9
    NOT_FOUND = 10


_WRITING = frozenset(
    (Op.CREATE, Op.WRITE, Op.REMOVE, Op.MAKE_FOLDER, Op.REMOVE_FOLDER, Op.OPEN_WRITE, Op.TRUNCATE, Op.RENAME)
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FtpPacket:
    """A received request, or an answer to be sent."""

    seq: int
    session: int
    opcode: int
    size: int
    offset: int
    data: bytes

    def following(self, sent: int) -> "FtpPacket":
        """The next packet of a burst; made ten thousand times a second."""
        return FtpPacket(
            seq=self.seq + 1,
            session=self.session,
            opcode=self.opcode,
            size=self.size,
            offset=self.offset + sent,
            data=self.data,
        )

    @property
    def path(self) -> str:
        return self.data.split(b"\0", 1)[0].decode("utf-8", errors="replace")


def request_of(payload: bytes) -> FtpPacket:
    """The request in a FILE_TRANSFER_PROTOCOL message."""
    seq, session, opcode, size, _, _, offset = _HEADER.unpack_from(payload)
    data = payload[_HEADER.size : _HEADER.size + min(size, MAX_DATA)]
    return FtpPacket(seq=seq, session=session, opcode=opcode, size=size, offset=offset, data=data)


@dataclass(slots=True)
class _FtpClient:
    file: OpenFile | None = None
    session: int = 0
    """Session id, taken from the client's open request."""
    answered: tuple[FtpPacket, Message] | None = None
    """The last request and its answer."""
    waiting: FtpPacket | None = None
    """Request that waits for the disk."""
    listing: BackgroundTask[tuple[LogDirectoryEntry, ...]] | None = None
    crc: BackgroundTask[int] | None = None
    burst: FtpPacket | None = None
    """Active burst: offset and sequence number of its next packet."""
    burst_left: int = 0
    burst_request_seq: int = 0
    """The number of its request."""
    pace: Pace = field(default_factory=Pace)
    arrived: int | None = None
    """Where the last burst ended, and the next one begins if it has arrived; None = it was held up by the link."""
    sent_tick: int = 0
    sent: int = 0
    """Packets of bursts in that tick."""

    def stop(self) -> None:
        """Nothing is waited for any more."""
        for task in (self.listing, self.crc):
            if task is not None:
                task.cancel()
        self.waiting = self.listing = self.crc = self.burst = None

    def close(self) -> None:
        self.stop()
        if self.file is not None:
            self.file.close()
            self.file = None


class FileTransfer:
    """The file transfer microservice.

    ``files``: files in memory, by name; ``log_directory``: the log directory, None without; ``made``: files generated
    on opening, by client and path, None = no such file; ``load``: of the loop, 0 to 1 (no time to spare).
    """

    def __init__(
        self,
        ctx: Outlet,
        files: Mapping[str, bytes],
        log_directory: LogDirectory | None,
        made: Callable[[MavlinkPeer, str], bytes | None] = lambda peer, path: None,
        load: Callable[[], float] = lambda: 1.0,
    ) -> None:
        self._ctx, self._files, self._log_directory, self._made = ctx, files, log_directory, made
        self._load = load
        self._clients: LatestUsed[MavlinkPeer, _FtpClient] = LatestUsed(MAX_CLIENTS, _FtpClient.close)

    def on_message(self, peer: MavlinkPeer, msg: Message) -> None:
        request = request_of(bytes(msg.payload))
        if request.opcode in (Op.ACK, Op.NAK):
            return
        client = self._clients.touch(peer, _FtpClient)
        before = client.answered
        if before is not None and before[0] == request and client.burst is None:
            self._ctx.send(peer, before[1])
            return
        running = client.burst is not None and request.opcode == Op.BURST and request.seq == client.burst_request_seq
        if running or client.waiting == request:
            return
        client.stop()
        self._begin(peer, client, request)

    @property
    def sending(self) -> bool:
        """Whether a client is waiting for the disk or for the rest of a burst."""
        return any(client.waiting or client.burst for client in self._clients.values())

    def tick(self) -> None:
        """Answer requests whose disk access is done, continue bursts."""
        for peer, client in tuple(self._clients.items()):
            if peer.link not in self._ctx.links:
                client.close()
                del self._clients[peer]
            elif client.waiting is not None:
                self._go_on(peer, client, client.waiting)
            elif client.burst is not None:
                self._go_on_burst(peer, client)

    @property
    def _tick(self) -> int:
        return self._ctx.t_us // TICK_US

    def _begin(self, peer: MavlinkPeer, client: _FtpClient, request: FtpPacket) -> None:
        match request.opcode:
            case Op.NONE:
                self._ack(peer, client, request)
            case Op.TERMINATE | Op.RESET:
                client.close()
                self._ack(peer, client, request)
            case Op.LIST | Op.OPEN_READ | Op.CRC32:
                self._begin_path(peer, client, request)
            case Op.READ | Op.BURST:
                self._begin_data(peer, client, request)
            case opcode if opcode in _WRITING:
                self._nak(peer, client, request, Error.PROTECTED)
            case _:
                self._nak(peer, client, request, Error.UNKNOWN_COMMAND)

    def _begin_path(self, peer: MavlinkPeer, client: _FtpClient, request: FtpPacket) -> None:
        parts = parts_of(request.path)
        made = self._made(peer, "/".join(parts)) if parts and request.opcode == Op.OPEN_READ else None
        if parts is None:
            self._nak(peer, client, request, Error.NOT_FOUND)
        elif made is not None:
            self._open(peer, client, request, OpenFile("/".join(parts), len(made), made))
        elif request.opcode == Op.LIST and not parts:
            self._answer_list(peer, client, request, ())
        elif len(parts) == 1 and parts[0] in self._files and request.opcode != Op.LIST:
            content = self._files[parts[0]]
            if request.opcode == Op.OPEN_READ:
                self._open(peer, client, request, OpenFile(parts[0], len(content), content))
            else:
                self._ack(peer, client, request, file_crc32(content).to_bytes(4, "little"))
        elif parts and parts[0] == LOGS and self._log_directory is not None:
            client.waiting = request
            if request.opcode == Op.CRC32:
                client.crc = self._log_directory.crc32(self._tick, "/".join(parts[1:]))
            else:
                client.listing = self._log_directory.list(self._tick)
        elif parts == (LOGS,) and request.opcode == Op.LIST:
            self._answer_list(peer, client, request, ())
        else:
            self._nak(peer, client, request, Error.NOT_FOUND)

    def _begin_data(self, peer: MavlinkPeer, client: _FtpClient, request: FtpPacket) -> None:
        if client.file is None or request.session != client.session:
            self._nak(peer, client, request, Error.INVALID_SESSION)
        elif request.offset >= client.file.size:
            self._nak(peer, client, request, Error.EOF)
        elif request.opcode == Op.READ:
            client.waiting = request
            client.pace.start()
            self._go_on(peer, client, request)
        else:
            if client.arrived == request.offset:
                client.pace.go_on(self._load(), self._ctx.t_us)
            else:
                client.pace.start()
            client.burst, client.arrived = replace(request, seq=request.seq + 1), request.offset
            client.burst_left = max(BURST_PACKETS, BURST_TICKS * client.pace.packets)
            client.burst_request_seq, client.answered = request.seq, None
            self._go_on_burst(peer, client)

    def _go_on(self, peer: MavlinkPeer, client: _FtpClient, request: FtpPacket) -> None:
        """Serve a request that waits for the disk."""
        if request.opcode == Op.READ:
            self._go_on_read(peer, client, request)
        elif client.crc is not None:
            crc = client.crc.poll(self._tick)
            if crc is not None and crc.value is None:
                self._nak(peer, client, request, Error.NOT_FOUND)
            elif crc is not None and crc.value is not None:
                self._ack(peer, client, request, crc.value.to_bytes(4, "little"))
        elif client.listing is not None:
            listed = client.listing.poll(self._tick)
            if listed is not None:
                self._go_on_listed(peer, client, request, listed.value or ())

    def _go_on_listed(
        self, peer: MavlinkPeer, client: _FtpClient, request: FtpPacket, logs: tuple[LogDirectoryEntry, ...]
    ) -> None:
        if request.opcode == Op.LIST:
            self._answer_list(peer, client, request, logs)
            return
        wanted = "/".join((parts_of(request.path) or ())[1:])
        found = next((log for log in logs if log.path == wanted), None)
        if found is None:
            self._nak(peer, client, request, Error.NOT_FOUND)
        else:
            self._open(peer, client, request, OpenFile(found.path, found.size, log_directory=self._log_directory))

    def _go_on_read(self, peer: MavlinkPeer, client: _FtpClient, request: FtpPacket) -> None:
        file = client.file
        if file is None:
            self._nak(peer, client, request, Error.INVALID_SESSION)
            return
        data = file.data(self._tick, request.offset, _wanted(request))
        if data:
            self._ack(peer, client, request, data)
        elif data is not None:
            self._nak(peer, client, request, Error.FAIL if file.failed else Error.EOF)

    def _go_on_burst(self, peer: MavlinkPeer, client: _FtpClient) -> None:
        if client.sent_tick != self._tick:
            client.sent_tick, client.sent = self._tick, 0
        while client.sent < client.pace.packets:
            burst, file = client.burst, client.file
            if burst is None or file is None:
                return
            if not self._ctx.has_capacity(peer.link, FILES):
                client.arrived = None
                return
            data = file.data(self._tick, burst.offset, _wanted(burst))
            if data is None:
                return
            if not data:
                client.burst = None
                self._send(peer, burst.seq, Op.NAK, burst, bytes((Error.FAIL if file.failed else Error.EOF,)))
                return
            client.sent += 1
            client.burst_left -= 1
            if client.arrived is not None:
                client.arrived = burst.offset + len(data)
            last = client.burst_left == 0
            self._send(peer, burst.seq, Op.ACK, burst, data, last=last)
            client.burst = None if last else burst.following(len(data))

    def _open(self, peer: MavlinkPeer, client: _FtpClient, request: FtpPacket, file: OpenFile) -> None:
        client.close()
        client.file, client.session = file, request.session
        self._ack(peer, client, request, min(file.size, 0xFFFF_FFFF).to_bytes(4, "little"))

    def _answer_list(
        self, peer: MavlinkPeer, client: _FtpClient, request: FtpPacket, logs: tuple[LogDirectoryEntry, ...]
    ) -> None:
        """Entries from the requested index on, as many as fit."""
        entries = folder_entries(self._files, logs, request.path)
        if entries is None:
            self._nak(peer, client, request, Error.NOT_FOUND)
            return
        data = b""
        for entry in entries[request.offset :]:
            line = _line_of(entry)
            if len(data) + len(line) > MAX_DATA:
                break
            data += line
        if data:
            self._ack(peer, client, request, data)
        else:
            self._nak(peer, client, request, Error.EOF)

    def _ack(self, peer: MavlinkPeer, client: _FtpClient, request: FtpPacket, data: bytes = b"") -> None:
        self._answer(peer, client, request, Op.ACK, data)

    def _nak(self, peer: MavlinkPeer, client: _FtpClient, request: FtpPacket, error: Error) -> None:
        self._answer(peer, client, request, Op.NAK, bytes((error,)))

    def _answer(self, peer: MavlinkPeer, client: _FtpClient, request: FtpPacket, opcode: Op, data: bytes) -> None:
        client.stop()
        message = self._send(peer, request.seq + 1, opcode, request, data)
        client.answered = request, message

    def _send(
        self, peer: MavlinkPeer, seq: int, opcode: Op, to: FtpPacket, data: bytes, *, last: bool = False
    ) -> Message:
        head = _HEADER.pack(seq & 0xFFFF, to.session, opcode, len(data), to.opcode, last, to.offset)
        payload = bytes((0, peer.sysid, peer.compid)) + (head + data).ljust(_PAYLOAD_BYTES, b"\0")
        message = RawMessage(mav.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL, _CRC_EXTRA, payload)
        self._ctx.send(peer, message)
        return message


def _line_of(entry: FolderEntry) -> bytes:
    """Of a listing. A name that is no text, or too long for a message, is skipped but counted, as clients ask for the
    rest of a folder by the number of its first entry."""
    name = f"D{entry.name}" if entry.size is None else f"F{entry.name}\t{entry.size}"
    line = name.encode(errors="replace") + b"\0"
    return line if entry.name.isprintable() and len(line) <= MAX_DATA else b"S\0"


def _wanted(request: FtpPacket) -> int:
    """Bytes per read requested; by default as many as fit."""
    return min(request.size, MAX_DATA) or MAX_DATA
