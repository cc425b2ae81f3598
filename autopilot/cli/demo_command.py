"""``autopilot demo``: fly the paper's mission and print the verdict."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.click_types import FiniteRange
from autopilot.cli.console_output import EXIT_FAILED, emit_json, progress_bar
from autopilot.cli.shared_options import JSON, SEED

if TYPE_CHECKING:
    from autopilot.run.demo import FlightResult, Show


@click.command()
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=Path("out/demo"), show_default=True)
@click.option("--laps", type=click.IntRange(1, 50), default=3, show_default=True, help="Laps A-B-A.")
@click.option("--speed", type=FiniteRange(min=0.0), default=0.0, help="0 = as fast as possible (default).")
@SEED
@JSON
def demo(out: Path, laps: int, speed: float, seed: int | None, as_json: bool) -> None:
    """Fly the paper's mission in the simulated tank, with the jet and in still water, and judge it.

    Writes OUT/run.mcap, OUT/report.html and the paper's figures (the still-water flight in OUT/still). Exit code 1 if a
    bound is broken.
    """
    from autopilot.core.extras import need_analysis

    need_analysis()
    from autopilot.run.demo import FLIGHTS, fly

    # Terminating the demo terminates its service too.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    results = []
    for scenario, sub in FLIGHTS:
        with _progress(scenario, quiet=as_json) as show:
            results.append(fly(scenario, out / sub, laps=laps, speed=speed, seed=seed, show=show))
        if not as_json:
            _print(results[-1])
    passed = all(result.passed for result in results)
    if as_json:
        emit_json({"passed": passed, "flights": [_plain(result) for result in results]})
    else:
        click.echo("demo passed: no bound is broken" if passed else "demo FAILED: see the rows marked fail")
    if not passed:
        raise click.exceptions.Exit(EXIT_FAILED)


def _print(result: FlightResult) -> None:
    from autopilot.cli.log import print_rows

    print_rows(list(result.rows), f"{result.scenario}, judged on the plant's truth")
    click.echo(f"log {result.log}, report {result.report}, {len(result.figures)} figures, {result.wall_s:.0f} s")


def _plain(result: FlightResult) -> dict[str, object]:
    shown = ("name", "unit", "limit", "worst", "margin")
    return {
        "scenario": result.scenario,
        "passed": result.passed,
        "log": str(result.log),
        "report": str(result.report),
        "figures": [str(figure) for figure in result.figures],
        "wall_s": result.wall_s,
        "rows": [{"verdict": row.verdict.value, **{name: getattr(row, name) for name in shown}} for row in result.rows],
    }


@contextmanager
def _progress(name: str, quiet: bool) -> Iterator[Show]:
    """A bar on a terminal, a line per news elsewhere."""
    shown = ""
    with progress_bar("{task.description:44}", elapsed=True, quiet=quiet) as bar:
        task = None if bar is None else bar.add_task(name, total=None)

        def show(what: str, done: int, total: int) -> None:
            nonlocal shown
            text = f"{name}: {what}" + (f", waypoint {done} of {total}" if done else "")
            if bar is not None and task is not None:
                bar.update(task, description=f"{name}: {what}", completed=done, total=total or None)
            elif text != shown and not quiet:
                click.echo(text, err=True)
            shown = text

        yield show
