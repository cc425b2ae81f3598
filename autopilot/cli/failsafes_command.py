"""``autopilot failsafes``: the table of failsafes without a vehicle."""

import re
from dataclasses import asdict
from pathlib import Path

import click

from autopilot.cli.console_output import emit_json, print_table
from autopilot.cli.shared_options import JSON


@click.command()
@JSON
@click.option("--markdown", is_flag=True, help="As a Markdown table.")
@click.option("--write", type=click.Path(path_type=Path, dir_okay=False, exists=True), help="Bring a page up to date.")
def failsafes(as_json: bool, markdown: bool, write: Path | None) -> None:
    """All failsafes: when they begin and end, what they do (with the default), what they say."""
    from autopilot.command.failsafe_docs import failsafe_markdown, failsafe_texts, with_table

    if write is not None:
        write.write_text(with_table(write.read_text(encoding="utf-8")), encoding="utf-8")
    elif as_json:
        emit_json([asdict(text) for text in failsafe_texts()])
    elif markdown:
        click.echo(failsafe_markdown(), nl=False)
    else:
        columns = ("bit", "failsafe", "begins when", "ends", "action", "message")
        rows = [tuple(asdict(text).values()) for text in failsafe_texts()]
        print_table("Failsafes", columns, [[_plain(str(cell)) for cell in row] for row in rows])


def _plain(cell: str) -> str:
    """Without the marks of Markdown."""
    return re.sub(r"\*\*(.+?)\*\*", r"\1 (default)", cell.replace("`", ""))
