"""MAVLink over TCP: a server for several clients, and a client that reconnects. Both return whole frames."""

import select
import socket
from collections.abc import Callable

from autopilot.core.clients import EVERYONE, UNPROVEN, ClientRecord, Reach
from autopilot.core.errors import DriverError
from autopilot.drivers.admission import Admission, AdmissionNotices, displaced_text
from autopilot.drivers.framing import FrameCutter
from autopilot.drivers.numbering import Numbering
from autopilot.drivers.protocols import Received
from autopilot.drivers.udp import bind_error, reach_of, resolve

CHUNK = 4096
"""Bytes taken of one connection per call: who sends more is slowed down by TCP itself."""
MAX_ACCEPTED = 4
"""Connections accepted per call."""
MAX_CLIENTS = 8
"""There is one place more (:mod:`autopilot.drivers.admission`); further clients wait in the system's queue."""
MAX_WAITING = 64
"""Length of that queue."""
GRACE_US = 1_500_000
"""Timeout for the first data of a connection (heartbeats of ground stations come every second)."""
MAX_PENDING = 262_144
"""Bytes that may wait for a slow client before it is cut off (2 s of dense telemetry would be 100 kB)."""
CONNECT_TIMEOUT_S = 3.0
"""For the first connection."""
RECONNECT_US = 1_000_000
"""Between attempts to reconnect."""
_KEEPALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 5, "TCP_KEEPCNT": 3, "TCP_USER_TIMEOUT": 20_000}
"""Seconds of silence before the system asks whether the other side is there, between its questions, how many without an
answer end the connection; the same of data that is not acknowledged [ms]. A cut tether says no goodbye."""


class _TcpConnection:
    """One open connection. OSError when it is gone already."""

    def __init__(self, connection: socket.socket, client: int, sender: str, reach: Reach) -> None:
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEPALIVE.items():
            if hasattr(socket, name):  # not available on every system
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        self._socket = connection
        self._cutter = FrameCutter()
        self._numbering = Numbering()
        self.client, self.sender, self._reach = client, sender, reach
        self._pending = bytearray()
        self.open = True
        self.spoke = False
        """Whether bytes have come; taken back by who looks."""
        self.slow = False
        """Whether it was closed because it does not read."""

    def fileno(self) -> int:
        return self._socket.fileno()

    def recv(self) -> list[Received]:
        self._flush()
        try:
            data = self._socket.recv(CHUNK)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self.close()
            return []
        self.spoke = True
        return [Received(frame, self.client, self.sender, self._reach) for frame in self._cutter.feed(data)]

    def send(self, data: bytes) -> bool:
        """Queue and send as much as the peer accepts; False if it is gone or too far behind."""
        self._pending += self._numbering(data)
        self._flush()
        if len(self._pending) > MAX_PENDING:
            self.slow = True
            self.close()
        return self.open

    def close(self) -> None:
        self.open = False
        self._socket.close()

    def _flush(self) -> None:
        if not self._pending:
            return
        try:
            sent = self._socket.send(self._pending)
        except BlockingIOError:
            return
        except OSError:
            self.close()
            return
        del self._pending[:sent]


