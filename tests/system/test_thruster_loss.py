"""Thrusters that fail in flight: the service finds out from the motion alone, goes on if it can, is safe if not."""

from pathlib import Path

import numpy as np
import pytest
from system_harness import ROOT, OpenSession, fly_to_the_end

from autopilot.core.messages import Failsafe, Outputs, ProgressState
from autopilot.log.check import BoundRow, BoundVerdict, acceptance_table
from autopilot.log.reader import open_log
from autopilot.mission.paper import paper_plan
from autopilot.mission.plan_files import write_plan

SCENARIO = ROOT / "sitl" / "scenarios" / "thruster-loss.toml"
FAULT_S = 12.0


QUADRATIC = "\n[params]\nMPC_COST = 0\n"


def _fly(
    session: OpenSession,
    folder: Path,
    thruster: str,
    loss: float,
    duration_s: float,
    params: str = "",
    safe_after_s: float = 0.0,
    laps: int = 1,
) -> Path:
    """``laps`` with this fault, to its end, or to so long after the loss has been found out for good; the log."""
    shipped = 'thruster = "port"\nloss = 0.5'
    text = SCENARIO.read_text(encoding="utf-8")
    assert shipped in text
    variant, plan, log = folder / "variant.toml", folder / "paper.plan", folder / "run.mcap"
    variant.write_text(text.replace(shipped, f'thruster = "{thruster}"\nloss = {loss}') + params, encoding="utf-8")
    write_plan(plan, paper_plan(laps))
    given = {"sensors": "pose", "plan": str(plan), "duration": duration_s, "log": log}
    if not safe_after_s:
        fly_to_the_end(session, str(variant), **given)
        return log
    dead: list[int] = []
    ended: list[int] = []

    def look(outputs: Outputs) -> None:
        if outputs.thrusters is not None and 0.0 in outputs.thrusters.effectiveness[:4]:
            dead.append(outputs.t_us)
        complete = outputs.progress is not None and outputs.progress.state is ProgressState.COMPLETE
        if outputs.mode.failsafes >> Failsafe.THRUSTER & 1 or (complete and dead):
            ended.append(outputs.t_us)

    run = session(str(variant), start=True, on_tick=look, **given)
    run.run(stop=lambda: bool(ended) and ended[-1] - ended[0] > 1e6 * safe_after_s)
    return log


def _rows(log: Path) -> dict[str, BoundRow]:
    return {row.name: row for row in acceptance_table(open_log(log))}


@pytest.mark.parametrize(("thruster", "laps"), [("port", 1), ("lateral", 2)])
def test_half_a_thruster_does_not_end_a_mission(session: OpenSession, tmp_path: Path, thruster: str, laps: int) -> None:
    # So little is asked of the lateral thruster that a lap may end before its loss shows, with least energy also two.
    rows = _rows(_fly(session, tmp_path, thruster, 0.5, 80.0, QUADRATIC, laps=laps))
    assert rows["laps"].worst == laps
    assert [row for row in rows.values() if row.verdict is BoundVerdict.FAIL] == []
    assert rows["failsafes raised"].worst == 0
    weakest = rows["lowest thruster effectiveness"].worst
    assert weakest is not None
    assert 30.0 < weakest < 75.0


def test_a_dead_horizontal_thruster_ends_safely(session: OpenSession, tmp_path: Path) -> None:
    # Long enough for both ends: with one thruster less the lap is slow, and where it has to stay it is found out.
    log = _fly(session, tmp_path, "port", 1.0, 70.0, safe_after_s=10.0)
    rows = _rows(log)
    assert rows["contacts"].worst == 0
    for name in ("distance to cylinder 1", "distance to cylinder 2", "distance to walls"):
        assert rows[name].verdict is not BoundVerdict.FAIL, rows[name]
    health = open_log(log)["/ctl/thrusters"]
    dead = health["effectiveness"][:, 0] == 0.0
    assert dead.any()
    assert (health["effectiveness"][:, 1:4] > 0.5).all()
    mode = open_log(log)["/sys/mode"]
    raised = int(np.bitwise_or.reduce(mode["failsafes"]))
    assert rows["laps"].worst == 1 or raised == 1 << Failsafe.THRUSTER


LONG_LEG = """
[origin]
lat_deg = 37.9755
lon_deg = 23.7790
[[waypoint]]
x_m = 75.0
y_m = 20.0
depth_m = 1.2
"""


def test_a_long_leg_in_still_water_shows_no_current_and_no_fault(tmp_path: Path, session: OpenSession) -> None:
    """Minutes straight on tell drag, current and thrust no more apart than a few seconds do; taken for news, noise was
    a current of 0.08 m/s after four minutes, and half a thruster."""
    text = (ROOT / "sitl" / "scenarios" / "open-water.toml").read_text(encoding="utf-8")
    (tmp_path / "leg.mission.toml").write_text(LONG_LEG, encoding="utf-8")
    text = text.replace("open-water.mission.toml", "leg.mission.toml").replace("[0.13, 0.075, 0.0]", "[0.0, 0.0, 0.0]")
    (tmp_path / "leg.toml").write_text(text, encoding="utf-8")
    log = tmp_path / "run.mcap"
    fly_to_the_end(session, str(tmp_path / "leg.toml"), duration=400.0, log=log, params={"SPD_CRUISE": 0.3})
    flown = open_log(log)
    late = flown["/nav/state"]["current_ned_m_s"][-20_000:, :2]
    assert np.abs(late.mean(axis=0)).max() < 0.03
    assert flown["/ctl/thrusters"]["effectiveness"][:, :4].min() == 1.0
