"""The IG-500's wire format: checksums and fields."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.errors import ConfigError
from autopilot.drivers.ig500_protocol import (
    AHRS_MASK,
    Ig500Parser,
    OutputCodec,
    OutputField,
    encode_continuous_mode,
    encode_frame,
    encode_output_mask,
)
from autopilot.drivers.sbg_frames import crc16


def bitwise_crc(data: bytes) -> int:
    """The checksum as sbgCom's documentation describes it, bit by bit."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return crc


def test_crc_check_value() -> None:
    assert crc16(b"123456789") == 0x2189  # catalogue value of CRC-16/KERMIT


@settings(deadline=None)
@given(st.binary(max_size=200))
def test_crc_is_the_bitwise_definition(data: bytes) -> None:
    assert crc16(data) == bitwise_crc(data)


def test_frame_layout() -> None:
    frame = encode_frame(0x53, b"\x00\x01\x04")
    assert frame[:8] == b"\xff\x02\x53\x00\x03\x00\x01\x04"
    assert frame[8:10] == struct.pack(">H", bitwise_crc(frame[2:8]))
    assert frame[10:] == b"\x03"


def test_commands_of_the_driver() -> None:
    assert encode_continuous_mode(4)[:8] == b"\xff\x02\x53\x00\x03\x00\x01\x04"
    assert encode_output_mask(AHRS_MASK)[:10] == b"\xff\x02\x50\x00\x05\x00\x00\x20\x18\x19"


def test_too_much_data_does_not_fit() -> None:
    with pytest.raises(ValueError, match="505 bytes"):
        encode_frame(1, bytes(Ig500Parser.max_data + 1))


FLOATS = st.floats(width=32, allow_nan=False, allow_infinity=False)


@settings(deadline=None)
@given(
    st.tuples(FLOATS, FLOATS, FLOATS, FLOATS),
    st.tuples(FLOATS, FLOATS, FLOATS),
    st.tuples(FLOATS, FLOATS, FLOATS),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**32 - 1),
    FLOATS,
)
def test_fields_round_trip_in_the_order_of_the_mask(
    quat: tuple[float, ...],
    gyro: tuple[float, ...],
    accel: tuple[float, ...],
    time_ms: int,
    status: int,
    accuracy: float,
) -> None:
    codec = OutputCodec(AHRS_MASK)
    values = {
        OutputField.ATTITUDE_ACCURACY: (accuracy,),
        OutputField.STATUS: (status,),
        OutputField.TIME_SINCE_RESET: (time_ms,),
        OutputField.ACCEL: accel,
        OutputField.GYRO: gyro,
        OutputField.QUATERNION: quat,
    }
    data = codec.encode(values)
    assert len(data) == codec.size == 52
    assert struct.unpack(">4f", data[:16]) == quat
    assert codec.decode(data) == values


def test_other_sizes_and_numbers_that_are_none_are_refused() -> None:
    codec = OutputCodec(OutputField.GYRO)
    assert codec.decode(bytes(11)) is None
    assert codec.decode(struct.pack(">3f", 0.0, float("nan"), 0.0)) is None
    assert codec.decode(struct.pack(">3f", 0.0, 1.0, 0.0)) == {OutputField.GYRO: (0.0, 1.0, 0.0)}


def test_unknown_mask_bits_are_named() -> None:
    with pytest.raises(ConfigError, match="0x40000000"):
        OutputCodec(OutputField(1 << 30))
