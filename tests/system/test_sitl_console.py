"""What `autopilot sitl` shows and what its exit code says."""

import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from plan_text import PILLARS, WORKSPACE, pillar, waypoint
from system_harness import ROOT, OpenSession

from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.messages import Outputs
from autopilot.core.plan import PlanKind
from autopilot.mission.paper import paper_plan
from autopilot.run.children import autopilot_command
from autopilot.run.console import Console
from autopilot.run.sitl_console import RunWatch, unknown_obstacles
from autopilot.sitl.scenario import load_scenario

TANK = (ROOT / "sitl/scenarios/paper-tank.toml").read_text()
PLAN = WORKSPACE + pillar(*PILLARS[0]) + waypoint(-1.6, 0.3, 0.45)
"""One waypoint beside the start; one of the two cylinders is in the fence."""


def _sitl(folder: Path, *more: str, scenario: str = "paper-tank") -> "subprocess.CompletedProcess[str]":
    command = autopilot_command(
        *("sitl", scenario, "--sensors", "pose", "--speed", "0", "--connect", "udpout:127.0.0.1:9", *more),
        *("--log", str(folder / "run.mcap")),
    )
    environment = {**os.environ, "AUTOPILOT_STATE_DIR": str(folder / "state")}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture
def plan(tmp_path: Path) -> str:
    file = tmp_path / "short.toml"
    file.write_text(PLAN)
    return str(file)


def test_a_run_until_its_mission_is_complete(tmp_path: Path, plan: str) -> None:
    done = _sitl(tmp_path, "--start", "--plan", plan, "--until", "complete", "--duration", "60")
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert "seed 1" in lines[0]
    shown = [re.fullmatch(r" *(\d+\.\d\d) s  (.+)", line) for line in lines[1:-1]]
    assert all(shown)
    texts = [match[2] for match in shown if match]
    times_s = [float(match[1]) for match in shown if match]
    assert times_s == sorted(times_s)
    for text in ("Armed", "Mode MISSION", "Reached item 0", "Mission complete, laps: 1"):
        assert text in texts, done.stdout
    unknown = [text for text in texts if "not in the fence" in text]
    assert len(unknown) == 1
    assert unknown[0].startswith("! Obstacle 2 at north 0.94, east 0.00 m")
    assert times_s[texts.index(unknown[0])] <= times_s[texts.index("Armed")]
    ended = re.search(r"^(\d+\.\d) s simulated.* 0 contacts$", lines[-1])
    assert ended
    assert float(ended[1]) == pytest.approx(times_s[texts.index("Mission complete, laps: 1")], abs=0.1)


def test_a_mission_that_is_not_complete_in_time_is_a_failure(tmp_path: Path, plan: str) -> None:
    done = _sitl(tmp_path, "--start", "--plan", plan, "--until", "complete", "--duration", "1.5", "--quiet")
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.startswith("error: the run ended before its mission was complete; ")
    assert len(done.stderr.splitlines()) == 1


def test_a_mission_that_comes_before_its_fence_is_not_told_of_obstacles(session: OpenSession) -> None:
    """Ground stations send the mission first."""
    plan, shown, ticks = paper_plan(1), list[str](), 0

    def look(outputs: Outputs) -> None:
        nonlocal ticks
        ticks += 1
        if ticks == 50:
            assert run.parts.plans.replace(PlanKind.MISSION, plan.mission) is None
        if ticks == 100:
            assert run.parts.plans.replace(PlanKind.FENCE, plan.fence) is None
        watch.step(outputs)

    run = session("paper-tank", sensors="pose", duration=2.0, on_tick=look)
    watch = RunWatch(run, shown.append)
    run.run()
    assert ticks > 150
    assert not [line for line in shown if "not in the fence" in line], shown


def test_contacts_are_shown_counted_and_in_the_exit_code(tmp_path: Path, plan: str) -> None:
    """A pillar that nobody drew stands on the way."""
    scenario = tmp_path / "pillar.toml"
    pillar = '\n[[obstacle]]\nkind = "cylinder"\ncenter_m = [-1.6, 0.25]\nradius_m = 0.1\n'
    scenario.write_text(TANK.replace('plan = "paper.plan"\n', "") + pillar)
    done = _sitl(tmp_path, "--start", "--plan", plan, "--duration", "12", scenario=str(scenario))
    assert done.returncode == 3, done.stdout
    assert "! Obstacle 3 at north -1.60, east 0.25 m is not in the fence" in done.stdout
    assert re.search(r"! Contact 1: \d+ mm at north -1\.\d+, east -?0\.\d+, depth 0\.\d+ m", done.stdout)
    counted = re.search(r", (\d+) contacts?$", done.stdout.splitlines()[-1])
    assert counted
    assert int(counted[1]) > 0
    assert done.stderr == f"warning: {counted[1]} contacts with walls, floor or obstacles\n"


# Obstacles and fences


def _square(half_m: float, x: float = 0.0, y: float = 0.0) -> Polygon:
    return Polygon(vertices_ned_m=half_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) + np.array([x, y]))


@pytest.mark.parametrize(
    ("exclusions", "unknown"),
    [
        ((), 2),
        ((Circle(center_ned_m=np.array([0.9375, 0.0]), radius_m=0.16),), 1),
        ((Circle(center_ned_m=np.array([0.9375, 0.0]), radius_m=0.12),), 2),
        ((_square(0.17, 0.9375, 0.0), _square(0.3, -0.7, -0.7)), 0),
        # Two shapes that have it together.
        ((_square(0.17, 0.9375, 0.17), _square(0.17, 0.9375, -0.16), _square(0.3, -0.7, -0.7)), 0),
    ],
)
def test_obstacles_that_the_fence_does_not_have(exclusions: tuple[Circle | Polygon, ...], unknown: int) -> None:
    scenario = load_scenario("paper-tank")
    walls = Polygon(vertices_ned_m=np.array(scenario.tank.polygon_m if scenario.tank else []))
    texts = unknown_obstacles(scenario, Fence(inclusions=(walls,), exclusions=exclusions))
    assert len(texts) == unknown
    assert all(text.startswith("Obstacle ") for text in texts)


def test_what_lies_outside_the_workspace_needs_no_shape() -> None:
    scenario = load_scenario("paper-tank")
    assert unknown_obstacles(scenario, Fence(inclusions=(_square(0.4),))) == ()
    assert len(unknown_obstacles(scenario, Fence())) == 3, "two cylinders and the walls"


def test_a_console_that_takes_nothing_holds_nobody_up() -> None:
    """A terminal that is held: lines wait, then are dropped, and closing does not wait for ever."""
    read, write = os.pipe()
    code = (
        "import sys\nfrom autopilot.run.console import Console\nconsole = Console()\n"
        "for number in range(100_000):\n    console.print(f'{number} ' + 80 * 'x')\n"
        "console.close(0.1)\nprint('went on', file=sys.stderr)\nsys.stderr.flush()\nimport os\nos._exit(0)\n"
    )
    from autopilot.run.children import python_command

    try:
        done = subprocess.run(python_command(code), stdout=write, stderr=subprocess.PIPE, text=True, check=False)
        assert done.stderr == "went on\n"
    finally:
        os.close(read)
        os.close(write)


def test_a_console_prints_in_order(capfd: pytest.CaptureFixture[str]) -> None:
    console = Console()
    for number in range(100):
        console.print(str(number))
    console.close(60.0)
    assert capfd.readouterr().out.split() == [str(number) for number in range(100)]
