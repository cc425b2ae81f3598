"""Plan files: every format read, ``.plan`` written, and each kind of damage answered by one line."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.core.errors import PlanError
from autopilot.core.geodesy import Origin
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.mission.paper import paper_plan
from autopilot.mission.plan_files import read_plan, read_waypoints, write_plan
from autopilot.mission.plan_model import FLOAT32_MAX, PlanFile, without_home
from autopilot.mission.qgc_plan import read_qgc_plan, write_qgc_plan
from autopilot.mission.store import plan_checksum
from tests.plan_items import NAN

PAPER = write_qgc_plan(paper_plan())


def same(a: PlanFile, b: PlanFile) -> bool:
    return a.home == b.home and all(plan_checksum(a.items(k)) == plan_checksum(b.items(k)) for k in PlanKind)


def changed(change: Callable[[dict[str, Any]], object]) -> str:
    document = json.loads(PAPER)
    change(document)
    return json.dumps(document)


def test_a_plan_survives_writing_and_reading(tmp_path: Path) -> None:
    path = tmp_path / "tour.plan"
    write_plan(path, paper_plan())
    assert same(read_plan(path), paper_plan())
    item = read_plan(path).mission[1]
    assert (item.z, item.param4, item.param2) == (-0.30, 180.0, 0.3)


degrees_e7 = st.tuples(st.integers(-890_000_000, 890_000_000), st.integers(-1_800_000_000, 1_800_000_000))
finite = st.floats(-1e6, 1e6, width=32)
free = st.one_of(finite, st.just(NAN))


@st.composite
def files(draw: st.DrawFn) -> PlanFile:
    mission = []
    count = draw(st.integers(0, 6))
    for seq in range(count):
        x, y = draw(degrees_e7)
        command = draw(st.sampled_from([16, 17, 19, 20, 21, 93, 115, 178, 179, 177, 530]))
        p1 = float(draw(st.integers(0, count - 1))) if command == 177 else draw(free)
        mission.append(
            PlanItem(
                seq=seq,
                frame=draw(st.sampled_from([0, 3, 1])),
                command=command,
                param1=p1,
                param2=draw(free),
                param3=draw(free),
                param4=draw(free),
                x=x,
                y=y,
                z=draw(finite),
                autocontinue=draw(st.integers(0, 1)),
            )
        )
    fence: list[PlanItem] = []
    for inclusion in draw(st.lists(st.booleans(), max_size=2)):
        vertices = draw(st.lists(degrees_e7, min_size=3, max_size=5))
        for x, y in vertices:
            n = float(len(vertices))
            fence.append(_fence(len(fence), 5001 if inclusion else 5002, n, x, y))
    for inclusion in draw(st.lists(st.booleans(), max_size=2)):
        x, y = draw(degrees_e7)
        fence.append(_fence(len(fence), 5003 if inclusion else 5004, draw(st.floats(0.01, 1e4)), x, y))
    points = draw(st.lists(degrees_e7, max_size=3))
    rally = tuple(
        PlanItem(seq=k, frame=3, command=5100, param4=0.0, x=x, y=y, z=draw(finite)) for k, (x, y) in enumerate(points)
    )
    home = Origin(lat_deg=draw(st.floats(-89, 89)), lon_deg=draw(st.floats(-180, 180)), alt_m=draw(finite))
    return PlanFile(mission=tuple(mission), fence=tuple(fence), rally=rally, home=home)


def _fence(seq: int, command: int, p1: float, x: int, y: int) -> PlanItem:
    return PlanItem(seq=seq, frame=0, command=command, param1=p1, param4=0.0, x=x, y=y, z=0.0)


@given(files())
def test_any_plan_survives_writing_and_reading(plan: PlanFile) -> None:
    assert same(read_qgc_plan(write_qgc_plan(plan), "x.plan"), plan)


@given(st.integers(0, len(PAPER) - 2))
def test_a_plan_cut_off_anywhere_is_refused(length: int) -> None:
    with pytest.raises(PlanError) as refusal:
        read_qgc_plan(PAPER[:length], "cut.plan")
    assert str(refusal.value).startswith("cut.plan: ")
    assert "\n" not in str(refusal.value)


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-5, 20)
    | st.just(10**400)
    | st.floats(allow_nan=False)
    | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)


@given(st.data(), json_values)
def test_any_value_anywhere_is_read_or_refused_in_one_line(data: st.DataObject, value: Any) -> None:
    document: Any = json.loads(PAPER)
    node = document
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = data.draw(st.sampled_from(keys))
        inner = node[key]
        if not isinstance(inner, dict | list) or not inner or data.draw(st.booleans()):
            node[key] = value
            break
        node = inner
    try:
        plan = read_qgc_plan(json.dumps(document), "odd.plan")
    except PlanError as error:
        assert "\n" not in str(error)
    else:
        for kind in PlanKind:
            plan_checksum(plan.items(kind))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (changed(lambda d: d.update(version=2)), "version 2 is not supported"),
        (changed(lambda d: d.update(fileType="Parameters")), "not 'Plan'"),
        (changed(lambda d: d.pop("mission")), "key 'mission' is missing"),
        (changed(lambda d: d["mission"].update(version=1)), "mission: version 1"),
        (changed(lambda d: d["mission"]["items"][1].pop("params")), "mission item 1: key 'params' is missing"),
        (changed(lambda d: d["mission"]["items"][0]["params"].pop()), "params has 6 numbers; 7 are needed"),
        (changed(lambda d: d["mission"]["items"][0]["params"].__setitem__(4, None)), "param5 (a coordinate) is nan"),
        (changed(lambda d: d["mission"]["items"][0]["params"].__setitem__(5, "x")), "params is str"),
        (changed(lambda d: d["mission"]["items"][0].update(Altitude=-0.9)), "item 0: Altitude is -0.9, which ground"),
        (changed(lambda d: d["mission"]["items"][0]["params"].__setitem__(5, 999.0)), "out of range"),
        (changed(lambda d: d["mission"]["items"][0]["params"].__setitem__(0, 1e39)), "32-bit"),
        (changed(lambda d: d["mission"]["items"][3]["params"].__setitem__(0, 77)), "doJumpId 77"),
        (changed(lambda d: d["mission"]["items"][0].update(type="ComplexItem")), "turn it into waypoints"),
        (changed(lambda d: d["mission"].update(plannedHomePosition=[95, 0, 0])), "latitude 95"),
        (changed(lambda d: d["geoFence"]["circles"][0].pop("inclusion")), "circle 0: key 'inclusion' is missing"),
        (changed(lambda d: d["geoFence"]["polygons"][0]["polygon"][2].pop()), "polygon 0 vertex 2"),
        (changed(lambda d: d["mission"]["items"][0].update(doJumpId=2)), "doJumpId 2, which 2 items have"),
        (changed(lambda d: d["geoFence"]["polygons"][0].update(polygon=[])), "polygon 0: polygon has no vertices"),
        (PAPER.replace('"geoFence": {', '"geoFence": {}, "geoFence": {'), "key 'geoFence' stands twice"),
        ("[1, 2]", "has to be an object"),
        ("[" * 5000, "JSON"),
        ("9" * 5000, "thousands of digits"),
        (changed(lambda d: d["mission"]["items"][0]["params"].__setitem__(4, 10**400)), "too large"),
        (PAPER.replace("37.9754856", "NaN"), "nan"),
    ],
)
def test_damaged_plans_name_the_place(text: str, words: str) -> None:
    with pytest.raises(PlanError) as refusal:
        read_qgc_plan(text, "bad.plan")
    assert words in str(refusal.value) or words == "JSON"
    assert "\n" not in str(refusal.value)


def test_a_survey_gives_the_items_that_it_was_turned_into() -> None:
    def survey(document: dict[str, Any]) -> None:
        simple = document["mission"]["items"]
        survey_item = {
            "type": "ComplexItem",
            "complexItemType": "survey",
            "version": 5,
            "TransectStyleComplexItem": {"Items": simple[1:3], "version": 2},
        }
        jump = {**simple[3], "params": [2, 2, 0, 0, 0, 0, 0]}
        document["mission"]["items"] = [simple[0], survey_item, jump]

    assert same(read_qgc_plan(changed(survey), "survey.plan"), paper_plan())


def test_unknown_keys_and_a_return_point_are_fine() -> None:
    def extend(document: dict[str, Any]) -> None:
        document["comment"] = "x"
        document["geoFence"]["breachReturn"] = [37.9755, 23.779, 0]

    plan = read_qgc_plan(changed(extend), "x.plan")
    assert plan.fence[-1].command == 5000


ROW = "{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t1"


def _wpl(*rows: tuple[object, ...]) -> str:
    return "\n".join(["QGC WPL 110", *(ROW.format(*row) for row in rows)]) + "\n"


def test_waypoints_file_with_and_without_home() -> None:
    home = (0, 1, 0, 16, 0, 0, 0, 0, 37.9755, 23.779, 5.0)
    a = (1, 0, 3, 16, 0, 0.3, 0, "nan", 37.9754856, 23.778996, -0.45)
    b = (2, 0, 3, 16, 1.5, 0, 0, 90, 37.9755158, 23.779, -0.3)
    jump = (3, 0, 3, 177, 1, 2, 0, 0, 0, 0, 0)
    with_home = read_waypoints(_wpl(home, a, b, jump), "x.waypoints")
    assert with_home.home == Origin(lat_deg=37.9755, lon_deg=23.779, alt_m=5.0)
    assert [(i.seq, i.is_home) for i in with_home.mission] == [(0, True), (1, False), (2, False), (3, False)]
    assert (with_home.mission[3].param1, with_home.mission[2].param1) == (1.0, 1.5)
    assert math.isnan(with_home.mission[1].param4)
    assert with_home.mission[1].x == 379754856
    without = read_waypoints(_wpl((0, 1, *a[2:]), (1, *b[1:]), (2, 0, 3, 177, 0, 2, 0, 0, 0, 0, 0)), "x.waypoints")
    assert plan_checksum(without.mission) == plan_checksum(without_home(with_home.mission))
    assert without.home is None
    unset = read_waypoints(_wpl((*home[:8], 0, 0, 0), a), "x.waypoints")
    assert (len(without_home(unset.mission)), unset.home) == (1, None)
    in_water = read_waypoints(_wpl((*home[:10], -0.5), a), "x.waypoints")
    assert ([item.is_home for item in in_water.mission], in_water.home) == ([False, False], None)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "line 1 is ''"),
        ("QGC WPL 120\n", "not 'QGC WPL 110'"),
        (_wpl((0, 1, 3, 16, 0, 0, 0, 0, 37.9, 23.7, -1)) + "1\t0\t3", "line 3: has 3 columns"),
        (_wpl((0, 1, 3, 16, 0, 0, 0, 0, "north", 23.7, -1)), "line 2: column 9 is 'north'"),
        (_wpl((0, 1, 3, 16.5, 0, 0, 0, 0, 37.9, 23.7, -1)), "column 4"),
        (_wpl((0, 1, 3, 16, 0, 0, 0, 0, "nan", 23.7, -1)), "param5 (a coordinate) is nan"),
        (_wpl((0, 1, "inf", 16, 0, 0, 0, 0, 37.9, 23.7, -1)), "column 3"),
        (
            _wpl((0, 1, 3, 16, 0, 0, 0, 0, 37.9, 23.7, -1), (2, 0, 3, 177, 0, 2, 0, 0, 0, 0, 0)),
            "line 3: item 1 is numbered 2",
        ),
    ],
)
def test_damaged_waypoint_files_name_the_line(text: str, words: str) -> None:
    with pytest.raises(PlanError) as refusal:
        read_waypoints(text, "bad.waypoints")
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)


TOML = """
[origin]
lat_deg = 37.9755
lon_deg = 23.7790
[[waypoint]]
x_m = 1.0
y_m = -0.5
depth_m = 0.4
hold_s = 2.0
speed_m_s = 0.2
[[waypoint]]
x_m = -1.0
y_m = 0.5
depth_m = 0.6
yaw_rad = 1.5707963267948966
[repeat]
first_waypoint = 0
laps = 4
[end]
action = "surface"
[[rally]]
x_m = 0.0
y_m = 0.0
"""


def test_local_metres(tmp_path: Path) -> None:
    path = tmp_path / "tank.toml"
    path.write_text(TOML, encoding="utf-8")
    plan = read_plan(path)
    assert [i.command for i in plan.mission] == [178, 16, 16, 177, 21]
    assert (plan.mission[3].param1, plan.mission[3].param2) == (0.0, 3.0)
    assert math.isnan(plan.mission[1].param4)
    assert plan.mission[2].param4 == pytest.approx(90.0)
    assert plan.mission[2].z == -0.6
    assert len(plan.rally) == 1
    assert plan.home == Origin(lat_deg=37.9755, lon_deg=23.779)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("depth_m = 0.4", "depth = 0.4"), "depth"),
        (("x_m = 1.0", "x_m = 'far'"), "$.waypoint[0].x_m"),
        (("x_m = 1.0", "x_m = nan"), "waypoint[0].x_m` = nan"),
        (("hold_s = 2.0", "hold_s = inf"), "waypoint[0].hold_s` = inf"),
        (("first_waypoint = 0", "first_waypoint = 2"), "first_waypoint 2 does not exist"),
        (("laps = 4", "laps = 0"), "$.repeat.laps"),
        (('action = "surface"', 'action = "dive"'), "$.end.action"),
        (("lat_deg = 37.9755", "lat_deg = 95.0"), "latitude"),
        (("[origin]", "[origin"), "not valid TOML"),
        (("x_m = 1.0", "x_m = 1e9"), "waypoint[0]: local position 1e+09"),
        (("[[rally]]", "[[fence.polygon]]\npoints_m = []\ninclusion = true\n[[rally]]"), "fence.polygon[0].points_m"),
        (("[origin]\nlat_deg = 37.9755\nlon_deg = 23.7790", ""), "origin"),
    ],
)
def test_wrong_local_plans_name_the_key(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    path = tmp_path / "tank.toml"
    path.write_text(TOML.replace(*change), encoding="utf-8")
    with pytest.raises(PlanError) as refusal:
        read_plan(path)
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_files_that_are_not_there_or_are_something_else(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match="cannot be read"):
        read_plan(tmp_path / "none.plan")
    with pytest.raises(PlanError, match="unknown kind"):
        read_plan(tmp_path / "plan.kml")
    (tmp_path / "b.plan").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(PlanError, match="UTF-8"):
        read_plan(tmp_path / "b.plan")
    with pytest.raises(PlanError, match="only"):
        write_plan(tmp_path / "x.toml", paper_plan())
    with pytest.raises(PlanError, match="cannot be written"):
        write_plan(tmp_path / "missing" / "x.plan", paper_plan())


def test_rally_points_of_version_1_are_read(tmp_path: Path) -> None:
    """As QGroundControl writes them."""
    path = tmp_path / "tank.toml"
    path.write_text(TOML, encoding="utf-8")
    plan = read_plan(path)
    written = tmp_path / "tank.plan"
    write_plan(written, plan)
    text = json.loads(written.read_text(encoding="utf-8"))
    for version in (1, 2):
        text["rallyPoints"]["version"] = version
        written.write_text(json.dumps(text), encoding="utf-8")
        assert same(read_plan(written), plan)
    text["rallyPoints"]["version"] = 3
    written.write_text(json.dumps(text), encoding="utf-8")
    with pytest.raises(PlanError, match="rallyPoints: version 3"):
        read_plan(written)


def test_the_largest_number_of_a_plan_is_that_of_the_wire() -> None:
    assert float(np.finfo(np.float32).max) == pytest.approx(FLOAT32_MAX, rel=1e-7)
