"""Wire format of SBG Systems' Ellipse references (sbgECom), both directions.

Frame: ``FF 5A | message u8 | class u8 | size u16 | data | crc u16 | 33``, little-endian, the CRC that of the IG-500
over everything between sync and itself. Logs are self-describing; later firmware appends fields.
"""

import math
import struct
from dataclasses import dataclass

from autopilot.drivers.sbg_frames import SbgParser

LOGS, COMMANDS = 0x00, 0x10
"""Classes."""
ACKNOWLEDGE, OUTPUT_CONF = 0, 30
"""Commands."""
IMU_DATA, EKF_QUATERNION = 3, 7
"""Logs."""
PORT_A = 0

ATTITUDE_VALID = 1 << 4
"""Bit of the solution's status."""
IMU_WORKS = 1 << 0
"""Bit of the inertial sensors' status: they talk to the filter."""

_IMU = struct.Struct("<IH6f")
_QUATERNION = struct.Struct("<I7fI")
_CONF = struct.Struct("<BBBH")


@dataclass(frozen=True, slots=True)
class EllipseFrame:
    """One frame whose checksum was right."""

    message: int
    kind: int
    """Class."""
    data: bytes


@dataclass(frozen=True, slots=True)
class Imu:
    """Log 3."""

    device_us: int
    status: int
    accel_frd_m_s2: tuple[float, ...]
    rate_frd_rad_s: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Attitude:
    """Log 7."""

    device_us: int
    quaternion: tuple[float, ...]
    """w x y z."""
    status: int


class EllipseParser(SbgParser[EllipseFrame]):
    sync, end, head_bytes, max_data, order = b"\xff\x5a", 0x33, 6, 4086, "<"

    def _make(self, ids: bytes, data: bytes) -> EllipseFrame:
        return EllipseFrame(ids[0], ids[1], data)


def encode_frame(message: int, kind: int, data: bytes = b"") -> bytes:
    return EllipseParser.encoded(bytes([message, kind]), data)


def encode_output(log: int, mode: int) -> bytes:
    """Command: how often a log is sent."""
    return encode_frame(OUTPUT_CONF, COMMANDS, _CONF.pack(PORT_A, log, LOGS, mode))


def encode_question(log: int) -> bytes:
    """Command: ask how often a log is sent."""
    return encode_frame(OUTPUT_CONF, COMMANDS, struct.pack("<BBB", PORT_A, log, LOGS))


def decode_output(data: bytes) -> tuple[int, int] | None:
    """(log, mode) of an order or of the device's answer; None if it is neither."""
    if len(data) != _CONF.size:
        return None
    _, log, kind, mode = _CONF.unpack(data)
    return (log, mode) if kind == LOGS else None


def decode_imu(data: bytes) -> Imu | None:
    """None if it is too short or a number is not finite."""
    if len(data) < _IMU.size:
        return None
    device_us, status, *numbers = _IMU.unpack_from(data)
    if not all(map(math.isfinite, numbers)):
        return None
    return Imu(device_us, status, tuple(numbers[0:3]), tuple(numbers[3:6]))


def decode_attitude(data: bytes) -> Attitude | None:
    """None if it is too short or a number is not finite."""
    if len(data) < _QUATERNION.size:
        return None
    device_us, *numbers, status = _QUATERNION.unpack_from(data)
    if not all(map(math.isfinite, numbers)):
        return None
    return Attitude(device_us, tuple(numbers[0:4]), status)
