"""``autopilot campaign rooms``: random workspaces, currents, missions and vehicles."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.click_types import OneOf
from autopilot.cli.console_output import EXIT_FAILED, emit_json, print_table
from autopilot.cli.shared_options import CAMPAIGN_OUT, ENGINE, JOBS, JSON
from autopilot.core.extras import need_analysis

if TYPE_CHECKING:
    from autopilot.campaign.worlds.world_results import WorldResult

MODES = ("quadratic", "energy")
"""Names of the values of MPC_COST."""


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
    from autopilot.campaign.worlds.world_store import WorldStore, read_flights
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
    from autopilot.campaign.worlds.world_summary import summarise

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
