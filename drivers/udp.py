"""MAVLink over UDP: one datagram, one entry. Sockets are non-blocking; an idle receive is one system call."""

import errno
import socket

from autopilot.core.errors import DriverError

MAX_DATAGRAM = 2048
"""Bytes; several MAVLink frames may share a datagram, none is longer than 280."""
MAX_PER_CALL = 256
"""Datagrams taken per call, so that a flood cannot hold up the caller."""
MAX_PEERS = 16
"""Peers that a listening port answers; the one silent for longest makes room."""
FORGET_AFTER_CALLS = 10_000
"""Receive calls without a word after which a peer is forgotten (100 s at the 100 Hz tick)."""

Address = tuple[str, int]


def resolve(name: str, host: str, port: int) -> Address:
    """IPv4 address of a host; DriverError if there is none."""
    try:
        info = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)
    except socket.gaierror as error:
        raise DriverError(f"link {name}: host {host!r} cannot be found ({error.strerror}); check the name") from error
    address = info[0][4]
    return str(address[0]), int(address[1])


def bind_error(name: str, port: int, error: OSError) -> DriverError:
    """What to tell the operator when a port cannot be listened on."""
    if error.errno == errno.EADDRINUSE:
        return DriverError(
            f"link {name}: port {port} is already in use; stop the program that uses it or give another port"
        )
    return DriverError(f"link {name}: port {port} cannot be opened ({error.strerror}); check host and rights")


class _Udp:
    """What both directions share."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self.dropped_tx = 0
        """Datagrams that could not be sent."""

    @property
    def name(self) -> str:
        """The connection string."""
        return self._name

    def close(self) -> None:
        """Let go of the port."""
        self._socket.close()

    def _receive(self) -> list[tuple[bytes, Address]]:
        received: list[tuple[bytes, Address]] = []
        while len(received) < MAX_PER_CALL:
            try:
                received.append(self._socket.recvfrom(MAX_DATAGRAM))
            except BlockingIOError:
                break
            except ConnectionError:  # an earlier datagram found nobody: says nothing about this direction
                continue
            except OSError:  # closed
                break
        return received

    def _send_to(self, data: bytes, address: Address) -> None:
        try:
            self._socket.sendto(data, address)
        except OSError:  # full buffer, no route, closed: a datagram may always get lost
            self.dropped_tx += 1


class UdpOut(_Udp):
    """Sends to one address and takes whatever comes back to the socket."""

    def __init__(self, name: str, host: str, port: int) -> None:
        self._target = resolve(name, host, port)
        super().__init__(name)

    def recv(self) -> list[bytes]:
        """Datagrams since the last call."""
        return [data for data, _ in self._receive()]

    def send(self, data: bytes) -> None:
        """Send one datagram."""
        self._send_to(data, self._target)


class UdpIn(_Udp):
    """Listens, and answers everyone who has spoken."""

    def __init__(self, name: str, host: str, port: int) -> None:
        address = resolve(name, host, port)
        super().__init__(name)
        try:
            self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            raise bind_error(name, port, error) from error
        self._calls = 0
        self._peers: dict[Address, int] = {}

    @property
    def peers(self) -> tuple[Address, ...]:
        """Who is answered, the one silent for longest first."""
        return tuple(self._peers)

    def recv(self) -> list[bytes]:
        """Datagrams since the last call."""
        self._calls += 1
        received = self._receive()
        for _, address in received:
            self._peers.pop(address, None)
            self._peers[address] = self._calls
        while self._peers:
            oldest = next(iter(self._peers))
            if len(self._peers) <= MAX_PEERS and self._calls - self._peers[oldest] <= FORGET_AFTER_CALLS:
                break
            del self._peers[oldest]
        return [data for data, _ in received]

    def send(self, data: bytes) -> None:
        """Send one datagram to every peer."""
        for address in self._peers:
            self._send_to(data, address)
