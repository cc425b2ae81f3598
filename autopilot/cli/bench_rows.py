"""Benchmarks that print a table, with the slowness of the machine during the run."""

from collections.abc import Callable, Mapping
from dataclasses import asdict

import click

from autopilot.cli.bench_tables import SHORT, Rows, names, print_rows
from autopilot.cli.console_output import emit_json
from autopilot.cli.shared_options import JSON

Work = Callable[[bool], Rows]
"""Takes whether it is to be short."""


def measured(
    title: str, work: Work, *, short: bool, as_json: bool, heads: Mapping[str, str] | None = None
) -> dict[str, object]:
    """Run a benchmark and print its table, unless JSON is requested; returns rows and slowness of the machine."""
    slow = _slowness()
    rows = work(short)
    slow = 0.5 * (slow + _slowness())
    if not as_json:
        print_rows(title, rows, heads)
        click.echo(f"the machine was {slow:.1f} times slower during this than when the asked figures were set")
    return {"machine_slowness": slow, "rows": rows}


def run_one(
    name: str, title: str, work: Work, *, short: bool, as_json: bool, heads: Mapping[str, str] | None = None
) -> None:
    """Run it as a command by itself."""
    found = measured(title, work, short=short, as_json=as_json, heads=heads)
    if as_json:
        emit_json({name: found})
    end({name: found})


def end(results: Mapping[str, Mapping[str, object]]) -> None:
    """Exit code 1 where a figure is not what is asked for; a table without a column ``kept`` asks for nothing."""
    missed = [name for name, found in results.items() if not all(row.get("kept", True) for row in rows_of(found))]
    if missed:
        click.echo(f"not what is asked for: {names(missed)}", err=True)
        raise click.exceptions.Exit(1)


def rows_of(found: Mapping[str, object]) -> Rows:
    rows = found["rows"]
    assert isinstance(rows, list)
    return rows


def rows_command(name: str, title: str, work: Work, heads: Mapping[str, str] | None = None) -> click.Command:
    """Command of a benchmark without options of its own; its help is the docstring of ``work``."""

    @click.command(name, help=work.__doc__)
    @SHORT
    @JSON
    def command(short: bool, as_json: bool) -> None:
        run_one(name, title, work, short=short, as_json=as_json, heads=heads)

    return command


def nmpc_rows(short: bool) -> Rows:
    """CPU time of one control step, beside IPOPT and fatrop.

    Several grids, the same problems in the same run; with 2, 10 and 50 obstacles; failures from 200 random starts;
    start-up and memory (minutes; less with --short).
    """
    from autopilot.bench.nmpc import STARTS, bench_nmpc

    rows = bench_nmpc(steps=100 if short else 400, starts=STARTS // 10 if short else STARTS)
    return [asdict(row) for row in rows]


def sitl_rows(short: bool) -> Rows:
    """Speed against real time, CPU time per tick, memory.

    With a rendered camera and with pose samples, minimum energy and quadratic cost (minutes; exit code 1 where a speed
    is below what is asked for).
    """
    from autopilot.bench.sitl_row import bench_sitl

    return [{**asdict(row), "kept": row.kept} for row in bench_sitl(duration_s=10.0 if short else 30.0)]


def estimator_rows(short: bool) -> Rows:
    """Error of the estimate in flights of the paper's tour.

    With positions from the pose sensor, several seeds (a minute; one seed with --short).
    """
    from autopilot.bench.estimator_row import SEEDS, bench_estimator

    return [asdict(row) for row in bench_estimator(SEEDS[:1] if short else SEEDS)]


def loop_rows(_short: bool) -> Rows:
    """CPU time of the loop's ticks in real time, with uploads in flight.

    With a camera: heartbeats and upload times while 500 items and a fence of 50 octagons are uploaded (half a minute;
    exit code 1 where a figure is above what is asked for).
    """
    from autopilot.bench.loop import bench_loop

    return [{**asdict(row), "kept": row.kept} for row in bench_loop()]


def _slowness() -> float:
    from autopilot.bench.machine import slowness

    return slowness()
