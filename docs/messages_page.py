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

Meaning and remedy of the texts on a ground station, where the text does not say all. Every text is also in the log.

<!-- tested -->
```
autopilot log export out/demo/run.mcap --topic /rosout      # the texts of a flight, as CSV
```

Names in braces are filled in when the text is sent; texts without an explanation stand last in their group. Conditions
after "Failsafe" are in [failsafes.md](failsafes.md). Texts above 50 characters arrive in chunks, which ground stations
join. By `python docs/messages_page.py --write` from [operator_messages.py](../autopilot/core/operator_messages.py).
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


def listed(rows: list[operator_messages.Row]) -> list[str]:
    """Texts of one severity: those to explain line by line, then those that say all themselves."""
    lines = [f"* {shown(row)}: {f'{row.meaning} {row.remedy}'.strip()}" for row in rows if row.meaning or row.remedy]
    plain = [shown(row) for row in rows if not (row.meaning or row.remedy)]
    return [*lines, f"* {', '.join(plain)}"] if plain else lines


def page() -> str:
    parts = [HEAD]
    for heading, names in sections().items():
        parts.append(f"## {heading}\n")
        rows = [operator_messages.ROWS[name] for name in names]
        for severity in sorted({row.severity for row in rows}):
            parts += [f"**{severity.name}**\n", *listed([row for row in rows if row.severity == severity]), ""]
    return "\n".join(parts).rstrip() + "\n"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write docs/messages.md")
    if parser.parse_args().write:
        PAGE.write_text(page(), encoding="utf-8")
    sys.exit(0 if PAGE.is_file() and PAGE.read_text(encoding="utf-8") == page() else "run with --write")
