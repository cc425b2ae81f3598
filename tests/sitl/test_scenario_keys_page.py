"""docs/simulation.md lists every key of a scenario file with its default."""

import runpy
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_keys_are_those_of_the_code() -> None:
    generator = runpy.run_path(str(ROOT / "docs" / "scenario_keys.py"))
    page = (ROOT / "docs" / "simulation.md").read_text(encoding="utf-8")
    assert page == generator["page"](), "run python docs/scenario_keys.py --write"
    assert "[[fault]] kind* at_s*\n[[fault]] kind=thruster_loss thruster* loss=1\n" in page
