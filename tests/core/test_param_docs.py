"""The table of parameters in docs/mavlink.md is the program's."""

from pathlib import Path

from autopilot.core.params import PARAMETERS, ParamSpec

DOCS = Path(__file__).parents[2] / "docs" / "mavlink.md"
HEAD = "| name | default | range | unit | meaning |"


def _row(spec: ParamSpec) -> str:
    name, bounds = f"`{spec.name}`", f"{spec.minimum:g} to {spec.maximum:g}"
    return f"| {name} | {spec.default:g} | {bounds} | {spec.unit} | {spec.help} |"


def test_documented_parameters_are_the_programs() -> None:
    lines = DOCS.read_text(encoding="utf-8").splitlines()
    begin = lines.index(HEAD) + 2
    end = next((n for n in range(begin, len(lines)) if not lines[n].startswith("|")), len(lines))
    assert lines[begin:end] == [_row(spec) for spec in sorted(PARAMETERS, key=lambda spec: spec.name)]
