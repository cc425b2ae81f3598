"""``autopilot campaign``: Monte Carlo over seeds and spreads of a scenario."""

from __future__ import annotations

import importlib
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Protocol

import click

from autopilot.cli.click_types import FiniteRange, OneOf
from autopilot.cli.completion import SCENARIO_NAME
from autopilot.cli.console_output import EXIT_FAILED, emit_json, make_console, print_table, progress_bar
from autopilot.cli.service_options import part_name
from autopilot.cli.shared_options import (
    CAMPAIGN_OUT,
    CAMPAIGN_PARAM,
    COLUMNS,
    ENGINE,
    JOBS,
    JSON,
    PAPER,
    SCENARIO_VEHICLE,
)
from autopilot.run.config import SENSORS

if TYPE_CHECKING:
    from autopilot.campaign.definition import Campaign
    from autopilot.campaign.engines import CampaignEngine
    from autopilot.campaign.results import RunResult
    from autopilot.campaign.run_store import Shard
    from autopilot.campaign.summary import Summary

ALL_FIT = 110
"""Characters of a line from which on all percentiles are shown."""


class _Show(Protocol):
    def __call__(self, result: RunResult | None, done: int, total: int) -> None: ...


class _Campaign(click.Group):
    """``table``, ``rooms``, ``sets`` and ``faults`` are sub-commands; any other argument is a scenario."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        return super().parse_args(ctx, args if args and args[0] in self.list_commands(ctx) else [FLY, *args])

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted([*self.commands, *_MODULES])

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the module of a command that has one."""
        if cmd_name not in _MODULES:
            return super().get_command(ctx, cmd_name)
        command: click.Command = getattr(importlib.import_module(_MODULES[cmd_name]), cmd_name)
        return command


FLY = "fly"
_MODULES = dict.fromkeys(("rooms", "sets", "faults"), "autopilot.cli.campaign_sets")


@click.group(cls=_Campaign)
def campaign() -> None:
    """Monte Carlo over seeds and spreads of a scenario, and its tables."""


@campaign.command("table")
@click.argument(
    "folders", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path), metavar="DIR..."
)
@click.option("--markdown", is_flag=True, help="As a Markdown table.")
@JSON
def table(folders: tuple[Path, ...], markdown: bool, as_json: bool) -> None:
    """Campaigns of the folders DIR beside each other, as far as they are flown.

    One column per folder; shares and medians with their intervals of 95 % confidence. Where a set was flown in both
    modes (--param MPC_COST=0 and 1), the modes are compared run by run: run k has the same vehicle and water in both.
    """
    from autopilot.campaign import run_table as tables

    rows, pairs = tables.table_of(folders)
    if as_json:
        emit_json({"rows": [asdict(row) for row in rows], "pairs": [asdict(pair) for pair in pairs]})
    elif markdown:
        click.echo(tables.markdown(rows, pairs), nl=False)
    else:
        names, *quantities = zip(tables.HEADS, *(tables.cells(row) for row in rows), strict=True)
        print_table("campaigns", names, quantities)  # a column per folder: a row would not fit a terminal
        for pair in pairs:
            click.echo(tables.pair_text(pair))


