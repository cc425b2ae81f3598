"""Pages of documentation: all in the index, no link that leads nowhere."""

import re
from pathlib import Path

import pytest
from md_pages import PAGES, ROOT, anchors, links

DOCS = ROOT / "docs"
INDEX = DOCS / "index.md"


def target(page: Path, link: str) -> Path:
    """The file of a link."""
    return (page.parent / link.partition("#")[0]).resolve() if not link.startswith("#") else page


def test_every_page_is_in_the_index() -> None:
    listed = {target(INDEX, link) for link in links(INDEX)}
    pages = {page for page in DOCS.rglob("*.md") if page not in (INDEX, DOCS / "README.md")}
    assert {str(page.relative_to(DOCS)) for page in pages - listed} == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for link in links(page):
        if link.startswith(("http:", "https:", "mailto:")):
            continue
        file = target(page, link)
        assert file.exists(), f"{link}: there is no such file"
        assert file.is_relative_to(ROOT), f"{link}: outside of the repository"
        name = link.partition("#")[2]
        if name:
            assert name in anchors(file), f"{link}: no such heading; there are {', '.join(sorted(anchors(file)))}"


def test_every_figure_is_shown() -> None:
    shown = {target(page, link) for page in PAGES for link in links(page)}
    figures = {path for path in (DOCS / "figures").iterdir() if path.is_file()}
    assert {path.name for path in figures - shown} == set()


def test_readme_stays_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


def test_decisions_are_short_and_have_one_number_each() -> None:
    text = (DOCS / "decisions.md").read_text(encoding="utf-8")
    entries = re.findall(r"^\*\*(\d+)\. (.*?)(?=^\*\*\d+\. |^## |\Z)", text, flags=re.MULTILINE | re.DOTALL)
    numbers = [int(number) for number, _ in entries]
    assert len(numbers) > 20 and len(numbers) == len(set(numbers))
    assert [number for number, entry in entries if len(entry.split()) > 120] == []
