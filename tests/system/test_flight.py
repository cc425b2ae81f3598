"""Whole missions in lockstep, judged on the plant's truth."""

from pathlib import Path

import pytest
from system_harness import OpenSession, fly_to_the_end

from autopilot.core.messages import NavHealth, Outputs
from autopilot.log.check import BoundVerdict, acceptance_table
from autopilot.log.reader import open_log
from autopilot.mission.paper import paper_plan
from autopilot.mission.plan_files import write_plan


def _plan(folder: Path, laps: int) -> str:
    path = folder / "paper.plan"
    write_plan(path, paper_plan(laps))
    return str(path)


@pytest.mark.parametrize(
    ("scenario", "sensors", "estimator", "laps", "duration_s"),
    [
        pytest.param("paper-tank", "camera", "ekf", 1, 40.0, marks=pytest.mark.long),
        pytest.param("paper-tank", "pose", "ekf", 2, 60.0, marks=pytest.mark.long),
        ("paper-tank-still", "pose", "ekf", 1, 40.0),
    ],
)
def test_laps_without_a_broken_bound(
    session: OpenSession, tmp_path: Path, scenario: str, sensors: str, estimator: str, laps: int, duration_s: float
) -> None:
    log = tmp_path / "run.mcap"
    fly_to_the_end(
        session,
        scenario,
        sensors=sensors,
        estimator=estimator,
        plan=_plan(tmp_path, laps),
        duration=duration_s,
        log=log,
    )
    rows = {row.name: row for row in acceptance_table(open_log(log))}
    assert rows["laps"].worst == laps
    broken = [row for row in rows.values() if row.verdict is BoundVerdict.FAIL]
    assert broken == []


@pytest.mark.long
def test_the_complementary_observer_flies_the_lap(session: OpenSession, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    fly_to_the_end(
        session,
        sensors="pose",
        estimator="complementary",
        plan=_plan(tmp_path, 1),
        duration=45.0,
        log=log,
        params={"MPC_COST": 0},  # by thrust: the search for energy plans would be half of the work
    )
    rows = {row.name: row for row in acceptance_table(open_log(log))}
    assert rows["laps"].worst == 1
    assert rows["contacts"].worst == 0
    for name in ("distance to cylinder 1", "distance to cylinder 2", "distance to walls"):
        assert rows[name].verdict is not BoundVerdict.FAIL, rows[name]


def test_finds_itself_wherever_it_stands(session: OpenSession, tmp_path: Path) -> None:
    scenario = (Path(__file__).parents[2] / "sitl/scenarios/paper-tank.toml").read_text()
    for index, (start, yaw) in enumerate([("[1.9, -1.0, 0.9]", 2.9), ("[-0.2, 0.9, 0.2]", -1.7)]):
        moved = tmp_path / f"moved-{index}.toml"
        moved.write_text(
            scenario.replace("start_m = [-1.9, 0.6, 0.4]", f"start_m = {start}").replace(
                "start_yaw_rad = 0.5", f"start_yaw_rad = {yaw}"
            )
        )
        seen: list[Outputs] = []
        run = session(str(moved), sensors="camera", duration=3.0, on_tick=seen.append)
        run.run()
        nav = seen[-1].nav
        assert nav is not None
        assert nav.health is NavHealth.GOOD
        x, y, z = (float(a) for a in start.strip("[]").split(","))
        assert nav.pos_ned_m == pytest.approx([x, y, z], abs=0.02)
        assert nav.rpy_rad[2] == pytest.approx(yaw, abs=0.02)


def test_a_scenario_says_what_is_flown_and_how_long(session: OpenSession, tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "sitl/scenarios/paper-tank.toml").read_text()
    write_plan(tmp_path / "mine.plan", paper_plan(1))
    mine = tmp_path / "mine.toml"
    mine.write_text(text.replace('plan = "paper.plan"', 'plan = "mine.plan"\nduration_s = 3.0'))
    seen: list[Outputs] = []
    session(str(mine), sensors="pose", start=True, on_tick=seen.append).run()
    assert seen[-1].t_us == 3_000_000
    assert seen[-1].mode.armed
    assert seen[-1].goal is not None
    assert seen[-1].goal.seq == 0
