"""``autopilot campaign sets|rooms|faults``: the robustness sets R1 to R4, random workspaces, every failsafe."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.click_types import OneOf
from autopilot.cli.console_output import EXIT_FAILED, emit_json, print_table
from autopilot.cli.shared_options import CAMPAIGN_OUT, CAMPAIGN_PARAM, ENGINE, JOBS, JSON, MARKDOWN_TABLE, ONLY_TABLE
from autopilot.core.extras import need_analysis

if TYPE_CHECKING:
    from autopilot.campaign.definition import Campaign
    from autopilot.campaign.worlds.world_results import WorldResult

HEADS = ("failsafe", "scenario", "flights", "effect", "slowest reaction s", "ends", "closest m", "contacts", "kept")
MODES = ("quadratic", "energy")
"""Names of the values of MPC_COST."""


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


@click.command()
@click.option("--runs", type=click.IntRange(min=1), default=20, show_default=True, help="Flights per row and scenario.")
@CAMPAIGN_OUT
@click.option("--row", "rows", multiple=True, metavar="NAME", help="Only this failsafe; repeatable.")
@click.option("--scenario", "scenarios", multiple=True, help="paper-tank or harbour; repeatable (default: both).")
@ONLY_TABLE
@MARKDOWN_TABLE
@JSON
def faults(
    runs: int,
    out: Path,
    rows: tuple[str, ...],
    scenarios: tuple[str, ...],
    only_table: bool,
    markdown: bool,
    as_json: bool,
) -> None:
    """Fly a fault scenario of every failsafe RUNS times each: reaction, end state, closest approach in one table.

    Finished flights are kept in OUT, one line each; the same command resumes where it was stopped. Exit code 1 if a
    failsafe came late, did not end as promised, or something was touched, or if a flight could not be flown.
    """
    from autopilot.campaign.fault_campaign import fly_campaign, results, table, tasks
    from autopilot.campaign.fault_flights import SCENARIOS
    from autopilot.campaign.summary import not_flown

    wanted = tasks(runs, rows, scenarios or SCENARIOS)
    lost: list[str] = []
    for result in () if only_table else fly_campaign(out, wanted):
        if isinstance(result, str):
            lost.append(result)
            click.echo(result, err=True)
        else:
            click.echo(
                f"{result.rule} {result.scenario} at {result.at_s:g} s: failsafe after {result.raised_s} s, "
                f"{result.end}, closest {result.closest_m:g} m{'' if result.kept else ', NOT KEPT'}",
                err=True,
            )
    kept = results(out)
    lines = table([kept[task.key] for task in wanted if task.key in kept])
    if as_json:
        emit_json([asdict(line) for line in lines])
    elif markdown:
        click.echo(f"| {' | '.join(HEADS)} |\n|{' --- |' * len(HEADS)}")
        for line in lines:
            click.echo(f"| {' | '.join(str(cell) for cell in asdict(line).values())} |")
    else:
        print_table("faults", HEADS, [tuple(asdict(line).values()) for line in lines])
    if lost:
        click.echo(not_flown(lost, len(wanted), "flights"), err=True)
    if lost or any(line.kept < line.flights or line.contacts for line in lines):
        raise click.exceptions.Exit(EXIT_FAILED)


@click.command("rooms")
@click.option(
    "--runs", type=click.IntRange(min=1), default=200, show_default=True, help="Number of worlds; a larger one resumes."
)
@CAMPAIGN_OUT
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of the campaign.")
@click.option("--modes", type=OneOf(("both", *MODES)), default="both", show_default=True)
@click.option("--only", type=click.IntRange(min=0), multiple=True, help="Fly this room alone, with log and picture.")
@ENGINE
@JOBS
@JSON
def rooms(
    runs: int,
    out: Path,
    seed: int,
    modes: str,
    only: tuple[int, ...],
    engine: str,
    jobs: int | None,
    as_json: bool,
) -> None:
    """Fly RUNS rooms made at random, each by the whole service, and judge every refusal and every flight.

    Finished flights are kept in OUT, one line each; the same command resumes where it was stopped. With --only a room
    is flown again and leaves its files, log and picture in OUT. Exit code 1 if anything is held against a flight.
    """
    if only:
        need_analysis()
    wanted = [mode for mode, name in enumerate(MODES) if modes in (name, "both")]
    if only:
        results = [_alone(out, seed, room, mode, quiet=as_json) for room in only for mode in wanted]
        if as_json:
            emit_json([_plain(result) for result in results])
    else:
        results = _all(out, seed, runs, wanted, engine, jobs, quiet=as_json)
        _report(results, wanted, out, seed, as_json=as_json)
    if any(result.failed for result in results):
        raise click.exceptions.Exit(EXIT_FAILED)


def _all(
    out: Path, seed: int, runs: int, modes: list[int], engine: str, jobs: int | None, *, quiet: bool
) -> list[WorldResult]:
    """Fly the missing flights; all finished flights that were requested."""
    from autopilot.campaign.engines import make_engine
    from autopilot.campaign.worlds.world_flight import WorldTask
    from autopilot.campaign.worlds.world_results import WorldStore, read_flights
    from autopilot.cli.campaign import stoppable
    from autopilot.sitl.spread import run_seed

    store = WorldStore(out, seed)
    try:
        finished = read_flights(out)
        pairs = [(room, mode) for room in range(runs) for mode in modes]
        tasks = [
            WorldTask(room=room, mode=mode, seed=run_seed(seed, room))
            for room, mode in pairs
            if (room, mode) not in finished or not finished[room, mode].flown
        ]
        done = len(pairs) - len(tasks)
        with stoppable() as stop:
            for result in make_engine(engine, jobs).run(tasks, lambda: bool(stop)):
                store.append(result)
                done += 1
                if not quiet:
                    click.echo(f"{done}/{len(pairs)} {_line(result)}")
        if stop:
            click.echo(f"{done} of {len(pairs)} flights are kept in {out}; the same command resumes", err=True)
            raise click.Abort
        results = read_flights(out)
        return [results[key] for key in pairs if key in results]
    finally:
        store.close()


def _alone(out: Path, seed: int, room: int, mode: int, *, quiet: bool) -> WorldResult:
    """One flight with log, picture and files."""
    import msgspec

    from autopilot.campaign.worlds.picture import draw
    from autopilot.campaign.worlds.random_world import make_world, write_files
    from autopilot.campaign.worlds.world_flight import fly_world
    from autopilot.sitl.spread import run_seed

    made = make_world(run_seed(seed, room))
    folder = out / f"room-{room:04d}-{MODES[mode]}"
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "run.mcap"
    log.unlink(missing_ok=True)
    flown = fly_world(made, mode, log=str(log))
    assert flown is not None  # not interruptible
    write_files(made, folder, mode=mode, duration_s=flown.prospect.bound_s(mode))
    draw(made, flown, folder / "flight.png")
    result = msgspec.structs.replace(flown.result, room=room)
    if not quiet:
        click.echo(_line(result))
        for line in result.events:
            click.echo(f"    {line}")
        click.echo(f"    {folder}/flight.png, run.mcap; as a scenario: autopilot sitl {folder}/scenario.toml --start")
    return result


def _line(result: WorldResult) -> str:
    faults = f"  FAILED: {'; '.join(result.faults)}" if result.failed else f"  {result.what}" if result.what else ""
    cost = f"{result.simulated_s:.0f} s, {result.cpu_s:.0f} s CPU"
    return f"room {result.room} {MODES[result.mode]}: {result.outcome} ({cost}; {result.title}){faults}"


def _plain(result: WorldResult) -> dict[str, Any]:
    import msgspec

    plain: dict[str, Any] = msgspec.to_builtins(result)
    return {**plain, "faults": result.faults}


def _report(results: list[WorldResult], modes: list[int], out: Path, seed: int, *, as_json: bool) -> None:
    from autopilot.campaign.summary import not_flown
    from autopilot.campaign.worlds.world_results import summarise

    rows = [summarise(results, mode) for mode in modes]
    failed = [result for result in results if result.failed]
    if as_json:
        emit_json({"modes": [asdict(row) for row in rows], "failed": [_plain(result) for result in failed]})
        return
    keys = [key for key in asdict(rows[0]) if key != "mode"]
    print_table(
        f"rooms of seed {seed}",
        ["", *(MODES[row.mode] for row in rows)],
        [(_title(key), *(_cell(key, asdict(row)[key]) for row in rows)) for key in keys],
    )
    lost = not_flown([result.what for result in results if not result.flown], len(results), "flights")
    if lost:
        click.echo(lost)
    for result in failed:
        click.echo(_line(result))
        click.echo(
            f"    autopilot campaign rooms --seed {seed} --only {result.room} --modes {MODES[result.mode]} --out {out}"
        )


def _title(key: str) -> str:
    """A figure's name in the table."""
    return {
        "refused": "refused rightly",
        "told": "told rightly on the way",
        "misrefused": "refused wrongly",
        "not_reached": "not reached",
        "contacts": "flights with contacts",
        "failsafes": "with unjustified failsafes",
        "fallbacks": "with solver fallbacks",
        "alarms": "with false thruster alarms",
        "bounds": "with a bound broken",
        "failure_bound": "failure rate at most (95 %)",
        "rough": "with rough commands",
        "median_cpu_s": "CPU time, s, median",
    }.get(key, key)


def _cell(key: str, value: Any) -> str:
    if key == "rough":
        return ", ".join(f"{name} {count}" for name, count in value.items()) or "0"
    return f"{value:.1%}" if key == "failure_bound" else f"{value:g}"
