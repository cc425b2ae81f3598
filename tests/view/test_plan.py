"""The plan's zoom, grid, arrows and fit: by the page's own geometry."""

import copy
import json
import math
import re
from functools import partial
from typing import Any

import pytest
from browser_module import needs_browser
from scripted_page import module, page

SCALES = [10 ** (k / 7 - 1.5) for k in range(32)]
"""Pixels per metre: from kilometres across to millimetres."""

pytestmark = needs_browser
geometry = partial(module, "plan")


SIZES = "for (const all of [{n0: 0, n1: 5, e0: 0, e1: 3}, {n0: -180, n1: 180, e0: -20, e1: 20}])"


def test_zooming_keeps_the_point_under_the_cursor() -> None:
    made = geometry(
        f"""{SIZES} for (const [w, h] of [[700, 430], [370, 360]]) for (const place of [[60, 70], [300, 200]]) {{
            let view = plan.planView(w, h, all), camera = null;
            for (const factor of [1.5, 3, 0.7, 1.1]) {{
                const under = view.back(...place);
                camera = plan.zoomed(view, false, factor, place);
                const next = plan.planView(w, h, all, camera), [x, y] = next.at(under);
                const edge = [camera.n === all.n0, camera.n === all.n1, camera.e === all.e0, camera.e === all.e1];
                made.push([x - place[0], y - place[1], next.scale / view.scale / factor, edge.includes(true)]);
                view = next;
            }}
        }}"""
    )
    free = [row for row in made if not row[3]]
    assert len(free) >= 24, "elsewhere the edge of everything stops the plan"
    for dx, dy, ratio, _ in free:
        assert (dx, dy, ratio) == pytest.approx((0, 0, 1), abs=1e-6)


def test_zooming_out_ends_with_everything_and_in_with_a_millimetre_per_pixel() -> None:
    made = geometry(
        f"""{SIZES} {{
            let view = plan.planView(700, 430, all);
            for (let k = 0; k < 40; k++) view = plan.planView(700, 430, all, plan.zoomed(view, false, 1.5, [200, 200]));
            const nearest = view.scale;
            let camera = null;
            for (let k = 0; k < 40; k++) {{
                camera = plan.zoomed(view, false, 1 / 1.5, [200, 200]);
                view = plan.planView(700, 430, all, camera);
            }}
            made.push([nearest, camera]);
        }}"""
    )
    assert made == [[1000, None], [1000, None]]


def test_panning_moves_what_is_shown_by_as_much_and_never_loses_it() -> None:
    made = geometry(
        f"""{SIZES} {{
            const view = plan.planView(700, 430, all, {{ n: 1, e: 1, scale: 90, follow: true }}), here = [1.2, 1.1];
            const moved = plan.planView(700, 430, all, plan.panned(view, [12, -7]));
            const far = plan.panned(view, [1e6, 1e6]);
            const [x, y] = view.at(here), [x1, y1] = moved.at(here);
            made.push([x1 - x, y1 - y, far.n >= all.n0 && far.n <= all.n1 && far.e >= all.e0 && far.e <= all.e1]);
        }}"""
    )
    for dx, dy, kept in made:
        assert (dx, dy) == pytest.approx((12, -7)) and kept


def test_following_keeps_the_vehicle_in_the_middle_and_is_calm_where_motion_is_unwelcome() -> None:
    made = geometry(
        """const all = {n0: -180, n1: 180, e0: -180, e1: 180};
        const camera = plan.following(plan.planView(700, 430, all), [3, 4], 0.2);
        const view = plan.planView(700, 430, all, camera), zoomed = plan.zoomed(view, true, 2, [10, 10]);
        made.push(camera, zoomed);
        for (const [north, calm] of [[3.5, false], [3.5, true], [9, true]]) {
            made.push(plan.followed(camera, view, [north, 4], calm));
        }"""
    )
    camera, zoomed, live, calm, left = made
    assert camera == {"n": 3, "e": 4, "scale": 60, "follow": True}, "seen as a vehicle, not as a dot"
    assert zoomed == camera | {"scale": 120}
    assert live["n"] == 3.5 and calm == camera and left["n"] == 9


