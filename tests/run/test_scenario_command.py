"""``autopilot scenario``: list, new, check, plan; and a fence that the scenario's geometry draws."""

import json
import math
import re
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.analysis.flow_maps import b6_map
from autopilot.cli.scenario_command import scenario as command
from autopilot.core.errors import ConfigError
from autopilot.core.geodesy import Origin
from autopilot.core.geometry import Circle
from autopilot.core.toml_table import convert
from autopilot.mission.fence import read_fence
from autopilot.mission.plan_files import read_plan
from autopilot.run.sitl_fence import drawn_fence, scenario_plan
from autopilot.sitl.grid_current import read_grid
from autopilot.sitl.scenario import load_scenario, plan_path, scenario_names, scenario_path
from autopilot.sitl.scenario_tables import Scenario


def call(*arguments: object) -> Result:
    return CliRunner().invoke(command, [str(each) for each in arguments])


def test_list_names_all_that_is_shipped() -> None:
    listed = json.loads(call("list", "--json").output)
    assert [each["name"] for each in listed] == scenario_names()
    assert {"blind-dash", "b6", "b6-est", "pool"} <= {each["name"] for each in listed}


@pytest.mark.parametrize("name", scenario_names())
def test_everything_shipped_passes_its_check(name: str) -> None:
    done = call("check", name, "--json")
    found = json.loads(done.output)
    assert found["problems"] == []
    # A surprise and something that moves are not in the fence on purpose.
    sensed = [text for text in found["remarks"] if "only the obstacle sensor may tell" in text]
    assert found["remarks"] == sensed
    assert done.exit_code == (3 if sensed else 0)


@pytest.mark.parametrize("source", ["paper-tank", "pool", "b6", "vortex", "r4"])
def test_a_copy_is_good_as_it_is(tmp_path: Path, source: str) -> None:
    assert call("new", "mine", "--from", source, "--out", tmp_path).exit_code == 0
    file = str(tmp_path / "mine.toml")
    copy, original = load_scenario(file), load_scenario(source)
    assert copy.scenario.name == "mine"
    assert (copy.tank, copy.obstacle, copy.vehicle) == (original.tank, original.obstacle, original.vehicle)
    done = call("check", file)
    assert done.exit_code == 0, done.output
    plan = plan_path(file, copy)
    assert (plan is None) == (original.scenario.plan is None)
    assert plan is None or plan.parent == tmp_path
    comments = [line for line in scenario_path(source).read_text().splitlines() if " # " in line]
    assert all(line in Path(file).read_text() for line in comments)
    again = call("new", "mine", "--from", source, "--out", tmp_path)
    assert again.exit_code == 1 and "is there already" in str(again.exception)


@pytest.mark.parametrize("name", ["", "a/b", "mine.toml", "ta nk"])
def test_a_bad_name_is_refused(tmp_path: Path, name: str) -> None:
    done = call("new", name, "--out", tmp_path)
    assert done.exit_code == 1 and "is no name for a scenario" in str(done.exception)
    assert not list(tmp_path.iterdir())


def blocks() -> list[str]:
    text = (resources.files("autopilot") / "data" / "templates" / "scenario-more.toml").read_text(encoding="utf-8")
    found = [block for block in text.split("\n\n") if block.startswith("#[")]
    return [re.sub(r"(?m)^#", "", block) for block in found]


@pytest.mark.parametrize("block", blocks())
def test_every_block_of_the_copy_can_be_switched_on(tmp_path: Path, block: str) -> None:
    call("new", "mine", "--from", "vortex" if block.startswith("[current]") else "paper-tank", "--out", tmp_path)
    path = tmp_path / "mine.toml"
    text = path.read_text()
    if block.startswith("[current]"):
        text = re.sub(r"(?ms)^\[current\].*?(?=^\[)", "", text, count=1)
    path.write_text(text + "\n" + block)
    done = call("check", path)
    assert done.exit_code in (0, 3), f"{done.output}{done.exception}"


TANK = """
[scenario]
name = "own"
description = "Own"
plan = "own.mission.toml"
fence = "from tank and obstacles"
[tank]
polygon_m = [[-3.0, -2.0], [3.0, -2.0], [3.0, 2.0], [-3.0, 2.0]]
depth_m = 2.0
[[obstacle]]
kind = "cylinder"
center_m = [0.0, 1.0]
radius_m = 0.2
[[obstacle]]
kind = "cylinder"
center_m = [0.0, -1.0]
radius_m = 0.2
surprise = true
[vehicle]
start_m = [-2.0, 0.0, 0.5]
held = true
[sensors]
position = "pose"
"""
MISSION = """
[origin]
lat_deg = 37.9755
lon_deg = 23.7790
[[waypoint]]
x_m = 2.0
y_m = 0.0
depth_m = 0.5
"""


