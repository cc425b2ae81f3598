"""``autopilot bench replay`` and ``bench reference``: does a flight repeat itself, and did it always do so?"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from autopilot.cli.console_output import print_table
from autopilot.cli.log_replay import moved_rows
from autopilot.cli.shared_options import JSON
from tests.bench.tables import TITLES, judge, printed_one_by_one

if TYPE_CHECKING:
    from tests.bench.replays import ReplayRow


@click.command()
@click.option("--short", is_flag=True, help="5 s of each flight instead of 30.")
@click.option("--whole", is_flag=True, help="Each flight until its mission is complete.")
@click.option("--only", multiple=True, metavar="SCENARIO", help="Only this scenario; repeatable.")
@JSON
def replay(only: tuple[str, ...], short: bool, whole: bool, as_json: bool) -> None:
    """Every shipped scenario flown and replayed, bit for bit.

    30 s (--short: 5 s, --whole: all) of each, with pictures and without, and one in real time (an hour, a quarter with
    --short, some hours with --whole; exit code 1 if anything differs). Every row is told on stderr when it is there.
    """
    from tests.bench.replays import flown_and_replayed, planned_flights

    if short and whole:
        raise click.UsageError("--short and --whole: give one of them")
    flights = planned_flights(short=short, whole=whole, only=only)
    rows = printed_one_by_one(flights, flown_and_replayed, _outcome)
    table = [
        (r.flight, r.sensors, f"{r.speed:g}", r.ticks, r.messages, r.differences, r.first or "all the same")
        for r in rows
    ]
    heads = ("flight", "sensors", "speed", "ticks", "messages", "fields that differ", "first")
    judge(
        not any(row.differences or row.first for row in rows),
        [asdict(row) for row in rows],
        lambda: print_table(TITLES["replay"], heads, table),
        as_json=as_json,
    )


def _outcome(row: ReplayRow) -> str:
    differs = f"{row.differences} differ, {row.first}" if row.differences else row.first or "all the same"
    return f"{row.ticks} ticks, {row.messages} messages: {differs}"


@click.command()
@click.option("--short", is_flag=True, help="Only the short flight.")
@click.option("--only", multiple=True, metavar="NAME", help="Only this flight; repeatable.")
@click.option("--update", is_flag=True, help="Keep the figures as those of this version.")
@JSON
def reference(only: tuple[str, ...], short: bool, update: bool, as_json: bool) -> None:
    """Figures of the reference flights, and which of them have moved.

    Flies them and shows what has moved since the figures were kept (some minutes, one with --short; exit code 1 if any
    has and --update is not given).
    """
    from tests.bench.reference_flights import FLIGHTS, SHORT, changes, flown, keep, read_release

    before = read_release()
    after = flown(only or (SHORT if short else FLIGHTS))
    found = changes(before, after)

    def show() -> None:
        for name, rows in found.items():
            kept = len(before.flights.get(name, {}))
            if rows:
                title = f"{name}: {len(rows)} figures have moved since {before.revision or 'never kept'}"
                print_table(title, ("figure", "kept", "now", "change"), moved_rows(rows))
            else:
                click.echo(f"{name}: all {kept} figures as they were at {before.revision}")

    if update:
        keep(after)
    figures = {name: [asdict(one) for one in rows] for name, rows in found.items()}
    judge(update or not any(found.values()), figures, show, as_json=as_json)
