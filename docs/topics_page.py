"""Writes docs/topics.md: every topic of a log with every field, from the schemas and docs/topics.csv.

``python docs/topics_page.py --write`` writes the page; without it, what is not documented is named.
"""

import argparse
import csv
import sys
from pathlib import Path

from autopilot.log.cdr import CdrField
from autopilot.log.schemas import own_comments as comments
from autopilot.log.schemas import types_of
from autopilot.log.topics import AID_PREFIX, TOPICS

HERE = Path(__file__).resolve().parent
PAGE, TABLE = HERE / "topics.md", HERE / "topics.csv"
OWN = "autopilot_msgs/"
AID = AID_PREFIX + "<sensor>"
UNITS = (
    *(("_rad_s", "rad/s"), ("_m_s2", "m/s²"), ("_m_s", "m/s"), ("_rad", "rad"), ("_deg", "deg"), ("_us", "µs")),
    *(("_m", "m"), ("_n", "N"), ("_s", "s"), ("_j", "J"), ("_w", "W"), ("_v", "V"), ("_a", "A"), ("_c", "°C")),
    *(("_pa", "Pa"), ("_px", "px")),
)
FRAMES = ("ned", "frd", "cam")
HEAD = """# Topics and fields

Which topics and fields does a log have? Written by `python docs/topics_page.py --write` from `docs/topics.csv` and
the tables in `autopilot/log` (`sample_table.py`, `record_table.py`). `autopilot log info LOG` prints its rates.

SI units, world `ned`, body `frd`. A field has its type, (unit, frame) and meaning. Every message begins with a `header`
(stamp = log time, frame) unless its standard type has none. Own types (`autopilot_msgs`) are of fixed size; every file
contains all definitions. "On change" topics are also written once per second. `/sim` and `/viz/truth`: simulation only.
"""


def described() -> dict[str, tuple[str, str]]:
    """Topic -> rate and text."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        return {row["topic"]: (row["rate"], row["what"]) for row in csv.DictReader(file)}


def unit(name: str) -> str:
    """Unit and frame by the name of a field."""
    base = name.removesuffix("_var")
    ending = next((text for end, text in UNITS if base.endswith(end)), "")
    frame = next((part.upper() if part != "cam" else "camera" for part in name.split("_") if part in FRAMES), "")
    return ", ".join(part for part in (ending, frame) if part)


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
    """A field of our own types: name, type, unit and frame, meaning."""
    size = "" if field.count is None else f"[{field.count}]"
    units = f" ({unit(field.name)})" if unit(field.name) else ""
    return f"* `{field.name}` {field.type}{size}{units}: {text}"


def page() -> str:
    """The whole page."""
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
        else:
            parts.append(f"Fields: {', '.join(f'`{field.name}`' for field in types_of(kind)[kind])}.\n")
    return "\n".join(parts)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write docs/topics.md")
    if parser.parse_args().write:
        PAGE.write_text(page(), encoding="utf-8")
    sys.exit("\n".join(missing()) or 0)