def own(folder: Path, text: str = TANK, mission: str = MISSION) -> Path:
    (folder / "own.mission.toml").write_text(mission, encoding="utf-8")
    path = folder / "own.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_geometry_is_typed_once_and_flown(tmp_path: Path) -> None:
    """What the vehicle has for a fence after it was loaded is what the scenario's tables say."""
    from autopilot.run.config import flight_settings
    from autopilot.run.sitl_session import open_sitl

    given = {"scenario": str(own(tmp_path)), "speed": 0.0, "start": True, "duration": 0.5}
    chosen = flight_settings(tmp_path, given)
    session = open_sitl(chosen, {}, log=False)
    session.run(lambda: False)
    fence = session.parts.commander.fence
    (walls,), (pillar,) = fence.inclusions, fence.exclusions
    assert not isinstance(walls, Circle) and isinstance(pillar, Circle)
    assert np.ptp(walls.vertices_ned_m, axis=0) == pytest.approx([6.0, 4.0], abs=0.03)
    assert [*pillar.center_ned_m, pillar.radius_m] == pytest.approx([0.0, 1.0, 0.2], abs=0.02)
    assert session.warnings == ()


def test_a_goal_beyond_the_drawn_fence_is_a_problem(tmp_path: Path) -> None:
    done = call("check", own(tmp_path, TANK.replace("[0.0, 1.0]", "[2.0, 0.3]")))
    assert done.exit_code == 1
    assert "problem:" in done.output
    bigger = TANK.replace("3.0, -2.0", "9.0, -2.0").replace("3.0, 2.0]]", "9.0, 2.0]]")
    far = MISSION.replace("x_m = 2.0", "x_m = 8.0")
    assert call("check", own(tmp_path, mission=far)).exit_code == 1
    assert call("check", own(tmp_path, bigger.replace("[3.0, 2.0]", "[9.0, 2.0]"), far)).exit_code in (0, 3)


def edited(folder: Path, source: str, *changes: tuple[str, str], more: str = "") -> Path:
    """A copy of a scenario with other lines, and more behind them."""
    assert call("new", "mine", "--from", source, "--out", folder).exit_code == 0
    file = folder / "mine.toml"
    text = file.read_text(encoding="utf-8")
    for pattern, line in changes:
        text, count = re.subn(pattern, line, text, flags=re.MULTILINE)
        assert count == 1
    file.write_text(text + more, encoding="utf-8")
    return file


@pytest.mark.parametrize("source", ["paper-tank", "open-water"])
def test_a_start_in_the_air_is_a_problem(tmp_path: Path, source: str) -> None:
    done = call("check", edited(tmp_path, source, (r"^start_m = .*$", "start_m = [-1.6, 0.0, -0.5]")))
    assert done.exit_code == 1 and "is above the water" in done.output, done.output


def test_a_yaw_in_degrees_is_remarked(tmp_path: Path) -> None:
    done = call("check", edited(tmp_path, "paper-tank", (r"^start_yaw_rad = .*$", "start_yaw_rad = 90.0")))
    assert done.exit_code == 3 and "start_yaw_rad = 90 is in radians" in done.output, done.output


@pytest.mark.parametrize("kind", ["sensor_silence", "sensor_frozen"])
def test_a_fault_of_a_sensor_that_is_not_there_is_named(tmp_path: Path, kind: str) -> None:
    fault = f'\n[[fault]]\nkind = "{kind}"\nat_s = 1.0\nduration_s = 1.0\nsensor = "dvl"\n'
    file = edited(tmp_path, "paper-tank", more=fault)
    with pytest.raises(ConfigError, match=r'`\$\.fault\[0\]\.sensor` = "dvl" .* add \[sensors\.dvl\]'):
        load_scenario(str(file))
    file.write_text(file.read_text(encoding="utf-8") + "\n[sensors.dvl]\n", encoding="utf-8")
    assert load_scenario(str(file)).fault


def test_a_fence_of_the_plans_own_is_left_out_aloud(tmp_path: Path) -> None:
    fence = "[[fence.circle]]\nx_m = 1.0\ny_m = 1.0\nradius_m = 0.5\n"
    done = call("check", own(tmp_path, mission=MISSION + fence))
    assert done.exit_code == 3
    assert "the plan's own fence (1 items) is left out" in done.output


