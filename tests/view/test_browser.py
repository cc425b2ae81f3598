"""The live view in a real browser, where there is one: no word on its console, on a desk and on a phone."""

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from viewers import Run, run

ROOT = Path(__file__).resolve().parents[2]


def loaded() -> ModuleType:
    spec = importlib.util.spec_from_file_location("browser", ROOT / "docs" / "browser.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


browser = loaded()
pytestmark = pytest.mark.skipif(browser.found() is None, reason="no Chromium here; CHROMIUM names one")


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    with run(tmp_path_factory.mktemp("browser"), "paper-tank", "--start", "--sensors", "pose") as made:
        yield made
        made.end()


SCREENS = {"desk": (1200, 800, False, False), "phone": (390, 844, True, True)}
PAINTED = """(() => {
    const canvas = document.getElementById("%s"), size = [canvas.width, canvas.height];
    const data = canvas.getContext("2d").getImageData(0, 0, ...size).data, colors = new Set();
    for (let i = 0; i < data.length; i += 4) colors.add(data[i] << 16 | data[i + 1] << 8 | data[i + 2]);
    return colors.size;
})()"""


@pytest.mark.parametrize("screen", SCREENS)
def test_the_page_in_a_browser(flight: Run, screen: str) -> None:
    width, height, phone, dark = SCREENS[screen]
    with browser.page(browser.found()) as page:
        page.size(width, height, phone=phone, dark=dark)
        page.open(f"http://127.0.0.1:{flight.port}/")
        page.wait("document.getElementById('armed')?.textContent === 'armed'")
        page.wait("document.querySelectorAll('#thrusters .bar').length === 4")
        assert page.ask(PAINTED % "plan") > 20 and page.ask(PAINTED % "side") > 10
        assert page.ask("document.documentElement.scrollWidth") <= width, "nothing sticks out sideways"
        if phone:
            sizes = page.ask("[...document.querySelectorAll('button')].map((b) => b.getBoundingClientRect().height)")
            assert min(size for size in sizes if size) >= 36, "for fingers"
        assert page.errors == []


def test_what_is_pressed_is_done(flight: Run) -> None:
    with browser.page(browser.found()) as page:
        page.size(1200, 800)
        page.open(f"http://127.0.0.1:{flight.port}/")
        page.wait("document.getElementById('mode')?.textContent === 'MISSION'")
        page.ask("document.getElementById('pause').click()")
        page.wait("document.getElementById('clock').textContent.includes('paused')")
        page.ask("document.getElementById('pause').click()")
        page.wait("!document.getElementById('clock').textContent.includes('paused')")
        assert page.errors == []
