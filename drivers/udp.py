"""MAVLink over UDP: one datagram, one entry. Sockets are non-blocking; an idle receive is one system call.

Every address is a separate client. A flood is read and dropped, so that other clients on the same socket are served.
"""

import errno
import socket
from collections.abc import Callable
from dataclasses import dataclass, field

from autopilot.core.clients import EVERYONE, UNPROVEN, ClientRecord, Reach
from autopilot.core.errors import DriverError
from autopilot.drivers.admission import KEEP_US, Admission, AdmissionNotices, displaced_text
from autopilot.drivers.numbering import Numbering
from autopilot.drivers.protocols import LOOPBACK, Received

MAX_DATAGRAM = 2048
"""Bytes; several MAVLink frames may share a datagram, none is longer than 280."""
MAX_PER_CALL = 128
"""Datagrams taken from the socket per call, so that a flood cannot hold up the caller (below a millisecond)."""
MAX_CLIENT_BYTES = 4096
"""Largest number of bytes per call and client; the rest is dropped."""
MAX_PEERS = 16
"""Clients that a port knows; there is one place more (:mod:`autopilot.drivers.admission`)."""
FORGET_US = 100_000_000
"""A client is forgotten after so much silence."""
FORGET_UNPROVEN_US = 10_000_000
"""The same of one that has never said anything valid."""
CHECK_US = 1_000_000
"""Between checks for silent clients."""
LOOPBACK_NET = "127."

Address = tuple[str, int]


def resolve(name: str, host: str, port: int) -> Address:
    """IPv4 address of a host; DriverError if there is none."""
    try:
        info = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)
    except socket.gaierror as error:
        raise DriverError(f"link {name}: host {host!r} cannot be found ({error.strerror}); check the name") from error
    address = info[0][4]
    return str(address[0]), int(address[1])


def reach_of(host: str) -> Reach:
    """Whether an address is on this machine or in the network."""
    return Reach.MACHINE if host.startswith(LOOPBACK_NET) else Reach.NETWORK


def bind_error(name: str, port: int, error: OSError) -> DriverError:
    """Message to the operator for a port that cannot be opened."""
    if error.errno == errno.EADDRINUSE:
        return DriverError(
            f"link {name}: port {port} is already in use; stop the program that uses it or give another port"
        )
    return DriverError(f"link {name}: port {port} cannot be opened ({error.strerror}); check host and rights")


@dataclass(slots=True)
class _Peer:
    client: int
    sender: str
    last_received_us: int
    reach: Reach
    numbering: Numbering = field(default_factory=Numbering)


