"""MAVLink over TCP: a server for several clients, and a client that reconnects. Both hand out whole frames."""

import socket

from autopilot.core.clients import EVERYONE, Reach
from autopilot.core.errors import DriverError
from drivers.framing import FrameCutter
from drivers.numbering import Numbering
from drivers.protocols import Received
from drivers.udp import bind_error, reach_of, resolve

CHUNK = 4096
"""Bytes taken of one connection per call: who sends more is slowed down by TCP itself."""
MAX_ACCEPTED = 4
"""Connections accepted per call."""
MAX_CLIENTS = 8
"""Further clients are turned away."""
MAX_PENDING = 262_144
"""Bytes that may wait for a slow client before it is cut off (2 s of dense telemetry would be 100 kB)."""
CONNECT_TIMEOUT_S = 3.0
"""For the first connection."""
RECONNECT_US = 1_000_000
"""Between attempts to reconnect."""


class _Stream:
    """One open connection. OSError when it is gone already."""

    def __init__(self, connection: socket.socket, client: int, sender: str, reach: Reach) -> None:
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = connection
        self._cutter = FrameCutter()
        self._numbering = Numbering()
        self.client, self.sender, self._reach = client, sender, reach
        self._pending = bytearray()
        self.open = True

    def fileno(self) -> int:
        """File descriptor, negative when closed."""
        return self._socket.fileno()

    def recv(self) -> list[Received]:
        """Frames that have become complete."""
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
        return [Received(frame, self.client, self.sender, self._reach) for frame in self._cutter.feed(data)]

    def send(self, data: bytes) -> bool:
        """Queue and send what the other side takes; False if it is gone or too far behind."""
        self._pending += self._numbering(data)
        self._flush()
        if len(self._pending) > MAX_PENDING:
            self.close()
        return self.open

    def close(self) -> None:
        """Close; what is pending is lost."""
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
        self._name = name
        self._clients: list[_Stream] = []
        self._numbers = 0
        self.dropped_tx = 0
        """Clients lost while sending to them."""
        address = resolve(name, host, port)
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setblocking(False)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind(address)
            self._listener.listen(MAX_CLIENTS)
        except OSError as error:
            self._listener.close()
            raise bind_error(name, port, error) from error

    @property
    def name(self) -> str:
        """The connection string."""
        return self._name

    @property
    def clients(self) -> int:
        """How many are connected."""
        return len(self._clients)

    def filenos(self) -> list[int]:
        """The listening socket and all connections."""
        numbers = [self._listener.fileno(), *(client.fileno() for client in self._clients)]
        return [number for number in numbers if number >= 0]

    def recv(self, t_us: int) -> list[Received]:
        """Frames since the last call, client by client."""
        self._accept()
        frames = [frame for client in self._clients for frame in client.recv()]
        self._clients = [client for client in self._clients if client.open]
        return frames

    def send(self, data: bytes, client: int = EVERYONE, beside: frozenset[int] = frozenset()) -> None:
        """Send to every client, or to one."""
        for stream in self._clients:
            if stream.client in beside:
                continue
            if client in (EVERYONE, stream.client) and not stream.send(data):
                self.dropped_tx += 1
        self._clients = [client for client in self._clients if client.open]

    def close(self) -> None:
        """Close all connections and the port."""
        for client in self._clients:
            client.close()
        self._clients = []
        self._listener.close()

    def _accept(self) -> None:
        for _ in range(MAX_ACCEPTED):
            try:
                connection, address = self._listener.accept()
            except OSError:  # nobody there, or closed
                return
            if len(self._clients) >= MAX_CLIENTS:
                connection.close()
                continue
            self._numbers += 1
            try:
                sender, reach = f"{address[0]}:{address[1]}", reach_of(address[0])
                self._clients.append(_Stream(connection, self._numbers, sender, reach))
            except OSError:  # gone again
                connection.close()


class TcpClient:
    """Connects to a server; tries again while the server is away, and what is sent meanwhile is lost."""

    def __init__(self, name: str, host: str, port: int) -> None:
        self._name = name
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
        self._stream = _Stream(connection, EVERYONE, name, reach_of(self._address[0]))

    @property
    def problem(self) -> str | None:
        """Whether the server is away."""
        return None if self._closed or self._stream.open else "server gone, connecting again"

    @property
    def name(self) -> str:
        """The connection string."""
        return self._name

    def filenos(self) -> list[int]:
        """The connection, while there is one."""
        number = self._stream.fileno()
        return [] if number < 0 else [number]

    def recv(self, t_us: int) -> list[Received]:
        """Frames since the last call."""
        if self._closed:
            return []
        if self._stream.open:
            return self._stream.recv()
        if t_us - self._attempt_us >= RECONNECT_US:
            self._attempt_us = t_us
            self._reconnect()
        return []

    def send(self, data: bytes, client: int = EVERYONE, beside: frozenset[int] = frozenset()) -> None:
        """Send, or drop when there is no connection."""
        if self._closed or not self._stream.open or not self._stream.send(data):
            self.dropped_tx += 1

    def close(self) -> None:
        """Close the connection for good."""
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
                self._stream = _Stream(attempt, EVERYONE, self._name, reach_of(self._address[0]))
                return
            except OSError:
                attempt.close()
        try:
            self._attempt = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            self._attempt.setblocking(False)
            self._attempt.connect_ex(self._address)
        except OSError:  # no descriptors left: the next attempt will show
            return
