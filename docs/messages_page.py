"""Writes docs/messages.md: the texts of STATUSTEXT and of the log's events, by the table in the core.

``python docs/messages_page.py --write`` writes the page; without it, the command fails when the page is not current.
"""

import argparse
import re
import sys
from pathlib import Path

from autopilot.core import operator_messages

TABLE = Path(operator_messages.__file__)
PAGE = Path(__file__).resolve().parent / "messages.md"
HEAD = """# Messages to operators

What a text on the ground station means and what to do. Written by `python docs/messages_page.py --write` from
[operator_messages.py](../autopilot/core/operator_messages.py). Names in braces are filled in when the text is sent.
Conditions after "Failsafe" are in [failsafes.md](failsafes.md). Texts above 50 characters arrive in chunks, which
ground stations join. Every text is also in the log.
"""


def sections() -> dict[str, list[str]]:
    """Heading -> identifiers, as the table's comments divide it."""
    found: dict[str, list[str]] = {}
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        if line.startswith("# "):
            found[line[2:].partition(";")[0]] = []
        elif (row := re.match(r"([A-Z][A-Z0-9_]*) = _", line)) is not None:
            found[list(found)[-1]].append(row[1])
    return found


def page() -> str:
    parts = [HEAD]
    for heading, names in sections().items():
        parts.append(f"## {heading}\n\n| severity | text | meaning | remedy |\n| --- | --- | --- | --- |")
        for name in names:
            row = operator_messages.ROWS[name]
            text = re.sub(r"\{(\w+):[^}]*\}", r"{\1}", row.template).replace("`", "")
            parts.append(f"| {row.severity.name} | `{text}` | {row.meaning} | {row.remedy} |")
        parts.append("")
    return "\n".join(parts).rstrip() + "\n"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write docs/messages.md")
    if parser.parse_args().write:
        PAGE.write_text(page(), encoding="utf-8")
    sys.exit(0 if PAGE.is_file() and PAGE.read_text(encoding="utf-8") == page() else "run with --write")
