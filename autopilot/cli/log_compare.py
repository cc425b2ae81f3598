"""``autopilot log compare``: flights beside each other."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.console_output import EXIT_LOSS, emit_json, make_console
from autopilot.cli.shared_options import JSON_NOT_TABLES

if TYPE_CHECKING:
    from autopilot.log.flight_comparison import Column, Value

_PATH = click.Path(path_type=Path)
_GAP = 2
"""Columns of a terminal between those of a table."""
_LABEL = 28
"""Columns of a quantity: longer ones are wrapped rather than that a column of figures goes to a further table."""


@click.command()
@click.argument("logs", metavar="A B ...", nargs=-1, required=True, type=_PATH)
@click.option("--figure", type=_PATH, help="Draw all tracks in one plan: a PNG, PDF or SVG file.")
@JSON_NOT_TABLES
def compare(logs: tuple[Path, ...], figure: Path | None, as_json: bool) -> None:
    """Laps, energy, distances and thrust of flights side by side.

    Ratios are to the first. Flights that differ only in their seed are one column: mean and standard deviation. Exit
    code 3 if part of a log could not be read.
    """
    from autopilot.log import flight_comparison

    if len(logs) < 2:
        raise click.UsageError("name two logs or more")
    flights = [flight_comparison.read_flight(path) for path in logs]
    shown = flight_comparison.columns(flights)
    if figure is not None:
        from autopilot.log.figure_tracks import write_tracks

        write_tracks(shown, figure)
    if as_json:
        emit_json(flight_comparison.as_json(shown))
    else:
        _print(shown)
        if figure is not None:
            click.echo(str(figure))
    if any(flight.problems for flight in flights):
        raise click.exceptions.Exit(EXIT_LOSS)


def _print(shown: "Sequence[Column]") -> None:
    from rich.text import Text

    from autopilot.log.flight_comparison import differences, headline, not_comparable, own

    console = make_console()
    if answer := headline(shown):
        console.print(Text(answer, style="bold"))
    for text in not_comparable(shown):
        console.print(Text.assemble(("not comparable: ", "yellow"), text))
    for column in own(shown):
        console.print(Text(f"{column.name:3} {_members(column)}"), overflow="fold")
    for text in differences(shown):
        console.print(Text(f"    {text}"))
    _print_figures(shown)


def _members(column: "Column") -> str:
    """Files of a column, with seed and verdict."""
    texts = []
    for one in column.flights:
        facts = [one.facts.get(name, "") for name in ("scenario", "vehicle", "controller")]
        seed = f"seed {one.seed}" if one.seed else ""
        verdict = "not judged" if one.verdict is None else one.verdict.value
        about = ", ".join(text for text in (*(facts if one is column.flights[0] else ()), seed, verdict) if text)
        texts.append(f"{one.path} ({about})")
    return ", ".join(texts)


def _print_figures(shown: "Sequence[Column]") -> None:
    """The table; columns that do not fit stand in further tables, beside the first again."""
    from rich.box import SIMPLE
    from rich.table import Table
    from rich.text import Text

    from autopilot.log.flight_comparison import COMPARED, ratio

    first, *others = shown
    names = {n: f"{n} [{unit}]" if unit else n for n, unit in COMPARED.items() if any(c.value(n) for c in shown)}
    if not names:
        return
    console = make_console()
    head = [_text(first.value(name), len(first.flights)) for name in names]
    room = console.width - min(_wide(list(names.values())), _LABEL) - _wide(head) - 2 * _GAP
    blocks: list[dict[str, list[str]]] = []
    used = 0
    for column in others:
        over = [ratio(first.value(name), column.value(name)) for name in names]
        pair = {
            column.name: [_text(column.value(name), len(column.flights)) for name in names],
            f"{column.name} / {first.name}": ["-" if value is None else f"{value:.2f}" for value in over],
        }
        needed = sum(_wide([title, *cells]) + _GAP for title, cells in pair.items())
        if not blocks or used + needed > room:
            blocks, used = [*blocks, {first.name: head}], 0
        blocks[-1] |= pair
        used += needed
    for block in blocks:
        table = Table(box=SIMPLE, padding=(0, _GAP, 0, 0), pad_edge=False)
        table.add_column("", overflow="fold")
        for title in block:
            table.add_column(title, justify="right", no_wrap=True)
        for label, *cells in zip(names.values(), *block.values(), strict=True):
            table.add_row(Text(label), *cells)
        console.print(table)


def _wide(texts: Sequence[str]) -> int:
    return max(map(len, texts), default=0)


def _text(value: "Value | None", flights: int) -> str:
    """A value with its spread, "-" without one; with the number of flights that have it, if not all of them do."""
    from autopilot.log.check import format_figure

    if value is None:
        return "-"
    text = format_figure(value.mean)
    if value.spread is not None:
        text += f" ± {value.spread:.{len(text.partition('.')[2])}f}"
    return text if value.count == flights else f"{text} ({value.count} of {flights})"
