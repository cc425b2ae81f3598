"""Controllers, estimators and plants that are not ours, through the whole service (docs/extend.md)."""

import json
from pathlib import Path

import numpy as np
import pytest
from system_harness import ROOT, OpenSession, fly_to_the_end

from autopilot.control.protocol import Controller, ControllerContext, simple_output
from autopilot.core.messages import Failsafe, Outputs
from autopilot.log.check import BoundVerdict, acceptance_table
from autopilot.log.figures import write_figures
from autopilot.log.reader import open_log
from autopilot.mission.paper import paper_plan
from autopilot.mission.plan_files import write_plan
from autopilot.replay.estimator_replay import matches, replay, replay_setup

EXAMPLES = ROOT / "docs" / "examples"


@pytest.fixture(autouse=True)
def examples(monkeypatch: pytest.MonkeyPatch) -> None:
    """The examples and this file can be imported, as from a folder on PYTHONPATH."""
    monkeypatch.syspath_prepend(str(EXAMPLES))


def plan(folder: Path) -> str:
    path = folder / "paper.plan"
    write_plan(path, paper_plan(1))
    return str(path)


def test_the_page_links_every_example_that_is_flown() -> None:
    text = (ROOT / "docs" / "extend.md").read_text(encoding="utf-8")
    examples = {path.name for path in EXAMPLES.glob("my_*.py")}
    assert len(examples) == 3 and all(f"(examples/{name})" in text for name in examples)


def test_a_controller_of_ones_own_flies_the_paper_tank_and_gets_the_same_report(
    session: OpenSession, tmp_path: Path
) -> None:
    log = tmp_path / "run.mcap"
    given = {"controller": "my_controller:Follower", "plan": plan(tmp_path), "duration": 45.0}
    fly_to_the_end(session, sensors="pose", log=log, **given)
    opened = open_log(log)
    rows = {row.name: row for row in acceptance_table(opened)}
    assert rows["laps"].worst == 1
    assert [row for row in rows.values() if row.verdict is BoundVerdict.FAIL] == []
    names = {"distance to cylinder 1", "thrust command", "contacts", "energy lap 1", "NMPC fallbacks"}
    assert names <= set(rows)
    assert len(write_figures(opened, tmp_path / "figures")) >= 5
    parts = json.loads(opened.attachments["run.json"])["parts"]
    assert parts["controller"]["target"] == "my_controller:Follower" and len(parts["controller"]["sha256"]) == 64
    assert parts["estimator"]["name"] == "ekf" and parts["estimator"]["version"].startswith("underwater-autopilot ")
    assert opened.run["controller"] == "my_controller:Follower" and opened.run["plant"] == "rigid-body"


def test_estimator_and_plant_of_ones_own_by_the_scenario_and_replayed(session: OpenSession, tmp_path: Path) -> None:
    """A vehicle in a swell finds its first waypoint by an estimator that is not ours."""
    text = (ROOT / "sitl" / "scenarios" / "paper-tank.toml").read_text(encoding="utf-8")
    mine = tmp_path / "mine.toml"
    plugins = 'controller = "my_controller:Follower"\nestimator = "my_estimator:Observer"\nplant = "my_plant:Swell"'
    mine.write_text(f"{text}\n[plugins]\n{plugins}\n", encoding="utf-8")
    log, seen = tmp_path / "run.mcap", []
    given = {"plan": plan(tmp_path), "start": True, "duration": 9.0, "on_tick": seen.append}
    session(str(mine), sensors="pose", log=log, **given).run()
    assert max(outputs.progress.reached_seq for outputs in seen) >= 0
    assert not any(outputs.faults for outputs in seen)
    assert any(outputs.shadow is not None for outputs in seen)
    opened = open_log(log)
    assert json.loads(opened.attachments["run.json"])["parts"]["plant"]["target"] == "my_plant:Swell"
    found = matches(opened, replay(opened, replay_setup(opened, None, ())))
    assert found[0].logged > 700 and all(match.same for match in found)


class Hostile(Controller):
    """Gives a wrong answer from the third second of its first flight on."""

    answer: object = None

    def __init__(self, given: ControllerContext) -> None:
        self.steps = 0
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1

    def step(self, t_us, nav, goal, fence, params, thruster_limit_n, tracks, *, delay_s):  # type: ignore[no-untyped-def]
        self.steps += 1
        n = len(thruster_limit_n)
        if self.steps < 20:
            return simple_output(t_us, nav, np.full(n, 1000.0))
        return {
            "no answer": None,
            "bare thrust": np.zeros(n),
            "wrong length": simple_output(t_us, nav, np.zeros(n + 1)),
            "not finite": simple_output(t_us, nav, np.full(n, np.nan)),
        }[Hostile.answer]  # type: ignore[index]


@pytest.mark.parametrize("answer", ["no answer", "bare thrust", "wrong length", "not finite"])
def test_what_is_no_answer_is_a_fault_and_the_place_is_held(
    session: OpenSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer: str
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    monkeypatch.setattr(Hostile, "answer", answer)
    seen: list[Outputs] = []
    given = {"controller": f"{__name__}:Hostile", "plan": plan(tmp_path), "start": True, "duration": 4.0}
    run = session(sensors="pose", on_tick=seen.append, **given)
    run.parts.guard.raises = False
    run.run()
    controlled = [outputs for outputs in seen if outputs.control is not None]
    limit_n = run.parts.params["THR_LIMIT"]
    assert controlled and all(np.abs(outputs.control.thrust_n).max() <= limit_n for outputs in controlled)
    faults = [fault for outputs in seen for fault in outputs.faults]
    assert [fault.part for fault in faults] == ["controller"]
    assert seen[-1].mode.armed and seen[-1].mode.failsafes >> Failsafe.FAULT & 1
    assert all(np.isfinite(outputs.command.thrust_n).all() for outputs in seen)
    assert any("Internal fault: controller" in event.text for outputs in seen for event in outputs.events)
    assert run.parts.controller.resets >= 1  # type: ignore[attr-defined]
