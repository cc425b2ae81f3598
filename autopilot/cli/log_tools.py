"""``autopilot log export|diff|recover|find|tlog|view``: operations on whole logs."""

import time
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from autopilot.cli.click_types import OneOf
from autopilot.cli.console_output import EXIT_FAILED, EXIT_LOSS, emit_json, print_table
from autopilot.cli.shared_options import JSON, JSON_NOT_TABLES, LOG_FILE
from autopilot.core.errors import AutopilotError, LogError
from autopilot.run.config import MAX_PORT

if TYPE_CHECKING:
    from autopilot.core.vehicle import Vehicle
    from autopilot.log.reader import Log

_LOG = click.Path(path_type=Path)
DEFAULT_VEHICLE = "lbv150"
POLL_S = 0.2


@click.command()
@click.argument("log_file", metavar="LOG", type=_LOG)
@click.option("--topic", "topics", multiple=True, help="Only this topic; repeatable (default: all).")
@click.option("--format", "kind", type=OneOf(("csv", "parquet")), default="csv", show_default=True)
@click.option("--out", type=_LOG, help="Folder to write into (default: LOG without its ending).")
@click.option("--stills", type=_LOG, metavar="DIR", help="Write the camera's stills into DIR as PNG, and no topics.")
def export(
    log_file: Path,
    topics: tuple[str, ...],
    kind: Literal["csv", "parquet"],
    out: Path | None,
    stills: Path | None,
) -> None:
    """Write LOG's topics as one CSV or Parquet file each. Exit 3 if part of LOG could not be read."""
    from autopilot.log.export import export_log, export_stills
    from autopilot.log.reader import open_log

    opened = open_log(log_file)
    if stills is not None and (topics or out is not None):
        raise click.UsageError("--stills writes no topics: leave --topic and --out out, or call it twice")
    written = (
        export_log(opened, out or log_file.with_suffix(""), topics=topics, kind=kind)
        if stills is None
        else export_stills(opened, stills)
    )
    for path in written:
        click.echo(str(path))
    if opened.problems:
        click.echo(f"warning: {log_file}: {'; '.join(opened.problems)}", err=True)
        raise click.exceptions.Exit(EXIT_LOSS)


@click.command()
@click.argument("first", metavar="A", type=_LOG)
@click.argument("second", metavar="B", type=_LOG)
@click.option("--ignore", multiple=True, metavar="TOPIC|FIELD", help="Leave a topic, field or topic.field out.")
@click.option("--all", "everything", is_flag=True, help="Compare also what the machine has measured of itself.")
@JSON_NOT_TABLES
def diff(first: Path, second: Path, ignore: tuple[str, ...], everything: bool, as_json: bool) -> None:
    """Where the messages of A and B differ, and their parameters. Exit 1 if they do, 3 if part could not be read."""
    from autopilot.log.compare import WALL_CLOCK_FIELDS, WALL_CLOCK_TOPICS, compare_logs
    from autopilot.log.reader import open_log

    a, b = open_log(first), open_log(second)
    topics = (*ignore, *(() if everything else WALL_CLOCK_TOPICS))
    fields = (*ignore, *(() if everything else WALL_CLOCK_FIELDS))
    found = compare_logs(a, b, topics, fields)
    ours, others = ({} if log.description is None else log.description.parameters for log in (a, b))
    parameters = [
        {"name": name, "first": ours.get(name), "second": others.get(name)}
        for name in sorted({*ours, *others})
        if ours.get(name) != others.get(name)
    ]
    problems = [f"{log.path}: {problem}" for log in (a, b) for problem in log.problems]
    if as_json:
        differences = [asdict(difference) for difference in found]
        emit_json({"differences": differences, "parameters": parameters, "problems": problems})
    else:
        for changed in parameters:
            click.echo(f"parameter {changed['name']}: {changed['first']} against {changed['second']}")
        for difference in found:
            click.echo(str(difference))
        if not found:
            click.echo("the same messages")
    for problem in problems:
        click.echo(f"warning: {problem}; compared is what is readable", err=True)
    if found or parameters:
        raise click.exceptions.Exit(EXIT_FAILED)
    if problems:
        raise click.exceptions.Exit(EXIT_LOSS)


@click.command()
@click.argument("place", metavar="LOG|FOLDER", type=_LOG)
@JSON_NOT_TABLES
def recover(place: Path, as_json: bool) -> None:
    """Repair a log that was never finished, or all such below a folder; it takes the old one's place.

    Exit 0 if nothing was to be done, 3 if something was repaired, 1 if something could not be.
    """
    from autopilot.log.recover import damage_within, recover_log, recover_unfinished

    if place.is_dir():
        found = recover_unfinished(place)
    else:
        one = recover_log(place) or damage_within(place)
        found = [] if one is None else [one]
    if as_json:
        emit_json([{**asdict(one), "path": str(one.path)} for one in found])
    else:
        for one in found:
            done = f"{one.messages} messages saved" if one.repaired else "left as it is"
            click.echo(f"{one.path}: {done} ({one.problem})")
        if not found:
            click.echo(f"{place}: nothing to repair: finished, or still being written")
    if found:
        raise click.exceptions.Exit(EXIT_LOSS if all(one.repaired for one in found) else 1)