def test_grid_steps_are_1_2_5_and_squares_of_a_readable_size() -> None:
    steps = geometry(f"for (const scale of {SCALES}) made.push(plan.gridStep(scale))")
    for scale, step in zip(SCALES, steps, strict=True):
        digit = step / 10 ** math.floor(math.log10(step) + 1e-9)
        assert min(abs(digit - round_one) for round_one in (1, 2, 5)) < 1e-6
        assert 55.9 <= step * scale <= 142
    assert len(set(steps)) > 10, "it changes with the zoom"


def test_arrows_of_the_current_are_bounded_apart_and_do_not_jump_at_any_zoom() -> None:
    made = geometry(
        f"""const arrows = [];
        for (let n = -10; n < 10; n += 0.1) for (let e = -10; e < 10; e += 0.1) arrows.push([n, e, 0.1, 0]);
        for (const scale of {SCALES}) {{
            const view = plan.planView(700, 430, {{n0: -180, n1: 180, e0: -180, e1: 180}}, {{ n: 0, e: 0, scale }});
            const moved = plan.planView(700, 430, view.all, {{ n: 0.05, e: 0, scale }});
            const kept = plan.thinned(arrows, view), after = plan.thinned(arrows, moved);
            const gaps = [0, 1].flatMap((axis) => {{
                const rows = [...new Set(kept.map((a) => a[axis]))].sort((a, b) => a - b);
                return rows.slice(1).map((value, k) => (value - rows[k]) * scale);
            }});
            const before = new Set(kept.map(String)), inside = (a) => a[0] < view.box.n1 && a[0] > view.box.n0;
            const jumped = after.filter((a) => inside(a) && !before.has(String(a))).length;
            made.push([kept.length, Math.min(1e9, ...gaps), jumped]);
        }}"""
    )
    for count, gap, jumped in made:
        assert count <= 700 / 20 * 430 / 20 and gap >= 19.9 and jumped == 0
    assert all(count >= 1 for count, *_ in made[:-8]), "where there is a current, one arrow stays"
    assert max(count for count, *_ in made) > 100


def test_a_fine_grid_of_the_current_stands_in_the_place_of_the_coarse_one() -> None:
    made = geometry(
        """const grid = (step, count, from) => Array.from({ length: count * count }, (_, k) =>
            [from + step * Math.floor(k / count), from + step * (k % count), 0.1, 0]);
        const field = { arrows: grid(15, 21, -150), near: grid(1.5, 13, -9) };
        const all = {n0: -180, n1: 180, e0: -180, e1: 180};
        for (const scale of [1, 6, 40, 300]) {
            const view = plan.planView(700, 430, all, { n: 0, e: 0, scale }), { n0, n1, e0, e1 } = view.box;
            const shown = plan.flowArrows(field, view, 20), is = (a) => field.near.includes(a);
            const inside = (a) => Math.abs(a[0]) <= 9 && Math.abs(a[1]) <= 9;
            made.push([shown.filter(is).length, shown.filter((a) => !is(a)).length,
                shown.filter((a) => !is(a) && inside(a)).length]);
        }"""
    )
    far, middle, near, nearest = made
    assert far[0] == 0 and far[1] > 100, "from far above a fine grid would be a blot"
    assert middle[0] >= 9 and middle[1] > 10 and middle[2] == 0
    assert near[0] > 60 and near[2] == nearest[2] == 0 and nearest[0] >= 1


def numbers(svg: str, color: str) -> list[tuple[float, float]]:
    """Points of everything drawn in a colour."""
    found = re.findall(rf'<path d="([^"]*)" fill="[^"]*"(?: stroke="{re.escape(color)}")', svg)
    return [(float(x), float(y)) for d in found for x, y in re.findall(r"[ML](-?[\d.]+) (-?[\d.]+)", d)]


