"""The site of `make docs`: navigation against pages, API reference against code, nothing from a network.

The built site is looked at where ``SITE`` names its folder: `make docs` sets it.
"""

import os
import pydoc
import re
from pathlib import Path

import pytest
from md_pages import ROOT, blocks

DOCS = ROOT / "docs"
PAGES = [page for page in sorted(DOCS.rglob("*.md")) if page != DOCS / "README.md"]
OBJECTS = [
    name for page in DOCS.glob("api/*.md") for name in re.findall(r"^::: (\S+)$", page.read_text(), re.MULTILINE)
]
SITE = Path(os.environ.get("SITE", ""))
built = pytest.mark.skipif("SITE" not in os.environ, reason="looked at by `make docs`, when it has built the site")


@pytest.mark.parametrize("name", OBJECTS)
def test_the_api_reference_names_what_exists(name: str) -> None:
    assert pydoc.locate(name) is not None


@pytest.mark.parametrize("page", ["examples/my_controller.py", "log.md", "python.md"])
def test_what_a_page_imports_is_in_the_api_reference(page: str) -> None:
    """``page``: with Python blocks, or an example that a page links."""
    path = DOCS / page
    code = "".join(block.text for block in blocks(path) if block.language == "python")
    code = path.read_text(encoding="utf-8") if path.suffix == ".py" else code
    imported = [
        (module, name.strip())
        for module, names in re.findall(r"^from (autopilot[\w.]*) import (.*)$", code, re.MULTILINE)
        for name in names.split(",")
    ]
    assert imported
    assert [f"{module}.{name}" for module, name in imported if not _places(module, name) & set(OBJECTS)] == []


def _places(module: str, name: str) -> set[str]:
    """Where the reference may have it: as it is imported, or where it is defined."""
    found = pydoc.locate(f"{module}.{name}")
    home = getattr(found, "__module__", module)
    return {module, f"{module}.{name}", home, f"{home}.{name}"}


@built
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_a_page_is_built_and_in_the_navigation(page: Path) -> None:
    name = page.relative_to(DOCS).with_suffix(".html").as_posix()
    text = (SITE / name).read_text(encoding="utf-8")
    start = (SITE / "index.html").read_text(encoding="utf-8")
    assert f'href="{name}" class="md-nav__link' in start.replace('href="#"', 'href="index.html"')
    for left in ("arithmatex", "<merror", ":::"):
        assert left not in text, f"{left}: not rendered"


@built
def test_nothing_is_loaded_from_a_network() -> None:
    for page in set(SITE.rglob("*.html")) - {SITE / "404.html"}:  # that one is a server's
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|link|img|iframe|source)\b[^>]*?\b(?:src|href)=[\"']?([^\"'\s>]+)", text)
        assert [each for each in loaded if re.match(r"(?:[a-z]+:)?//", each)] == [], page
        missing = [each for each in loaded if not each.startswith(("data:", "#")) and not (page.parent / each).exists()]
        assert missing == [], page
    for sheet in SITE.rglob("*.css"):
        assert re.findall(r"url\([\"']?(?:[a-z]+:)?//[^)]*|@import[^;]*", sheet.read_text(encoding="utf-8")) == [], (
            sheet
        )
