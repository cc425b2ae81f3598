"""What every device looks like to the service: a sensor, a byte port, a thruster output, a link.

Time is handed in by the caller (``t_us``, microseconds since the service's clock started); no driver reads a clock.
Opening may raise DriverError; bad data from a device never raises, it is counted and dropped. Closing twice is allowed.
"""

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self, TypeVar, runtime_checkable

from autopilot.core.clients import EVERYONE, ClientRecord, Reach

if TYPE_CHECKING:  # links are opened before anything heavy is loaded
    from autopilot.core.messages import Below, Severity

T = TypeVar("T")

LOOPBACK = "127.0.0.1"
"""This machine, for itself only: what an empty host means."""


class Device(Protocol):
    """Something that is opened, used inside a ``with`` block, and closed."""

    def open(self) -> None:
        """Take hold of the device; DriverError says why it cannot be had and what to do."""
        ...

    def close(self) -> None:
        """Let go of the device. Idempotent."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Sensor(Device, Protocol[T]):
    """A source of samples (:mod:`autopilot.core.messages`)."""

    def poll(self, t_us: int) -> list[T]:
        """What has arrived up to ``t_us``, oldest first. Never blocks, never raises because of bad data."""
        ...


@runtime_checkable
class Noticing(Protocol):
    """A sensor that has something to say of itself, for instance of its clock (:mod:`autopilot.core.device_clock`)."""

    def take_notices(self) -> "Sequence[tuple[Severity, str]]":
        """What operators should know since the last call; the device's name is put before it."""
        ...


class BytePort(Device, Protocol):
    """A stream of bytes in both directions: a serial line, or what stands for one."""

    def read(self, t_us: int) -> list[tuple[int, bytes]]:
        """What has arrived up to ``t_us``: (time of arrival [us], bytes), oldest first. Never blocks."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes. DriverError if the port is gone."""
        ...


class ThrusterOutput(Device, Protocol):
    """Pulses to the thruster amplifiers. Neutral when opened, closed, in error, and when commands stop coming."""

    def write(self, t_us: int, pwm_us: Sequence[int]) -> None:
        """Command one pulse per thruster [us]; entries beyond the last thruster are ignored."""
        ...

    def check(self, t_us: int) -> bool:
        """To be called every tick: goes to neutral when the last command is too old; True while it is."""
        ...

    def neutral(self) -> None:
        """Stop all thrusters now."""
        ...


@runtime_checkable
class PayloadOutput(Protocol):
    """An output that also moves what the vehicle carries (``[[payload]]`` of the vehicle file)."""

    def unwired(self) -> dict[str, str]:
        """Things that it cannot move, by name, and why."""
        ...

    def set_payload(self, t_us: int, pulses_us: Sequence[int]) -> None:
        """What all of it is to get, in the order of the vehicle file; called on every tick."""
        ...


@runtime_checkable
class WatchedOutput(Protocol):
    """An output that a process beside the service stops when the service cannot (:mod:`autopilot.drivers.watchdog`)."""

    @property
    def watchdog_problem(self) -> str:
        """What is wrong with that process, "" while it answers or none is needed."""
        ...

    @property
    def watchdog_failed(self) -> bool:
        """Whether that is more than that the first one is starting."""
        ...


class FlightController(Sensor[Any], ThrusterOutput, Protocol):
    """An autopilot below ours: it measures, and drives the thrusters with what we ask for as long as it is asked to."""

    def command(self, t_us: int, *, armed: bool) -> None:
        """To be called every tick before ``write``: whether our thrust is meant to act."""
        ...

    def hand_back(self, t_us: int) -> None:
        """Nothing is commanded any more, and it is left armed; after ``command`` and ``write`` of the same tick."""
        ...

    def stop(self, t_us: int) -> None:
        """Disarm it, whoever armed it; called on every tick until :meth:`below` says that it is not armed."""
        ...

    def stand_down(self, t_us: int) -> bool:
        """The service ends: called instead of ``poll`` until True, or for a bounded time. Disarms what is ours."""
        ...

    def below(self, t_us: int) -> "Below":
        """Who has the vehicle now. After ``poll`` on the same tick."""
        ...

    def advice(self) -> tuple[tuple[str, str], ...]:
        """What could be set better though it flies, and how."""
        ...

    def take_notices(self) -> "Sequence[tuple[Severity, str]]":
        """What it says that operators should know, since the last call."""
        ...


class Received(NamedTuple):
    """A datagram or frame, and who sent it."""

    data: bytes
    client: int
    """A number per address or connection, never used again for another; EVERYONE on a link with one other end."""
    sender: str
    """The client as operators know it: address and port, or device."""
    reach: Reach = Reach.NETWORK
    """How far away it is."""


class Link(Protocol):
    """A MAVLink connection. Whole datagrams or whole frames, never a part of one. Open from construction on.

    Nothing raises after construction: what breaks is counted, shown in ``problem``, and mended when that is possible.
    """

    dropped_tx: int
    """What could not be sent so far: frames, or clients that were lost."""

    @property
    def problem(self) -> str | None:
        """What is wrong now and what to do, for operators; None while all is well."""
        ...

    @property
    def name(self) -> str:
        """The connection string that opened it."""
        ...

    def recv(self, t_us: int) -> list[Received]:
        """What has come up to ``t_us``, oldest first per client, bounded in bytes per client. Never blocks."""
        ...

    def send(self, data: bytes, client: int = EVERYONE, beside: frozenset[int] = frozenset()) -> None:
        """Send to everyone at the other end (but those ``beside``), or to one client. Never blocks: what cannot be sent
        is dropped and counted."""
        ...

    def filenos(self) -> list[int]:
        """File descriptors that become readable when ``recv`` has something to do; none while nothing is open."""
        ...

    def close(self) -> None:
        """Let go of the port. Idempotent."""
        ...


@runtime_checkable
class SharedLink(Protocol):
    """A link with places for so many clients and no more."""

    standing: Callable[[int], ClientRecord]
    """What a client (its number) has shown of itself; set by who reads what the link brings."""

    def take_news(self) -> tuple[bool, str] | None:
        """Who lost his place or found none since the last call: whether it is a warning, and a line."""
        ...