class _Udp:
    problem: str | None = None
    """A datagram socket has none: what is sent may always get lost."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._known: dict[Address, _Peer] = {}
        """The one silent for longest first."""
        self._addresses: dict[int, Address] = {}
        self._numbers = 0
        self.standing: Callable[[int], ClientRecord] = lambda client: UNPROVEN
        self._admission: Admission[Address] = Admission(
            MAX_PEERS, lambda address: self.standing(self._known[address].client)
        )
        self._notices = AdmissionNotices()
        self._checked_us = 0
        self.dropped_tx = 0
        """Datagrams that could not be sent."""

    @property
    def peers(self) -> tuple[Address, ...]:
        """Known peers, the longest silent first."""
        return tuple(self._known)

    def filenos(self) -> list[int]:
        number = self._socket.fileno()
        return [] if number < 0 else [number]

    def close(self) -> None:
        self._socket.close()

    def recv(self, t_us: int) -> list[Received]:
        received: list[Received] = []
        bytes_of: dict[int, int] = {}
        self._admission.begin()
        for data, address in self._receive():
            peer = self._peer(t_us, address) if self._welcome(address) else None
            if peer is None:
                continue
            taken = bytes_of[peer.client] = bytes_of.get(peer.client, 0) + len(data)
            if taken <= MAX_CLIENT_BYTES:
                received.append(Received(data, peer.client, peer.sender, peer.reach))
        self._forget(t_us)
        return received

    def _welcome(self, address: Address) -> bool:
        """Whether an address may speak here at all."""
        return True

    def _expects(self, address: Address) -> bool:
        """Whether an address has a reserved place."""
        return False

    def take_news(self) -> tuple[bool, str] | None:
        """Displaced and refused clients since the last call."""
        return self._notices.take()

    def _peer(self, t_us: int, address: Address) -> _Peer | None:
        """The client of an address, now the last to have spoken; None when there is no place for another."""
        peer = self._known.pop(address, None)
        if peer is None:
            peer = self._admit(t_us, address)
            if peer is None:
                return None
        peer.last_received_us = t_us
        self._admission.note_received(address, t_us)
        self._known[address] = peer
        return peer

    def _admit(self, t_us: int, address: Address) -> _Peer | None:
        """Admit a client that is new or was silent."""
        sender = f"{address[0]}:{address[1]}"
        entry = self._admission.enter(address, t_us, always=self._expects(address))
        if entry.displaced is not None:
            removed = self._known[entry.displaced.key]
            self._drop(entry.displaced.key)
            self._notices.note(displaced_text(removed.sender, entry.displaced), warning=False)
        if not entry.admitted:
            self._notices.note(f"{sender} turned away: {len(self._known)} clients are served")
            return None
        self._numbers += 1
        peer = _Peer(self._numbers, sender, t_us, reach_of(address[0]))
        self._addresses[peer.client] = address
        return peer

    def _forget(self, t_us: int) -> None:
        if 0 <= t_us - self._checked_us < CHECK_US:
            return
        self._checked_us = t_us
        for address in self._admission.idle(t_us, FORGET_UNPROVEN_US, FORGET_US):
            self._drop(address)

    def _drop(self, address: Address) -> None:
        self._admission.leave(address)
        del self._addresses[self._known.pop(address).client]

    def _receive(self) -> list[tuple[bytes, Address]]:
        received: list[tuple[bytes, Address]] = []
        for _ in range(MAX_PER_CALL):
            try:
                received.append(self._socket.recvfrom(MAX_DATAGRAM))
            except BlockingIOError:
                break
            except ConnectionError:  # ICMP error of an earlier datagram: unrelated to this direction
                continue
            except OSError:  # closed, or the network is down
                break
        return received

    def _send_to(self, data: bytes, address: Address) -> None:
        try:
            self._socket.sendto(data, address)
        except OSError:  # full buffer, no route, closed: a datagram may always get lost
            self.dropped_tx += 1

    def _send_one(self, data: bytes, client: int) -> None:
        address = self._addresses.get(client)
        if address is None:
            self.dropped_tx += 1
        else:
            self._send_to(self._known[address].numbering(data), address)


class _Directed(_Udp):
    """A socket with a destination before any peer has sent."""

    def __init__(self, name: str, host: str, port: int) -> None:
        self._target = resolve(name, host, port)
        super().__init__(name)
        if self._target[0].startswith(LOOPBACK_NET):
            # A socket that is bound to no address would be open to the network.
            self._socket.bind((LOOPBACK, 0))
        self._numbering = Numbering()
        """Of the target, heard or not."""


class UdpOut(_Directed):
    """Sends to one address and receives from that host (any port); others are ignored."""

    def send(self, data: bytes, client: int = EVERYONE, beside: frozenset[int] = frozenset()) -> None:
        if client == EVERYONE and beside and any(self._addresses.get(other) == self._target for other in beside):
            return
        if client == EVERYONE or self._addresses.get(client) == self._target:
            self._send_to(self._numbering(data), self._target)
        else:
            self._send_one(data, client)

    def _welcome(self, address: Address) -> bool:
        return address[0] == self._target[0]

    def _expects(self, address: Address) -> bool:
        return address == self._target


class UdpBroadcast(_Directed):
    """Sends to a broadcast address, once per second, until a peer replies, and then to the peers. After KEEP_US
    without any data it broadcasts again.
    """

    def __init__(self, name: str, host: str, port: int) -> None:
        super().__init__(name, host, port)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._now_us = 0

    def recv(self, t_us: int) -> list[Received]:
        self._now_us = t_us
        return super().recv(t_us)

    def send(self, data: bytes, client: int = EVERYONE, beside: frozenset[int] = frozenset()) -> None:
        """To every client, or to one; while there is none, heartbeats to the whole network."""
        if client != EVERYONE:
            self._send_one(data, client)
            return
        if _is_heartbeat(data) and all(self._now_us - peer.last_received_us > KEEP_US for peer in self._known.values()):
            self._send_to(self._numbering(data), self._target)
        for address, peer in self._known.items():
            if peer.client not in beside:
                self._send_to(peer.numbering(data), address)


def _is_heartbeat(data: bytes) -> bool:
    """Whether a datagram is a MAVLink 2 HEARTBEAT, by which ground stations discover a vehicle."""
    return data[:1] == b"\xfd" and data[7:10] == b"\0\0\0"


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

    def send(self, data: bytes, client: int = EVERYONE, beside: frozenset[int] = frozenset()) -> None:
        if client != EVERYONE:
            self._send_one(data, client)
            return
        for address, peer in self._known.items():
            if peer.client in beside:
                continue
            self._send_to(peer.numbering(data), address)
