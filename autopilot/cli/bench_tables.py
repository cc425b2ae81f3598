"""Output of benchmarks: titles, column heads, figures."""

from collections.abc import Mapping, Sequence

import click

from autopilot.cli.console_output import print_table

Rows = list[dict[str, object]]
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
