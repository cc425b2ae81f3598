"""Artificial horizon and compass: senses, words, age."""

import copy
import json
import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import pytest
from browser_module import browser, needs_browser
from scripted_page import module, page

from autopilot.view.http_server import ViewServer

pytestmark = needs_browser
made = partial(module, "attitude")


@pytest.mark.parametrize("roll", [-0.4, 0.0, 0.25])
@pytest.mark.parametrize("pitch", [-0.2, 0.0, 0.3])
def test_the_horizon_is_where_a_camera_in_the_nose_sees_it(roll: float, pitch: float) -> None:
    """Small angles: a far point at elevation `up` and azimuth `right`, turned into FRD axes, to the right and down."""
    places = [(0.0, 0.0), (0.05, 0.0), (0.0, 0.05), (-0.03, -0.04)]
    code = f"made.push(...{json.dumps(places)}.map(attitude.seenAt({{roll: {roll}, pitch: {pitch}}}, [0, 0], 0.6)))"
    for (right, up), (x, y) in zip(places, made(code), strict=True):
        across, down = right, -(up - pitch)
        # FRD: body = Rx(roll)^T of what a level vehicle sees.
        seen_right = math.cos(roll) * across + math.sin(roll) * down
        seen_down = -math.sin(roll) * across + math.cos(roll) * down
        assert (x, y) == pytest.approx((seen_right, seen_down), abs=1e-12)


def test_bearings_of_goal_route_and_current() -> None:
    frame = {
        "estimate": {"pos_ned_m": [1, 2, 0.5], "rpy_rad": [0.1, -0.2, -1.0], "current_ned_m_s": [0, -0.12, 0]},
        "goal": {"pos_ned_m": [1, 5, 0.5]},
        "control": {"route_ned_m": [[1, 2], [1.1, 2.1], [-1, 0], [1, 5]]},
    }
    still = copy.deepcopy(frame) | {"goal": {"pos_ned_m": [1.02, 2, 0.5]}, "control": None}
    still["estimate"]["current_ned_m_s"] = [0.001, 0, 0]
    code = "made.push(attitude.attitudeWords(attitude.attitudeOf(frame)));"
    words, none = made(f"for (const frame of {json.dumps([frame, still])}) {code}")
    assert [line for line, *_ in words["horizon"]] == ["roll 5.7°", "pitch -11.5°"]
    assert [line for line, *_ in words["compass"]] == [
        "heading 303°",
        "goal 090°, 3.00 m",
        "route 225°",
        "current to 270°, 0.12 m/s",
    ]
    assert [line for line, *_ in none["compass"]] == ["heading 303°", "goal 0.02 m", "current 0.00 m/s"]
    placeless = frame | {"measured": {"rpy_rad": [0, 0, 0.5], "depth_m": None}}
    (words,) = made(f"const frame = {json.dumps(placeless)}; {code}")
    assert [line for line, *_ in words["compass"]] == ["heading 029°"], "what the AHRS says where there is no place"
    assert made("made.push(attitude.bearingText(-1e-4), attitude.bearingText(2 * Math.PI))") == ["000°", "000°"]


def test_the_page_shows_them_and_how_old_they_are(events: list[dict[str, Any]]) -> None:
    scene, frame = next(event for event in events if event["name"] == "scene"), copy.deepcopy(events[-1])
    frame["data"]["estimate"]["rpy_rad"] = [0.1, -0.2, math.pi / 2]
    fresh = page([scene, frame])
    assert fresh["words"]["horizonkey"] == "roll 5.7° pitch -11.5°"
    assert fresh["words"]["compasskey"].startswith(" heading 090°") and " m/s" in fresh["words"]["compasskey"]
    assert "dials" not in fresh["stale"]
    frame["data"]["estimate"]["age_s"] = 60.0
    old = page([scene, frame])
    assert "dials" in old["stale"] and "60 s old" in old["words"]["attitudeage"]
    frame["data"]["estimate"] = None
    assert page([scene, frame])["words"]["attitudeage"] == "no estimate"
    frame["data"]["measured"] = {"rpy_rad": [0.1, -0.2, math.pi / 2], "depth_m": 0.62}
    measured = page([scene, frame])
    assert measured["words"]["compasskey"].strip() == "heading 090°" and "dials" not in measured["stale"]
    assert measured["state"][:4] == ["Estimate", "none", "Depth by pressure", "0.62 m"]
    assert measured["state"][4:6] == ["Roll, pitch, yaw by AHRS", "5.7°, -11.5°, 90.0°"]


@pytest.fixture
def served() -> Iterator[str]:
    server = ViewServer(0)
    yield server.url
    server.close()


PAINTED = """(async () => {
    const { attitudeOf, drawCompass, drawHorizon } = await import("/attitude.js"), { LIGHT } = await import("/draw.js");
    const canvas = Object.assign(document.createElement("canvas"), { width: 200, height: 200 });
    const ctx = canvas.getContext("2d", { willReadFrequently: true });
    const estimate = { pos_ned_m: [0, 0, 0], rpy_rad: %s, current_ned_m_s: [0, 0.2, 0] };
    const facts = attitudeOf({ estimate, goal: { pos_ned_m: [-5, 0, 0] }, control: null });
    const hex = (value) => value.toString(16).padStart(2, "0");
    const color = ([x, y]) => "#" + [...ctx.getImageData(x, y, 1, 1).data].slice(0, 3).map(hex).join("");
    drawHorizon(ctx, 200, 200, facts, LIGHT);
    const name = { [LIGHT.above]: "above", [LIGHT.below]: "below" };
    const horizon = [[100, 40], [170, 100], [100, 160], [30, 100]].map((place) => name[color(place)] ?? color(place));
    drawCompass(ctx, 200, 200, facts, LIGHT);
    const ring = (degrees, r, wanted) => {
        const x = 100 + r * Math.sin(degrees * Math.PI / 180), y = 100 - r * Math.cos(degrees * Math.PI / 180);
        const at = [Math.round(x), Math.round(y)], steps = [-2, -1, 0, 1, 2];
        return steps.some((dx) => steps.some((dy) => color([at[0] + dx, at[1] + dy]) === wanted));
    };
    const marks = [[75, LIGHT.body], [40, LIGHT.felt], [98, LIGHT.goal]];
    const found = [0, 90, 180, 270].map((degrees) => marks.map((mark) => ring(degrees, ...mark)));
    return { horizon, found };
})()"""


@pytest.mark.parametrize(
    ("rpy_rad", "horizon"),
    [
        ((0.0, 0.3, 0.0), ["above", "above", "below", "above"]),
        ((0.0, -0.3, 0.0), ["above", "below", "below", "below"]),
        ((0.5, 0.0, 0.0), ["above", "below", "below", "above"]),
        ((-0.5, 0.0, 0.0), ["above", "above", "below", "below"]),
        ((0.0, 1.5, 0.0), ["above"] * 4),
    ],
)
def test_what_is_painted_at_known_attitudes(
    served: str, rpy_rad: tuple[float, float, float], horizon: list[str]
) -> None:
    """Top, right, bottom and left of the dial: nose up = more is above, right side down = below to the right."""
    with browser.page(browser.found()) as tab:
        tab.open(served)
        made = tab.ask(PAINTED % json.dumps([*rpy_rad[:2], math.pi]))
        assert made["horizon"] == horizon
        heading, current, goal = zip(*made["found"], strict=True)
        assert heading == (False, False, True, False), "to the south"
        assert current == (False, True, False, True), "an arrow through the middle from west to east"
        assert goal == (False, False, True, False)
        assert tab.errors == []
