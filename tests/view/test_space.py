"""The view in three dimensions, in a browser with WebGL in software."""

import base64
import contextlib
import sys
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import cv2
import numpy as np
import pytest
from browser_module import browser, needs_browser
from numpy.typing import NDArray
from viewers import Run, get, press

from autopilot.view.http_server import NO_THREE, ViewServer

pytestmark = needs_browser

SWITCH = "document.getElementById('solid').click()"
ON = "document.getElementById('chart').className === 'space'"
WORDS = "document.getElementById('spacesaid').textContent"
PAUSE = "document.getElementById('pause').click()"
PAUSED = "document.getElementById('clock').textContent.includes('paused')"
CANVAS = "document.getElementById('space')"
RING_PX = 4
COUNTED = """(() => {
    const draw = WebGLRenderingContext.prototype.clear;
    window.pictures = 0;
    WebGLRenderingContext.prototype.clear = function (...given) {
        window.pictures += 1;
        return draw.apply(this, given);
    };
})()"""


@contextlib.contextmanager
def opened(flight: Run, *options: str, dark: bool = False) -> Iterator[Any]:
    with browser.page(browser.found(), *options) as tab:
        tab.size(1200, 800, dark=dark)
        tab.open(f"http://127.0.0.1:{flight.port}/")
        tab.wait("document.querySelectorAll('#thrusters .bar').length === 4")
        yield tab
        assert tab.errors == []


@contextlib.contextmanager
def paused(tab: Any) -> Iterator[None]:
    """Time stands still, and everything that comes has come; afterwards it goes on, also for the next test."""
    tab.ask(PAUSE)
    tab.wait(PAUSED)
    tab.ask("new Promise((done) => setTimeout(done, 800))")
    try:
        yield
    finally:
        tab.ask(PAUSE)
        tab.wait(f"!{PAUSED}")


