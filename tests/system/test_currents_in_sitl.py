"""Current maps end to end: a gridded world, a controller that is told another one, refusals at the start, the log."""

import functools
from pathlib import Path

import numpy as np
import pytest
from system_harness import OpenSession

from autopilot.analysis.current_forecasts import compare_forecasts
from autopilot.campaign.worlds.random_world import make_world, write_files
from autopilot.core.errors import ConfigError, LogError, PlanError
from autopilot.core.frames import FloatArray
from autopilot.log.reader import open_log
from autopilot.run.config import gather, sitl_defaults
from autopilot.sitl.scenario import scenario_path

NORTH, EAST = np.linspace(-3.0, 3.0, 13), np.linspace(-2.0, 2.0, 9)
SCENARIO = """
[scenario]
name = "gridded"
description = "a world from a file"
[sensors]
position = "pose"
[current]
kind = "grid"
file = "truth.npz"
[vehicle]
start_m = [-1.6, -0.35, 0.45]
[controller]
currents = "map"
map = "forecast.npz"
"""


def _write(path: Path, north_m_s: float, scale: float = 1.0) -> None:
    flow = np.full((13, 9), north_m_s)
    np.savez(path, north_m=scale * NORTH, east_m=scale * EAST, current_north_m_s=flow, current_east_m_s=0.0 * flow)


@pytest.fixture
def opened(tmp_path: Path, session: OpenSession) -> OpenSession:
    _write(tmp_path / "truth.npz", 0.1)
    _write(tmp_path / "forecast.npz", 0.3)
    _write(tmp_path / "small.npz", 0.1, 0.5)
    (tmp_path / "gridded.toml").write_text(SCENARIO)
    return functools.partial(session, str(tmp_path / "gridded.toml"), log=tmp_path / "run.mcap", duration=2.0)


def test_truth_and_map_are_two_files_and_the_log_names_the_map(tmp_path: Path, opened: OpenSession) -> None:
    session = opened()
    session.run()
    log = open_log(tmp_path / "run.mcap")
    assert log["/sim/truth"]["current_ned_m_s"][-1] == pytest.approx([0.1, 0.0, 0.0])
    assert log.run["currents"] == "map"
    assert log.run["currents_map"] == "forecast.npz"
    assert len(log.run["currents_map_sha256"]) == 64
    with pytest.raises(LogError, match="give the log of a simulated mission"):
        compare_forecasts(tmp_path / "run.mcap")


def test_what_does_not_fit_is_refused_before_anything_runs(
    tmp_path: Path, opened: OpenSession, capsys: pytest.CaptureFixture[str]
) -> None:
    """A map that is too small for the plan forbids only to fly it: without --start it is a warning."""
    plan = str(scenario_path("paper-tank").parent / "paper.plan")
    with pytest.raises(PlanError, match=r"current map small\.npz: does not cover"):
        opened(plan=plan, currents_map=str(tmp_path / "small.npz"), start=True)
    assert opened(plan=plan, currents_map=str(tmp_path / "small.npz")).parts.plans.problem
    assert "current map small.npz: does not cover" in capsys.readouterr().err
    with pytest.raises(ConfigError, match="--currents-map needs --currents map, not uniform"):
        opened(currents="uniform", currents_map=str(tmp_path / "small.npz"))
    with pytest.raises(ConfigError, match="cannot be read"):
        opened(currents_map=str(tmp_path / "nothing.npz"))
    with pytest.raises(
        ConfigError, match="AUTOPILOT_CURRENTS='maps' is not known; did you mean map\\? use one of estimate, map"
    ):
        gather(sitl_defaults(0), {}, {"AUTOPILOT_CURRENTS": "maps"})


@pytest.mark.parametrize("seed", range(3))
def test_a_stream_is_known_two_seconds_after_a_hand_lets_go(tmp_path: Path, session: OpenSession, seed: int) -> None:
    """Poses with noise show a held vehicle moving: without thrust and drag the model took that for still water, and its
    looks at the stream were rejected for as long as 9 s, with a thruster blamed."""
    still = scenario_path("open-water").read_text()
    plan = scenario_path("open-water").parent / "open-water.mission.toml"
    text = still.replace('"open-water.mission.toml"', f'"{plan}"').replace("[0.13, 0.075, 0.0]", "[-0.3, 0.1, 0.0]")
    (tmp_path / "stream.toml").write_text(f"{text}\n[sensors.pose]\nsigma_xy_m = 0.03\n")
    found: list[tuple[bool, FloatArray]] = []
    session(
        str(tmp_path / "stream.toml"), start=True, duration=4.0, seed=seed,
        on_tick=lambda out: found.append((out.mode.armed, out.nav.current_ned_m_s)) if out.nav else None,
    ).run()  # fmt: skip
    flown = np.array([current for armed, current in found if armed])
    assert np.abs(flown[200] - [-0.3, 0.1, 0.0]).max() < 0.15


def test_a_stream_that_the_first_moment_of_thrust_denies_is_known_a_second_later(
    tmp_path: Path, session: OpenSession
) -> None:
    """A look at the moment when the hand lets go says still water, and all that follow were rejected for 5 s, with a
    sound thruster blamed: thrusters that begin and a model that is denied mean that the current is not known."""
    write_files(make_world(543_000_019), tmp_path, mode=0, duration_s=60.0)
    found: list[FloatArray] = []
    session(
        str(tmp_path / "scenario.toml"), start=True, duration=3.0, seed=543_000_019,
        on_tick=lambda out: found.append(out.nav.current_ned_m_s) if out.mode.armed and out.nav else None,
    ).run()  # fmt: skip
    assert np.abs(np.array(found[100:]) - [0.3, -0.34, 0.0]).max() < 0.15
