"""``autopilot markers``: print marker boards, check marker maps, survey them."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.completion import VEHICLE_NAME
from autopilot.cli.console_output import emit_json, print_table, warn
from autopilot.cli.markers_board import board
from autopilot.cli.markers_survey import survey
from autopilot.cli.shared_options import JSON, not_over

if TYPE_CHECKING:
    pass


@click.group()
def markers() -> None:
    """Print marker boards, check and survey marker maps."""


@markers.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False))
@click.option(
    "--vehicle", type=VEHICLE_NAME, default="lbv150", show_default=True, help="Whose camera looks at it: name or file."
)
@JSON
def check(file: str, vehicle: str, as_json: bool) -> None:
    """What the map FILE holds, and how much of it the camera sees. Exit 1 if it is wrong, 3 with warnings."""
    from autopilot.core.camera import CameraModel
    from autopilot.core.marker_files import load_marker_map
    from autopilot.core.vehicle import load_vehicle
    from autopilot.markermaps.check_markers import describe_markers, map_warnings, view_fractions

    layout = load_marker_map(Path(file))
    boat = load_vehicle(vehicle)
    rows = describe_markers(layout)
    fractions = view_fractions(layout, CameraModel.of_vehicle(boat)) if layout.level else []
    warnings = map_warnings(layout)
    if as_json:
        emit_json({**dict(rows), "view_shares": fractions, "warnings": warnings})
    else:
        print_table(f"Marker map {file}", ("what", "value"), rows)
        if fractions:
            print_table(
                f"Places over the floor from which {boat.name} sees whole markers",
                ("camera height m", "one or more", "two or more"),
                [(f"{h:g}", f"{100.0 * one:.0f} %", f"{100.0 * two:.0f} %") for h, one, two in fractions],
            )
    warn(warnings)


@markers.command()
@click.argument("log", type=click.Path(exists=True, dir_okay=False))
@click.option("--map", "map_path", type=click.Path(exists=True, dir_okay=False), help="Another map than the log's.")
@click.option("--out", type=click.Path(dir_okay=False), required=True, help="The refined map (TOML).")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def refine(log: str, map_path: str | None, out: str, as_json: bool) -> None:
    """Where the sheets of the map really lie, as the estimator finds them in the flight LOG."""
    import numpy as np

    from autopilot.core.disk import write_result
    from autopilot.core.marker_files import load_marker_map, marker_file_text
    from autopilot.log.reader import open_log
    from autopilot.record.estimator_setup import read_markers, read_setup
    from autopilot.replay.estimator_replay import refined_by

    not_over(Path(out), Path(log))
    flight = open_log(Path(log))
    rough = read_markers(flight.attachments) if map_path is None else load_marker_map(Path(map_path))
    result = refined_by(flight, read_setup(flight), rough)
    assert rough is not None
    assert rough.errors is not None
    assert result.errors is not None
    rows: list[dict[str, Any]] = []
    for k, name in enumerate(result.errors.names):
        mine = result.errors.sheet == k
        moved = (result.centers_ned_m[mine] - rough.centers_ned_m[mine])[:, :2]
        arm = rough.corners_ned_m[mine][0, 1] - rough.corners_ned_m[mine][0, 0]
        now = result.corners_ned_m[mine][0, 1] - result.corners_ned_m[mine][0, 0]
        turn = math.atan2(arm[0] * now[1] - arm[1] * now[0], arm[0] * now[0] + arm[1] * now[1])
        sigma = result.errors.sigma[k]
        seen = bool((sigma < rough.errors.sigma[k]).any())
        rows.append(
            {
                "sheet": name,
                "markers": int(mine.sum()),
                "seen": seen,
                "moved_m": float(np.sqrt((moved**2).sum(axis=1).mean())),
                "turned_rad": turn,
                "sigma_m": float(sigma[:2].max()),
                "sigma_rad": float(sigma[3]),
            }
        )
    notes = [f"refined from {Path(log).name}"]
    write_result(Path(out), marker_file_text(result, notes))
    if as_json:
        emit_json({"sheets": rows, "frame_sigma": result.errors.frame_sigma})
        return
    print_table(
        "Sheets",
        ("sheet", "markers", "moved mm", "turned deg", "sigma mm", "sigma deg"),
        [
            (
                row["sheet"],
                row["markers"],
                f"{1e3 * row['moved_m']:.2f}",
                f"{math.degrees(row['turned_rad']):.3f}",
                f"{1e3 * row['sigma_m']:.2f}" if row["seen"] else "not seen",
                f"{math.degrees(row['sigma_rad']):.3f}" if row["seen"] else "",
            )
            for row in rows
        ],
    )
    across, _, turn = result.errors.frame_sigma
    click.echo(f"all together may be off by {1e3 * across:.2f} mm and {math.degrees(turn):.3f} deg (sigma)")
    click.echo(f"{out}: {len(result.ids)} markers on {len(rows)} sheets")


markers.add_command(board)
markers.add_command(survey)