def picture(tab: Any) -> NDArray[np.uint8]:
    """(rows, columns, 3) BGR of the canvas as it is on the screen, without the ring of what has the focus."""
    tab.ask("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    clip = tab.ask(f"{CANVAS}.getBoundingClientRect().toJSON()") | {"scale": 1}
    data = base64.b64decode(tab.call("Page.captureScreenshot", format="png", clip=clip)["data"])
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image[RING_PX:-RING_PX, RING_PX:-RING_PX].astype(np.uint8)


def settled(tab: Any, since: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
    """The canvas once it stands still, and is another than ``since``: a busy machine draws late."""
    before, begin_s, moved, other = picture(tab), time.monotonic(), 0, 0
    while time.monotonic() - begin_s < browser.PATIENCE_S:
        after = picture(tab)
        moved, other = changed(before, after), 201 if since is None else changed(since, after)
        if moved == 0 and other > 200:
            return after
        before = after
    lost = tab.ask(f"{CANVAS}.getContext('webgl').isContextLost()")
    raise AssertionError(f"{moved} pixels still move, {other} are new; lost {lost}, {tab.ask(WORDS)!r}, {tab.errors}")


def changed(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> int:
    """Pixels that differ clearly."""
    return int((np.abs(one.astype(int) - other).max(axis=2) > 40).sum())


def pixels(image: NDArray[np.uint8], color: str) -> int:
    """How many are of a color #rrggbb."""
    wanted = [int(color[k : k + 2], 16) for k in (5, 3, 1)]
    return int((np.abs(image.astype(int) - wanted).max(axis=2) < 12).sum())


@pytest.mark.parametrize("dark", [False, True])
def test_it_is_loaded_when_switched_on_shows_the_world_and_turns_by_keys_and_mouse(flight: Run, dark: bool) -> None:
    with opened(flight, dark=dark) as tab, contextlib.ExitStack() as stack:
        assert tab.ask("typeof window.THREE") == "undefined" and tab.ask(f"{CANVAS}.hidden")
        tab.ask(SWITCH)
        tab.wait(ON)
        tab.wait("/good|degraded/.test(document.getElementById('health').textContent)")  # then there is a vehicle
        stack.enter_context(paused(tab))
        tab.ask(f"{CANVAS}.focus()")
        press(tab, "0")
        first = settled(tab)
        wall, fence, body = ("#c3d0db", "#ff6b6b", "#4fb3e8") if dark else ("#33414e", "#c4262e", "#0b6fa4")
        assert all(pixels(first, color) > 100 for color in (wall, fence, body))
        before = first
        x, y = tab.ask(f"(({{ x, y }}) => [x + 200, y + 150])({CANVAS}.getBoundingClientRect())")

        def dragged() -> None:
            for kind, px in (("mousePressed", x), ("mouseMoved", x + 80), ("mouseReleased", x + 80)):
                tab.call("Input.dispatchMouseEvent", type=kind, x=px, y=y, button="left", buttons=1, clickCount=1)

        def wheeled() -> None:
            tab.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-240)

        keys = [partial(press, tab, key) for key in ("ArrowLeft", "ArrowUp", "+", "f")]
        for work in (*keys, dragged, wheeled):
            work()
            before = settled(tab, before)
        assert tab.ask("window.scrollY") == 0
        tab.ask("document.getElementById('follow').click()")
        tab.ask("document.getElementById('fit').click()")
        assert changed(settled(tab, before), first) == 0, "everything, as at first"


def test_nothing_is_drawn_while_it_is_off_or_out_of_sight(flight: Run) -> None:
    later = "const begin = window.pictures; setTimeout(() => done(window.pictures - begin), 1500);"
    frames = f"new Promise((done) => {{ {later} }})"
    with opened(flight) as tab:
        tab.ask(COUNTED)
        tab.ask(SWITCH)
        tab.wait(ON)
        tab.wait("window.pictures > 3")
        tab.size(390, 500, phone=True)
        tab.ask("window.scrollTo(0, document.body.scrollHeight)")
        tab.ask("new Promise((done) => setTimeout(done, 500))")
        assert tab.ask(frames) == 0, "scrolled away"
        tab.ask("window.scrollTo(0, 0)")
        tab.wait(f"{frames}.then((count) => count > 0)")
        tab.ask(SWITCH)
        tab.ask("new Promise((done) => setTimeout(done, 500))")
        assert tab.ask(frames) == 0 and tab.ask(f"{CANVAS}.hidden")


def test_a_browser_without_webgl_says_so_and_shows_all_else(flight: Run) -> None:
    with opened(flight, "--disable-3d-apis") as tab:
        tab.ask(SWITCH)
        assert "needs WebGL" in tab.wait(WORDS)
        assert not tab.ask(ON) and tab.ask("document.getElementById('solid').ariaPressed") == "false"
        clock = tab.ask("document.getElementById('clock').textContent")
        tab.wait(f"document.getElementById('clock').textContent !== '{clock}'")


def test_a_lost_context_is_told_and_it_goes_on_with_the_next(flight: Run) -> None:
    with opened(flight) as tab:
        tab.ask(SWITCH)
        tab.wait(ON)
        tab.ask(f"window.lost = {CANVAS}.getContext('webgl').getExtension('WEBGL_lose_context'); lost.loseContext()")
        assert "has reset" in tab.wait(WORDS)
        tab.ask("lost.restoreContext()")
        tab.wait(f"{WORDS} === ''")
        assert pixels(picture(tab), "#c4262e") > 100


def test_without_three_js_the_page_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pythreejs", None)
    server = ViewServer(0)
    try:
        port = int(server.url.split(":")[2].strip("/"))
        status, _, body = get(port, "/three.js")
        assert status == 404 and NO_THREE in body.decode() and "[view3d]" in NO_THREE
        with browser.page(browser.found()) as tab:
            tab.open(server.url)
            tab.wait("document.getElementById('legend')?.children.length > 5")
            tab.ask(SWITCH)
            assert tab.wait(WORDS) == NO_THREE
            assert tab.errors == []
    finally:
        server.close()
