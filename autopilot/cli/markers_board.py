"""``autopilot markers board``: boards to print."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.click_types import Finite, FiniteRange
from autopilot.cli.console_output import warn

if TYPE_CHECKING:
    from autopilot.core.markers import MarkerMap


MOST_M = 5.0
"""As in map files: a larger number is in millimetres."""
MARKER_SIZE = FiniteRange(min=0.002, max=MOST_M)


@click.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False), required=False)
@click.option("--rows", type=click.IntRange(1, 1000), help="Grid: rows,")
@click.option("--columns", type=click.IntRange(1, 1000), help="columns,")
@click.option(
    "--floor", nargs=2, type=FiniteRange(min=0.0, min_open=True), metavar="NORTH EAST", help="or metres to fill."
)
@click.option("--size", type=MARKER_SIZE, default=0.06, show_default=True, help="Black square [m].")
@click.option(
    "--gap", type=FiniteRange(min=0.0, max=MOST_M), default=0.02, show_default=True, help="White between them [m]."
)
@click.option("--dictionary", default="DICT_4X4_1000", show_default=True, help="OpenCV's name, AprilTags too.")
@click.option("--first-id", type=click.IntRange(min=0), default=0, show_default=True, help="Of the grid.")
@click.option("--seed", type=click.IntRange(min=0), default=7, show_default=True, help="Order of ids of a floor.")
@click.option(
    "--at", nargs=3, type=Finite(), default=(0.0, 0.0, 0.0), metavar="N E D", help="Middle of the board in the map."
)
@click.option("--heading", type=Finite(), default=0.0, show_default=True, help="Where the board's top points [deg].")
@click.option("--paper", default="A4", show_default=True, help="A0 to A4, or WIDTHxHEIGHT in mm.")
@click.option("--landscape", is_flag=True, help="Paper on its side.")
@click.option("--margin", type=FiniteRange(min=0.0), default=8.0, show_default=True, help="The printer's, mm.")
@click.option("--out", type=click.Path(file_okay=False), required=True, help="Folder for board.pdf, sheets, map.toml.")
def board(file: str | None, **options: Any) -> None:
    """Make printable sheets in true size (PDF and SVG) and the map file, of a grid, a whole floor or the map FILE.

    Exit 3 with warnings."""
    from autopilot.core.disk import write_result
    from autopilot.core.marker_files import load_marker_map, marker_file_text
    from autopilot.markermaps.check_markers import map_warnings
    from autopilot.markermaps.page import pdf_bytes, svg_text
    from autopilot.markermaps.sheets import make_sheets, on_sheets, paper_of, plane_of

    heading = math.radians(options["heading"])
    given = [
        file is not None,
        options["rows"] is not None or options["columns"] is not None,
        options["floor"] is not None,
    ]
    if sum(given) != 1:
        raise click.UsageError("give a map FILE, --rows and --columns, or --floor")
    if file is not None:
        layout, pitch_m = load_marker_map(Path(file)), None
        title = Path(file).stem
    else:
        layout = _grid(heading_rad=heading, **options)
        pitch_m = options["size"] + options["gap"]
        title = "floor" if options["floor"] is not None else "board"
    paper = paper_of(options["paper"], options["landscape"], options["margin"])
    plane = plane_of(layout, heading, pitch_m)
    pages = make_sheets(plane, paper, title)
    folder = Path(options["out"])
    write_result(folder / "board.pdf", pdf_bytes(pages), folder=True)
    for number, page in enumerate(pages, start=1):
        write_result(folder / f"sheet-{number:03d}.svg", svg_text(page))
    notes = [
        f"{title}: {len(layout.ids)} markers on {len(pages)} sheets of {options['paper']}",
        "as printed; survey it once it is laid, or say with sigma_m and sigma_rad how well",
    ]
    write_result(folder / "map.toml", marker_file_text(on_sheets(plane, paper), notes))
    click.echo(f"{folder}: {len(layout.ids)} markers on {len(pages)} sheets (board.pdf, sheet-NNN.svg), map.toml")
    click.echo("print at 100 % and measure the scale bar")
    warn(map_warnings(layout))


def _grid(*, heading_rad: float, **options: Any) -> "MarkerMap":
    """The board or floor of the options."""
    import numpy as np

    from autopilot.core.dictionaries import dictionary_size, resolve_dictionary
    from autopilot.core.errors import ConfigError
    from autopilot.core.frames import r_ned_from_frd
    from autopilot.core.marker_files import MAX_MARKERS, PlacedMarker, board_offsets, make_map, placed_markers
    from autopilot.core.marker_files import BoardEntry as BoardTable
    from autopilot.core.markers import grid_floor

    options["dictionary"] = resolve_dictionary(options["dictionary"], Path(), "--dictionary")
    r = r_ned_from_frd(np.array([0.0, 0.0, heading_rad]))
    middle = np.array(options["at"])
    pitch_m = options["size"] + options["gap"]
    rows, columns = options["rows"] or 1, options["columns"] or 1
    if options["floor"] is not None:
        rows, columns = (int(metres / pitch_m) for metres in options["floor"])
    if rows * columns > MAX_MARKERS:
        raise ConfigError(
            f"{rows} x {columns} markers are more than the {MAX_MARKERS} of a map; make it smaller, or the gap larger"
        )
    if options["floor"] is not None:
        half = 0.5 * np.array(options["floor"])
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * half
        flat = grid_floor(
            polygon_m=corners,
            depth_m=0.0,
            pitch_m=pitch_m,
            size_m=options["size"],
            seed=options["seed"],
            dictionary=options["dictionary"],
        )
        places = [(m.id, m.center_ned_m) for m in placed_markers(flat)]
    else:
        table = BoardTable(
            rows=rows, columns=columns, gap_m=options["gap"], first_id=options["first_id"], center_m=(0.0, 0.0, 0.0)
        )
        places = [(options["first_id"] + n, offset) for n, offset in enumerate(board_offsets(table, options["size"]))]
    count = dictionary_size(options["dictionary"]) or 0
    last = max(i for i, _ in places)
    if last >= count:
        raise ConfigError(
            f"the board needs ids up to {last} and the dictionary has {count}; use a larger one or --floor"
        )
    return make_map(
        [
            PlacedMarker(
                place="",
                dictionary=options["dictionary"],
                id=i,
                size_m=options["size"],
                center_ned_m=middle + r @ offset,
                r_ned_from_marker=r,
            )
            for i, offset in places
        ],
        "board",
    )
