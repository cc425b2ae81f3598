"""An obstacle that the fence does not have crosses the route: the whole service evades it and the mission goes on."""

from pathlib import Path

from system_harness import ROOT, OpenSession, fly_to_the_end

from autopilot.log.check import BoundVerdict, acceptance_table
from autopilot.log.reader import open_log
from autopilot.mission.paper import paper_plan
from autopilot.mission.plan_files import write_plan


def test_a_lap_with_an_obstacle_across_the_route(session: OpenSession, tmp_path: Path) -> None:
    plan, log = tmp_path / "paper.plan", tmp_path / "run.mcap"
    write_plan(plan, paper_plan(1))
    scenario = ROOT / "sitl" / "scenarios" / "crossing.toml"
    fly_to_the_end(session, str(scenario), sensors="pose", plan=str(plan), duration=36.0, log=log)
    read = open_log(log)
    rows = {row.name: row for row in acceptance_table(read)}
    assert rows["laps"].worst == 1
    assert rows["contacts"].worst == 0
    assert rows["distance to moving 3"].limit == 0.12 + 0.3
    assert [row for row in rows.values() if row.verdict is BoundVerdict.FAIL] == []
    assert (read["/in/tracks"]["track_id"] == 3).all()
    assert len(read["/in/tracks"]) > 100
    assert rows["distance to moving 3"].worst is not None
    assert rows["distance to moving 3"].worst < 1.0, "it was never near: the test shows nothing"
