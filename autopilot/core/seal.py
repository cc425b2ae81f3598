"""The seal of the compiled library: what it was made of and that it is whole.

Written behind the library's last byte when it is built, read before it is loaded: the system's loader kills a process
that touches what is missing of a truncated file, and runs whatever an old one has to say. Uses the standard library
alone, for the build runs without the package's requirements.
"""

import hashlib
from pathlib import Path

MAGIC = b"\nautopilot step, sealed 1\n"
DIGEST = hashlib.sha256().digest_size


GENERATORS = ("core/model4.py", "control/nmpc/model_code.py", "control/energy/interval.py")
"""Files of the package that the generated sources come from."""


def sources_digest(folder: Path) -> bytes:
    """Of all C sources in the package's ``data/native``, and of what writes the others."""
    digest = hashlib.sha256()
    written = sorted([*folder.glob("*.c"), *folder.glob("*.h")], key=lambda path: path.name)
    for path in [*written, *(folder.parents[1] / name for name in GENERATORS)]:
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.digest()


def seal(library: Path, sources: Path) -> None:
    """Append to ``library`` what it is made of and its own digest."""
    content = library.read_bytes() + MAGIC + sources_digest(sources)
    library.write_bytes(content + hashlib.sha256(content).digest())


def flaw(library: Path, sources: Path) -> str | None:
    """What is wrong with a sealed library, None if it is whole and of these sources. OSError if it cannot be read."""
    content = library.read_bytes()
    body, digest = content[:-DIGEST], content[-DIGEST:]
    if not body[:-DIGEST].endswith(MAGIC) or hashlib.sha256(body).digest() != digest:
        return "is damaged or unfinished"
    return None if body[-DIGEST:] == sources_digest(sources) else "was built from other sources than these"
