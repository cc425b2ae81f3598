"""The page for people who see little contrast, use no mouse, or hear the page: WCAG 2.2 AA where a machine can tell."""

import re
from pathlib import Path
from typing import Any

import pytest
from browser_module import browser, needs_browser
from scripted_page import module
from viewers import Run, press

PAGE = Path(__file__).resolve().parents[2] / "autopilot" / "data" / "view"
TEXT, GRAPHIC = 4.5, 3.0
"""Least contrast ratios: success criteria 1.4.3 and 1.4.11."""
THEMES = ("light", "dark")


def luminance(color: str) -> float:
    parts = [int(color[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def poor(palette: dict[str, str], pairs: list[tuple[str, str]], least: float) -> dict[tuple[str, str], float]:
    """Pairs of names below this ratio."""
    ratios = {(one, other): round(contrast(palette[one], palette[other]), 2) for one, other in pairs}
    return {pair: ratio for pair, ratio in ratios.items() if ratio < least}


def test_the_ratio_is_that_of_wcag() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)


@pytest.mark.parametrize("theme", THEMES)
def test_contrast_of_the_style_sheet(theme: str) -> None:
    blocks = re.findall(r":root \{(.*?)\}", (PAGE / "view.css").read_text(encoding="utf-8"), re.DOTALL)
    palette = dict(re.findall(r"--(\w+): (#\w{6})", blocks[THEMES.index(theme)]))
    texts = [(text, ground) for text in ("ink", "weak", "old", "good", "warn", "bad") for ground in ("back", "panel")]
    texts += [(text, "chip") for text in ("ink", "good", "warn", "bad")]
    texts += [("panel", ground) for ground in ("bad", "warn", "accent")]
    graphics = [
        ("bar", "chip"),
        ("bad", "chip"),
        *((name, on) for name in ("edge", "accent") for on in ("back", "panel")),
    ]
    assert poor(palette, texts, TEXT) == {} and poor(palette, graphics, GRAPHIC) == {}


@needs_browser
@pytest.mark.parametrize("theme", THEMES)
def test_contrast_of_the_drawings(theme: str) -> None:
    """Areas (margin, tube, pillar, nose) have edges in one of these colours or a line along them; the grid is told by
    its scale bar."""
    [palette] = module("draw", f"made.push(draw.{theme.upper()})")
    texts = [(text, ground) for text in ("ink", "weak", "place", "track") for ground in ("back", "water")]
    texts += [("fence", "back"), ("fence", "water"), ("ink", "above"), ("ink", "below")]
    lines = set(palette) - {"back", "water", "margin", "tube", "pillar", "nose", "grid", "above", "below"}
    graphics = [(name, ground) for name in lines for ground in ("back", "water")]
    graphics += [("body", "above"), ("body", "below")]
    assert poor(palette, [*texts, ("back", "solid")], TEXT) == {} and poor(palette, graphics, GRAPHIC) == {}


# In a browser

POOR = """((stale) => {
    const parts = (color) => color.match(/[\\d.]+/g).map(Number);
    const light = (color) => parts(color).slice(0, 3).map((v) => v / 255)
        .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
        .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
    const ground = (one) => {
        for (; one; one = one.parentElement) {
            const color = getComputedStyle(one).backgroundColor;
            if (parts(color)[3] !== 0) return color;
        }
        return "rgb(255, 255, 255)";
    };
    if (stale) for (const id of ["now", "state", "legend", "bars", "thrusters", "sensors", "messages"]) {
        document.getElementById(id).classList.add("stale");
    }
    let seen = 0;
    const poor = [];
    for (const one of document.querySelectorAll("body *")) {
        const words = [...one.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
        if (!words || !one.checkVisibility() || one.closest(":disabled, noscript, option")) continue;
        seen += 1;
        const [a, b] = [light(getComputedStyle(one).color), light(ground(one))].sort((x, y) => y - x);
        let opacity = 1;
        for (let up = one; up; up = up.parentElement) opacity *= getComputedStyle(up).opacity;
        if ((a + 0.05) / (b + 0.05) >= 4.5 && opacity === 1) continue;
        poor.push(`${one.tagName} ${one.id} ${one.className}: ${one.textContent}`);
    }
    return { seen, poor };
})(%s)"""

NAMES = """[...document.querySelectorAll("button, select, summary, [tabindex], input")]
    .filter((one) => one.checkVisibility())
    .map((one) => {
        const about = one.labels && one.labels[0] ? one.labels[0].firstChild.textContent : "";
        const own = one.tagName === "SELECT" ? "" : one.textContent;
        return [one.id || one.tagName, (one.getAttribute("aria-label") || about || own).trim()];
    })"""

FOCUSED = """(() => {
    const one = document.activeElement, style = getComputedStyle(one);
    const name = one === document.body ? "" : one.id || one.getAttribute("aria-label") || one.textContent.trim();
    return [name, style.outlineStyle, parseFloat(style.outlineWidth)];
})()"""


def opened(tab: Any, flight: Run) -> None:
    tab.open(f"http://127.0.0.1:{flight.port}/")
    tab.wait("document.getElementById('armed')?.textContent === 'armed'")
    tab.wait("document.querySelectorAll('#thrusters .bar').length === 4")
    tab.wait("document.querySelectorAll('#handles button').length > 0")


@needs_browser
@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("stale", [False, True])
def test_contrast_of_every_text_as_shown(flight: Run, theme: str, stale: bool) -> None:
    with browser.page(browser.found()) as tab:
        tab.size(1440, 900, dark=theme == "dark")
        opened(tab, flight)
        made = tab.ask(POOR % str(stale).lower())
        assert made["seen"] > 80 and made["poor"] == []


@needs_browser
def test_every_control_has_a_name_and_is_reached_by_tab_with_its_focus_seen(flight: Run) -> None:
    with browser.page(browser.found()) as tab:
        tab.size(1440, 900)
        opened(tab, flight)
        names = tab.ask(NAMES)
        assert len(names) > 15 and [one for one, name in names if not name] == []
        reached = []
        for _ in range(2 * len(names)):
            press(tab, "Tab", 9)
            name, style, width = tab.ask(FOCUSED)
            if name in reached:
                break
            if name:
                assert style != "none" and width >= 2, name
                reached.append(name)
        wanted = {
            "nearer",
            "farther",
            "fit",
            "follow",
            "solid",
            "plan",
            "pause",
            "speed",
            "reset",
            "fault",
            "call",
            "flow",
            "still",
        }
        assert wanted <= set(reached)
        assert len([name for name in reached if name.startswith("Obstacle ")]) == tab.ask(
            "document.querySelectorAll('#handles button').length"
        )
        assert len(reached) >= len(names), "nothing is for the mouse only"


@needs_browser
def test_obstacles_and_the_added_flow_by_keys(flight: Run) -> None:
    said = "document.getElementById('said').textContent"
    with browser.page(browser.found()) as tab:
        tab.size(1440, 900)
        opened(tab, flight)
        tab.ask("document.getElementById('pause').click()")
        tab.wait("document.getElementById('clock').textContent.includes('paused')")
        tab.ask("document.querySelector('#handles button').focus()")
        press(tab, "ArrowRight", 39)
        assert "Enter moves it" in tab.ask(said)
        press(tab, "Escape", 27)
        assert tab.ask(said) == ""
        press(tab, "ArrowRight", 39)
        press(tab, "ArrowUp", 38)
        press(tab, "Enter", 13)
        assert tab.wait(f"{said}.startsWith('Obstacle 1 moved to') && {said}")
        tab.ask("document.getElementById('flow').focus()")
        press(tab, "ArrowRight", 39)
        assert "0.05 m/s" in tab.ask(said)
        press(tab, "Enter", 13)
        assert tab.wait("/0.05/.test(document.getElementById('flowtext').textContent)")
        tab.ask("document.getElementById('still').click()")
        tab.ask("document.getElementById('pause').click()")
        tab.wait("!document.getElementById('clock').textContent.includes('paused')")
        assert tab.errors == []


@needs_browser
def test_zoom_by_mouse_wheel_fingers_and_keys_in_a_browser(flight: Run) -> None:
    follow = "document.getElementById('follow').getAttribute('aria-pressed')"
    box = "document.getElementById('plan').getBoundingClientRect()"
    middle = f"[{box}.x + {box}.width / 2, {box}.y + {box}.height / 2]"
    handles = "[...document.querySelectorAll('#handles button')]"
    apart = f"Math.abs(parseFloat({handles}[0].style.left) - parseFloat({handles}[1].style.left))"
    drawn = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 0, true))))"
    pixels = "document.getElementById('plan').toDataURL().length + ':' + document.getElementById('clock').textContent"
    with browser.page(browser.found()) as tab:
        tab.size(1440, 900)
        opened(tab, flight)
        x, y = tab.ask(middle)
        tab.ask("document.getElementById('plan').focus()")
        press(tab, "f", 70)
        assert tab.ask(follow) == "true"
        for kind, px in (("mousePressed", x), ("mouseMoved", x + 40), ("mouseReleased", x + 40)):
            tab.call("Input.dispatchMouseEvent", type=kind, x=px, y=y + 150, button="left", buttons=1, clickCount=1)
        assert tab.ask(follow) == "false", "a drag of the plan ends following"
        before = tab.ask(pixels)
        tab.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-240)
        assert tab.ask("window.scrollY") == 0 and tab.wait(f"{pixels} !== '{before}'")
        press(tab, "0", 48)
        tab.size(390, 844, phone=True)
        x, y = tab.ask(middle)
        tab.wait(f"{box}.width < 390 && parseFloat({handles}[0].style.left) < 390")
        tab.wait(drawn)
        before = tab.ask(apart)
        tab.call("Input.synthesizePinchGesture", x=x, y=y, scaleFactor=2.0)
        tab.wait(f"{apart} > 1.5 * {before}")
        assert tab.ask("window.visualViewport.scale") == 1, "the plan is zoomed, not the page"
        assert tab.errors == []
