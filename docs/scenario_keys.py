"""The keys of a scenario file, as docs/simulation.md lists them, from the tables in the code.

``python docs/scenario_keys.py --write`` renews the list in the page.
"""

import argparse
import typing
from pathlib import Path
from typing import Any

import msgspec

from autopilot.sitl.mismatch import MAY_BE_ZERO, MISMATCH_KEYS
from autopilot.sitl.scenario_tables import Scenario

PAGE = Path(__file__).resolve().parent / "simulation.md"
BEGIN, END = "<!-- keys: python docs/scenario_keys.py --write -->\n", "<!-- end of keys -->\n"


def tables(kind: Any) -> list[type[msgspec.Struct]]:
    """The tables that a key may hold."""
    if not typing.get_args(kind):
        return [kind] if isinstance(kind, type) and issubclass(kind, msgspec.Struct) else []
    return [table for part in typing.get_args(kind) for table in tables(part)]


def value(given: Any) -> str:
    """A default as TOML has it, without spaces."""
    if isinstance(given, bool):
        return str(given).lower()
    if isinstance(given, tuple):
        return f"[{','.join(map(value, given))}]"
    return f"{given:g}" if isinstance(given, float) else str(given)


def lines(name: str, kind: Any, listed: bool = False) -> list[str]:
    """One line for a table ``name`` of this type, and for the tables in it."""
    found = []
    for table in tables(kind):
        tag = table.__struct_config__.tag
        head = f"[[{name}]]" if listed else f"[{name}]"
        keys, inner = [f"kind={tag}"] if tag else [], []
        hints = typing.get_type_hints(table)
        for field in msgspec.structs.fields(table):
            if tables(hints[field.name]) and not field.required:
                inner += lines(f"{name}.{field.encode_name}", hints[field.name])
            elif field.required:
                keys.append(field.encode_name + "*")
            elif field.default is None or field.default is msgspec.NODEFAULT:
                keys.append(field.encode_name)
            else:
                keys.append(f"{field.encode_name}={value(field.default)}")
        found += [f"{head} {' '.join(keys)}", *inner] if keys else inner
    return _common_first(found)


def _common_first(found: list[str]) -> list[str]:
    """Keys that every kind of a table has, once."""
    keys = [set(line.split()[1:]) for line in found if " kind=" in line]
    common = set.intersection(*keys) if len(keys) > 1 else set()
    if not common:
        return found
    head = found[0].split()[0]
    left = [" ".join(word for word in line.split() if word not in common) for line in found]
    return [f"{head} kind* {' '.join(sorted(common))}", *left]


def listing() -> str:
    found = []
    for name, kind in typing.get_type_hints(Scenario).items():
        if name not in ("params", "spread"):
            found += lines(name, kind, listed=typing.get_origin(kind) is list)
    factors = " ".join(key + "°" * (key in MAY_BE_ZERO) for key in MISMATCH_KEYS)
    found.insert(
        found.index(next(line for line in found if line.startswith("[sensors]"))), f"[vehicle.mismatch] {factors}"
    )
    return "```text\n" + "\n".join(found) + "\n```\n"


def page() -> str:
    """The page with the list as it has to be."""
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    return before + BEGIN + listing() + END + rest.partition(END)[2]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="renew the list in docs/simulation.md")
    if parser.parse_args().write:
        PAGE.write_text(page(), encoding="utf-8")
