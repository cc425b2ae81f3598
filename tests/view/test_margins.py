"""Distances to the nearest boundary, on the plan."""

import copy
import json
import math
import re
from typing import Any

import pytest
from browser_module import needs_browser
from scripted_page import module, page

INK, FENCE = "#1b2733", "#c4262e"

pytestmark = needs_browser


def drawn(scene: Any, frame: Any, *asked: Any) -> dict[str, list[str]]:
    """Figures beside dimension lines, by their colour: of the body, then of the prediction."""
    svg = page([scene, frame, *asked])["svg"]["plan"]
    texts = re.findall(r'<text [^>]*fill="([^"]*)"[^>]*>(-?\d+\.\d\d m)</text>', svg)
    return {color: [words for kind, words in texts if kind == color] for color in (INK, FENCE)}


HALF_CM = 0.0051
"""The page rounds; a half may go either way."""


def metres(text: str) -> float:
    return float(text.removesuffix(" m"))


def test_the_body_is_as_far_from_the_fence_as_the_gauge_says(events: list[dict[str, Any]]) -> None:
    scene, frame = next(event for event in events if event["name"] == "scene"), copy.deepcopy(events[-1])
    frame["data"]["tracks"] = []
    radius, control = scene["data"]["body_radius_m"], frame["data"]["control"]
    free_m = frame["data"]["clearance_m"] - radius
    told = drawn(scene, frame)
    assert metres(told[INK][0]) == pytest.approx(free_m, abs=HALF_CM)
    (now, ahead), gaps = module(
        "margins",
        f"""const scene = {json.dumps(scene["data"])}, frame = {json.dumps(frame["data"])};
        const gaps = frame.control.horizon_ned_m.map((place) => margins.nearestFence(scene.fence, place).gap_m);
        made.push(margins.dimensions(scene, frame), gaps);""",
    )
    place = frame["data"]["estimate"]["pos_ned_m"]
    assert now["free_m"] == pytest.approx(free_m, abs=2e-3), "circles are polygons on the page"
    assert math.dist(now["point"], place[:2]) == pytest.approx(now["free_m"] + radius)
    least = min(gap - radius - tube for gap, tube in zip(gaps, control["tube_m"], strict=True))
    assert ahead["free_m"] == pytest.approx(least)
    assert ahead["free_m"] >= control["margin_m"] - 0.005, "the controller's holds between nodes too"


def test_the_prediction_is_told_where_it_is_nearest_unless_that_covers_the_figure_of_now(
    events: list[dict[str, Any]],
) -> None:
    scene, frame = next(event for event in events if event["name"] == "scene"), copy.deepcopy(events[-1])
    radius, control = scene["data"]["body_radius_m"], frame["data"]["control"]
    control["horizon_ned_m"], control["tube_m"] = [[1.5, -0.8, 0.4], [1.9, -0.8, 0.4]], [0.01, 0.04]
    assert drawn(scene, frame)[INK][1] == f"{0.6 - radius - 0.04:.2f} m", "of a wall at 2.5 m north"
    control["horizon_ned_m"] = [frame["data"]["estimate"]["pos_ned_m"]] * 2
    assert len(drawn(scene, frame)[INK]) == 1


def test_a_nearer_reported_obstacle_is_told_instead_and_an_old_one_is_not(events: list[dict[str, Any]]) -> None:
    scene, frame = next(event for event in events if event["name"] == "scene"), copy.deepcopy(events[-1])
    north, east, _ = frame["data"]["estimate"]["pos_ned_m"]
    radius = scene["data"]["body_radius_m"]
    track = {"number": 1, "vel_ned_m_s": [0, 0], "radius_m": 0.1, "age_s": 0.1}
    track["pos_ned_m"] = [north, east + radius + 0.1 + 0.03]
    frame["data"]["tracks"] = [track]
    assert drawn(scene, frame)[INK][0] == "0.03 m"
    track["pos_ned_m"] = [north, east + radius]
    assert "-0.10 m" in drawn(scene, frame)[FENCE], "overlap is negative and red"
    track["age_s"] = 60.0
    free_m = frame["data"]["clearance_m"] - radius
    assert metres(drawn(scene, frame)[INK][0]) == pytest.approx(free_m, abs=HALF_CM)


def test_distances_can_be_switched_off_and_give_way_far_from_above(events: list[dict[str, Any]]) -> None:
    scene, frame = copy.deepcopy(next(event for event in events if event["name"] == "scene")), copy.deepcopy(events[-1])
    nothing: dict[str, list[str]] = {INK: [], FENCE: []}
    assert drawn(scene, frame) != nothing
    frame["data"]["estimate"]["health"] = "INVALID"
    assert drawn(scene, frame) == nothing, "nobody knows how far it is"
    frame["data"]["estimate"]["health"] = "GOOD"
    scene["data"]["places"] = [scene["data"]["places"][0] | {"pos_ned_m": [n, 0, 1]} for n in (-180, 180)]
    assert drawn(scene, frame) == nothing
    follow = {"event": "click", "name": "follow", "data": {}}
    assert drawn(scene, frame, follow) != nothing
    switch = {"event": "click", "name": "distances", "data": {}}
    assert drawn(scene, frame, follow, switch) == nothing
    assert drawn(scene, frame, follow, switch, switch) == drawn(scene, frame, follow)
    scene["data"]["fence"] = frame["data"]["tracks"] = []
    assert drawn(scene, frame, follow) == nothing
