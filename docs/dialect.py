"""Generates ``autopilot/mavlink/extra_messages.py`` from ``underwater.xml`` beside it with pymavlink's generator.

``python docs/dialect.py`` writes it, ``python docs/dialect.py --check`` says whether it is current.
"""

import contextlib
import importlib
import io
import sys
import tempfile
from pathlib import Path

from pymavlink import __version__
from pymavlink.generator import mavgen

ROOM = Path(__file__).resolve().parent.parent / "autopilot" / "mavlink"
XML = ROOM / "underwater.xml"
MODULE = ROOM / "extra_messages.py"
HEAD = f"""# Generated from underwater.xml by `python docs/dialect.py` (pymavlink {__version__}): not to be edited.
# mypy: ignore-errors
"""


def generated() -> str:
    """The module's text. RuntimeError when the definitions are not accepted."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "extra_messages.py"
        said = io.StringIO()
        opts = mavgen.Opts(str(out), "2.0", language="Python3", validate=False)
        with contextlib.redirect_stdout(said):
            done = mavgen.mavgen(opts, [str(XML)])
        if not done or not out.exists():
            raise RuntimeError(f"{XML}: {said.getvalue()}")
        return HEAD + out.read_text(encoding="utf-8") + old_sizes()


def old_sizes() -> str:
    """Payload sizes of MAVLink 1, which has no extension fields: the packaged dialect of that version knows them."""
    module = importlib.import_module("pymavlink.dialects.v10.development")
    sizes = {number: kind.unpacker.size for number, kind in sorted(module.mavlink_map.items()) if 0 <= number <= 255}
    entries = [f"{number}: {size}," for number, size in sizes.items()]
    lines = ["    " + " ".join(entries[at : at + 8]) for at in range(0, len(entries), 8)]
    return "\n".join(("", "", "MAVLINK1_SIZES = {", *lines, "}", ""))


def main() -> int:
    """Write the module, or check it."""
    text = generated()
    if "--check" in sys.argv[1:]:
        current = MODULE.read_text(encoding="utf-8") == text
        print(f"{MODULE.name} is {'current' if current else 'not current: run python docs/dialect.py'}")
        return 0 if current else 1
    MODULE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
