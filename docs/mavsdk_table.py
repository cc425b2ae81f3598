"""Tries every plugin of the installed MAVSDK on the service as a process: ``python docs/mavsdk_table.py --write``.

The table stands in ``docs/mavlink.md`` between ``mavsdk:begin`` and ``mavsdk:end``; without ``--write`` it is printed.
``--only NAME`` tries single plugins. Calls: ``docs/mavsdk_probes.py``; outcomes: ``docs/mavsdk_bench.py``.
"""

import argparse
import re
import sys
from collections.abc import Callable
from pathlib import Path

import mavsdk.plugins
from mavsdk_bench import bench_on_a_vehicle
from mavsdk_probes import PROBES

PAGE = Path(__file__).resolve().parent / "mavlink.md"
BEGIN, END = "<!-- mavsdk:begin -->\n", "<!-- mavsdk:end -->"
HEAD = ("| plugin | works | does not |", "| --- | --- | --- |")


def plugin_names() -> list[str]:
    """Plugins for clients in the installed package: not those of the other side (servers)."""
    folder = Path(mavsdk.plugins.__file__ or "").parent
    names = sorted(path.name for path in folder.iterdir() if (path / "__init__.py").exists())
    return [name for name in names if "server" not in name]


def table(names: list[str], show: Callable[[str], None] = lambda _: None) -> str:
    """Markdown."""
    rows: dict[str, str] = {}
    for sensors, wanted in (("pose", lambda name: name != "camera"), ("camera", lambda name: name == "camera")):
        if not any(map(wanted, names)):
            continue
        with bench_on_a_vehicle(sensors) as bench:
            for name in filter(wanted, names):
                rows[name] = bench.row(name, PROBES.get(name)).markdown()
                show(rows[name])
    return "\n".join([*HEAD, *(rows[name] for name in names)]) + "\n"


def written() -> str:
    """The table as it stands in the page."""
    found = re.search(re.escape(BEGIN) + "(.*?)" + re.escape(END), PAGE.read_text(), re.DOTALL)
    assert found, f"{PAGE} has lost its table"
    return found[1]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--only", action="append")
    given = parser.parse_args()
    text = table(given.only or plugin_names(), lambda line: print(line, file=sys.stderr, flush=True))
    if given.write:
        PAGE.write_text(PAGE.read_text().replace(BEGIN + written() + END, BEGIN + text + END))
    else:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
