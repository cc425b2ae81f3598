"""Seal of the compiled library: hash of its sources and of its content.

Written into a constant of the library when it is built, checked before it is loaded: the dynamic loader kills a
process that accesses the missing part of a truncated file, and cannot detect an outdated one. Only the loaded segments
count, so that ``strip`` may remove symbols. Uses the standard library only, because the build runs without the
package's requirements.
"""

import hashlib
import struct
from pathlib import Path

MAGIC = b"autopilot library, seal 2:"
"""Of ``library_seal`` in library.c; the digests of the sources and of the library follow."""

DIGEST = hashlib.sha256().digest_size
DAMAGED = "is damaged or unfinished"

GENERATORS = ("core/model4.py", "control/nmpc/model_code.py", "control/energy/interval.py")
"""Files of the package that the generated sources come from."""

_PT_LOAD = 1
_ELF = {1: ("I", 28, "HH", 42, "IIIII", (1, 4)), 2: ("Q", 32, "HH", 54, "IIQQQQ", (2, 5))}
"""Of 32 and 64 bits: offset of the program headers and where it stands, size and number of them and where, begin of a
header, which of its numbers are offset and size within the file."""


def sources_digest(folder: Path) -> bytes:
    """Digest of all C sources in the package's ``data/native``, and of the generators of the others."""
    digest = hashlib.sha256()
    written = sorted([*folder.glob("*.c"), *folder.glob("*.h")], key=lambda path: path.name)
    for path in [*written, *(folder.parents[1] / name for name in GENERATORS)]:
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.digest()


def seal(library: Path, sources: Path) -> None:
    """Write the digests of sources and content into ``library``. ValueError if it is not this package's."""
    content = bytearray(library.read_bytes())
    begin, end = _digests(content)
    content[begin:end] = sources_digest(sources) + bytes(DIGEST)
    content[begin + DIGEST : end] = _digest(content)
    library.write_bytes(content)


def flaw(library: Path, sources: Path) -> str | None:
    """Defect of a sealed library, None if it is complete and of these sources. OSError if it cannot be read."""
    content = bytearray(library.read_bytes())
    try:
        begin, end = _digests(content)
        of_sources, own = content[begin : begin + DIGEST], content[begin + DIGEST : end]
        content[begin + DIGEST : end] = bytes(DIGEST)
        if own != _digest(content):
            return DAMAGED
    except (ValueError, KeyError, IndexError, struct.error):
        return DAMAGED
    return None if of_sources == sources_digest(sources) else "was built from other sources than these"


def _digests(content: bytearray) -> tuple[int, int]:
    """Begin and end of the two digests. ValueError without seal."""
    begin = content.index(MAGIC) + len(MAGIC)
    return begin, begin + 2 * DIGEST


def _digest(content: bytearray) -> bytes:
    """Digest of the loaded segments of an ELF file without headers; of any other file completely. ValueError if
    truncated.
    """
    if content[:4] != b"\x7fELF":
        return hashlib.sha256(content).digest()
    order, digest = "<" if content[5] == 1 else ">", hashlib.sha256()
    place, place_at, sizes, sizes_at, header, picked = _ELF[content[4]]
    (first,) = struct.unpack_from(order + place, content, place_at)
    size, count = struct.unpack_from(order + sizes, content, sizes_at)
    after_headers = first + size * count
    for i in range(count):
        numbers = struct.unpack_from(order + header, content, first + size * i)
        begin, length = (numbers[k] for k in picked)
        if begin + length > len(content):
            raise ValueError("a segment ends behind the file")
        if numbers[0] == _PT_LOAD:
            digest.update(content[max(begin, after_headers) : begin + length])
    return digest.digest()