def test_the_plan_is_written_with_its_fence(tmp_path: Path) -> None:
    out = tmp_path / "own.plan"
    assert call("plan", own(tmp_path), "--out", out).exit_code == 0
    plan = read_plan(out)
    assert (len(plan.mission), len(plan.fence)) == (1, 5)
    assert "is there already" in str(call("plan", tmp_path / "own.toml", "--out", out).exception)
    assert "has no plan" in str(call("plan", "vortex", "--out", tmp_path / "v.plan").exception)


def test_nothing_to_draw_from_is_refused(tmp_path: Path) -> None:
    text = re.sub(r"(?ms)^\[tank\].*?(?=^\[vehicle\])", "", TANK)
    done = call("check", own(tmp_path, text))
    assert done.exit_code == 1 and "there is neither; add [tank] or [[obstacle]]" in done.output


FREE = st.floats(-40.0, 40.0).map(lambda value: round(value, 2))


@st.composite
def worlds(draw: st.DrawFn) -> dict[str, Any]:
    """Tanks of any simple shape, with all kinds of obstacles."""
    corners = draw(st.integers(3, 9))
    turned = sorted(draw(st.lists(st.floats(0.0, 6.2), min_size=corners, max_size=corners, unique=True)))
    outline = [[round(40.0 * math.cos(a), 3), round(40.0 * math.sin(a), 3)] for a in turned]
    solids = st.one_of(
        st.fixed_dictionaries(
            {"kind": st.just("cylinder"), "center_m": st.tuples(FREE, FREE), "radius_m": st.floats(0.05, 3.0)}
        ),
        st.fixed_dictionaries(
            {"kind": st.just("sphere"), "center_m": st.tuples(FREE, FREE, FREE), "radius_m": st.floats(0.05, 3.0)}
        ),
        st.tuples(FREE, FREE, st.floats(0.2, 4.0)).map(
            lambda t: {
                "kind": "prism",
                "polygon_m": [(t[0], t[1]), (t[0] + t[2], t[1]), (t[0] + t[2], t[1] + t[2])],
            }
        ),
    )
    return {
        "scenario": {"name": "w", "description": "w", "fence": "from tank and obstacles"},
        "origin": {"lat_deg": draw(st.floats(1.0, 60.0)), "lon_deg": draw(st.floats(-179.0, 179.0))},
        "tank": {"polygon_m": outline, "depth_m": 5.0},
        "obstacle": draw(st.lists(solids, max_size=6)),
        "vehicle": {"start_m": (0.0, 0.0, 1.0)},
    }


@settings(max_examples=20, deadline=None)
@given(tables=worlds())
def test_whatever_stands_in_the_scenario_stands_in_the_fence(tables: dict[str, Any]) -> None:
    spread = np.array(tables["tank"]["polygon_m"])
    if np.linalg.norm(spread - np.roll(spread, 1, axis=0), axis=1).min() < 0.5:
        return
    known: Scenario = convert(tables, Scenario, "w")
    place = known.origin
    origin = Origin(lat_deg=place.lat_deg, lon_deg=place.lon_deg, alt_m=0.0)
    shapes, wrong = read_fence(drawn_fence(known), origin)
    assert wrong == ()
    assert len(shapes) == 1 + len(known.obstacle)
    found = {tuple(np.round(shape.shape.center_ned_m, 1)) for shape in shapes if isinstance(shape.shape, Circle)}
    for obstacle in known.obstacle:
        if hasattr(obstacle, "center_m"):
            assert any(np.hypot(*(np.array(obstacle.center_m[:2]) - at)) < 0.2 for at in found)
    plan, warnings = scenario_plan(read_plan(scenario_path("paper-tank").parent / "paper.plan"), known)
    assert plan.fence == drawn_fence(known) and len(warnings) == 1
    assert scenario_plan(plan, known)[1] == (), "its own drawing is no other fence"


def test_the_shipped_grid_is_the_benchmarks() -> None:
    grid, flow = read_grid(str(scenario_path("b6").parent / "b6.npz")), b6_map()
    assert [list(axis) for axis in grid.axes[2:]] == [flow.north_m.tolist(), flow.east_m.tolist()]
    assert np.array(grid.values[0]) == pytest.approx(flow.current_north_m_s.ravel(), abs=1e-6)
    assert np.array(grid.values[1]) == pytest.approx(flow.current_east_m_s.ravel(), abs=1e-6)
