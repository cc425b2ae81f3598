"""The page on what a process sends."""

import copy
import math
from pathlib import Path
from typing import Any

import pytest
from browser_module import needs_browser
from scripted_page import module, page

from autopilot.core.messages import Failsafe
from autopilot.view.http_server import PAGES, POLICY

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "autopilot" / "data" / "view"


@needs_browser
@pytest.mark.parametrize(("width", "height", "theme"), [(700, 600, "light"), (360, 500, "dark")])
def test_the_page_shows_what_it_is_sent(events: list[dict[str, Any]], width: int, height: int, theme: str) -> None:
    made = page(events, width, height, theme)
    frame = events[-1]["data"]
    words = made["words"]
    assert words["mode"] == frame["mode"] and words["armed"] == "armed"
    assert words["title"] == "paper-tank · lbv150 · simulated"
    facts = dict(zip(made["state"][::2], made["state"][1::2], strict=True))
    assert facts["Estimate"] == frame["estimate"]["health"]
    north = float(facts["North, east, depth"].split(",")[0])
    assert north == pytest.approx(frame["estimate"]["pos_ned_m"][0], abs=0.006)
    rods = {bar["words"][0]: bar for bar in made["bars"]}
    planar = math.hypot(*frame["estimate"]["vel_water_frd_m_s"][:2])
    assert float(rods["Planar speed"]["rod"]["width"].rstrip("%")) == pytest.approx(min(200 * planar, 100), abs=0.1)
    port = frame["thrust_n"][0]
    assert float(rods["port"]["rod"]["width"].rstrip("%")) == pytest.approx(50 * min(abs(port) / 12, 1), abs=0.1)
    for name in ("plan", "side"):
        assert made["svg"][name].count("<path") > 5
    fence, tube = ("#c4262e", "rgba(184,106,0,.3)") if theme == "light" else ("#ff6b6b", "rgba(240,168,60,.35)")
    assert made["svg"]["side"].count(fence) >= 3, "two ends of the fence and the deepest place"
    assert tube in made["svg"]["side"] and tube in made["svg"]["plan"]
    assert ">A</text>" in made["svg"]["plan"] and ">B</text>" in made["svg"]["plan"]
    assert "steer" not in made["hidden"]
    assert "camerabox" in made["hidden"], "the tracking system's run has no camera"
    assert words["health"] == "estimate good" and words["control"] == ""
    assert any("Armed" in line for line in made["messages"])


PLANS = """
const { extent, flowScale, planView } = plan;
for (const [width, height] of [[720, 440], [360, 500], [500, 500], [900, 300]]) {
  for (const [north, east, speed] of [[5, 3, 0.25], [3, 5, 0.004], [12, 6, 0.021], [400, 120, 0.7], [4, 4, 1.9]]) {
    const tank_m = [[0, 0], [north, 0], [north, east], [0, east]], scene = { tank_m, places: [], fence: [] };
    const box = extent(scene, null), view = planView(width, height, box), ys = tank_m.map((p) => view.at(p)[1]);
    const flow = { arrows: [[1, 1, speed, 0], [2, 1, 0, -0.3 * speed]] }, { told, reach } = flowScale(flow, box);
    const share = (reach * speed) / Math.max(north, east), still = flowScale(null, box).told;
    made.push({ height, top: Math.min(...ys), bottom: Math.max(...ys), speed, told, share, still });
  }
}
"""


@needs_browser
def test_the_plan_leaves_room_for_its_margins_and_shows_every_current() -> None:
    """North, scale and key stand in strips that no wall reaches; arrows are to scale with the field."""
    made = module("plan", PLANS)
    assert len(made) == 20
    for plan in made:
        assert plan["top"] >= 26 and plan["bottom"] <= plan["height"] - 26
        assert plan["still"] == pytest.approx(0.2)
        if plan["speed"] >= 0.005:
            assert 0.39 * plan["speed"] <= plan["told"] <= 1.001 * plan["speed"]
            assert 0.06 <= plan["share"] <= 0.25, "neither a dot nor across the plan"


@needs_browser
def test_nothing_has_no_sign(events: list[dict[str, Any]]) -> None:
    scene, frame = next(event for event in events if event["name"] == "scene"), copy.deepcopy(events[-1])
    frame["data"]["estimate"]["pos_ned_m"] = [-0.004, -0.006, 0.3]
    frame["data"]["estimate"]["rpy_rad"] = [-1e-4, 0.0, 0.0]
    made = page([scene, frame])
    facts = dict(zip(made["state"][::2], made["state"][1::2], strict=True))
    assert facts["North, east, depth"] == "0.00, -0.01, 0.30 m"
    assert facts["Roll, pitch, yaw"] == "0.0°, 0.0°, 0.0°"


