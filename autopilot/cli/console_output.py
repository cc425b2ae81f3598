"""Tables and JSON for all commands."""

import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress


EXIT_FAILED = 1
EXIT_LOSS = 3
"""Exit code: done, with warnings, remarks, contacts or losses."""


def emit_json(value: Any) -> None:
    """Print a value as JSON; numbers that are not finite, which JSON does not have, are null."""
    click.echo(json.dumps(_finite(value), indent=2, sort_keys=True, default=str, allow_nan=False))


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    return [_finite(each) for each in value] if isinstance(value, list | tuple) else value


def warn(texts: Sequence[str]) -> None:
    """Print warnings on stderr; with any, the exit code says so."""
    for text in texts:
        click.echo(f"warning: {text}", err=True)
    if texts:
        raise click.exceptions.Exit(EXIT_LOSS)


SPEED_OVER_S = 3600.0
"""The time that remains is told from the steps of so long: one may take minutes."""
FILE_WIDTH = 140
"""Columns of a table that does not go to a terminal."""


def make_console() -> "Console":
    """A console as wide as the terminal or COLUMNS, with a default width without either."""
    from rich.console import Console

    console = Console()
    asked = os.environ.get("COLUMNS", "").isdigit()
    return console if console.is_terminal or asked else Console(width=FILE_WIDTH)


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table; numbers are right-aligned."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(title), title_justify="left")
    for index, column in enumerate(columns):
        numeric = bool(rows) and all(_is_number(row[index]) for row in rows)
        table.add_column(escape(column), justify="right" if numeric else "left")
    for row in rows:
        table.add_row(*[escape(str(cell)) for cell in row])
    make_console().print(table)


def _is_number(cell: object) -> bool:
    try:
        float(str(cell))
    except ValueError:
        return False
    return True


@contextmanager
def progress_bar(
    text: str, *, elapsed: bool = False, remaining: bool = False, transient: bool = False, quiet: bool = False
) -> Iterator["Progress | None"]:
    """A bar on stderr behind ``text``, rich's markup of a task; None if stderr is no terminal, or with ``quiet``."""
    if quiet:
        yield None
        return
    from rich import progress
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield None
        return
    times = [progress.TimeElapsedColumn()] * elapsed + [progress.TimeRemainingColumn()] * remaining
    columns = (progress.TextColumn(text), progress.BarColumn(), progress.MofNCompleteColumn(), *times)
    with progress.Progress(*columns, console=console, transient=transient, speed_estimate_period=SPEED_OVER_S) as bar:
        yield bar
