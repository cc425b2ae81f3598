"""MS5837: both kinds' formulas against the data sheets' examples, and the way there and back."""

import pytest
from emulators import MS5837_WORDS, Ms5837Chip
from hypothesis import given
from hypothesis import strategies as st

from autopilot.core.errors import DriverError
from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.ms5837 import CONVERSION_US, Kind, Ms5837, Ms5837Options, compensated, crc4
from autopilot.sitl.i2c_bus import EmulatedI2c

VEHICLE = load_vehicle("bluerov2")


@pytest.mark.parametrize(
    ("kind", "d1", "d2", "first_order_pa", "degc"),
    [("30ba", 4958179, 6815414, 399_980.0, 19.81), ("02ba", 6465444, 8077636, 110_002.0, 20.00)],
)
def test_examples_of_the_data_sheets(kind: Kind, d1: int, d2: int, first_order_pa: float, degc: float) -> None:
    pascal, celsius = compensated(kind, MS5837_WORDS[kind], d1, d2)
    assert pascal == pytest.approx(first_order_pa, abs=10.0)  # second order adds less than this near 20 degC
    assert celsius == pytest.approx(degc, abs=0.01)


@given(st.sampled_from(["30ba", "02ba"]), st.floats(-0.5, 10.0))
def test_depth_comes_back_from_the_bytes(kind: Kind, depth_m: float) -> None:
    bus = EmulatedI2c()
    bus.chips[0x76] = Ms5837Chip(kind, depth_m)
    with Ms5837(VEHICLE, Ms5837Options(kind=kind), bus=bus) as driver:
        samples = [sample for t_us in range(0, 200_000, 10_000) for sample in driver.poll(t_us)]
    assert samples
    assert all(sample.depth_m == pytest.approx(depth_m, abs=0.003) for sample in samples)
    assert samples[0].t_us == CONVERSION_US // 2  # the middle of the conversion of the pressure


@given(st.lists(st.integers(0, 0xFFFF), min_size=7, max_size=7), st.integers(16, 111))
def test_a_flipped_bit_of_the_calibration_is_noticed(words: list[int], bit: int) -> None:
    words[0] = words[0] & 0x0FFF | crc4([words[0] & 0x0FFF, *words[1:]]) << 12
    assert crc4(words) == Ms5837Chip.checksum(words)
    words[bit // 16] ^= 1 << bit % 16
    assert crc4(words) != words[0] >> 12


def test_another_sensor_at_the_address_is_refused() -> None:
    bus = EmulatedI2c()
    bus.chips[0x76] = Ms5837Chip("30ba")
    bus.noise = b"\x12\x34"
    with pytest.raises(DriverError, match="calibration words have a wrong checksum"):
        Ms5837(VEHICLE, Ms5837Options(), bus=bus).open()
