"""``autopilot log``: inspect a log. Exit codes: 0 ok, 1 failed or unreadable, 3 warnings or loss."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.console_output import EXIT_FAILED, EXIT_LOSS, emit_json, make_console, print_table
from autopilot.cli.log_compare import compare
from autopilot.cli.log_replay import replay
from autopilot.cli.log_tools import diff, export, find, recover, tlog, view
from autopilot.cli.shared_options import COLUMNS, JSON_NOT_TABLES, LOG_FILE, PAPER, not_over

if TYPE_CHECKING:
    from autopilot.log.check import BoundRow
    from autopilot.log.reader import Log

NOTES_BESIDE = 110
"""Columns of a terminal from which on notes stand beside their rows instead of below the quantity."""


@click.group()
def log() -> None:
    """Look into logs: info, check, compare, report, plot, export, diff, find, recover, replay, programs, tlog,
    view."""


for _command in (tlog, compare, export, diff, recover, find, replay, view):
    log.add_command(_command)


@log.command()
@LOG_FILE
@JSON_NOT_TABLES
@click.pass_context
def info(ctx: click.Context, log_file: Path, as_json: bool) -> None:
    """What LOG holds: topics, run, attachments, damage. Exit 3 if something is lost."""
    from autopilot.log.reader import open_log

    opened = open_log(log_file)
    opened.verify()
    facts = _facts(opened)
    if as_json:
        emit_json(facts)
    else:
        _print_facts(opened, facts)
    ctx.exit(EXIT_LOSS if opened.problems else 0)


@log.command()
@LOG_FILE
@click.option("--all", "everything", is_flag=True, help="Print every row, by subject (default: the most important).")
@JSON_NOT_TABLES
@click.pass_context
def check(ctx: click.Context, log_file: Path, everything: bool, as_json: bool) -> None:
    """Judge LOG by the bounds of its run. Exit 1 if one is broken, 3 if there are warnings."""
    from autopilot.log.check import BoundVerdict, acceptance_table, overall
    from autopilot.log.reader import open_log

    rows = acceptance_table(open_log(log_file))
    verdict = overall(rows)
    if as_json:
        listed = [{**asdict(row), "verdict": row.verdict.value} for row in rows]
        emit_json({"log": str(log_file), "verdict": verdict.value, "rows": listed})
    else:
        print_rows(rows, str(log_file), everything=everything)
    ctx.exit({BoundVerdict.FAIL: EXIT_FAILED, BoundVerdict.WARN: EXIT_LOSS}.get(verdict, 0))


@log.command()
@LOG_FILE
@click.option("--out", type=click.Path(path_type=Path), help="File to write (default: LOG with the ending .html).")
def report(log_file: Path, out: Path | None) -> None:
    """Write LOG as one HTML file with interactive plots, which needs no network."""
    from autopilot.log.reader import open_log
    from autopilot.log.report import write_report

    target = out if out is not None else log_file.with_suffix(".html")
    not_over(target, log_file)
    opened = open_log(log_file)
    click.echo(str(write_report(opened, target)))
    _tell_loss(opened)


@log.command()
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="Folder to write into (default: LOG without its ending).")
@click.option("--only", multiple=True, metavar="NAME", help="Only this figure, e.g. 1_trajectory; repeatable.")
@PAPER
@COLUMNS
@click.option("--band", is_flag=True, help="Three logs or more: median and 5 to 95 % of them, no curve each.")
def plot(
    logs: tuple[Path, ...], out: Path | None, only: tuple[str, ...], paper: str | None, columns: int, band: bool
) -> None:
    """Draw LOG as PNG and PDF figures: the paper's five, errors of the estimate, solve time, energy, current.

    Several logs are drawn into the same figures: trajectory, depth and yaw, speeds, energy.
    """
    from autopilot.log.figures import paper_style, write_figures
    from autopilot.log.reader import open_log

    more = f"_and_{len(logs) - 1}_more" if len(logs) > 1 else ""
    target = out if out is not None else logs[0].with_name(logs[0].stem + more)
    opened = [open_log(path) for path in logs]
    for path in write_figures(opened, target, only=only, style=paper_style(paper, columns), band=band):
        click.echo(str(path))
    for each in opened:
        _tell_loss(each)


@log.command()
@LOG_FILE
@JSON_NOT_TABLES
def programs(log_file: Path, as_json: bool) -> None:
    """Solve what the optimiser failed to solve in LOG once more, by every solver.

    Exit 1 if there is something, 3 if part of LOG could not be read.
    """
    from autopilot.control.nmpc.unsolved import solve_again
    from autopilot.log.packing.programs import unpack
    from autopilot.log.reader import open_log

    opened = open_log(log_file)
    opened.verify()
    found = {name: unpack(name, data) for name, data in opened.attachments.items() if name.startswith("program-")}
    trials = {name: solve_again(program) for name, program in found.items()}
    listed = [
        {
            "name": name,
            "t_s": program.t_us * 1e-6,
            "solver": program.solver,
            "status": program.status.name,
            "again": [
                {**asdict(trial), "status": None if trial.status is None else trial.status.name}
                for trial in trials[name]
            ],
        }
        for name, program in found.items()
    ]
    if as_json:
        emit_json({"log": str(log_file), "programs": listed})
    elif not found:
        flown = opened.topics.get("/ctl/nmpc")
        text = "every program was solved" if flown is not None and flown.count else "has no control steps (/ctl/nmpc)"
        click.echo(f"{log_file}: {text}")
    else:
        rows = [
            (
                name,
                f"{program.t_us * 1e-6:.2f}",
                f"{program.solver}: {program.status.name}",
                trial.solver,
                "not on this machine" if trial.status is None else trial.status.name,
                f"{trial.violation:.1e}",
                f"{trial.gap:.1e}",
                " ".join(f"{force:.2f}" for force in trial.thrust_n),
            )
            for name, program in found.items()
            for trial in trials[name]
        ]
        columns = ("program", "at [s]", "in flight", "solver", "now", "violation", "gap of guess", "first thrust [N]")
        print_table(f"{log_file}: programs that were not solved, solved again", columns, rows)
    if found:
        raise click.exceptions.Exit(EXIT_FAILED)
    _tell_loss(opened, "looked at")


def _tell_loss(opened: "Log", done: str = "drawn") -> None:
    """Warn that the log is incomplete, also by the exit code."""
    if opened.problems:
        click.echo(f"warning: {opened.path}: {'; '.join(opened.problems)}; only what is readable was {done}", err=True)
        raise click.exceptions.Exit(EXIT_LOSS)


def print_rows(rows: "list[BoundRow]", title: str, *, everything: bool = False) -> None:
    """The verdict, and the rows that fail, warn or matter most; with ``everything`` all of them, by subject."""
    from rich.box import SIMPLE
    from rich.table import Table
    from rich.text import Text

    from autopilot.log.check import BoundVerdict, format_figure, overall, short_form

    styles = {
        BoundVerdict.PASS: "green",
        BoundVerdict.WARN: "yellow",
        BoundVerdict.FAIL: "bold red",
        BoundVerdict.INFO: "dim",
    }
    console = make_console()
    verdict, counts = overall(rows), [(kind, sum(row.verdict is kind for row in rows)) for kind in styles]
    summary = ", ".join(f"{count} {kind.value}" for kind, count in counts if count)
    console.print(Text.assemble(f"{title}\n", (f"verdict: {verdict.value}", styles[verdict]), f" ({summary})"))
    shown = rows if everything else short_form(rows)
    beside = console.width >= NOTES_BESIDE
    table = Table(box=SIMPLE, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("quantity", overflow="fold")
    for column in ("worst", "limit", "margin"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    if beside:
        table.add_column("note", overflow="fold")
    subject = ""
    for row in shown:
        if everything and row.subject != subject:
            subject = row.subject
            table.add_row(Text(subject, style="bold"))
        figures = [format_figure(value) for value in (row.worst, row.limit, row.margin)]
        below = f"\n  {row.note}" if row.note and not beside else ""
        name, note = Text.assemble(row.name, (below, "dim")), [Text(row.note)] if beside else []
        table.add_row(name, *figures, row.unit, Text(row.verdict.value, style=styles[row.verdict]), *note)
    console.print(table)
    if len(rows) > len(shown):
        console.print(Text(f"{len(rows) - len(shown)} more rows: autopilot log check LOG --all"))


def _facts(opened: "Log") -> dict[str, Any]:
    """Output of ``info`` for JSON."""
    span_s = opened.duration_s
    return {
        "path": str(opened.path),
        "bytes": opened.path.stat().st_size,
        "duration_s": span_s,
        "messages": opened.message_count,
        "run": dict(opened.run),
        "attachments": {name: len(data) for name, data in opened.attachments.items()},
        "topics": {
            topic: {
                "type": entry.type,
                "messages": entry.count,
                "rate_hz": entry.count / span_s if span_s > 0.0 else 0.0,
            }
            for topic, entry in opened.topics.items()
        },
        "slowest_tick": _slowest_tick(opened),
        "problems": list(opened.problems),
    }


def _slowest_tick(opened: "Log") -> dict[str, float]:
    """Milliseconds by part of the loop's slowest tick, empty without loop statistics."""
    from autopilot.core.marks import LoopPart

    if "/sys/loop" not in opened.topics:
        return {}
    loop = opened["/sys/loop"]
    if "part_s" not in (loop.dtype.names or ()) or not len(loop):
        return {}
    slowest = loop["part_s"][int(loop["part_s"].sum(axis=1).argmax())]
    return {part.name.lower(): round(1000.0 * float(slowest[part]), 3) for part in LoopPart}


