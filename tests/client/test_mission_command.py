"""``autopilot mission`` from the command line, exit codes and output, with the memory vehicle at the other end."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from client_world import MemoryLink

from autopilot.cli.mission import mission
from autopilot.core.errors import DriverError, PlanError
from autopilot.core.plan import PlanKind
from mission.paper import paper_plan
from mission.plan_files import read_plan, write_plan
from mission.store import plan_checksum

SCENARIOS = Path(__file__).resolve().parents[2] / "sitl" / "scenarios"
PAPER = SCENARIOS / "paper.plan"


@pytest.fixture
def link(monkeypatch: pytest.MonkeyPatch) -> MemoryLink:
    world = MemoryLink()
    monkeypatch.setattr("autopilot.client.session.open_link", lambda text: world)
    return world


def run(*args: str | Path) -> Result:
    return CliRunner().invoke(mission, [str(a) for a in args])


def test_check_finds_nothing_wrong_with_the_papers_plan() -> None:
    for name in ("paper.plan", "paper.mission.toml"):
        result = run("check", SCENARIOS / name)
        assert result.exit_code == 0
        assert "fit to fly: mission 4 items, fence 6 items" in result.output


def test_check_shows_every_problem(tmp_path: Path) -> None:
    text = PAPER.read_text(encoding="utf-8").replace("-0.45", "50.0")
    path = tmp_path / "high.plan"
    path.write_text(text, encoding="utf-8")
    result = run("check", path, "--json")
    assert result.exit_code == 1
    found = json.loads(result.output)
    assert found["ok"] is False
    assert [(p["plan"], p["item"], p["result"]) for p in found["problems"]] == [
        ("mission", 0, "INVALID_PARAM7"),
        ("mission", 2, "INVALID_PARAM7"),
    ]
    table = run("check", path)
    assert table.exit_code == 1
    assert "what is wrong" in table.output


def test_check_judges_with_other_parameters_and_vehicles() -> None:
    result = run("check", PAPER, "--param", "DEPTH_MAX=0.4", "--json")
    assert result.exit_code == 1
    assert {p["item"] for p in json.loads(result.output)["problems"]} == {0, 2}
    assert run("check", PAPER, "--param", "DEPTH_MAX").exit_code == 1
    assert run("check", PAPER, "--param", "NO_SUCH=1").exit_code == 1


def test_check_of_a_file_that_is_not_there() -> None:
    result = run("check", "nothing.plan")
    assert isinstance(result.exception, PlanError)
    assert run("check").exit_code == 2


def test_upload_then_download_gives_the_same_plan(link: MemoryLink, tmp_path: Path) -> None:
    result = run("upload", PAPER, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.output) == {
        "vehicle": {"system": 1, "autopilot": 12},
        "fence": 6,
        "rally": 0,
        "mission": 4,
    }
    copy = tmp_path / "copy.plan"
    assert run("download", copy).exit_code == 0
    for kind in PlanKind:
        assert plan_checksum(read_plan(copy).items(kind)) == plan_checksum(paper_plan().items(kind))


def test_a_refused_upload_gives_the_reason(link: MemoryLink, tmp_path: Path) -> None:
    assert run("upload", PAPER).exit_code == 0
    other = tmp_path / "other.toml"
    other.write_text(
        "[origin]\nlat_deg = 37.9755\nlon_deg = 23.7790\n"
        "[[fence.circle]]\nx_m = 1.75\ny_m = 0.0\nradius_m = 0.5\n"
        "[[waypoint]]\nx_m = -3.0\ny_m = 0.0\ndepth_m = 0.5\n",
        encoding="utf-8",
    )
    refused = run("upload", other)
    assert isinstance(refused.exception, PlanError)
    assert "clear the mission first" in str(refused.exception)
    assert "clear the mission first" not in refused.output, "the reason is said once: as the error"
    assert len(link.plans.items(PlanKind.FENCE)) == 6
    assert run("upload", other, "--clear").exit_code == 0
    assert len(link.plans.items(PlanKind.FENCE)) == 1


def test_a_waypoints_file_leaves_the_fence_alone(link: MemoryLink, tmp_path: Path) -> None:
    assert run("upload", PAPER).exit_code == 0
    path = tmp_path / "one.waypoints"
    path.write_text("QGC WPL 110\n0\t1\t3\t16\t0\t0\t0\tnan\t37.9755\t23.779\t-0.5\t1\n", encoding="utf-8")
    assert run("upload", path).exit_code == 0
    assert (len(link.plans.items(PlanKind.MISSION)), len(link.plans.items(PlanKind.FENCE))) == (1, 6)


def test_start_and_watch_to_the_end(link: MemoryLink) -> None:
    result = run("start", PAPER, "--wait", "--json", "--timeout", "60")
    assert result.exit_code == 0, result.output
    assert json.loads(result.output) == {"state": "COMPLETE", "seq": 3, "total": 4, "reached": [0, 1, 2, 1, 2, 1, 2]}
    assert link.vehicle.starts == 1


def test_start_without_waiting_and_in_words(link: MemoryLink, tmp_path: Path) -> None:
    short = tmp_path / "short.plan"
    write_plan(short, paper_plan(1))
    assert "mission started" in run("start", short).output
    link.vehicle.armed = False
    again = run("start", "--wait")
    assert again.exit_code == 0, again.output
    assert "mission complete: 2 items reached" in again.output, "item 0 was reached before, the mission goes on"


def test_nobody_answers(link: MemoryLink) -> None:
    link.cut = True
    result = run("upload", PAPER, "--patience", "0.05")
    assert isinstance(result.exception, DriverError)
    assert "no vehicle heard on udpout:127.0.0.1:14540" in str(result.exception)
