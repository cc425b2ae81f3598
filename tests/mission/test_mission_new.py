"""``autopilot mission new``: what it writes is what was asked for, and fit to fly or said not to be."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.cli.mission_new import new
from autopilot.core.errors import ConfigError
from autopilot.core.geodesy import ned_from_geodetic
from autopilot.core.params import ParamSet
from autopilot.mission.plan_check import judge_file
from autopilot.mission.plan_files import read_plan

RADIUS_M = 0.3


def run(*args: str) -> int:
    result = CliRunner().invoke(new, args)
    if isinstance(result.exception, ConfigError):
        raise result.exception
    return result.exit_code


def test_the_papers_tank(tmp_path: Path) -> None:
    path = tmp_path / "tank.plan"
    obstacles = ("--obstacle", "-0.625,-0.625,0.16", "--obstacle", "0.9375,0,0.16")
    stops = ("--waypoint", "-1.6,-0.35,0.45,0", "--waypoint", "1.75,0,0.3,180")
    assert run("--tank", "5x3", *obstacles, *stops, "--laps", "3", "--end", "surface", "--out", str(path)) == 0
    plan = read_plan(path)
    assert [item.command for item in plan.mission] == [16, 16, 177, 21]
    assert [item.command for item in plan.fence] == [5001] * 4 + [5004] * 2
    origin = plan.drawing_origin()
    first = plan.mission[0]
    place = ned_from_geodetic(origin, first.x * 1e-7, first.y * 1e-7, origin.alt_m + first.z)
    assert place == pytest.approx([-1.6, -0.35, 0.45], abs=0.012)
    assert plan.mission[1].param4 == 180.0 and plan.mission[2].param2 == 2.0


@settings(max_examples=15, deadline=None)
@given(north=st.floats(2.5, 40.0), east=st.floats(2.5, 40.0), seed=st.integers(0, 2**31), count=st.integers(0, 4))
def test_a_tour_is_fit_to_fly_or_said_not_to_be(
    tmp_path_factory: pytest.TempPathFactory, north: float, east: float, seed: int, count: int
) -> None:
    path = tmp_path_factory.mktemp("plans") / "tour.plan"
    rng = np.random.default_rng(seed)
    places = rng.uniform(-0.5, 0.5, (count, 2)) * (north, east)
    obstacles = [arg for x, y in places for arg in ("--obstacle", f"{x:.3f},{y:.3f},{rng.uniform(0.05, 0.5):.3f}")]
    code = run("--tank", f"{north:.2f}x{east:.2f}", *obstacles, "--out", str(path))
    plan = read_plan(path)
    verdict = judge_file(plan, plan.drawing_origin(), ParamSet(), radius_m=RADIUS_M, goal_margin_m=0.03)
    assert code == (3 if verdict.own or verdict.joint else 0)
    if count == 0:
        assert code == 0 and len(plan.mission) == 4


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("--tank", "5x-3"), "both lengths"),
        ((), "nothing to plan"),
        (("--tank", "5x3", "--obstacle", "1,1,0"), "radius"),
    ],
)
def test_wrong_wishes_are_named(tmp_path: Path, args: tuple[str, ...], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        run(*args, "--out", str(tmp_path / "x.plan"))
    assert not (tmp_path / "x.plan").exists()


def test_what_is_there_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "mine.plan"
    path.write_text("mine")
    with pytest.raises(ConfigError, match="is there already"):
        run("--tank", "5x3", "--out", str(path))
    assert path.read_text() == "mine"
    assert run("--tank", "5x3", "--out", str(path), "--force") == 0
    assert run("--tank", "5y3", "--out", str(tmp_path / "y.plan")) == 2