def _print_facts(opened: "Log", facts: dict[str, Any]) -> None:
    from rich.table import Table
    from rich.text import Text

    console = make_console()
    head = Table(show_header=False, box=None, pad_edge=False)
    size = f"{facts['bytes'] / 1e6:.1f} MB, {facts['duration_s']:.1f} s, {facts['messages']} messages"
    head.add_row("log", Text(f"{facts['path']}: {size}"))
    for name, value in facts["run"].items():
        head.add_row(Text(name), Text(value))
    attached = ", ".join(f"{name} ({size} B)" for name, size in facts["attachments"].items())
    head.add_row("attachments", Text(attached))
    if facts["slowest_tick"]:
        parts = sorted(facts["slowest_tick"].items(), key=lambda part: -part[1])[:4]
        head.add_row("slowest tick", Text(", ".join(f"{name} {ms:.1f} ms" for name, ms in parts)))
    console.print(head)
    table = Table("topic", "type")
    table.add_column("messages", justify="right")
    table.add_column("Hz", justify="right")
    for topic, entry in facts["topics"].items():
        table.add_row(Text(topic), Text(entry["type"]), str(entry["messages"]), f"{entry['rate_hz']:.1f}")
    console.print(table)
    for problem in opened.problems:
        console.print(Text.assemble(("loss: ", "bold red"), problem))
    if opened.problems:
        console.print(f"{opened.message_count} messages are readable", highlight=False)
