"""The checksum that MAVLink's file transfer and component metadata go by."""

import zlib

_ALL = 0xFFFF_FFFF


def file_crc32(data: bytes, before: int = 0) -> int:
    """CRC-32 (polynomial 0xEDB88320, begins at 0, not inverted) of ``data`` behind what gave ``before``.

    zlib's begins with all ones and is inverted at the end (https://mavlink.io/en/services/ftp.html).
    """
    return zlib.crc32(data, before ^ _ALL) ^ _ALL
