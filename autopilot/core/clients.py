"""Client numbers of a link, shared by links and service."""

from dataclasses import dataclass
from enum import IntEnum

EVERYONE = 0
"""The client number of all who are at the other end of a link."""


class Verbatim(bytes):
    """A packet of another system that is forwarded: it keeps its sequence number."""

    __slots__ = ()


class Reach(IntEnum):
    """Where a client is: this machine or the network; decides its permissions."""

    NETWORK = 0
    """Another machine, or whatever is at the end of a radio or serial line."""
    MACHINE = 1
    """A program of this machine (loopback interface)."""
    PROCESS = 2
    """A part of this service's own process."""


@dataclass(frozen=True, slots=True)
class ClientRecord:
    """Observed behaviour of a client."""

    valid_us: int | None = None
    """When a frame with a good checksum (and signature, where there is a key) last came of it; None = never."""
    in_control: bool = False
    """Whether it is the operator in control."""


UNPROVEN = ClientRecord()
"""Of a client that nobody has understood so far."""
