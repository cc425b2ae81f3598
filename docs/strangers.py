"""The table of docs/threats.md: what the service handles, by who may send it. ``--write`` puts it into the page."""

import argparse
import re
import sys
import tempfile
from pathlib import Path

from autopilot.mavlink.operators import Rights

PAGE = Path(__file__).resolve().parent / "threats.md"


def served() -> Rights:
    """Of a vehicle with a camera and everything else."""
    from autopilot.run.config import gather, sitl_defaults
    from autopilot.run.sitl_session import open_sitl

    with tempfile.TemporaryDirectory() as folder:
        settings = gather(sitl_defaults(0), {"scenario": "paper-tank", "speed": 0.0}, {})
        for name, value in (("connect", ()), ("state_dir", folder), ("log", None)):
            settings.put(name, value, "docs")
        session = open_sitl(settings, {}, log=False)
        try:
            return session.parts.server.rights()
        finally:
            session.runtime.close()
            session.recorder.close()


def table(rights: Rights) -> str:
    """As it stands in the page."""
    rows = {
        "everybody: reads, requests, measurements": rights.anyone,
        "the station in control; everybody while there is none": rights.control,
        "the same; with `MAV_CTRL_NEEDED` 1 only the station in control": rights.grave,
    }
    lines = ["| who | messages | commands |", "| --- | --- | --- |"]
    lines += [
        f"| {who} | {', '.join(messages)} | {', '.join(commands)} |" for who, (messages, commands) in rows.items()
    ]
    return "\n".join(lines)


def page_with(text: str) -> str:
    """The page with this table in it."""
    page = PAGE.read_text(encoding="utf-8")
    block = f"<!-- strangers:begin -->\n{text}\n<!-- strangers:end -->"
    pattern = r"<!-- strangers:begin -->.*?<!-- strangers:end -->"
    changed, count = re.subn(pattern, lambda _: block, page, flags=re.DOTALL)
    if count != 1:
        raise SystemExit(f"{PAGE.name}: needs one pair of strangers:begin and strangers:end lines, has {count}")
    return changed


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="put the table into docs/threats.md")
    if parser.parse_args().write:
        PAGE.write_text(page_with(table(served())), encoding="utf-8")
    else:
        sys.stdout.write(table(served()) + "\n")
