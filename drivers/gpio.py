"""Lines of a Linux GPIO chip: inputs and outputs."""

from typing import Any, Protocol

from autopilot.core.errors import DriverError
from autopilot.drivers.base import Closing
from autopilot.drivers.protocols import Device


class GpioLine(Device, Protocol):
    """One line. OSError when the chip has gone."""

    def get(self) -> bool: ...

    def set(self, active: bool) -> None: ...


class LinuxGpio(Closing):
    """A line of ``/dev/gpiochipN`` through gpiod (version 2)."""

    def __init__(self, chip: str, line: int, *, output: bool = False, active_low: bool = False) -> None:
        """An ``output`` is inactive when it is opened."""
        self._chip, self._line = chip, line
        self._output, self._active_low = output, active_low
        self._request: Any = None
        self._value: Any = None

    def open(self) -> None:
        """Request the line. DriverError with the reason."""
        if self._request is not None:
            return
        try:
            import gpiod
            from gpiod.line import Direction, Value
        except ModuleNotFoundError as error:
            raise DriverError(
                "GPIO needs the Python module 'gpiod'; install it with pip install 'underwater-autopilot[hardware]'"
            ) from error
        settings = gpiod.LineSettings(
            direction=Direction.OUTPUT if self._output else Direction.INPUT,
            active_low=self._active_low,
            output_value=Value.INACTIVE,
        )
        try:
            self._request = gpiod.request_lines(self._chip, {self._line: settings}, consumer="autopilot")
        except (OSError, ValueError) as error:
            raise DriverError(
                f"{self._chip} line {self._line} cannot be had ({error}); check number and rights"
            ) from error
        self._value = Value

    def close(self) -> None:
        request, self._request = self._request, None
        if request is not None:
            request.release()

    def get(self) -> bool:
        return bool(self._held().get_value(self._line) == self._value.ACTIVE)

    def set(self, active: bool) -> None:
        self._held().set_value(self._line, self._value.ACTIVE if active else self._value.INACTIVE)

    def _held(self) -> Any:
        if self._request is None:
            raise DriverError(f"{self._chip} line {self._line} is closed; open it before use")
        return self._request