@needs_browser
def test_what_is_old_is_no_news(events: list[dict[str, Any]]) -> None:
    """A prediction of before the estimate was lost, a sensor that no longer measures."""
    scene = next(event for event in events if event["name"] == "scene")
    frame = copy.deepcopy(events[-1])
    fresh = page([scene, frame])
    silent = frame["data"]["sensors"][0]
    silent["age_s"], frame["data"]["control"]["age_s"] = 7.2, 6.0
    frame["data"]["estimate"]["health"] = "INVALID"
    made = page([scene, frame])
    horizon = "#b86a00"
    assert horizon in fresh["svg"]["plan"] and horizon not in made["svg"]["plan"] + made["svg"]["side"]
    facts = dict(zip(made["state"][::2], made["state"][1::2], strict=True))
    assert facts["Controller"] == "at rest for 6 s" and "Predicted margin" not in facts
    assert made["words"]["health"] == "estimate invalid"
    assert f"{silent['name']} silent" in made["words"]["sensors"] and "silent" not in fresh["words"]["sensors"]


@needs_browser
def test_the_page_bears_what_is_missing(events: list[dict[str, Any]]) -> None:
    bare = copy.deepcopy(events[-1])
    for name in ("estimate", "truth", "goal", "progress", "control", "battery", "loop", "clearance_m"):
        bare["data"][name] = None
    for name in ("solids", "tracks", "thrust_n", "pwm_us", "effectiveness", "sensors", "messages"):
        bare["data"][name] = []
    bare["data"]["extra_current_ned_m_s"] = None
    bare["data"]["failsafes"] = [failsafe.name for failsafe in Failsafe]
    scene = copy.deepcopy(next(event for event in events if event["name"] == "scene"))
    scene["data"].update(tank_m=[], tank_depth_m=None, fence=[], places=[], camera_px=None, simulated=False)
    scene["data"]["steerable"] = {
        **dict.fromkeys(("pause", "speed", "reset", "current", "obstacles"), False),
        "faults": [],
        "missing": ["read-only"],
    }
    made = page([scene, bare])
    assert "steer" in made["hidden"] and made["words"]["readonly"] == "read-only"
    assert made["words"]["alarms"].startswith("Failsafe: ") and "leak" in made["words"]["alarms"]


@needs_browser
def test_what_a_person_does_is_asked_for(events: list[dict[str, Any]]) -> None:
    frame = copy.deepcopy(events[-1])
    solid = frame["data"]["solids"][0]
    scene = next(event for event in events if event["name"] == "scene")

    def at(away_px: list[float]) -> dict[str, float]:
        """So far from where the page has drawn the obstacle."""
        dots = page([scene, frame])["svg"]["plan"].split(f">{solid['number']}</text>")[0].rpartition("<text")[2]
        x, y = (float(dots.split(f'{axis}="')[1].split('"')[0]) for axis in "xy")
        return {"clientX": x + away_px[0], "clientY": y - 4 + away_px[1], "pointerId": 1}

    made = page(
        [
            scene,
            frame,
            {"event": "click", "name": "pause", "data": {}},
            {"event": "pointerdown", "name": "plan", "data": at([0, 0])},
            {"event": "pointermove", "name": "plan", "data": at([20, 10])},
            {"event": "pointerup", "name": "plan", "data": at([40, 20])},
            {"event": "pointerdown", "name": "flow", "data": {"clientX": 56, "clientY": 56, "pointerId": 1}},
            {"event": "pointerup", "name": "flow", "data": {"clientX": 80, "clientY": 56, "pointerId": 1}},
            {"event": "click", "name": "reset", "data": {}},
        ]
    )
    pause, obstacle, flow, reset = made["requests"]
    assert pause == {"url": "do", "do": "pause"} and reset == {"url": "do", "do": "reset"}
    assert obstacle["do"] == "obstacle" and obstacle["number"] == solid["number"]
    moved = math.hypot(obstacle["north_m"] - solid["center_m"][0], obstacle["east_m"] - solid["center_m"][1])
    assert 0.1 < moved < 1.5
    assert flow == {"url": "do", "do": "current", "north_m_s": 0.0, "east_m_s": 0.0}


def test_nothing_comes_from_outside() -> None:
    for name, _ in PAGES.values():
        text = (PAGE / name).read_text(encoding="utf-8").replace('xmlns="http://www.w3.org/2000/svg"', "")
        assert "http:" not in text and "https:" not in text and "//cdn" not in text, name
    index = (PAGE / "index.html").read_text(encoding="utf-8")
    # The policy allows neither of these.
    assert " style=" not in index and " onclick=" not in index and "<script>" not in index
    assert "unsafe" not in POLICY
