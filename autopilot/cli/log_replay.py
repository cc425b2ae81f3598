"""``autopilot log replay``: a logged run once more, the same or with something changed."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.output import EXIT_LOSS, emit_json, print_table
from autopilot.cli.part_name import part_name

if TYPE_CHECKING:
    from autopilot.log.reader import Log
    from autopilot.run.sitl_replay import ReplayResult

EXIT_DIFFERENT = 1
SHOWN = 20
"""Differences that are printed."""


@click.command()
@click.argument("log_file", metavar="LOG", type=click.Path(path_type=Path))
@click.option("--only", type=click.Choice(("estimator",)), help="Replay the estimator alone.")
@click.option("--estimator", callback=part_name, help="The estimator alone: another one than the run's.")
@click.option(
    "--set", "changes", multiple=True, metavar="NAME=VALUE", help="Change an estimator option (estimator alone)."
)
@click.option("--out", type=click.Path(path_type=Path), help="Keep what was replayed: .mcap (estimator: or .csv).")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
def replay(
    log_file: Path,
    only: str | None,
    estimator: str | None,
    changes: tuple[str, ...],
    out: Path | None,
    as_json: bool,
) -> None:
    """Give LOG's inputs to the whole service again and compare all that comes out, bit for bit.

    Exit 1 if anything differs (the first difference of each field is named), 3 if LOG ends before its run did.
    """
    from autopilot.log.reader import open_log

    opened = open_log(log_file)
    if only or estimator or changes:
        _estimator_alone(opened, estimator, changes, out, as_json=as_json)
        return
    from autopilot.run.sitl_replay import replay_service

    _tell_versions(opened)
    _tell(opened, replay_service(opened, out=out), as_json=as_json)


def _tell_versions(opened: "Log") -> None:
    """What is the same can only be expected of the same version."""
    from autopilot.run.provenance import revision

    then, now = opened.run.get("revision", ""), revision()
    if then != now:
        text = f"LOG is of revision {then or 'unknown'}, this is {now or 'unknown'}: differences may be theirs"
        click.echo(f"note: {text}", err=True)


def _tell(opened: "Log", result: "ReplayResult", *, as_json: bool) -> None:
    if as_json:
        listed = [asdict(one) for one in result.differences]
        emit_json({**asdict(result), "log": str(opened.path), "same": result.same, "differences": listed})
    else:
        verdict = "all the same" if result.same else f"{len(result.differences)} fields differ"
        click.echo(
            f"{opened.path}: {result.ticks} ticks, {result.messages} messages of {result.topics} topics: {verdict}"
        )
        for difference in result.differences[:SHOWN]:
            click.echo(f"  {difference}")
        if len(result.differences) > SHOWN:
            click.echo(f"  and {len(result.differences) - SHOWN} more (--json lists all)")
    for remark in result.remarks:
        click.echo(f"not compared: {remark}", err=True)
    for problem in (*opened.problems, *((result.stopped,) if result.stopped else ())):
        click.echo(f"warning: {opened.path}: {problem}; replayed is what comes before", err=True)
    if not result.same:
        raise click.exceptions.Exit(EXIT_DIFFERENT)
    if result.stopped or opened.problems:
        raise click.exceptions.Exit(EXIT_LOSS)


def _estimator_alone(
    opened: "Log", estimator: str | None, changes: tuple[str, ...], out: Path | None, *, as_json: bool
) -> None:
    """The estimator's replay: bit for bit, or how far another one is from the log and both from the truth."""
    from autopilot.replay import estimation as replaying
    from autopilot.replay.setup import read_setup

    setup = replaying.replay_setup(opened, estimator, changes)
    states = replaying.replay(opened, setup)
    changed = setup != read_setup(opened)
    found = replaying.matches(opened, states)
    if out is not None:
        replaying.write_replay(out, opened, states)
    spreads = replaying.spreads(opened, states) if changed else []
    if as_json:
        same = all(match.same for match in found)
        listed = [{**asdict(match), "same": match.same} for match in found]
        rows = [asdict(row) for row in spreads]
        emit_json({"log": str(opened.path), "same": same, "topics": listed, "spreads": rows})
    elif changed:
        title = f"{opened.path}: replayed with {setup.name}{''.join(f', {change}' for change in changes)} (rms)"
        columns = ("quantity", "unit", "replayed - logged", "logged - truth", "replayed - truth")
        figures = [(row.difference, row.logged_error, row.replayed_error) for row in spreads]
        print_table(
            title,
            columns,
            [
                (row.quantity, row.unit, *("-" if value is None else f"{value:.4f}" for value in values))
                for row, values in zip(spreads, figures, strict=True)
            ],
        )
    else:
        for match in found:
            click.echo(f"{match.topic}: {match.identical} of {match.logged} messages identical")
            if match.first:
                click.echo(f"  first difference {match.first}")
    if not changed and not all(match.same for match in found):
        raise click.exceptions.Exit(EXIT_DIFFERENT)