def key(name: str, target: str = "plan") -> dict[str, Any]:
    return {"event": "keydown", "name": target, "data": {"key": name}}


def test_the_keys_and_buttons_of_the_plan(events: list[dict[str, Any]]) -> None:
    """Zoomed in there is a mini-map, and the wall is outside; fit shows the wall whole again."""
    scene, frame = next(event for event in events if event["name"] == "scene"), events[-1]
    wall = "#33414e"

    def extent_px(*asked: dict[str, Any]) -> tuple[float, bool, str]:
        """Width of the widest wall, whether there is a mini-map, and the text of the scale bar."""
        svg = page([scene, frame, *asked])["svg"]["plan"]
        xs = [x for x, _ in numbers(svg, wall)]
        metres = re.findall(r">([\d.]+ m)</text>", svg)
        return max(xs) - min(xs), 'stroke="#1b2733" stroke-width="2.0"' in svg, metres[-1]

    whole, mini, scale = extent_px()
    assert 300 < whole <= 700 and not mini
    nearer, mini_in, scale_in = extent_px(key("+"), key("+"), key("+"))
    assert nearer == pytest.approx(1.5**3 * whole, rel=0.01) and mini_in and scale_in != scale
    assert extent_px(*[{"event": "click", "name": "nearer", "data": {}}] * 3) == (nearer, mini_in, scale_in)
    wheel = {"event": "wheel", "name": "plan", "data": {"deltaY": -300, "clientX": 200, "clientY": 200}}
    assert extent_px(wheel)[0] == pytest.approx(math.exp(0.6) * whole, rel=0.01)
    for back in (key("0"), {"event": "click", "name": "fit", "data": {}}):
        assert extent_px(key("+"), key("ArrowLeft"), key("f"), back) == (whole, mini, scale)
    assert extent_px(key("+"), key("-"))[0] == pytest.approx(whole)


def test_two_fingers_zoom_and_a_drag_pans(events: list[dict[str, Any]]) -> None:
    scene, frame = next(event for event in events if event["name"] == "scene"), copy.deepcopy(events[-1])
    frame["data"]["solids"] = []

    def touch(kind: str, finger: int, x: float, y: float, pointer: str = "touch") -> dict[str, Any]:
        at = {"clientX": x, "clientY": y, "pointerId": finger, "pointerType": pointer}
        return {"event": f"pointer{kind}", "name": "plan", "data": at}

    def corner(*asked: dict[str, Any]) -> tuple[list[float], float]:
        xs, ys = zip(*numbers(page([scene, frame, *asked])["svg"]["plan"], "#33414e")[:4], strict=True)
        return [xs[0], ys[0]], max(xs) - min(xs)

    start, width = corner()
    pinch = [touch("down", 1, 300, 200), touch("down", 2, 400, 200), touch("move", 2, 500, 200)]
    assert corner(*pinch)[1] == pytest.approx(2 * width, rel=0.01)
    assert corner(touch("down", 1, 300, 200), touch("move", 1, 340, 190)) == (start, width), "a finger scrolls the page"
    dragged, same = corner(*[touch(kind, 1, x, y, "mouse") for kind, x, y in (("down", 300, 200), ("move", 340, 190))])
    assert same == width and [dragged[0] - start[0], dragged[1] - start[1]] == pytest.approx([40, -10], abs=0.2)


def test_a_followed_vehicle_moves_the_plan_unless_motion_is_unwelcome(events: list[dict[str, Any]]) -> None:
    scene, frame = next(event for event in events if event["name"] == "scene"), events[-1]
    ahead = copy.deepcopy(frame)
    ahead["data"]["estimate"]["pos_ned_m"][0] += 0.3

    def wall(sent: dict[str, Any], *options: str) -> tuple[float, float]:
        clicks = [{"event": "click", "name": name, "data": {}} for name in ("nearer", "follow")]
        made = page([scene, frame, *clicks, sent], 700, 600, "light", *options)
        return numbers(made["svg"]["plan"], "#33414e")[0]

    assert math.dist(wall(frame), wall(ahead)) > 20
    assert wall(frame, "calm") == wall(ahead, "calm")


