"""The live view in a real browser, where there is one: no word on its console, on a desk and on a phone."""

import signal
import time
from pathlib import Path

import pytest
from browser_module import browser, needs_browser, pixels_of
from viewers import Run, run

pytestmark = needs_browser


SCREENS = {"desk": (1200, 800, False, False), "phone": (390, 844, True, True)}
PAINTED = f"""(() => {{
    const data = {pixels_of("%s")}, colors = new Set();
    for (let i = 0; i < data.length; i += 4) colors.add(data[i] << 16 | data[i + 1] << 8 | data[i + 2]);
    return colors.size;
}})()"""


@pytest.mark.parametrize("screen", SCREENS)
def test_the_page_in_a_browser(flight: Run, screen: str) -> None:
    width, height, phone, dark = SCREENS[screen]
    with browser.page(browser.found()) as page:
        page.size(width, height, phone=phone, dark=dark)
        page.open(f"http://127.0.0.1:{flight.port}/")
        page.wait("document.getElementById('armed')?.textContent === 'armed'")
        page.wait("document.querySelectorAll('#thrusters .bar').length === 4")
        page.wait(f"{PAINTED % 'plan'} > 20 && {PAINTED % 'side'} > 10")  # drawn with the next frame
        assert page.ask("document.documentElement.scrollWidth") <= width, "nothing sticks out sideways"
        if phone:
            sizes = page.ask("[...document.querySelectorAll('button')].map((b) => b.getBoundingClientRect().height)")
            assert min(size for size in sizes if size) >= 36, "for fingers"
        assert page.errors == []


STALE = "document.querySelectorAll('.stale').length"


def test_a_page_across_a_killed_and_a_restarted_service(tmp_path: Path) -> None:
    """Two tabs: grey once the process is stopped or killed, of the new one after a restart, where controls work."""
    with browser.page(browser.found()) as page, browser.page(browser.found()) as other:
        port = 0
        for turn in range(2):
            with run(tmp_path, "paper-tank", "--start", view=port) as made:
                if not port:
                    port = made.port
                    for tab in (page, other):
                        tab.size(1440, 900)
                        tab.open(f"http://127.0.0.1:{port}/")
                for tab in (page, other):
                    tab.wait("document.getElementById('mode')?.textContent === 'MISSION'")
                    tab.wait(f"{STALE} === 0 && document.getElementById('link').textContent === ''")
                press, back = (page, other) if turn else (other, page)
                press.wait("!document.getElementById('clock').textContent.includes('paused')")
                press.ask("document.getElementById('pause').click()")
                back.wait("document.getElementById('clock').textContent.includes('paused')")
                press.wait("document.getElementById('said').textContent === 'Paused'")  # the other may hear it first
                press.ask("document.getElementById('pause').click()")
                back.wait("!document.getElementById('clock').textContent.includes('paused')")
                if not turn:
                    made.process.send_signal(signal.SIGSTOP)
                    for tab in (page, other):
                        tab.wait(f"{STALE} >= 9")
                        tab.wait("document.getElementById('stateage').textContent.endsWith('old')")
                    made.process.send_signal(signal.SIGCONT)
                    for tab in (page, other):
                        tab.wait(f"{STALE} === 0")
                made.process.kill()
                made.process.wait()
                for tab in (page, other):
                    tab.wait(f"{STALE} >= 9")
                    assert "no connection" in tab.wait("document.getElementById('link').textContent")
        assert [error for error in page.errors + other.errors if "ERR_" not in error] == []


def test_a_picture_of_before_a_blackout_in_a_browser(tmp_path: Path) -> None:
    with run(tmp_path, "paper-tank", "--start") as made, browser.page(browser.found()) as page:
        page.size(1440, 900)
        page.open(f"http://127.0.0.1:{made.port}/")
        shown = "document.getElementById('cameraage')"
        page.wait(f"{shown}?.textContent && {shown}.className === 'age'")
        page.ask("document.getElementById('call').click()")  # camera silent for 10 s
        page.wait(f"{shown}.className === 'age old' && document.getElementById('camera').className === 'stale'")
        assert page.ask("document.getElementById('thrusters').className") == "", "all else is of now"
        page.wait(f"{shown}.className === 'age'")
        assert page.errors == []


WATCHED = """(() => {
    const shown = (id) => document.getElementById(id), all = { childList: true, subtree: true };
    const note = () => window.noted.push([%s, shown("frameage").className]);
    window.noted = [];
    for (const id of ["clock", "frameage"]) new MutationObserver(note).observe(shown(id), all);
})()"""


def test_a_tab_that_was_frozen_wakes_grey_and_goes_on_with_the_present(tmp_path: Path) -> None:
    given = ("paper-tank", "--start", "--sensors", "pose")
    with run(tmp_path, *given) as made, browser.page(browser.found()) as page:
        page.open(f"http://127.0.0.1:{made.port}/")
        page.wait("document.getElementById('mode')?.textContent === 'MISSION'")
        page.ask(WATCHED % STALE)
        page.call("Page.setWebLifecycleState", state="frozen")
        time.sleep(6.0)  # longer than silence on an open stream may be
        before = page.ask("window.noted.length")
        page.call("Page.setWebLifecycleState", state="active")
        page.wait(f"window.noted.length > {before + 5} && {STALE} === 0")
        woken = page.ask(f"window.noted.slice({before})")
        assert woken[0][0] > 9 and woken[0][1] == "age old", woken[:5]
        assert page.errors == []
