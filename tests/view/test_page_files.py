"""What the page is made of is served."""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser_module import browser
from viewers import get

from autopilot.view.http_server import PAGES, ViewServer


@pytest.fixture
def port() -> Iterator[int]:
    server = ViewServer(0)
    yield int(server.url.rstrip("/").rpartition(":")[2])
    server.close()


def test_every_file_of_the_folder_is_served(port: int) -> None:
    folder = Path(__file__).resolve().parents[2] / "autopilot" / "data" / "view"
    for file in folder.iterdir():
        assert get(port, f"/{file.name}" if file.name != "index.html" else "/")[0] == 200, file.name


def test_the_page_works_below_any_path(port: int) -> None:
    """BlueOS shows it below /extensionv2: every address that it asks for is relative."""
    code = "".join(get(port, path)[2].decode() for path in PAGES if not path.endswith((".css", ".svg")))
    asked = re.findall(r"""(?:href=|src=|fetch\(|asked\(|loaded\(|import\(|from |EventSource\()["'`]([^"'`]*)""", code)
    assert len(asked) > 20 and [each for each in asked if each.startswith("/")] == []


def test_three_js_is_served_without_its_package_being_imported(port: int) -> None:
    status, headers, body = get(port, "/three.js")
    assert status == 200 and b"WebGLRenderer" in body and headers["content-type"].startswith("text/javascript")
    assert "pythreejs" not in sys.modules and "ipywidgets" not in sys.modules


def test_where_there_is_no_browser_one_is_asked_for() -> None:
    with pytest.raises(FileNotFoundError, match="CHROMIUM"), browser.page(None):
        raise AssertionError("a page of no browser")
