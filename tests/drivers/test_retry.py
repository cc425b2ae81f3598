"""Devices that come and go: opened beside the loop, told once, never an exception."""

from typing import Any

import pytest

from autopilot.core.errors import DriverError
from autopilot.drivers.base import Closing
from autopilot.drivers.retry import DeviceState, SteadyOutput, SteadySensor


class Plug(Closing):
    """A device with a cable that can be pulled."""

    def __init__(self) -> None:
        self.there = True
        self.speaks = True
        self.opened = self.closed = 0
        self.written: list[tuple[int, ...]] = []

    def open(self) -> None:
        if not self.there:
            raise DriverError("no such port; check the cable")
        self.opened += 1

    def close(self) -> None:
        self.closed += 1

    def poll(self, t_us: int) -> list[Any]:
        if not self.there:
            raise OSError("gone")
        return [t_us] if self.speaks else []

    def write(self, t_us: int, pwm_us: Any) -> None:
        if not self.there:
            raise DriverError("wire; check it")
        self.written.append(tuple(pwm_us))

    def check(self, t_us: int) -> bool:
        return False

    def neutral(self) -> None:
        self.written.append(())


def _run(sensor: SteadySensor, begin_s: float, end_s: float) -> int:
    """Ticks; the opener's thread gets its turn between them. The result is how many samples came."""
    count = 0
    for tick in range(round(begin_s * 100), round(end_s * 100)):
        opening = sensor._opening
        if opening is not None:
            opening.exception(timeout=10.0)
        count += len(sensor.poll(tick * 10_000))
    return count


def test_a_plug_is_pulled_and_put_back() -> None:
    plug = Plug()
    sensor = SteadySensor(plug, "Sonar")
    assert _run(sensor, 0.0, 1.0) > 90
    assert sensor.state is DeviceState.UP and not sensor.take_notices()
    plug.there = False
    assert _run(sensor, 1.0, 20.0) == 0
    assert sensor.state is DeviceState.DOWN
    texts = [text for _, text in sensor.take_notices()]
    assert texts == ["Sonar: down: gone", "Sonar: down: no such port; check the cable"]  # not at every attempt
    plug.there = True
    assert _run(sensor, 20.0, 32.0) > 100
    assert [text for _, text in sensor.take_notices()] == ["Sonar: reconnected"]
    assert (plug.opened, plug.closed) == (2, 1)
    sensor.close()


def test_a_device_that_says_nothing_is_silent_and_then_works() -> None:
    plug = Plug()
    sensor = SteadySensor(plug, "Sonar")
    plug.speaks = False
    _run(sensor, 0.0, 5.0)
    assert sensor.state is DeviceState.SILENT
    plug.speaks = True
    _run(sensor, 5.0, 5.1)
    assert sensor.state is DeviceState.UP
    assert [text for _, text in sensor.take_notices()] == [
        "Sonar: silent: check power and settings",
        "Sonar: working again",
    ]
    sensor.close()


def test_a_device_that_opens_without_anybody_there_is_no_news_until_it_is_heard() -> None:
    plug = Plug()
    sensor = SteadySensor(plug, "Sonar")
    _run(sensor, 0.0, 1.0)
    plug.speaks = False
    for begin_s in range(1, 31, 5):  # given up for its silence, and opened again
        _run(sensor, begin_s, begin_s + 5)
        sensor.lose(1_000_000 * (begin_s + 5), "silent; check the cable")
    assert plug.opened > 5
    texts = [text for _, text in sensor.take_notices()]
    assert texts == ["Sonar: silent: check power and settings", "Sonar: down: silent; check the cable"]
    plug.speaks = True
    _run(sensor, 31.0, 42.0)
    assert [text for _, text in sensor.take_notices()] == ["Sonar: reconnected"]
    sensor.close()


def test_an_output_that_is_away_says_so_at_every_write() -> None:
    plug = Plug()
    output = SteadyOutput(plug, "Thrusters")
    output.attend(0)
    assert output._opening is not None
    output._opening.exception(timeout=10.0)
    output.write(10_000, (1500,))
    assert plug.written == [(1500,)]
    plug.there = False
    for tick in range(60):
        with pytest.raises(DriverError):
            output.write(20_000 + tick * 10_000, (1500,))
    assert output.state is DeviceState.DOWN
    output.close()
