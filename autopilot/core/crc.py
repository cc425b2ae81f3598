"""MAVLink's checksums: of packets, and of file transfer and component metadata."""

import binascii
import zlib

_ALL = 0xFFFF_FFFF
MIRRORED = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))
"""Every byte with its bits in the other order."""


def file_crc32(data: bytes, before: int = 0) -> int:
    """CRC-32 (polynomial 0xEDB88320, initial value 0, not inverted) of ``data``, continued from ``before``.

    zlib's has initial value all ones and is inverted at the end (https://mavlink.io/en/services/ftp.html).
    """
    return zlib.crc32(data, before ^ _ALL) ^ _ALL


def checksum(data: bytes) -> int:
    """MAVLink's CRC-16/MCRF4XX: the standard library's CRC-CCITT of the same polynomial, bits in the other order."""
    crc = binascii.crc_hqx(data.translate(MIRRORED), 0xFFFF)
    return MIRRORED[crc & 0xFF] << 8 | MIRRORED[crc >> 8]
