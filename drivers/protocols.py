"""The interfaces of devices to the service: sensor, byte port, thruster output, flight controller, link.

The caller passes the time (``t_us``, microseconds since the service's clock started); no driver reads a clock. Opening
may raise DriverError. Bad data from a device never raises: it is counted and dropped. Closing twice is allowed.
"""

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self, TypeVar, runtime_checkable

from autopilot.core.clients import EVERYONE, ClientRecord, Reach

if TYPE_CHECKING:  # links are opened before anything heavy is loaded
    from autopilot.core.messages import FlightControllerState, Severity

T = TypeVar("T")

LOOPBACK = "127.0.0.1"
"""The loopback interface: default for an empty host."""


class Device(Protocol):
    """Something that is opened, used inside a ``with`` block, and closed."""

    def open(self) -> None:
        """Open the device.

        Raises
        ------
        DriverError
            It cannot be opened; the text gives the reason and the remedy.
        """
        ...

    def close(self) -> None:
        """Close the device. Idempotent."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Sensor(Device, Protocol[T]):
    """A source of samples (:mod:`autopilot.core.samples`)."""

    def poll(self, t_us: int) -> list[T]:
        """Samples that have arrived up to ``t_us``, without blocking.

        Parameters
        ----------
        t_us
            The present time [us].

        Returns
        -------
        list
            Oldest first, each stamped with its time of measurement [us]; empty if there is none.

        Raises
        ------
        DriverError, OSError
            The device is gone. Bad data does not raise.
        """
        ...


@runtime_checkable
class Noticing(Protocol):
    """A sensor with messages about itself, for instance about its clock (:mod:`autopilot.core.device_clock`)."""

    def take_notices(self) -> "Sequence[tuple[Severity, str]]":
        """Messages to the operator since the last call: severity and text, without the device's name."""
        ...


class BytePort(Device, Protocol):
    """A bidirectional stream of bytes: a serial line or its emulation."""

    def read(self, t_us: int) -> list[tuple[int, bytes]]:
        """Received chunks up to ``t_us`` as (time of arrival [us], bytes), oldest first. Never blocks."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes. DriverError if the port is gone."""
        ...


class ThrusterOutput(Device, Protocol):
    """Pulses to the thruster amplifiers. Neutral when opened, closed, in error, and when commands stop coming."""

    def write(self, t_us: int, pwm_us: Sequence[int]) -> None:
        """Command the thrusters.

        Parameters
        ----------
        t_us
            The present time [us].
        pwm_us
            One pulse per thruster [us], in the order of the vehicle file; further entries are ignored.

        Raises
        ------
        DriverError
            The command did not get through; the thrusters are neutral where that is possible.
        """
        ...

    def check(self, t_us: int) -> bool:
        """Called every tick: sets neutral when the last command is too old. True while it is."""
        ...

    def neutral(self) -> None:
        """Stop all thrusters now."""
        ...


@runtime_checkable
class PayloadOutput(Protocol):
    """An output that also drives the payload (``[[payload]]`` of the vehicle file)."""

    def unwired(self) -> dict[str, str]:
        """Payload that it cannot drive: name -> reason."""
        ...

    def set_payload(self, t_us: int, pulses_us: Sequence[int]) -> None:
        """Pulses of the payload [us], in the order of the vehicle file, 0 = as it is; called every tick."""
        ...


@runtime_checkable
class WatchedOutput(Protocol):
    """An output with a watchdog process that stops it when the service cannot (:mod:`autopilot.drivers.watchdog`)."""

    @property
    def watchdog_problem(self) -> str:
        """Problem of the watchdog process, "" while it answers or none is needed."""
        ...

    @property
    def watchdog_failed(self) -> bool:
        """Whether the problem is more than the first process still starting."""
        ...


class FlightController(Sensor[Any], ThrusterOutput, Protocol):
    """A lower autopilot: it has sensors, and drives the thrusters as commanded while our commands have authority."""

    def command(self, t_us: int, *, armed: bool) -> None:
        """Called every tick before ``write``: whether our thrust commands are to act."""
        ...

    def hand_back(self, t_us: int) -> None:
        """Stop commanding and leave it armed; called after ``command`` and ``write`` of the same tick."""
        ...

    def stop(self, t_us: int) -> None:
        """Disarm it, whoever armed it; called every tick until :meth:`below` reports it disarmed."""
        ...

    def stand_down(self, t_us: int) -> bool:
        """Shutdown: called instead of ``poll`` until it returns True, for a bounded time. Disarms what we armed."""
        ...

    def below(self, t_us: int) -> "FlightControllerState":
        """State of authority and arming; called after ``poll`` on the same tick."""
        ...

    def advice(self) -> tuple[tuple[str, str], ...]:
        """Settings that could be better although it flies: (finding, remedy)."""
        ...

    def take_notices(self) -> "Sequence[tuple[Severity, str]]":
        """Its messages to the operator since the last call: severity and text."""
        ...


class Received(NamedTuple):
    """A datagram or frame with its sender."""

    data: bytes
    client: int
    """A number per address or connection, never used again for another; EVERYONE on a link with one other end."""
    sender: str
    """Name of the client for operators: address and port, or device."""
    reach: Reach = Reach.NETWORK
    """Whether the client is on this machine or in the network."""


class Link(Protocol):
    """A MAVLink connection. Transfers whole datagrams or frames only. Open from construction on.

    Nothing raises after construction: failures are counted, reported in ``problem`` and repaired when possible.
    """

    dropped_tx: int
    """Frames that could not be sent so far, or clients lost by it."""

    @property
    def problem(self) -> str | None:
        """Present problem and remedy for operators; None while there is none."""
        ...

    @property
    def name(self) -> str:
        """The connection string that opened it."""
        ...

    def recv(self, t_us: int) -> list[Received]:
        """Data received up to ``t_us``, oldest first per client, bounded in bytes per client. Never blocks."""
        ...

    def send(self, data: bytes, client: int = EVERYONE, beside: frozenset[int] = frozenset()) -> None:
        """Send data without blocking; what cannot be sent is dropped and counted.

        Parameters
        ----------
        data
            One datagram or frame.
        client
            Number of one client, or EVERYONE.
        beside
            Clients that are left out.
        """
        ...

    def filenos(self) -> list[int]:
        """File descriptors that become readable when ``recv`` has something to do; none while nothing is open."""
        ...

    def close(self) -> None:
        """Close the port. Idempotent."""
        ...


@runtime_checkable
class SharedLink(Protocol):
    """A link with a limited number of clients."""

    standing: Callable[[int], ClientRecord]
    """Client number -> what it has sent so far; set by the reader of the link."""

    def take_news(self) -> tuple[bool, str] | None:
        """Clients that were displaced or refused since the last call: whether it is a warning, and one line."""
        ...
