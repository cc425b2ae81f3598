"""Back to a moment of the live view, in a browser: the whole page of then, a badge that says so, and the way back."""

from typing import Any

from browser_module import browser, needs_browser
from viewers import Run, press

pytestmark = needs_browser

TEXT = "document.getElementById('%s').textContent"
CLOCK = "parseFloat(document.getElementById('clock').textContent)"
PLACE = "[...document.querySelectorAll('#state dd')][1].textContent"
NOTED = """(() => {
    window.noted = {};
    const note = () => { window.noted[parseFloat(document.getElementById("clock").textContent)] = %s; };
    new MutationObserver(note).observe(document.getElementById("clock"), { childList: true });
})()"""


def opened(tab: Any, flight: Run) -> None:
    """With some seconds of history, and what stood there at each time."""
    tab.size(1440, 900)
    tab.open(f"http://127.0.0.1:{flight.port}/")
    tab.wait("document.querySelectorAll('#thrusters .bar').length === 4")
    tab.ask(NOTED % PLACE)
    tab.wait("Object.keys(window.noted).length > 20")


def test_the_slider_shows_the_whole_page_of_then_and_leads_back(flight: Run) -> None:
    with browser.page(browser.found()) as tab:
        opened(tab, flight)
        assert tab.ask(TEXT % "past") == "" and tab.ask("document.getElementById('present').hidden")
        tab.ask("document.getElementById('when').focus()")
        press(tab, "Home", 36)
        tab.wait(f"{TEXT % 'past'}.startsWith('Past: ')")
        begin = float(tab.ask("document.getElementById('when').min"))
        for _ in range(12):
            press(tab, "ArrowRight", 39)
        tab.wait(f"{CLOCK} > {begin} + 0.6 && {CLOCK} < {begin} + 1.3")
        tab.ask("new Promise((done) => setTimeout(() => done(true), 200))")  # panels follow
        then = tab.ask(CLOCK)
        assert tab.ask(f"window.noted[{then}] === {PLACE}")
        plan = tab.ask("document.getElementById('plan').toDataURL()")
        assert tab.ask("document.querySelectorAll('.stale').length") == 0, "it is as it was then"
        assert tab.ask("document.querySelectorAll('#handles button').length") == 0, "the past cannot be moved"
        newest = tab.ask("Number(document.getElementById('when').max)")
        tab.wait(f"Number(document.getElementById('when').max) > {newest} + 1")
        assert tab.ask(CLOCK) == then, "it stands still while the vehicle goes on"
        assert tab.ask("document.getElementById('plan').toDataURL()") == plan
        press(tab, "Escape", 27)
        tab.wait(f"{TEXT % 'past'} === '' && {CLOCK} > {newest} + 1")
        press(tab, "Home", 36)
        tab.wait(f"{TEXT % 'past'}.startsWith('Past: ')")
        tab.ask("document.getElementById('present').click()")
        tab.wait(f"{TEXT % 'past'} === ''")
        tab.wait("document.querySelectorAll('#handles button').length > 0")
        assert tab.errors == []


def test_dragging_in_the_charts_goes_back(flight: Run) -> None:
    box = "document.getElementById('strips').getBoundingClientRect()"
    with browser.page(browser.found()) as tab:
        opened(tab, flight)
        x, y, width, height = tab.ask(f"[{box}.x, {box}.y, {box}.width, {box}.height]")
        right = x + width / 6 - 8
        for kind, px in (("mousePressed", right - 3), ("mouseMoved", right - 6), ("mouseReleased", right - 6)):
            tab.call(
                "Input.dispatchMouseEvent", type=kind, x=px, y=y + height / 2, button="left", buttons=1, clickCount=1
            )
        back = float(tab.wait(TEXT % "moment").removesuffix(" s ago"))
        assert 0.5 < back < 10 and tab.ask(TEXT % "past") != ""
        tab.call("Input.dispatchMouseEvent", type="mousePressed", x=right + 4, y=y + 40, button="left", clickCount=1)
        tab.call("Input.dispatchMouseEvent", type="mouseReleased", x=right + 4, y=y + 40, button="left", clickCount=1)
        tab.wait(f"{TEXT % 'moment'} !== '{back:.1f} s ago'")
        assert tab.errors == []


def test_a_reset_ends_the_past(flight: Run) -> None:
    """Of another run nothing is shown beside this one."""
    with browser.page(browser.found()) as tab:
        opened(tab, flight)
        tab.ask("document.getElementById('when').focus()")
        press(tab, "Home", 36)
        before = float(tab.ask("document.getElementById('when').max"))
        tab.ask("document.getElementById('reset').click()")
        tab.wait(f"{TEXT % 'past'} === '' && {CLOCK} < {before} && {CLOCK} < 8")
        tab.wait("Number(document.getElementById('when').min) < 8")
        assert tab.errors == []