@click.command()
@click.argument("folder", required=False, type=_LOG)
@click.option("--where", multiple=True, metavar="KEY=VALUE", help="Only runs of which that holds; repeatable.")
@JSON_NOT_TABLES
def find(folder: Path | None, where: tuple[str, ...], as_json: bool) -> None:
    """List the logs below FOLDER (default: the log folder): run, time, length, damage.

    KEY is of the run's metadata: scenario, vehicle, seed, started, revision ...; VALUE is how it begins.
    """
    from autopilot.log.find import find_logs
    from autopilot.run.config import gather, sitl_defaults

    wanted = dict(_pair(text) for text in where)
    place = folder or Path(gather(sitl_defaults(0), {})["log_dir"])
    found = list(find_logs(place, wanted))
    if as_json:
        emit_json([{**asdict(one), "path": str(one.path)} for one in found])
        return
    rows = [
        (
            str(one.path.relative_to(place)),
            one.facts.get("scenario") or one.facts.get("place", ""),
            one.facts.get("vehicle", ""),
            one.facts.get("seed", ""),
            one.facts.get("started", ""),
            f"{one.duration_s:.1f}",
            f"{1e-6 * one.size_bytes:.1f}",
            one.problem,
        )
        for one in found
    ]
    columns = ("log", "run", "vehicle", "seed", "started", "s", "MB", "problem")
    print_table(f"{len(rows)} logs below {place}", columns, rows)


def _pair(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise LogError(f"--where {text!r}: write KEY=VALUE, e.g. scenario=paper-tank")
    return key, value


@click.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@JSON
def tlog(file: Path, as_json: bool) -> None:
    """Attitude in a .tlog of any MAVLink vehicle: rate, gaps and their causes, and what the AHRS intake makes of it.

    Exit codes: 0 every gap is explained by what the file shows, 1 not.
    """
    from autopilot.replay.tlog import replay_tlog

    found = replay_tlog(file)
    if as_json:
        emit_json({**asdict(found), "unexplained": len(found.unexplained)})
    else:
        rate = 1.0 / found.median_s if found.median_s else 0.0
        click.echo(
            f"{found.attitudes} attitudes in {found.duration_s:.1f} s, {rate:.1f} Hz;"
            f" {sum(found.damaged.values())} damaged pieces"
        )
        for piece, count in found.damaged.items():
            click.echo(f"  {count} x {piece}")
        copies = Counter(gap.reason(found.median_s) for gap in found.gaps if gap.sender_s == 0.0)
        for reason, count in copies.items():
            click.echo(f"  {count} x {reason}")
        rows = [
            [
                f"{gap.at_s:.2f}",
                f"{gap.arrival_s:.3f}",
                f"{gap.sender_s:.3f}",
                gap.reason(found.median_s) or "not explained",
            ]
            for gap in found.gaps
            if gap.sender_s != 0.0
        ]
        if rows:
            print_table("Gaps between attitudes", ["at s", "arrival s", "sender's clock s", "cause"], rows)
        click.echo(", ".join(f"{name} {count}" for name, count in found.counters.items()))
    if found.unexplained:
        raise click.exceptions.Exit(EXIT_FAILED)


@click.command()
@LOG_FILE
@click.option(
    "--port",
    type=click.IntRange(0, MAX_PORT),
    help="Port on 127.0.0.1, 0 = any (default: 8760, or the next that is free).",
)
def view(log_file: Path, port: int | None) -> None:
    """Play LOG in the page of the live view, on 127.0.0.1, until Ctrl-C."""
    from autopilot.cli.service_run import StopSignals
    from autopilot.log.reader import open_log
    from autopilot.run.sitl_world_view import logged_world
    from autopilot.view.http_server import ViewServer
    from autopilot.view.log_frames import LogFrames

    opened = open_log(log_file)
    world, unknown = logged_world(opened)
    if unknown:
        click.echo(f"warning: {log_file}: {unknown}; obstacles are shown as described, without the current", err=True)
    frames = LogFrames(opened, _vehicle(opened), world)
    if opened.problems:
        click.echo(f"warning: {log_file}: {'; '.join(opened.problems)}; only what is readable is shown", err=True)
    server = ViewServer(port, frames, "--port")
    stop = StopSignals()
    click.echo(f"view: {server.url}")
    try:
        while not stop:
            time.sleep(POLL_S)
    finally:
        server.close()


def _vehicle(log: "Log") -> "Vehicle":
    """The vehicle file of the run; of a log without it the shipped one of that name, else the default."""
    from autopilot.core.vehicle import load_vehicle
    from autopilot.record.estimator_setup import read_vehicle

    try:
        return read_vehicle(log)
    except AutopilotError as error:
        name = log.run.get("vehicle", "")
        try:
            vehicle = load_vehicle(name or DEFAULT_VEHICLE)
        except AutopilotError:
            name, vehicle = DEFAULT_VEHICLE, load_vehicle(DEFAULT_VEHICLE)
        click.echo(f"warning: {error}; drawn as {name or DEFAULT_VEHICLE}", err=True)
        return vehicle
