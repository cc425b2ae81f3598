"""Writes the table of parameters into docs/parameters.md: ``python docs/parameters_page.py --write``.

The table stands between the lines ``parameters:begin`` and ``parameters:end`` and comes from
:mod:`autopilot.core.params`. Without ``--write`` the exit code says whether it is current.
"""

import re
import sys
from pathlib import Path

from generated_block import GeneratedBlock

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "parameters.md"
ACTIONS = "0 = warn, 1 = hold, 2 = surface, 3 = return, 4 = disarm, 5 = surface and drop the weight, 6 = hand back"
_NUMBERED = re.compile(r"^(BTN|THR)\d+(_\w+)$")


def table() -> str:
    """One row per parameter; numbered ones share a row."""
    from autopilot.core.params import PARAMETERS

    lines = ["| name | default, range | meaning |", "| --- | --- | --- |"]
    seen: set[str] = set()
    acts = ", ".join(
        f"`{spec.name}`" for spec in sorted(PARAMETERS, key=lambda spec: spec.name) if ACTIONS in spec.help
    )
    lines.append(f"| `FS_*_ACT` | [failsafes.md](failsafes.md), 0..6 | {ACTIONS}: {acts} |")
    for spec in sorted((spec for spec in PARAMETERS if ACTIONS not in spec.help), key=lambda spec: spec.name):
        numbered = _NUMBERED.match(spec.name)
        name = f"{numbered[1]}n{numbered[2]}" if numbered else spec.name
        if name in seen:
            continue
        seen.add(name)
        meaning = spec.help
        if numbered:
            meaning = re.sub(r"\b(button|thruster) \d+", r"\1 n", meaning)
        value = f"{spec.default:g} {spec.unit}".rstrip()
        lines.append(f"| `{name}` | {value}, {spec.minimum:g}..{spec.maximum:g} | {meaning.rstrip('.')} |")
    return "\n".join(lines)


BLOCK = GeneratedBlock(PAGE, "parameters", table)
written = BLOCK.written


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(BLOCK.main(__doc__))