@campaign.command(
    FLY, epilog="Also: campaign table DIR..., campaign rooms, campaign faults; each has a --help of its own."
)
@click.argument("scenario", type=SCENARIO_NAME)
@click.option(
    "--runs", type=click.IntRange(min=1), required=True, help="Total number of runs; a larger one than before resumes."
)
@CAMPAIGN_OUT
@ENGINE
@JOBS
@click.option("--shard", default="1/1", show_default=True, help="I/N: only every N-th run, from the I-th on.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the campaign (default: the scenario's).")
@SCENARIO_VEHICLE
@click.option(
    "--duration", "duration_s", type=FiniteRange(min=0.0, min_open=True), help="End every run after so many seconds."
)
@click.option("--controller", callback=part_name, help="Default: the scenario's, else nmpc.")
@click.option("--estimator", callback=part_name, help="Default: the scenario's, else ekf.")
@click.option("--plant", callback=part_name, help="Default: the scenario's, else rigid-body.")
@click.option("--sensors", type=OneOf(SENSORS), help="Default: the scenario's.")
@CAMPAIGN_PARAM
@click.option("--figures/--no-figures", default=True, show_default=True, help="Figures in the folder.")
@PAPER
@COLUMNS
@click.option(
    "--logs", type=click.IntRange(min=0), default=3, show_default=True, help="Fly the N worst runs again with a log."
)
@JSON
def fly(
    scenario: str,
    runs: int,
    out: Path,
    engine: str,
    jobs: int | None,
    shard: str,
    param: tuple[str, ...],
    figures: bool,
    paper: str | None,
    columns: int,
    logs: int,
    as_json: bool,
    **given: Any,
) -> None:
    """Fly SCENARIO (a shipped name or a TOML file) RUNS times, each with another seed and other values of its [spread].

    Every run is the whole service on the simulated vehicle, judged on the plant's truth at 100 Hz. Finished runs are
    kept in OUT, one line each; the same command resumes where it was stopped. At the end there are runs.csv (and
    runs.parquet where pyarrow is installed), figures, and logs of the worst runs. Exit code 1 if a bound is broken.

    The word fly may be left out.
    """
    from autopilot.campaign.definition import define
    from autopilot.campaign.engines import make_engine
    from autopilot.campaign.run_store import Shard
    from autopilot.campaign.summary import summarise
    from autopilot.core.extras import need_analysis
    from autopilot.run.config import parse_overrides

    if figures:
        need_analysis()
    defined = define(scenario, params=parse_overrides(param), **given)
    if defined.identity.own_code:
        from autopilot.campaign.flight import check  # all that flies

        check(defined.task(0))
    name = defined.scenario.scenario.name
    results, stopped = _fly(defined, make_engine(engine, jobs), out, runs, Shard.parse(shard), quiet=as_json)
    if stopped:
        click.echo(f"{name}: {len(results)} of {runs} runs are kept in {out}; the same command resumes", err=True)
        raise click.Abort
    flown = list(results.values())
    summary = summarise(flown, runs)
    with stoppable() as stop:
        drawn = (paper, columns) if figures else None
        written, logged = keep(flown, defined, out, lambda: bool(stop), figures=drawn, logs=logs)
    if as_json:
        places = {"files": [str(path) for path in written], "logs": {str(run): str(p) for run, p in logged.items()}}
        emit_json({"passed": summary.passed, "scenario": name, **_plain(summary), **places})
    else:
        _print(summary, name, out, logged)
        click.echo(f"{name}: {summary.verdict}; runs in {out}")
    if not summary.passed:
        raise click.exceptions.Exit(EXIT_FAILED)


def _fly(
    defined: Campaign, engine: CampaignEngine, out: Path, runs: int, shard: Shard, *, quiet: bool
) -> tuple[dict[int, RunResult], bool]:
    """Fly the missing runs; all finished runs of the folder, and whether the campaign was interrupted."""
    from autopilot.campaign.run_store import read_results
    from autopilot.campaign.sets import fly_sets

    name, kept = defined.scenario.scenario.name, read_results(out)
    mine = [run for run in range(runs) if shard.holds(run)]
    done = sum(run in kept and kept[run].flown for run in mine)
    with stoppable() as stop, _progress(name, quiet=quiet) as show:
        show(None, done, len(mine))
        for _, result in fly_sets({name: (defined, out)}, engine, runs, lambda: bool(stop), shard):
            done += 1
            show(result, done, len(mine))
    return {run: result for run, result in read_results(out).items() if run < runs}, bool(stop)


