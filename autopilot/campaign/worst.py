"""Repeats the runs with the smallest margins with a log."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec

from autopilot.campaign.results import RunResult, Task
from autopilot.core.errors import AutopilotError

UNRANKED = ("thrust",)
"""Commands lie at their bound whenever the optimum does."""


def worst_first(results: Sequence[RunResult]) -> list[RunResult]:
    """Runs that flew: the failed ones, then by their least margin in tolerances of its bound."""
    return sorted((result for result in results if result.flown), key=_rank)


def _rank(result: RunResult) -> tuple[bool, float, int]:
    nearness = (m.margin / m.tolerance for name, m in result.margins.items() if name not in UNRANKED and m.tolerance)
    return not result.failed, min(nearness, default=0.0), result.run


def log_file(folder: Path, run: int) -> Path:
    """Where the log of a run lies, once it was flown with one."""
    return folder / "logs" / f"run-{run:04d}.mcap"


def fly_logged(task: Task, known: RunResult, folder: Path, stop: Callable[[], bool]) -> str:
    """Repeat a run with a log. Returns a deviation from the first result, "" if none. AutopilotError if it cannot
    be flown.
    """
    from autopilot.campaign.flight import fly  # the whole service

    path = log_file(folder, task.run)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part.mcap")
    files = {unfinished.with_suffix(kind): path.with_suffix(kind) for kind in (".mcap", ".tlog")}
    for part in files:
        part.unlink(missing_ok=True)
    again = fly(replace(task), stop, log=unfinished)
    if again is None:
        for part in files:
            part.unlink(missing_ok=True)
        return ""
    for part, whole in files.items():
        if part.exists():
            part.replace(whole)
    if msgspec.structs.replace(again, cpu_s=known.cpu_s) != known:
        return f"run {task.run} flew otherwise than in the campaign: not the same machine or libraries?"
    return ""


def logs_of(
    results: Sequence[RunResult],
    count: int,
    folder: Path,
    task: Callable[[int], Task],
    stop: Callable[[], bool],
    notify: Callable[[str], None],
) -> dict[int, Path]:
    """Logs of the ``count`` worst runs, those that are missing flown now. Run -> file."""
    for result in worst_first(results)[:count]:
        if stop():
            break
        if log_file(folder, result.run).exists():
            continue
        try:
            odd = fly_logged(task(result.run), result, folder, stop)
        except AutopilotError as error:
            odd = f"run {result.run} could not be flown again: {error}"
        if odd:
            notify(odd)
    found = (result.run for result in results)
    return {run: log_file(folder, run) for run in found if log_file(folder, run).exists()}
