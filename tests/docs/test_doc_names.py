"""Names and values on pages are those of the program: parameters with their defaults, modules, files, topics."""

import pkgutil
import re
from pathlib import Path

import pytest
from md_pages import PAGES, ROOT

from autopilot.core.params import PARAMETERS
from autopilot.log.topics import AID_PREFIX, TOPICS

SPECS = {spec.name: spec for spec in PARAMETERS}
FAMILIES = ("AVD_", "DEPTH_", "EST_", "FENCE_", "FS_", "LAT_", "MPC_", "OFFB_", "PILOT_", "SPD_", "THR_", "WP_")
"""First letters that no other names in capitals have."""
OTHERS = {"mavlogdump.py"}
"""Programs of other packages."""
FILES = {path.relative_to(ROOT).as_posix() for path in ROOT.rglob("*.py")}


def _spans(page: Path) -> list[str]:
    """What stands in backticks outside of blocks."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return re.findall(r"`([^`\n]+)`", text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_parameters_exist(page: Path) -> None:
    if page.name == "hardware.md":
        pytest.skip("it names parameters of ArduSub, too")
    named = {found[0] for span in _spans(page) if (found := re.match(r"[A-Z]+_[A-Z0-9_]+$", span))}
    assert {name for name in named if name.startswith(FAMILIES)} - {*SPECS} == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_defaults_in_brackets_are_the_programs(page: Path) -> None:
    """``NAME`` (3 s) is a default."""
    for name, value in re.findall(r"`([A-Z][A-Z0-9_]+)` \((-?[\d.]+)(?: [^)]*)?\)", page.read_text(encoding="utf-8")):
        if name in SPECS:
            assert float(value) == SPECS[name].default, f"{name} ({value})"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_and_modules_exist(page: Path) -> None:
    for span in _spans(page):
        if re.fullmatch(r"[\w./]+\.py", span) and not span.startswith("my_") and span not in OTHERS:
            assert (ROOT / span).exists() or any(file.endswith(f"/{span}") for file in FILES), span
        elif re.fullmatch(r"autopilot(\.\w+)+", span):
            assert pkgutil.resolve_name(span), span


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_topics_exist(page: Path) -> None:
    for span in _spans(page):
        if re.fullmatch(r"/(in|nav|ctl|out|mission|sys|sim|viz|payload)/[\w/]+", span):
            assert span in TOPICS or span.startswith(AID_PREFIX), span
