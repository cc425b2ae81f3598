"""The rule of all thruster outputs beyond what every driver is held to (test_output_contract.py): counts, retries."""

import pytest

from autopilot.core.errors import DriverError
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.drivers.thruster_output import SafeThrusterOutput

VEHICLE = load_vehicle("lbv150")
NEUTRAL = (1500, 1500, 1500, 1500)
TIMEOUT_US = round(VEHICLE.drive.command_timeout_s * 1e6)


class WireOutput(SafeThrusterOutput):
    """The template over a wire that remembers what it carried and can be broken."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self.carried: list[tuple[int, ...]] = []
        self.broken = False
        self.released = 0

    @property
    def pwm_us(self) -> tuple[int, ...]:
        return self.carried[-1]

    def _acquire(self) -> None:
        pass

    def _put(self, pwm_us: tuple[int, ...]) -> None:
        if self.broken:
            raise OSError("wire is cut")
        self.carried.append(pwm_us)

    def _release(self) -> None:
        self.released += 1


@pytest.fixture
def output() -> WireOutput:
    return WireOutput(VEHICLE)


def test_neutral_when_commands_stop_coming(output: WireOutput) -> None:
    with output:
        output.write(1000, (1600,) * 4)
        assert not output.check(1000 + TIMEOUT_US)
        assert output.pwm_us == (1600,) * 4
        assert output.check(1001 + TIMEOUT_US)
        assert output.pwm_us == NEUTRAL
        assert output.check(2000 + TIMEOUT_US)
        assert output.stale_count == 1
        output.write(3000 + TIMEOUT_US, (1600,) * 4)
        assert not output.check(3000 + TIMEOUT_US)
        assert output.pwm_us == (1600,) * 4


def test_pulses_beyond_the_amplifiers_are_cut_and_counted(output: WireOutput) -> None:
    with output:
        output.write(0, (3000, 0, 1900, 1100))
        assert output.pwm_us == (1900, 1100, 1900, 1100)
        assert output.clamped_count == 2


def test_neutral_is_tried_again_until_the_wire_takes_it() -> None:
    output = WireOutput(VEHICLE)
    output.open()
    output.write(0, (1600,) * 4)
    output.broken = True
    assert output.check(TIMEOUT_US + 1)
    assert output.check(TIMEOUT_US + 2)
    assert (output.stale_count, output.failed_neutral_count) == (1, 2)
    with pytest.raises(DriverError, match="neutral did not get through"):
        output.neutral()
    assert output.pwm_us == (1600,) * 4
    output.broken = False
    assert output.check(TIMEOUT_US + 3)
    assert output.pwm_us == NEUTRAL
    carried = len(output.carried)
    assert output.check(TIMEOUT_US + 4)
    assert len(output.carried) == carried  # said once, not every tick
    output.close()


def test_a_broken_wire_raises_once_and_closing_still_lets_go() -> None:
    output = WireOutput(VEHICLE)
    output.open()
    output.broken = True
    with pytest.raises(DriverError, match="wire is cut"):
        output.write(0, (1600,) * 4)
    output.close()
    assert output.released == 1
    assert output.failed_neutral_count == 2
