"""``autopilot campaign faults``: every failsafe at random times."""

from dataclasses import asdict
from pathlib import Path

import click

from autopilot.cli.console_output import EXIT_FAILED, emit_json, print_table
from autopilot.cli.shared_options import CAMPAIGN_OUT, JSON, MARKDOWN_TABLE, ONLY_TABLE

HEADS = ("failsafe", "scenario", "flights", "effect", "slowest reaction s", "ends", "closest m", "contacts", "kept")


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
