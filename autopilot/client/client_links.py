"""Sockets of the client, opened from pymavlink's connection strings (MAVSDK's with ``//`` are accepted too).

``udpout:HOST:PORT`` sends there, ``udpin:HOST:PORT`` waits there for the vehicle, ``tcp:HOST:PORT`` connects.
"""

import select
import socket
from typing import Protocol

from autopilot.core.errors import DriverError

_CHUNK_BYTES = 65536
_CONNECT_TIMEOUT_S = 5.0
_KINDS = {"udp": "udpin", "udpin": "udpin", "udpout": "udpout", "tcp": "tcp", "tcpout": "tcp"}
HINT = "use udpout:HOST:PORT, udpin:HOST:PORT or tcp:HOST:PORT"


class ClientLink(Protocol):
    """Byte transport between client and vehicle."""

    def send(self, data: bytes) -> None:
        """Send, or drop while no peer is known."""
        ...

    def receive(self, timeout_s: float) -> bytes:
        """Bytes received, b"" after ``timeout_s`` [s] without any."""
        ...

    def close(self) -> None: ...


def parse_connection(text: str) -> tuple[str, str, int]:
    """Split a connection string.

    Parameters
    ----------
    text
        ``udpin:HOST:PORT``, ``udpout:HOST:PORT`` or ``tcp:HOST:PORT``.

    Returns
    -------
    kind : str
        ``udpin``, ``udpout`` or ``tcp``.
    host : str
    port : int

    Raises
    ------
    DriverError
        The text is no connection string.
    """
    kind, _, rest = text.partition(":")
    host, _, port = rest.removeprefix("//").rpartition(":")
    if kind not in _KINDS or not port.isdigit() or not 0 < int(port) < 65536:
        raise DriverError(f"connection {text!r} is not understood; {HINT}")
    return _KINDS[kind], host or "127.0.0.1", int(port)


def open_link(text: str) -> ClientLink:
    """Open a connection.

    Parameters
    ----------
    text
        Connection string, see :func:`parse_connection`.

    Returns
    -------
    ClientLink
        The open socket.

    Raises
    ------
    DriverError
        It cannot be opened; the message names the connection and the remedy.
    """
    kind, host, port = parse_connection(text)
    try:
        if kind == "tcp":
            return TcpLink(host, port)
        return UdpLink(host, port, listen=kind == "udpin")
    except OSError as error:
        remedy = "is another program using the port?" if kind == "udpin" else "is the vehicle running there?"
        raise DriverError(f"connection {text!r}: {error.strerror or error}; {remedy}") from error


class UdpLink:
    """UDP to a fixed address, or to the sender of the last datagram received."""

    def __init__(self, host: str, port: int, listen: bool) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._peer: tuple[str, int] | None = None
            if listen:
                self._socket.bind((host, port))
            else:
                self._peer = (socket.gethostbyname(host), port)
        except OSError:
            self._socket.close()
            raise
        self._listen = listen
        self._socket.setblocking(False)

    def send(self, data: bytes) -> None:
        """One datagram; dropped while no peer is known or none listens. DriverError without a network."""
        if self._peer is not None:
            try:
                self._socket.sendto(data, self._peer)
            except (BlockingIOError, ConnectionError):
                return
            except OSError as error:
                raise DriverError(f"cannot send: {error.strerror or error}; check network and address") from error

    def receive(self, timeout_s: float) -> bytes:
        ready, _, _ = select.select([self._socket], [], [], max(0.0, timeout_s))
        if not ready:
            return b""
        try:
            data, peer = self._socket.recvfrom(_CHUNK_BYTES)
        except (BlockingIOError, ConnectionError):
            # ICMP "port unreachable" for an earlier datagram: no listener there yet.
            return b""
        if self._listen:
            self._peer = peer
        return data

    def close(self) -> None:
        self._socket.close()


class TcpLink:
    """TCP client of a vehicle that listens."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), timeout=_CONNECT_TIMEOUT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, data: bytes) -> None:
        """Blocks until all is sent. DriverError when the vehicle has closed the connection."""
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise DriverError(f"connection lost: {error.strerror or error}; start the vehicle and try again") from error

    def receive(self, timeout_s: float) -> bytes:
        """Bytes received. DriverError when the vehicle has closed the connection."""
        ready, _, _ = select.select([self._socket], [], [], max(0.0, timeout_s))
        if not ready:
            return b""
        try:
            data = self._socket.recv(_CHUNK_BYTES)
        except OSError as error:
            raise DriverError(f"connection lost: {error.strerror or error}; start the vehicle and try again") from error
        if not data:
            raise DriverError("connection closed by the vehicle; start it and try again")
        return data

    def close(self) -> None:
        self._socket.close()
