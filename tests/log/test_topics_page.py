"""docs/topics.md: every topic and field is documented, and the page is what the schemas say."""

import re
import runpy
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from autopilot.log.reader import open_log
from autopilot.log.topics import TOPICS
from autopilot.run.children import autopilot_command

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def generator() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "docs" / "topics_page.py"))


def test_nothing_is_undocumented(generator: dict[str, Any]) -> None:
    assert generator["missing"]() == []


def test_the_page_is_current(generator: dict[str, Any]) -> None:
    page = (ROOT / "docs" / "topics.md").read_text(encoding="utf-8")
    assert page == generator["page"](), "run python docs/topics_page.py --write"
    for topic in TOPICS:
        assert f"## {topic}\n" in page
    assert "* `pos_ned_m[3]`: place\n" in page


def test_what_is_not_documented_is_named(generator: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TOPICS, "/new/topic", "autopilot_msgs/Goal")
    assert generator["missing"]() == ["topic /new/topic: no row in docs/topics.csv"]


def test_rates_are_those_of_a_flight(generator: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    flight = "sitl paper-tank-still --sensors pose --start --speed 0 --duration 8 --quiet --log"
    subprocess.run([*autopilot_command(), *flight.split(), str(file)], check=True, timeout=900)
    log, looked = open_log(file), 0
    for topic, (rate, text) in generator["described"]().items():
        stated = re.match(r"(\d+) Hz(?! each)", rate) or re.search(r"; (\d+) Hz", text)
        if stated and topic in log.topics:
            at_s = np.unique([1e-6 * message.t_us for message in log.messages(topic)])
            assert 1.0 / np.median(np.diff(at_s)) == pytest.approx(float(stated[1]), rel=0.1), topic
            looked += 1
    assert looked > 20
