"""``autopilot campaign sets``: the robustness sets R1 to R4 by one command."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.console_output import EXIT_FAILED, emit_json, print_table
from autopilot.cli.shared_options import CAMPAIGN_PARAM, ENGINE, JOBS, JSON, MARKDOWN_TABLE, ONLY_TABLE

if TYPE_CHECKING:
    from autopilot.campaign.definition import Campaign


@click.command("sets")
@click.option("--set", "names", multiple=True, metavar="SCENARIO", help="Repeatable (default: r1 r2 r3 r4).")
@click.option(
    "--runs", type=click.IntRange(min=1), default=300, show_default=True, help="Runs of each; a larger number resumes."
)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder of all folders.")
@ENGINE
@JOBS
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the campaigns (default: the scenarios').")
@CAMPAIGN_PARAM
@click.option("--figures/--no-figures", default=True, show_default=True, help="Figures in the folders.")
@click.option(
    "--logs", type=click.IntRange(min=0), default=3, show_default=True, help="Fly the N worst runs of each with a log."
)
@ONLY_TABLE
@MARKDOWN_TABLE
@JSON
def sets(
    names: tuple[str, ...],
    runs: int,
    out: Path,
    engine: str,
    jobs: int | None,
    seed: int | None,
    param: tuple[str, ...],
    figures: bool,
    logs: int,
    only_table: bool,
    markdown: bool,
    as_json: bool,
) -> None:
    """Fly the sets R1 to R4, RUNS runs of each in turn: 1,200 in a night or two, resumable, with one table at the end.

    Finished runs are kept in OUT/SET; the same command resumes where it was stopped. At the end every folder has its
    table of runs, figures, and logs of its worst runs. Exit code 1 if a bound is broken.
    """
    from autopilot.campaign import run_table as tables
    from autopilot.campaign.definition import define
    from autopilot.campaign.engines import make_engine
    from autopilot.campaign.run_store import IDENTITY, read_results
    from autopilot.campaign.sets import SETS, fly_sets
    from autopilot.campaign.summary import summarise
    from autopilot.cli.campaign import keep, stoppable, verdict, what_broke
    from autopilot.core.errors import ConfigError
    from autopilot.run.config import parse_overrides

    chosen = {Path(name).stem: name for name in names or SETS}
    if len(chosen) < len(set(names or SETS)):
        raise ConfigError(f"--set: two of {', '.join(names)} have one name, and would share a folder; rename one")
    campaigns: dict[str, Campaign] = {}
    stopped = False
    if not only_table:
        overrides = parse_overrides(param)
        campaigns = {label: define(name, seed=seed, params=overrides) for label, name in chosen.items()}
        total_runs = runs * len(campaigns)
        with stoppable() as stop:
            finished = [read_results(out / label) for label in campaigns if (out / label).is_dir()]
            done = sum(run < runs and kept.flown for results in finished for run, kept in results.items())
            places = {label: (defined, out / label) for label, defined in campaigns.items()}
            for label, result in fly_sets(places, make_engine(engine, jobs), runs, lambda: bool(stop)):
                done += 1
                click.echo(f"{done} of {total_runs}: {label} {verdict(result)}", err=True)
            stopped = bool(stop)
    folders = [out / label for label in chosen if (out / label / IDENTITY).is_file()]
    if not folders:
        raise ConfigError(f"{out}: holds no campaigns; leave --table out to fly them")
    rows, _ = tables.table_of(folders)
    results = {folder.name: [r for r in read_results(folder).values() if r.run < runs] for folder in folders}
    logged: dict[str, dict[int, Path]] = {}
    passed = True
    not_flown: list[str] = []
    with stoppable() as stop:
        for folder in folders:
            label, flown = folder.name, results[folder.name]
            ended = None if stopped or stop else campaigns.get(label)
            _, logged[label] = keep(
                flown, ended, folder, lambda: bool(stop), figures=(None, 1) if figures else None, logs=logs
            )
            summary = summarise(flown, runs)
            passed &= summary.passed
            not_flown += [f"{label}: {summary.not_flown}"] if summary.not_flown else []
        stopped |= bool(stop)
    if as_json:
        logs_of = {label: {str(run): str(path) for run, path in found.items()} for label, found in logged.items()}
        emit_json({"passed": passed, "rows": [asdict(row) for row in rows], "logs": logs_of})
    elif markdown:
        click.echo(tables.markdown(rows, ()), nl=False)
    else:
        print_table("campaigns", tables.HEADS, [tables.cells(row) for row in rows])
        looked = [
            (label, run.run, run.seed, what_broke(run), logged[label][run.run].name if run.run in logged[label] else "")
            for label, flown in results.items()
            for run in flown
            if run.failed or run.run in logged[label]
        ]
        if looked:
            print_table("runs to look at (OUT/SET/logs)", ("set", "run", "seed", "what", "log"), looked)
        for line in not_flown:
            click.echo(line)
    if stopped:
        click.echo(f"stopped; finished runs are kept in {out}, the same command resumes", err=True)
        raise click.Abort
    if not passed:
        raise click.exceptions.Exit(EXIT_FAILED)
