"""The ``with`` protocol of all drivers."""

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

G_M_S2 = 9.80665
"""Standard gravity, for depth from pressure and acceleration from g."""


class Closing(ABC):
    """Opens on entering a ``with`` block and closes on leaving it."""

    @abstractmethod
    def open(self) -> None:
        """Open the device. DriverError if it cannot be opened."""

    @abstractmethod
    def close(self) -> None:
        """Release the device. Idempotent."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class AlwaysOpen(Closing):
    """A device without resources: opening and closing are no-ops."""

    def open(self) -> None:
        """No-op."""

    def close(self) -> None:
        """No-op."""
