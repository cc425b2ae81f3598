"""``autopilot identify``: masses and drags of a vehicle from logs of its flights."""

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from autopilot.cli.completion import VEHICLE_NAME
from autopilot.cli.console_output import EXIT_LOSS, emit_json, print_table
from autopilot.cli.shared_options import JSON

if TYPE_CHECKING:
    from autopilot.core.vehicle import Vehicle
    from autopilot.identify.identification_report import CoefficientRow


@click.command()
@click.argument("logs", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "--vehicle",
    type=VEHICLE_NAME,
    help="Vehicle to begin with, a name or a file (default: what the first log was flown with).",
)
@click.option(
    "--out", type=click.Path(dir_okay=False, path_type=Path), help="Write a vehicle file with the new values."
)
@click.option("--compare", is_flag=True, help="Beside what the simulator flew; for logs of the simulator only.")
@JSON
def identify(logs: tuple[Path, ...], vehicle: str | None, out: Path | None, compare: bool, as_json: bool) -> None:
    """Masses (added mass included), drags and buoyancy of the 4-DoF model from the motion in LOGS.

    Thrust is taken from the pulses and the drive of the vehicle file: measure that first, on a bollard. Fly the axes
    that are to be told at several speeds both ways, as the scenario `identify` does. Axes that the flights tell too
    little of keep the values of the vehicle file.

    Exit codes: 0 all axes told, 3 some kept.
    """
    from autopilot.core.vehicle import load_vehicle
    from autopilot.identify.fit import fit
    from autopilot.identify.identification_report import changes, rows_of
    from autopilot.identify.record import read_windows

    twice = next((log for at, log in enumerate(logs) if any(log.samefile(other) for other in logs[:at])), None)
    if twice is not None:
        raise click.UsageError(f"{twice} is given twice; its errors would seem smaller than they are")
    windows, base = read_windows(list(logs), None if vehicle is None else load_vehicle(vehicle))
    found = fit(windows, base.to_model())
    rows = rows_of(found, base)
    truth = _truth(logs[0], base) if compare else None
    if out is not None:
        from autopilot.calibrate.vehicle_edit import write_updated
        from autopilot.core.vehicle import vehicle_names

        if vehicle is None and base.name not in vehicle_names():
            raise click.UsageError(f"the logs are of {base.name!r}, which does not ship: name its file with --vehicle")
        names = ", ".join(log.name for log in logs)
        write_updated(vehicle or base.name, changes(found, base), f"identified from {names}", out)
    if as_json:
        emit_json({"windows": found.windows, "residuals": found.sigma.tolist(), "rows": [asdict(row) for row in rows]})
    else:
        _print(rows, truth)
        north_south = ", ".join(f"{north:+.3f} {east:+.3f}" for north, east in found.current_m_s)
        x, y, z, yaw, rate = found.sigma
        click.echo(
            f"{found.windows} windows of 4 s; residuals x {1e3 * x:.1f} y {1e3 * y:.1f} z {1e3 * z:.1f} mm, yaw"
            f" {math.degrees(yaw):.2f} deg, rate {math.degrees(rate):.2f} deg/s; current north, east: {north_south} m/s"
        )
        if out is not None:
            click.echo(f"written: {out}")
    if any(row.kept for row in rows):
        raise click.exceptions.Exit(EXIT_LOSS)


def _print(rows: "list[CoefficientRow]", truth: dict[str, float] | None) -> None:
    columns = ["coefficient", "unit", "before", "found", "95 % from", "to", "+- %", ""]
    if truth is not None:
        columns += ["flown", "off %", "covered"]
    table = []
    for row in rows:
        half_width = 100.0 * 0.5 * (row.high - row.low) / abs(row.value) if row.value else math.inf
        cells = [
            row.name,
            row.unit,
            *(f"{v:.4g}" for v in (row.before, row.value, row.low, row.high)),
            f"{half_width:.1f}",
        ]
        cells.append("kept" if row.kept else "")
        if truth is not None:
            flown = truth[row.name]
            inside = "yes" if row.low <= flown <= row.high else "no"
            cells += [f"{flown:.4g}", f"{100.0 * (row.value / flown - 1.0):+.1f}" if flown else "", inside]
        table.append(cells)
    print_table("Coefficients of the 4-DoF model", columns, table)


def _truth(log: Path, vehicle: "Vehicle") -> dict[str, float]:
    """Coefficients of the simulated body on each axis, by row name."""
    import msgspec

    from autopilot.core.errors import LogError
    from autopilot.identify.identification_report import REFERENCE_SPEEDS
    from autopilot.identify.prediction import AXES
    from autopilot.log.reader import open_log
    from autopilot.sitl.mismatch import mismatched
    from autopilot.sitl.scenario_tables import Scenario

    data = open_log(log).attachments.get("scenario.json")
    if data is None:
        raise LogError(f"{log}: has no scenario.json; --compare needs a log of the simulator")
    body = mismatched(vehicle, msgspec.json.decode(data, type=Scenario).vehicle.mismatch).body
    masses = [
        *(body.mass_kg + added for added in body.added_mass_kg),
        body.inertia_kg_m2[2] + body.added_inertia_kg_m2[2],
    ]
    linear = [*body.linear_drag_n_s_m, body.angular_linear_drag_n_m_s[2]]
    square = [*body.quadratic_drag_n_s2_m2, body.angular_quadratic_drag_n_m_s2[2]]
    flown = {"buoyancy excess": body.buoyancy_excess_n}
    for axis, speed, mass, d1, d2 in zip(AXES, REFERENCE_SPEEDS, masses, linear, square, strict=True):
        flown[f"{axis} mass"] = mass
        flown[f"{axis} drag at {speed:g}"] = d1 * speed + d2 * speed * speed
        flown[f"{axis} linear drag"], flown[f"{axis} quadratic drag"] = d1, d2
    return flown
