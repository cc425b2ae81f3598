"""``autopilot mission`` from the command line, exit codes and output, with the memory vehicle at the other end."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from client_world import MemoryLink

from autopilot.cli.mission import mission
from autopilot.core.errors import AutopilotError, DriverError, PlanError
from autopilot.core.plan import PlanKind
from autopilot.mission.paper import paper_plan
from autopilot.mission.plan_files import read_plan, write_plan
from autopilot.mission.store import plan_checksum

SCENARIOS = Path(__file__).resolve().parents[2] / "sitl" / "scenarios"
PAPER = SCENARIOS / "paper.plan"


@pytest.fixture
def link(monkeypatch: pytest.MonkeyPatch) -> MemoryLink:
    world = MemoryLink()
    monkeypatch.setattr("autopilot.client.client_session.open_link", lambda text: world)
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


def test_check_warns_of_kilometres_without_a_fence(tmp_path: Path) -> None:
    path = tmp_path / "far.toml"
    rows = "[origin]\nlat_deg = 37.9755\nlon_deg = 23.7790\n" + "".join(
        f"[[waypoint]]\nx_m = {x_m}\ny_m = {x_m}\ndepth_m = 0.5\n" for x_m in (0.0, 900.0)
    )
    path.write_text(rows, encoding="utf-8")
    result = run("check", path)
    assert result.exit_code == 0, result.output
    assert "warning: Mission of 1.3 km, 1.3 km from home, with no fence in force" in result.output
    assert json.loads(run("check", path, "--json").output)["warning"].startswith("Mission of 1.3 km")
    path.write_text(rows.replace("900", "90"), encoding="utf-8")
    assert "warning" not in run("check", path).output
    assert json.loads(run("check", PAPER, "--json").output)["warning"] == ""


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
        "problem": "",
    }
    copy = tmp_path / "copy.plan"
    assert run("download", copy).exit_code == 0
    for kind in PlanKind:
        assert plan_checksum(read_plan(copy).items(kind)) == plan_checksum(paper_plan().items(kind))


OTHER = """[origin]
lat_deg = 37.9755
lon_deg = 23.7790
[[fence.circle]]
x_m = 1.75
y_m = 0.0
radius_m = 0.5
[[waypoint]]
x_m = {x_m}
y_m = 0.0
depth_m = {depth_m}
"""


def test_a_refused_upload_gives_the_reason(link: MemoryLink, tmp_path: Path) -> None:
    assert run("upload", PAPER).exit_code == 0
    other = tmp_path / "other.toml"
    other.write_text(OTHER.format(x_m=-3.0, depth_m=3.0), encoding="utf-8")
    refused = run("upload", other)
    assert isinstance(refused.exception, PlanError)
    assert "DEPTH_MAX 1.2 m: use" in str(refused.exception)
    assert "DEPTH_MAX" not in refused.output, "the reason is said once: as the error"
    assert len(link.plans.items(PlanKind.MISSION)) == 4
    assert run("check", other).exit_code == 1


def test_a_plan_that_does_not_fit_together_is_stored_and_the_exit_code_says_so(
    link: MemoryLink, tmp_path: Path
) -> None:
    other = tmp_path / "other.toml"
    other.write_text(OTHER.format(x_m=1.5, depth_m=0.5), encoding="utf-8")
    stored = run("upload", other)
    assert stored.exit_code == 3
    assert stored.output.count("item 0 (QGC 1) is 0.24 m inside exclusion circle (fence item 0): move it 0.54 m") == 1
    assert "neither arms nor starts" in stored.output
    assert [len(link.plans.items(kind)) for kind in (PlanKind.MISSION, PlanKind.FENCE)] == [1, 1]
    told = run("upload", other, "--json")
    assert told.exit_code == 3
    assert "item 0 (QGC 1) is 0.24 m inside" in told.output
    offline = run("check", other, "--json")
    assert offline.exit_code == 3
    assert [(p["plan"], p["item"], p["means"]) for p in json.loads(offline.output)["problems"]] == [
        ("mission", 0, "not flown")
    ]
    other.write_text(OTHER.format(x_m=-3.0, depth_m=0.5), encoding="utf-8")
    assert run("upload", other).exit_code == 0


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


def test_what_start_has_armed_it_disarms_again_if_the_mission_is_refused(link: MemoryLink) -> None:
    refused = run("start")
    assert isinstance(refused.exception, AutopilotError) and "no mission" in str(refused.exception)
    assert "not started: disarmed again" in refused.output
    assert not link.vehicle.armed
    link.vehicle.armed = True  # by somebody else: his it stays
    assert isinstance(run("start").exception, AutopilotError)
    assert link.vehicle.armed


@pytest.mark.parametrize("command", ["upload", "start"])
def test_an_armed_vehicle_keeps_the_plans_that_it_has(link: MemoryLink, command: str) -> None:
    assert run("upload", PAPER).exit_code == 0
    link.vehicle.armed = True
    refused = run(command, PAPER, "--clear")
    assert isinstance(refused.exception, PlanError) and "disarm it" in str(refused.exception)
    assert [len(link.plans.items(kind)) for kind in (PlanKind.MISSION, PlanKind.FENCE)] == [4, 6]
    link.vehicle.armed = False
    assert run(command, PAPER, "--clear").exit_code == 0


def test_nobody_answers(link: MemoryLink) -> None:
    link.cut = True
    result = run("upload", PAPER, "--patience", "0.05")
    assert isinstance(result.exception, DriverError)
    assert "no vehicle heard on udpout:127.0.0.1:14540" in str(result.exception)
