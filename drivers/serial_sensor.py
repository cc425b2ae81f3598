"""Common part of sensors on a serial line: configured when the line opens, and again after a timeout without data."""

from abc import abstractmethod
from typing import Any, Generic, TypeVar

from autopilot.core.errors import DriverError
from autopilot.drivers.base import Closing
from autopilot.drivers.framing import FrameParser
from autopilot.drivers.protocols import BytePort

S = TypeVar("S")

REQUEST_AGAIN_POLLS = 100
"""Polls without a good sample after which the device is configured again (1 s at the 100 Hz tick)."""


class SerialSensor(Closing, Generic[S]):
    """A :class:`autopilot.drivers.protocols.Sensor` on a serial line. The device is not stopped on closing."""

    def __init__(self, port: BytePort, parser: FrameParser[Any]) -> None:
        self._port, self._parser = port, parser
        self._silent_polls = 0
        self.bad_samples = 0
        """Frames that are intact but useless (wrong size, not finite, out of range, time standing still)."""

    @abstractmethod
    def _configure(self) -> None:
        """Send the configuration to the device."""

    @abstractmethod
    def _take(self, arrival_us: int, frame: Any) -> S | None:
        """The sample of a frame, None if it makes none."""

    def _begin(self) -> None:
        """Hook: the line has been opened."""

    def _too_silent(self, t_us: int, *, received: bool) -> bool:
        """Whether the device is to be configured again."""
        self._silent_polls = 0 if received else self._silent_polls + 1
        if self._silent_polls < REQUEST_AGAIN_POLLS:
            return False
        self._silent_polls = 0
        return True

    @property
    def bad_frames(self) -> int:
        """Frames dropped for their size, checksum or end."""
        return self._parser.bad_frames

    def open(self) -> None:
        self._port.open()
        self._parser.restart()
        self._begin()
        self._configure()

    def close(self) -> None:
        self._port.close()

    def poll(self, t_us: int) -> list[S]:
        """Samples that have arrived, stamped with their time of validity. DriverError when the line is gone."""
        samples = []
        for arrival_us, data in self._port.read(t_us):
            for frame in self._parser.feed(data):
                sample = self._take(arrival_us, frame)
                if sample is not None:
                    samples.append(sample)
        if getattr(self._port, "lost", False):
            raise DriverError("serial line gone, check the cable")
        if self._too_silent(t_us, received=bool(samples)):
            self._configure()
        return samples
