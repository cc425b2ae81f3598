"""Writes docs/topics.md: every topic of a log with every field, from the schemas and the table in docs/log.md.

``python docs/topics.py --write`` writes the page; without it, what is not documented is named.
"""

import argparse
import re
import sys
from pathlib import Path

from autopilot.log.schemas import own_comments as comments
from autopilot.log.schemas import types_of
from autopilot.log.topics import AID_PREFIX, TOPICS

HERE = Path(__file__).resolve().parent
PAGE, TABLE = HERE / "topics.md", HERE / "log.md"
OWN = "autopilot_msgs/"
AID = AID_PREFIX + "<sensor>"
UNITS = (
    *(("_rad_s", "rad/s"), ("_m_s2", "m/s²"), ("_m_s", "m/s"), ("_rad", "rad"), ("_deg", "deg"), ("_us", "µs")),
    *(("_m", "m"), ("_n", "N"), ("_s", "s"), ("_j", "J"), ("_w", "W"), ("_v", "V"), ("_a", "A"), ("_c", "°C")),
    *(("_pa", "Pa"), ("_px", "px")),
)
FRAMES = ("ned", "frd", "cam")
HEAD = """# Topics and fields

Written by `python docs/topics.py --write`; the texts stand in [log.md](log.md) and `autopilot/log/schemas.py`.
Every message begins with a `header` (stamp = log time, frame of reference) unless its standard type has none. Own types
(`autopilot_msgs`) are of fixed size; the definition of every type is in every file.
"""


def told_topics() -> dict[str, tuple[str, str]]:
    """Topic -> rate and text, from the table of topics."""
    found = {}
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split(" | ")]
        if len(cells) == 4 and cells[0].startswith("`/"):
            for topic in re.findall(r"`(/[^`]+)`", cells[0]):
                found[topic] = (cells[2], cells[3])
    return found


def unit(name: str) -> str:
    """Unit and frame by the name of a field."""
    base = name.removesuffix("_var")
    ending = next((text for end, text in UNITS if base.endswith(end)), "")
    frame = next((part.upper() if part != "cam" else "camera" for part in name.split("_") if part in FRAMES), "")
    return ", ".join(part for part in (ending, frame) if part)


def missing() -> list[str]:
    """What has no text: topics and fields of our own types."""
    told = told_topics()
    found = [f"topic {topic}: no row in docs/log.md" for topic in (*TOPICS, AID) if topic not in told]
    found += [f"topic {topic}: in docs/log.md, but not in TOPICS" for topic in told if topic not in {*TOPICS, AID}]
    for kind in sorted({*TOPICS.values(), "autopilot_msgs/AidStatus"}):
        if kind.startswith(OWN):
            texts = comments(kind)
            fields = [field.name for field in types_of(kind)[kind] if field.name != "header"]
            found += [
                f"{kind}.{name}: no comment in autopilot/log/schemas.py" for name in fields if not texts.get(name)
            ]
    return found


def page() -> str:
    """The whole page."""
    told = told_topics()
    parts = [HEAD]
    for topic, kind in sorted({**TOPICS, AID: "autopilot_msgs/AidStatus"}.items()):
        rate, text = told.get(topic, ("", ""))
        parts.append(f"## {topic}\n\n`{kind}`, {rate}: {text}.\n")
        if kind.startswith(OWN):
            texts = comments(kind)
            parts.append("| field | type | unit, frame | what |\n| --- | --- | --- | --- |")
            for field in types_of(kind)[kind]:
                if field.name != "header":
                    size = "" if field.count is None else f"[{field.count}]"
                    what = texts.get(field.name, "").replace("|", "/")
                    parts.append(f"| `{field.name}` | {field.type}{size} | {unit(field.name)} | {what} |")
            parts.append("")
        else:
            fields = ", ".join(f"`{field.name}`" for field in types_of(kind)[kind])
            parts.append(f"Standard type: {fields}.\n")
    return "\n".join(parts)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write docs/topics.md")
    if parser.parse_args().write:
        PAGE.write_text(page(), encoding="utf-8")
    sys.exit("\n".join(missing()) or 0)