def test_an_open_water_of_360_m_shows_a_vehicle_and_few_arrows(events: list[dict[str, Any]]) -> None:
    scene, frame = copy.deepcopy(next(event for event in events if event["name"] == "scene")), copy.deepcopy(events[-1])
    scene["data"] |= {"tank_m": [], "fence": []}
    scene["data"]["places"] = [scene["data"]["places"][0] | {"pos_ned_m": [n, 0, 1]} for n in (-180, 180)]
    grid = [round(-10 + 20 / 13 * (k + 0.5), 3) for k in range(13)]
    flow = {"name": "flow", "data": {"t_s": 6, "arrows": [[n, e, 0.1, 0.05] for n in grid for e in grid]}}
    made = page([scene, flow, frame])["svg"]["plan"]
    arrows = made.count('stroke="#5689ab" stroke-width="1.2"') / 2
    assert 1 <= arrows <= 4
    follow = {"event": "click", "name": "follow", "data": {}}

    def size(svg: str) -> float:
        """Of the vehicle, in pixels."""
        xs = [x for x, _ in numbers(svg, "#0b6fa4")]
        return max(xs) - min(xs)

    assert size(made) >= 8
    sides = [page([scene, flow, frame, *asked])["svg"]["side"] for asked in ([], [follow])]
    assert size(sides[1]) > 10 * size(sides[0]), "the side view goes with the plan"


def test_everything_is_shown_at_first(events: list[dict[str, Any]]) -> None:
    """A goal outside of walls and waypoints too."""
    scene, frame = next(event for event in events if event["name"] == "scene"), copy.deepcopy(events[-1])
    frame["data"]["goal"] |= {"pos_ned_m": [40.0, -25.0, 1.0]}
    made = geometry(
        f"""const scene = {json.dumps(scene["data"])}, frame = {json.dumps(frame["data"])};
        const view = plan.planView(700, 430, plan.extent(scene, frame));
        const states = [frame.goal, frame.estimate, frame.truth, ...scene.places];
        for (const state of states) made.push(view.at(state.pos_ned_m));
        for (const corner of scene.tank_m) made.push(view.at(corner));"""
    )
    assert all(0 <= x <= 700 and 26 <= y <= 404 for x, y in made)


def test_speed_reached_and_asked(events: list[dict[str, Any]]) -> None:
    """Of the vehicle over ground, and of a simulation that cannot keep up."""
    scene, last = next(event for event in events if event["name"] == "scene"), events[-1]
    sent = [copy.deepcopy(last) for _ in range(40)]
    for k, frame in enumerate(sent):
        frame["data"] |= {"sent_s": 50 + 0.1 * k, "t_s": 10 + 0.25 * k, "stale_s": 0, "speed": 8, "paused": False}
        frame["data"]["estimate"]["vel_frd_m_s"] = [0.3, 0.4, 0.0]
        frame["data"]["goal"] |= {"speed_m_s": 0.6, "speed_asked": k % 2 == 0}
    made = page([scene, *sent])
    facts = dict(zip(made["state"][::2], made["state"][1::2], strict=True))
    assert facts["Speed over ground"] == "0.50 m/s, at most 0.60" and made["words"]["pace"] == "2.5 × reached"
    made = page([scene, *sent[:-1]])
    facts = dict(zip(made["state"][::2], made["state"][1::2], strict=True))
    assert facts["Speed over ground"] == "0.50 m/s, 0.60 asked"
    sent[-1]["data"]["paused"] = True
    assert page([scene, *sent])["words"]["pace"] == ""
