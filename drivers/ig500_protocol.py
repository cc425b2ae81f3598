"""Wire format of the SBG Systems IG-500 attitude references, both directions, after the manufacturer's sbgCom library.

Frame: ``FF 02 | command u8 | size u16 | data (size bytes) | crc u16 | 03``, big-endian. The CRC (reflected polynomial
0x8408, start 0, known as CRC-16/KERMIT) covers command, size and data. Measurements are frames of command 0x90 whose
data contain the fields of the output mask, in the order of the mask's bits, without the mask itself: it has to be set
before data can be decoded.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntFlag

from autopilot.core.errors import ConfigError
from autopilot.drivers.sbg_frames import SbgParser

ACKNOWLEDGE = 0x01
SET_OUTPUT_MASK, GET_OUTPUT_MASK, RETURN_OUTPUT_MASK = 0x50, 0x51, 0x52
SET_CONTINUOUS_MODE = 0x53
CONTINUOUS_OUTPUT = 0x90


class OutputField(IntFlag):
    """Supported bits of the output mask."""

    QUATERNION = 1 << 0
    EULER = 1 << 1
    MATRIX = 1 << 2
    GYRO = 1 << 3
    ACCEL = 1 << 4
    MAG = 1 << 5
    TEMPERATURE = 1 << 6
    TIME_SINCE_RESET = 1 << 11
    STATUS = 1 << 12
    ATTITUDE_ACCURACY = 1 << 21


class Ig500Status(IntFlag):
    """Bits of the device's status that are checked: 1 = good, 0 = a warning."""

    CALIBRATION = 1 << 0
    SETTINGS = 1 << 1
    ACCEL_X = 1 << 2
    ACCEL_Y = 1 << 3
    ACCEL_Z = 1 << 4
    ACCEL_RANGE = 1 << 5
    GYRO_X = 1 << 6
    GYRO_Y = 1 << 7
    GYRO_Z = 1 << 8
    GYRO_RANGE = 1 << 9


STATUS_GOOD = Ig500Status(0x3FF)
"""All that it looks at is in order."""

_LAYOUT: dict[OutputField, str] = {
    OutputField.QUATERNION: "4f",
    OutputField.EULER: "3f",
    OutputField.MATRIX: "9f",
    OutputField.GYRO: "3f",
    OutputField.ACCEL: "3f",
    OutputField.MAG: "3f",
    OutputField.TEMPERATURE: "2f",
    OutputField.TIME_SINCE_RESET: "I",
    OutputField.STATUS: "I",
    OutputField.ATTITUDE_ACCURACY: "f",
}
"""Struct codes: quaternion w x y z, Euler roll pitch yaw [rad], rad/s, m/s^2, arbitrary, deg C, ms, bits, rad."""

AHRS_MASK = (
    OutputField.QUATERNION
    | OutputField.GYRO
    | OutputField.ACCEL
    | OutputField.TIME_SINCE_RESET
    | OutputField.STATUS
    | OutputField.ATTITUDE_ACCURACY
)
"""What the driver asks the device for."""

RAW_MASK = OutputField.GYRO | OutputField.ACCEL | OutputField.MAG | OutputField.TIME_SINCE_RESET | OutputField.STATUS
"""What it asks for when the attitude is to be made on board."""


@dataclass(frozen=True, slots=True)
class Ig500Frame:
    """One frame whose checksum was right."""

    command: int
    data: bytes


class Ig500Parser(SbgParser[Ig500Frame]):
    sync, end, head_bytes, max_data, order = b"\xff\x02", 0x03, 5, 504, ">"

    def _make(self, ids: bytes, data: bytes) -> Ig500Frame:
        return Ig500Frame(ids[0], data)


def encode_frame(command: int, data: bytes = b"") -> bytes:
    return Ig500Parser.encoded(bytes([command]), data)


def encode_output_mask(mask: OutputField) -> bytes:
    """Command that chooses the fields of the continuous output, until the next power-up."""
    return encode_frame(SET_OUTPUT_MASK, struct.pack(">BI", 0, mask))


def decode_output_mask(data: bytes) -> int | None:
    """The output mask in a reply of the device; None if it is no such reply."""
    return int.from_bytes(data, "big") if len(data) == 4 else None


def encode_continuous_mode(divider: int) -> bytes:
    """Command that starts the continuous output at the filter's rate over ``divider``, until the next power-up."""
    return encode_frame(SET_CONTINUOUS_MODE, struct.pack(">BBB", 0, 1, divider))


class OutputCodec:
    """Encodes and decodes the data of 0x90 frames for one output mask. ConfigError for an unsupported bit."""

    def __init__(self, mask: OutputField) -> None:
        known = OutputField(sum(_LAYOUT))
        if int(mask) & ~int(known):
            raise ConfigError(f"IG-500 output mask 0x{int(mask):x} has unknown bits; use bits of 0x{int(known):x}")
        self.mask = mask
        self._fields = [field for field in _LAYOUT if field & mask]
        self._struct = struct.Struct(">" + "".join(_LAYOUT[field] for field in self._fields))
        self.parts: dict[OutputField, slice] = {}
        """Where the numbers of a field are in :meth:`numbers`."""
        at = 0
        for field in self._fields:
            count = int(_LAYOUT[field][:-1] or 1)
            self.parts[field] = slice(at, at + count)
            at += count

    @property
    def size(self) -> int:
        return self._struct.size

    def encode(self, values: Mapping[OutputField, tuple[float, ...]]) -> bytes:
        """Data of a frame; ``values`` holds one tuple per field of the mask (whole numbers for time and status)."""
        numbers: list[float] = []
        for field in self._fields:
            numbers += values[field]
        return self._struct.pack(*numbers)

    def numbers(self, data: bytes) -> tuple[float, ...] | None:
        """All values in a row; None if the size is not that of the mask or a number is not finite."""
        if len(data) != self._struct.size:
            return None
        numbers = self._struct.unpack(data)
        return numbers if all(map(math.isfinite, numbers)) else None

    def decode(self, data: bytes) -> dict[OutputField, tuple[float, ...]] | None:
        """Values by field; None if there are no good :meth:`numbers`."""
        numbers = self.numbers(data)
        return None if numbers is None else {field: numbers[part] for field, part in self.parts.items()}