class TcpServer:
    """Listens; every connection is a client of its own."""

    problem: str | None = None
    """A port that listens has none: clients come and go."""

    def __init__(self, name: str, host: str, port: int) -> None:
        self.name = name
        self._clients: dict[int, _TcpConnection] = {}
        """By number."""
        self._numbers = 0
        self.standing: Callable[[int], ClientRecord] = lambda client: UNPROVEN
        self._admission: Admission[int] = Admission(MAX_CLIENTS, lambda client: self.standing(client), GRACE_US)
        self._notices = AdmissionNotices()
        self._full = False
        """Whether somebody may be waiting who cannot come in now."""
        self.dropped_tx = 0
        """Clients lost while sending to them."""
        address = resolve(name, host, port)
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setblocking(False)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind(address)
            self._listener.listen(MAX_WAITING)
        except OSError as error:
            self._listener.close()
            raise bind_error(name, port, error) from error

    @property
    def clients(self) -> int:
        return len(self._clients)

    def filenos(self) -> list[int]:
        numbers = [client.fileno() for client in self._clients.values()]
        if not self._full:
            numbers.append(self._listener.fileno())
        return [number for number in numbers if number >= 0]

    def recv(self, t_us: int) -> list[Received]:
        self._admission.begin()
        self._accept(t_us)
        frames = []
        for number, client in self._clients.items():
            frames += client.recv()
            if client.spoke:
                client.spoke = False
                self._admission.note_received(number, t_us)
        self._forget_closed()
        return frames

    def send(self, data: bytes, client: int = EVERYONE, beside: frozenset[int] = frozenset()) -> None:
        for stream in self._clients.values():
            if stream.client in beside:
                continue
            if client in (EVERYONE, stream.client) and not stream.send(data):
                self.dropped_tx += 1
        self._forget_closed()

    def take_news(self) -> tuple[bool, str] | None:
        """Displaced and refused clients since the last call."""
        return self._notices.take()

    def close(self) -> None:
        for client in self._clients.values():
            client.close()
        self._clients = {}
        self._listener.close()

    def _forget_closed(self) -> None:
        for number in [number for number, client in self._clients.items() if not client.open]:
            self._admission.leave(number)
            removed = self._clients.pop(number)
            if removed.slow:
                self._notices.note(f"{removed.sender} cut off: it does not read")

    def _accept(self, t_us: int) -> None:
        """Let in who waits, as far as there are places."""
        for _ in range(MAX_ACCEPTED):
            self._full = not self._admission.has_place(t_us)
            if self._full:
                if select.select([self._listener], [], [], 0.0)[0]:
                    self._notices.note(f"a client waits for a place: {len(self._clients)} are served")
                return
            try:
                connection, address = self._listener.accept()
            except (OSError, ValueError):  # no server, or closed
                return
            self._numbers += 1
            try:
                stream = _TcpConnection(connection, self._numbers, f"{address[0]}:{address[1]}", reach_of(address[0]))
            except OSError:  # gone again
                connection.close()
                continue
            self._enter(stream, t_us)

    def _enter(self, stream: _TcpConnection, t_us: int) -> None:
        """Admit a connection, displacing another one if all places are taken."""
        entry = self._admission.enter(stream.client, t_us)
        if entry.displaced is not None:
            removed = self._clients.pop(entry.displaced.key)
            removed.close()
            self._notices.note(displaced_text(removed.sender, entry.displaced), warning=False)
        self._clients[stream.client] = stream


class TcpClient:
    """Connects to a server; reconnects while it is away, and data sent meanwhile are lost."""

    def __init__(self, name: str, host: str, port: int) -> None:
        self.name = name
        self._address = resolve(name, host, port)
        self._attempt_us = 0
        self._attempt: socket.socket | None = None
        self._closed = False
        self.dropped_tx = 0
        """Sends without a connection."""
        try:
            connection = socket.create_connection(self._address, timeout=CONNECT_TIMEOUT_S)
        except OSError as error:
            reason = error.strerror or "no answer"
            raise DriverError(
                f"link {name}: nobody answers at {host}:{port} ({reason}); start the server or correct the address"
            ) from error
        self._stream = _TcpConnection(connection, EVERYONE, name, reach_of(self._address[0]))

    @property
    def problem(self) -> str | None:
        return None if self._closed or self._stream.open else "server gone, connecting again"

    def filenos(self) -> list[int]:
        number = self._stream.fileno()
        return [] if number < 0 else [number]

    def recv(self, t_us: int) -> list[Received]:
        if self._closed:
            return []
        if self._stream.open:
            return self._stream.recv()
        if t_us - self._attempt_us >= RECONNECT_US:
            self._attempt_us = t_us
            self._reconnect()
        return []

    def send(self, data: bytes, client: int = EVERYONE, beside: frozenset[int] = frozenset()) -> None:
        if self._closed or not self._stream.open or not self._stream.send(data):
            self.dropped_tx += 1

    def close(self) -> None:
        self._closed = True
        self._stream.close()
        if self._attempt is not None:
            self._attempt.close()

    def _reconnect(self) -> None:
        """Look whether the attempt before this call succeeded; else start another. Does not wait."""
        if self._attempt is not None:
            attempt, self._attempt = self._attempt, None
            try:
                attempt.getpeername()
                self._stream = _TcpConnection(attempt, EVERYONE, self.name, reach_of(self._address[0]))
                return
            except OSError:
                attempt.close()
        try:
            self._attempt = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            self._attempt.setblocking(False)
            self._attempt.connect_ex(self._address)
        except OSError:  # no descriptors left: the next attempt will show
            return
