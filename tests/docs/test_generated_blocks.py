"""Tables and lists that a script of docs writes into a page are what it would write today."""

import runpy

import pytest
from md_pages import ROOT

DOCS = ROOT / "docs"


@pytest.mark.parametrize("script", ["ardusub_page", "mission_items", "parameters_page", "results_page"])
def test_a_table_is_what_its_script_makes(script: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cases with ArduSub, mission items, parameters, figures of the reference flights."""
    monkeypatch.syspath_prepend(DOCS)  # the module beside the scripts
    block = runpy.run_path(str(DOCS / f"{script}.py"))["BLOCK"]
    text = block.page.read_text(encoding="utf-8")
    assert text == block.written(text), f"run python docs/{script}.py --write"


def test_every_key_of_a_scenario_is_listed_with_its_default() -> None:
    page = (DOCS / "simulation.md").read_text(encoding="utf-8")
    assert page == runpy.run_path(str(DOCS / "scenario_keys.py"))["page"](), "run python docs/scenario_keys.py --write"
    assert "[[fault]] kind* at_s*\n[[fault]] kind=thruster_loss thruster* loss=1\n" in page
