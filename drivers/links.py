"""MAVLink links by connection string.

| spelling | is |
| --- | --- |
| ``udpin:HOST:PORT``, ``udp:HOST:PORT``, ``udpin://HOST:PORT``, ``udp://HOST:PORT`` | listen, reply to the senders |
| ``udpout:HOST:PORT``, ``udpout://HOST:PORT`` | send to that address, receive its replies |
| ``udpbcast:HOST:PORT``, ``udpbcast://HOST:PORT`` | broadcast until somebody replies |
| ``tcpin:HOST:PORT``, ``tcpin://HOST:PORT`` | server for several clients |
| ``tcp:HOST:PORT``, ``tcp://HOST:PORT``, ``tcpout://HOST:PORT`` | client, reconnects |
| ``/dev/ttyX``, ``/dev/ttyX:57600``, ``/dev/ttyX,57600``, ``serial:///dev/ttyX:57600`` | serial line |

The first column's first spellings are pymavlink's, those with ``://`` MAVSDK's. MAVLink has no passwords: an empty
host listens on the loopback interface only; 0.0.0.0 has to be given explicitly for access from the network.
"""

from dataclasses import dataclass

from autopilot.core.errors import ConfigError
from autopilot.drivers.protocols import LOOPBACK, Link
from autopilot.drivers.registry import load_backend

DEFAULT_BAUD = 57600
"""Telemetry radios and pymavlink alike."""

_KINDS = {
    "udp": "udpin",
    "udpin": "udpin",
    "udpout": "udpout",
    "udpbcast": "udpbcast",
    "tcp": "tcpout",
    "tcpout": "tcpout",
    "tcpin": "tcpin",
}

_REMEDY = (
    "use e.g. udpout:127.0.0.1:14550, udpin:127.0.0.1:14540, tcp:127.0.0.1:5760, tcpin:0.0.0.0:5760, /dev/ttyUSB0:57600"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Connection:
    text: str
    """As it was given."""
    kind: str
    """udpin, udpout, udpbcast, tcpin, tcpout or serial."""
    address: str
    """Host, or device."""
    number: int
    """Port, or baud rate."""


def parse_connection(text: str) -> Connection:
    """Parse a connection string. ConfigError with the reason."""
    scheme, colon, rest = text.partition(":")
    if colon and scheme in _KINDS:
        rest = rest.removeprefix("//")
        host, colon, port = rest.rpartition(":")
        kind = _KINDS[scheme]
        if not colon or not port.isdigit() or not 0 < int(port) < 65536:
            raise ConfigError(f"connection {text!r} has no port between 1 and 65535; {_REMEDY}")
        if not host and kind in ("udpout", "udpbcast", "tcpout"):
            raise ConfigError(f"connection {text!r} names no host to send to; {_REMEDY}")
        return Connection(text=text, kind=kind, address=host or LOOPBACK, number=int(port))
    if scheme == "serial" or text.startswith("/") or text.upper().startswith("COM"):
        device = rest.removeprefix("//") if scheme == "serial" else text
        for separator in (",", ":"):
            name, found, baud = device.rpartition(separator)
            if found and baud.isdigit() and int(baud) > 0:
                return Connection(text=text, kind="serial", address=name, number=int(baud))
        if device:
            return Connection(text=text, kind="serial", address=device, number=DEFAULT_BAUD)
    raise ConfigError(f"connection {text!r} is not understood; {_REMEDY}")


def open_link(text: str) -> Link:
    """An open link. ConfigError for a malformed string; DriverError when the port or device cannot be had."""
    connection = parse_connection(text)
    link: Link = load_backend("link", connection.kind)(connection.text, connection.address, connection.number)
    return link
