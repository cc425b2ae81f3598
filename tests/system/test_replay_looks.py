"""A control step taken apart, and a run with other parameters."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from autopilot.analysis.flight_figures import MACHINE
from autopilot.analysis.step_replay import other_sides
from autopilot.analysis.what_if import closed_loop, open_loop, read_changes
from autopilot.cli.main import cli
from autopilot.control.path.planner import Planner
from autopilot.core.errors import ConfigError, LogError
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.log.check import acceptance_table
from autopilot.log.reader import open_log
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import open_sitl
from tests.bench.reference_flights import Release, changes, keep, read_release


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("looks")
    path = folder / "flown.mcap"
    given = {"scenario": "paper-tank", "speed": 0.0, "sensors": "pose", "start": True, "duration": 4.0}
    settings = flight_settings(folder, {**given, "log": str(path)})
    open_sitl(settings, {}).run()
    return path


def call(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["log", "replay", *map(str, arguments)])


def test_a_step_is_what_was_flown_and_near_the_optimum(flown: Path, tmp_path: Path) -> None:
    figure = tmp_path / "step.png"
    done = call(flown, "--step", 3.5, "--figure", figure, "--json")
    assert done.exit_code == 0, done.output
    told: dict[str, Any] = json.loads(done.output)
    log = open_log(flown)
    table = log["/out/thrusters"]
    row = table[table["t_us"] == round(1e6 * told["t_s"])][0]
    assert told["thrust_n"] == row["thrust_n"][: len(told["thrust_n"])].tolist()
    assert 3.5 <= told["t_s"] < 3.56
    assert told["converged"]
    assert told["cost"] == pytest.approx(told["converged_cost"], rel=0.05)
    assert told["apart"]["place_m"] < 0.05

    for side in told["other_sides"]:
        assert side["other_m"] is None or side["other_m"] > side["way_m"]
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_the_other_side_of_an_obstacle_is_longer() -> None:
    """A pillar right of the middle of a corridor: the free way passes left of it, the other one is known in advance."""
    corridor = Polygon(vertices_ned_m=np.array([[-4.0, -3.0], [4.0, -3.0], [4.0, 3.0], [-4.0, 3.0]]))
    pillar = Circle(center_ned_m=np.array([0.0, 0.2]), radius_m=0.3)
    fence = Fence(inclusions=(corridor,), exclusions=(pillar,), depth_min_m=0.0, depth_max_m=2.0)
    start, goal = np.array([-3.0, 0.0]), np.array([3.0, 0.0])
    way = Planner(fence, 0.3).path(start, goal)
    assert way is not None
    (side,) = other_sides(fence, 0.3, start, goal, way, way)
    assert side.side == "starboard"
    assert side.other_m is not None
    assert side.way_m < side.other_m < side.way_m + 0.5
    assert side.route_ned_m[:, 1].max() > 0.75

    # Close to the wall on its far side there is no way: the same question, another answer.
    narrow = Circle(center_ned_m=np.array([0.0, 2.0]), radius_m=0.9)
    there = np.array([-3.0, 1.0]), np.array([3.0, 1.0])
    fence = Fence(inclusions=(corridor,), exclusions=(narrow,), depth_min_m=0.0, depth_max_m=2.0)
    way = Planner(fence, 0.3).path(*there)
    assert way is not None
    (side,) = other_sides(fence, 0.3, *there, way, way)
    assert side.other_m is None


def test_a_step_that_is_not_there(flown: Path) -> None:
    done = call(flown, "--step", 100)
    assert done.exit_code == 1
    assert isinstance(done.exception, LogError)
    assert "the log ends at 4.00 s" in str(done.exception)


def test_the_same_parameter_gives_the_same_flight_and_another_one_another(flown: Path) -> None:
    log = open_log(flown)
    same = read_changes(log, ["MPC_MARGIN=0.03"])
    assert log.description is not None
    assert log.description.parameters["MPC_MARGIN"] == same[0][1]
    rows = [row.name for row in acceptance_table(log)]
    assert not [name for name in MACHINE if not any(row.startswith(name) for row in rows)], "left out under an old name"
    assert not [one for one in closed_loop(log, same).moved if not one.same]
    assert open_loop(log, same).largest_n == 0.0
    slow = open_loop(log, read_changes(log, ["SPD_CRUISE=0.1"]))
    assert slow.changes == (("SPD_CRUISE", log.description.parameters["SPD_CRUISE"], 0.1),)
    assert slow.largest_n > 0.1


def test_what_cannot_be_asked(flown: Path) -> None:
    assert isinstance(call(flown, "--set", "MPC_MARGINS=1").exception, ConfigError)
    assert isinstance(call(flown, "--set", "MPC_MARGIN=much").exception, ConfigError)
    assert call(flown, "--open-loop").exit_code == 2
    assert call(flown, "--set", "MPC_MARGIN=0.1", "--set", "model_aid=false").exit_code == 2


def test_reference_figures_that_move_are_named(tmp_path: Path) -> None:
    table = tmp_path / "reference.json"
    before = Release(version="1", revision="a", flights={"harbour": {"laps": 3.0, "armed, s": 10.0}})
    keep(before, table)
    assert read_release(table) == before
    after = Release(version="2", revision="b", flights={"harbour": {"laps": 3.0, "armed, s": 11.0, "new": 1.0}})
    found = changes(read_release(table), after)["harbour"]
    assert [(one.figure, one.before, one.after) for one in found] == [("armed, s", 10.0, 11.0), ("new", None, 1.0)]
    assert found[0].relative_change == pytest.approx(0.1)
    table.write_text("{")
    with pytest.raises(ConfigError, match=r"reference\.json"):
        read_release(table)