@contextmanager
def stoppable() -> Iterator[list[int]]:
    """A list that fills on SIGINT or SIGTERM; the second one exits at once."""
    stopped: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        stopped.append(number)
        signal.signal(number, signal.SIG_DFL)

    before = [(number, signal.signal(number, note)) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        yield stopped
    finally:
        for number, handler in before:
            signal.signal(number, handler)


def keep(
    results: list[RunResult],
    defined: Campaign | None,
    out: Path,
    stop: Callable[[], bool],
    *,
    figures: tuple[str | None, int] | None,
    logs: int,
) -> tuple[list[Path], dict[int, Path]]:
    """Write the tables and, for a complete campaign (else None), figures (for a paper and its columns) and logs of
    its worst runs. LogError if they cannot be written.
    """
    from autopilot.campaign.run_store import GO_ON
    from autopilot.campaign.run_table import write_tables
    from autopilot.campaign.worst import logs_of
    from autopilot.core.errors import LogError

    try:
        written = write_tables(results, out)
        if defined is None:
            return written, {}
        if figures is not None:
            from autopilot.campaign.campaign_figures import write_figures
            from autopilot.log.figures import paper_style

            written += write_figures(results, defined.scenario.scenario.name, out, paper_style(*figures))
        found = logs_of(results, logs, out, defined.task, stop, lambda text: click.echo(f"warning: {text}", err=True))
    except OSError as error:
        raise LogError(f"{out}: cannot be written ({error.strerror}); {GO_ON}") from error
    return written, found


def _plain(summary: Summary) -> dict[str, Any]:
    from autopilot.campaign.summary import PERCENTILES

    def run(result: RunResult) -> Mapping[str, Any]:
        return {"run": result.run, "seed": result.seed, "what": what_broke(result)}

    return {
        "asked": summary.planned,
        "finished": summary.finished,
        "not_flown": summary.not_flown,
        "bars": [asdict(bar) for bar in summary.bars],
        "percentiles": PERCENTILES,
        "margins": [asdict(row) for row in summary.margins],
        "distributions": [asdict(row) for row in summary.figures],
        "failed": [run(result) for result in summary.failed],
        "within_tolerance": [run(result) for result in summary.within_tolerance],
    }


def _print(summary: Summary, name: str, out: Path, logs: Mapping[int, Path]) -> None:
    from autopilot.campaign.run_store import scenario_file
    from autopilot.campaign.summary import PERCENTILES

    held = {True: "pass", False: "FAIL", None: ""}
    print_table(
        f"{name}: {summary.finished} of {summary.planned} runs",
        ("quantity", "bound", "value", "verdict", "note"),
        [(bar.name, bar.bar, bar.value, held[bar.held], bar.note) for bar in summary.bars],
    )
    shown = [at for at, p in enumerate(PERCENTILES) if make_console().width >= ALL_FIT or p in (0.0, 50.0, 100.0)]
    heads = tuple({0.0: "min", 100.0: "max"}.get(PERCENTILES[at], f"p{PERCENTILES[at]:g}") for at in shown)
    print_table(
        "worst margin of each run (distance from the bound itself)",
        ("bound", "unit", *heads, "broken", "beyond tolerance"),
        [
            (m.name, m.unit, *(f"{m.percentiles[at]:.4f}" for at in shown if m.percentiles), m.broken, m.beyond)
            for m in summary.margins
        ],
    )
    print_table(
        "distributions",
        ("", "unit", "count", *heads),
        [(f.name, f.unit, f.count, *(f"{f.percentiles[at]:.4g}" for at in shown)) for f in summary.figures],
    )
    listed = [(result, "failed") for result in summary.failed] + [(result, "") for result in summary.within_tolerance]
    if listed:
        rows = [
            (
                r.run,
                r.seed,
                verdict,
                what_broke(r),
                scenario_file(out, r.run).name,
                logs[r.run].name if r.run in logs else "",
            )
            for r, verdict in listed
        ]
        columns = ("run", "seed", "", "what", "file", "log")
        print_table("runs to look at (autopilot sitl FILE --speed 0 --start)", columns, rows)
    if logs:
        click.echo(f"logs of the worst runs: {', '.join(str(path) for path in logs.values())}")


def what_broke(result: RunResult) -> str:
    """Broken bounds of a run as text."""
    if result.error is not None:
        return result.error
    parts = [f"{result.contacts} contacts, {1000.0 * result.penetration_m:.0f} mm"] if result.contacts else []
    if result.laps_missing:
        parts.append(
            "mission not completed" if result.laps_asked is None else f"{result.laps} of {result.laps_asked} laps"
        )
    parts += [
        f"{name} {result.margins[name].margin:+.4f} at {result.margins[name].at_s:.1f} s" for name in result.broken
    ]
    parts += [f"failsafe {name}" for name in result.failsafes]
    return "; ".join(parts)


def verdict(result: RunResult) -> str:
    """Result of a run in one line."""
    broke = what_broke(result)
    return f"run {result.run}, seed {result.seed}: {f'FAILED: {broke}' if result.failed else broke or 'good'}"


def _span(seconds: float) -> str:
    """A span of time as far as an estimate is worth."""
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} s"


@contextmanager
def _progress(name: str, *, quiet: bool) -> Iterator[_Show]:
    """A bar on a terminal, a line per run elsewhere; both with the time that is left."""
    failures, begun_s, first = 0, time.monotonic(), -1
    with progress_bar("{task.description}", elapsed=True, remaining=True, quiet=quiet) as bar:
        task = None if bar is None else bar.add_task(name, total=None)

        def show(result: RunResult | None, done: int, total: int) -> None:
            nonlocal failures, first
            first = done if first < 0 else first
            failures += result is not None and result.failed
            if bar is not None and task is not None:
                if result is not None and result.failed:
                    bar.console.print(verdict(result), highlight=False)
                bar.update(task, completed=done, total=total, description=f"{name}: {failures} failed")
            elif result is not None and not quiet:
                left_s = (time.monotonic() - begun_s) / max(done - first, 1) * (total - done)
                left = f", about {_span(left_s)} left" if done < total else ""
                click.echo(f"{name}: {done} of {total}{left}: {verdict(result)}", err=True)

        yield show
