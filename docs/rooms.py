"""Draws the packages and the imports between them: ``python docs/rooms.py --write``.

The drawing is a Mermaid diagram in ``docs/architecture.md``, between the lines ``rooms:begin`` and ``rooms:end``. The
packages of ``autopilot/control`` are drawn as one. ``core``, which all import, and those that import everything
(command line, benchmarks, campaigns, the front door) are left out, and so are arrows that follow from others.
"""

import argparse
import ast
import re
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "architecture.md"
TOPS = ("autopilot", "drivers", "estimator", "mission", "sitl")
SPLIT = ("autopilot", "autopilot.control")
"""Packages whose folders are rooms of their own."""

FRONT_DOOR = ROOT / "autopilot" / "__init__.py"
"""Lends the names of ``autopilot.api``; importing it imports none of them."""

UNDRAWN = tuple("autopilot" + part for part in ("", ".core", ".cli", ".bench", ".analysis", ".campaign", ".api"))


def modules() -> dict[str, Path]:
    """Dotted name of each module of ours -> its file."""
    found = {}
    for top in TOPS:
        for path in sorted((ROOT / top).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            inside = () if top == "autopilot" else ("autopilot",)
            found[".".join((*inside, *(parts[:-1] if parts[-1] == "__init__" else parts)))] = path
    return found


def room_of(module: str, path: Path) -> str:
    """The room that a module lives in, e.g. ``autopilot.control.constraints``."""
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    while package.rpartition(".")[0] not in ("", *SPLIT):
        package = package.rpartition(".")[0]
    return package


def imports_of(path: Path, known: dict[str, Path]) -> set[str]:
    """Modules of ours that a file imports, wherever in it."""
    if path == FRONT_DOOR:
        return set()
    found = {full if full in known else module for full, module in _names(path)}
    return found & known.keys()


@cache
def _names(path: Path) -> frozenset[tuple[str, str]]:
    """What a file imports, wherever in it: each name with its module in front, and that module."""
    found: set[tuple[str, str]] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update((alias.name, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.update((f"{node.module}.{alias.name}", node.module) for alias in node.names)
    return frozenset(found)


def arrows() -> dict[str, set[str]]:
    """Room -> rooms that it imports from."""
    known = modules()
    rooms: dict[str, set[str]] = {room_of(module, path): set() for module, path in known.items()}
    for module, path in known.items():
        here = room_of(module, path)
        rooms[here].update(room_of(name, known[name]) for name in imports_of(path, known))
        rooms[here].discard(here)
    return rooms


def circles(rooms: dict[str, set[str]]) -> list[tuple[str, ...]]:
    """Groups of rooms that can be reached from each other."""

    def behind(room: str, seen: set[str]) -> set[str]:
        for name in rooms[room] - seen:
            seen.add(name)
            behind(name, seen)
        return seen

    reach = {room: behind(room, set()) for room in rooms}
    groups = {tuple(sorted({a, *(b for b in reach[a] if a in reach[b])})) for a in rooms if a in reach[a]}
    return sorted(groups)


def drawn() -> dict[str, set[str]]:
    """The arrows of the picture: control as one package, without arrows that follow from others."""
    whole: dict[str, set[str]] = {}
    for room, names in arrows().items():
        found = whole.setdefault(_whole(room), set())
        found.update({_whole(name) for name in names if name not in UNDRAWN} - {_whole(room)})
    kept = {room: names for room, names in whole.items() if room not in UNDRAWN}

    def behind(room: str) -> set[str]:
        return kept[room].union(*(behind(name) for name in kept[room]))

    return {room: names - {far for name in names for far in behind(name)} for room, names in kept.items()}


def _whole(room: str) -> str:
    return "autopilot.control" if room.startswith("autopilot.control.") else room


def drawing() -> str:
    """The diagram as it stands in the page."""
    lines = ["```mermaid", "flowchart TD"]
    for room, names in sorted(drawn().items()):
        short = room.removeprefix("autopilot.")
        lines += [f"    {short} --> {name.removeprefix('autopilot.')}" for name in sorted(names)]
    return "\n".join([*lines, "```"])


def page_with(text: str) -> str:
    """The page with this drawing in it."""
    page = PAGE.read_text(encoding="utf-8")
    block = f"<!-- rooms:begin -->\n{text}\n<!-- rooms:end -->"
    changed, count = re.subn(r"<!-- rooms:begin -->.*?<!-- rooms:end -->", lambda _: block, page, flags=re.DOTALL)
    if count != 1:
        raise SystemExit(f"{PAGE.name}: needs one pair of rooms:begin and rooms:end lines, has {count}")
    return changed


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="put the drawing into docs/architecture.md")
    if parser.parse_args().write:
        PAGE.write_text(page_with(drawing()), encoding="utf-8")
    else:
        sys.stdout.write(drawing() + "\n")
