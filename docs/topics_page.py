"""Writes docs/topics.md: every topic of a log with every field, from the schemas and docs/topics.csv.

``python docs/topics_page.py --write`` writes the page; without it, what is not documented is named.
"""

import argparse
import csv
import sys
from pathlib import Path

from autopilot.log.cdr import CdrField
from autopilot.log.schemas import definition, types_of
from autopilot.log.topics import AID_PREFIX, TOPICS

HERE = Path(__file__).resolve().parent
PAGE, TABLE = HERE / "topics.md", HERE / "topics.csv"
OWN = "autopilot_msgs/"
AID = AID_PREFIX + "<sensor>"
HEAD = """# Topics and fields

Every topic of a log: message type, rate, meaning and fields.

<!-- tested -->
```
autopilot log info out/demo/run.mcap      # topics and rates of a log
```

A field's name ends with its SI unit and holds its frame: `pos_ned_m` in NED and metres, `vel_frd_m_s` in body axes and
m/s; `us` is microseconds. It is float64 unless a type is given. Every message begins with a `header` (stamp = log time,
frame) unless its standard type has none. Types of `autopilot_msgs` are of fixed size, their arrays 0 beyond what is
used; every file contains all definitions. "On change" topics are also written once per second. `/sim` and `/viz/truth`:
simulation only.

Written by `python docs/topics_page.py --write` from `docs/topics.csv` and the tables
in `autopilot/log` (`sample_table.py`, `record_table.py`).
"""


def described() -> dict[str, tuple[str, str]]:
    """Topic -> rate and text."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        return {row["topic"]: (row["rate"], row["what"]) for row in csv.DictReader(file)}


def comments(name: str) -> dict[str, str]:
    """Comments of the fields of ``package/Name``, by name; a field without a comment is left out."""
    found = {}
    for line in definition(name).split("=" * 80)[0].strip().splitlines():
        head, hash_sign, text = line.partition("#")
        if hash_sign and head.strip():
            found[head.split()[1]] = text.strip()
    return found


def missing() -> list[str]:
    """What has no text: topics and fields of our own types."""
    texts_of = described()
    found = [f"topic {topic}: no row in docs/topics.csv" for topic in (*TOPICS, AID) if topic not in texts_of]
    found += [
        f"topic {topic}: in docs/topics.csv, but not in TOPICS" for topic in texts_of if topic not in {*TOPICS, AID}
    ]
    for kind in sorted({*TOPICS.values(), "autopilot_msgs/AidStatus"}):
        if kind.startswith(OWN):
            texts = comments(kind)
            fields = [field.name for field in types_of(kind)[kind] if field.name != "header"]
            found += [
                f"{kind}.{name}: no comment in its table in autopilot/log" for name in fields if not texts.get(name)
            ]
    return found


def field_line(field: CdrField, text: str) -> str:
    """A field of our own types: name with size, type unless it is float64, meaning."""
    size = "" if field.count is None else f"[{field.count}]"
    kind = "" if field.type == "float64" else f" {field.type}"
    return f"* `{field.name}{size}`{kind}: {text.replace(', unused = 0', '')}"


def page() -> str:
    texts_of = described()
    parts = [HEAD]
    first: dict[str, str] = {}
    for topic, kind in sorted({**TOPICS, AID: "autopilot_msgs/AidStatus"}.items()):
        rate, text = texts_of.get(topic, ("", ""))
        parts.append(f"## {topic}\n\n`{kind}`, {rate}: {text}.\n")
        if kind in first:
            parts.append(f"Fields as `{first[kind]}`.\n")
        elif kind.startswith(OWN):
            first[kind] = topic
            texts = comments(kind)
            own = [field for field in types_of(kind)[kind] if field.name != "header"]
            parts.append("\n".join(field_line(field, texts.get(field.name, "")) for field in own) + "\n")
    return "\n".join(parts)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write docs/topics.md")
    if parser.parse_args().write:
        PAGE.write_text(page(), encoding="utf-8")
    sys.exit("\n".join(missing()) or 0)
