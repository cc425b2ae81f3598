"""docs/topics.md: every topic and field is documented, and the page is what the schemas say."""

import runpy
from pathlib import Path
from typing import Any

import pytest

from autopilot.log.topics import TOPICS

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def generator() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "docs" / "topics.py"))


def test_nothing_is_undocumented(generator: dict[str, Any]) -> None:
    assert generator["missing"]() == []


def test_the_page_is_current(generator: dict[str, Any]) -> None:
    page = (ROOT / "docs" / "topics.md").read_text(encoding="utf-8")
    assert page == generator["page"](), "run python docs/topics.py --write"
    for topic in TOPICS:
        assert f"## {topic}\n" in page
    assert "| `pos_ned_m` | float64[3] | m, NED | place |" in page


def test_what_is_not_documented_is_named(generator: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TOPICS, "/new/topic", "autopilot_msgs/Goal")
    assert generator["missing"]() == ["topic /new/topic: no row in docs/log.md"]
