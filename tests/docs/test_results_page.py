"""The tables of flights in docs are those that were recorded."""

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def _beside(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs")  # the module beside the scripts


def test_the_reference_flights_are_those_of_the_benchmark() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "results_page.py"))
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    assert text == script["written"](text), "run python docs/results_page.py --write"


def test_the_cases_with_ardusub_are_those_that_were_recorded() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "ardusub_page.py"))
    text = (ROOT / "docs" / "hardware.md").read_text(encoding="utf-8")
    assert text == script["written"](text), "run python docs/ardusub_page.py --write"
