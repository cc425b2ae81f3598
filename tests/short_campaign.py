"""Campaigns of a few seconds, and what they leave."""

from pathlib import Path
from typing import Any

import msgspec
from click.testing import CliRunner

from autopilot.campaign.run_store import read_results
from autopilot.cli.main import cli, run
from autopilot.mission.paper import paper_plan
from autopilot.mission.plan_files import write_plan
from autopilot.sitl.scenario import scenario_path

SHORT_S = 2.5
"""Of the paper's tour: enough to arm and to move."""
SPREAD = '[spread]\n"vehicle.mismatch.drag" = { low = 0.7, high = 1.3 }\n'


def scenario_in(folder: Path, spread: str = SPREAD, name: str = "short.toml", seconds: float = SHORT_S) -> str:
    """The file of a short scenario in a folder, with its plan."""
    folder.mkdir(parents=True, exist_ok=True)
    text = scenario_path("r1").read_text(encoding="utf-8")
    head = text[: text.index("[spread]")].replace("duration_s = 150.0", f"duration_s = {seconds}")
    (folder / name).write_text(head + spread, encoding="utf-8")
    write_plan(folder / "paper.plan", paper_plan(1))
    return str(folder / name)


def command(*arguments: str) -> tuple[int, str]:
    """Exit code and output of ``autopilot campaign``; errors in their one line on stderr."""
    printed: list[str] = []

    def call() -> object:
        done = CliRunner().invoke(cli, ["campaign", *arguments], standalone_mode=False)
        printed.append(done.output)
        if done.exception is not None:
            raise done.exception
        return done.return_value

    return run(call), printed[0]


def lines(out: Path) -> list[dict[str, Any]]:
    """What is kept of every run, but for the time it took."""
    found = [msgspec.to_builtins(result) for result in read_results(out).values()]
    return [{key: value for key, value in each.items() if key != "cpu_s"} for each in found]
