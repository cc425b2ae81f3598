"""Benchmarks that print a table, with the slowness of the machine during the run."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict

import click

from autopilot.cli.console_output import emit_json, print_table
from autopilot.cli.shared_options import JSON

Rows = list[dict[str, object]]
Work = Callable[[bool], Rows]
"""Takes whether it is to be short."""
SHORT = click.option("--short", is_flag=True, help="Fewer samples, for a quick look.")

TITLES = {
    "loop": "The loop in real time with a camera, 500 items and 50 octagons uploaded in flight; asked = at most",
    "nmpc": "One control step, CPU time; bar and goal are for the median",
    "sitl": "The paper's mission with its log; speed = simulated over wall time, asked = what the project asks for",
    "estimator": "Estimate against truth in the paper's tank, one lap per seed; asked as in `autopilot log check`",
}


SITL_HEADS = {
    "simulated_s": "sim. s",
    "cpu_s_per_s": "cpu s/s",
    "beside_s_per_s": "beside",
    "tick_mean_ms": "tick ms",
    "tick_median_ms": "median",
    "tick_p99_ms": "p99",
    "step_median_ms": "step ms",
    "step_p99_ms": "p99",
    "step_max_ms": "max",
}
"""Heads of the columns of ``sitl``, whose names are long."""


def print_rows(title: str, rows: Rows, long: Mapping[str, str] | None = None) -> None:
    """Print a benchmark's table; ``long``: heads for columns with long names; ``parts`` of a row follow it."""
    columns = [column for column in rows[0] if column != "parts"]
    heads = [(long or {}).get(column, column) for column in columns]
    print_table(title, heads, [[_figure(row[column]) for column in columns] for row in rows])
    for row in rows:
        if "parts" in row:
            click.echo(f"{row[columns[0]]}, mean tick by part [ms]: {row['parts']}")


def _figure(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def names(found: Sequence[str]) -> str:
    """``a, b and c``."""
    return " and ".join([", ".join(found[:-1]), found[-1]] if len(found) > 1 else found)


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
