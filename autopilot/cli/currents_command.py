"""``autopilot currents``: describe current maps and generate the benchmark's."""

from pathlib import Path

import click

from autopilot.cli.click_types import Finite, FiniteRange
from autopilot.cli.console_output import EXIT_LOSS, emit_json, print_table
from autopilot.cli.shared_options import JSON


@click.group()
def currents() -> None:
    """Check current maps, make the benchmark's."""


@currents.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False))
@click.option("--plan", type=click.Path(exists=True, dir_okay=False), help="Plan whose workspace the map has to cover.")
@click.option(
    "--origin", nargs=2, type=Finite(), metavar="LAT LON", help="Local origin (default: ORIGIN_LAT, ORIGIN_LON)."
)
@JSON
def check(file: str, plan: str | None, origin: tuple[float, float] | None, as_json: bool) -> None:
    """What the map FILE holds, and whether it fits a plan: exit 1 if not, 3 with a warning."""
    from autopilot.command.map_check import describe_map, open_map, plan_findings
    from autopilot.core.geodesy import Origin

    where = None if origin is None else Origin(lat_deg=origin[0], lon_deg=origin[1])
    current_map = open_map(Path(file), where)
    rows = describe_map(current_map)
    problem, warning = ("", "") if plan is None else plan_findings(current_map, Path(plan), where)
    if as_json:
        emit_json({**dict(rows), "problem": problem, "warning": warning})
    else:
        print_table(f"Current map {file}", ("what", "value"), rows)
        for kind, text in (("problem", problem), ("warning", warning)):
            if text:
                click.echo(f"{kind}: {text}", err=True)
    if problem or warning:
        raise click.exceptions.Exit(1 if problem else EXIT_LOSS)


@currents.command()
@click.argument("file", type=click.Path(dir_okay=False))
@click.option("--error", type=FiniteRange(0.0, 1.0), help="Write a forecast: wrong by this share of the rms.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of the forecast's error.")
def b6(file: str, error: float | None, seed: int) -> None:
    """Write the current of benchmark B6 as a map, or a forecast of it."""
    import numpy as np

    from autopilot.analysis.flow_maps import b6_map, flow_map_bytes, forecast_of
    from autopilot.core.disk import write_result

    flow = b6_map()
    if error is not None:
        flow = forecast_of(flow, error=error, rng=np.random.default_rng(seed))
    path = Path(file)
    write_result(path, flow_map_bytes(flow), folder=True)
    click.echo(f"{path}: {len(flow.time_s)} frames, rms {flow.rms_m_s:.3f} m/s, {path.stat().st_size // 1024} KiB")


@currents.command()
@click.argument("log", type=click.Path(exists=True, dir_okay=False))
@JSON
def compare(log: str, as_json: bool) -> None:
    """Mean error [m/s] of the forecasts without a map along the way that a simulated flight's LOG then took."""
    from dataclasses import asdict

    from autopilot.analysis.current_forecasts import compare_forecasts

    rows = [asdict(row) for row in compare_forecasts(Path(log))]
    if as_json:
        emit_json(rows)
        return
    print_table(
        "Mean error of the forecast, m/s",
        ("forecast", "lap", "next 8 s", "rest of the leg", "revisions"),
        [(r["forecast"], r["lap"], round(r["next_8_s"], 4), round(r["rest_of_leg"], 4), r["revisions"]) for r in rows],
    )
