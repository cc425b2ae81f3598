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

What a text on the ground station means beyond its words, and what to do. Every text is also in the log.

```
autopilot log export run.mcap --topic /rosout      # the texts of a flight, as CSV
```

Names in braces are filled in when the text is sent. Conditions after "Failsafe" are in [failsafes.md](failsafes.md).
Texts above 50 characters arrive in chunks, which ground stations join. Written by
`python docs/messages_page.py --write` from [operator_messages.py](../autopilot/core/operator_messages.py).
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


def shown(row: operator_messages.Row) -> str:
    """The text without the formats of its fields; one that is all a field has none to look up."""
    if re.fullmatch(r"\{\w+\}", row.template):
        return "(varies)"
    return "`" + re.sub(r"\{(\w+):[^}]*\}", r"{\1}", row.template).replace("`", "") + "`"


def plain(rows: list[operator_messages.Row]) -> str:
    """Texts that say all themselves, by severity."""
    texts: dict[str, list[str]] = {}
    for row in sorted(rows, key=lambda row: row.severity):
        texts.setdefault(row.severity.name, []).append(shown(row))
    return "\n".join(f"* {severity}: {', '.join(found)}" for severity, found in texts.items())


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for heading, names in sections().items():
        rows = [operator_messages.ROWS[name] for name in names]
        explained = [row for row in rows if row.meaning or row.remedy]
        parts.append(f"## {heading}\n\n| severity | text | meaning, remedy |\n| --- | --- | --- |")
        parts += [
            f"| {row.severity.name} | {shown(row)} | {f'{row.meaning} {row.remedy}'.strip()} |"
            for row in sorted(explained, key=lambda row: row.severity)
        ]
        left = plain([row for row in rows if row not in explained])
        parts += ["", left, ""] if left else [""]
    return "\n".join(parts).rstrip() + "\n"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write docs/messages.md")
    if parser.parse_args().write:
        PAGE.write_text(page(), encoding="utf-8")
    sys.exit(0 if PAGE.is_file() and PAGE.read_text(encoding="utf-8") == page() else "run with --write")
