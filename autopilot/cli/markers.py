"""``autopilot markers``: print marker boards, check marker maps, survey them."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.output import EXIT_LOSS, emit_json, print_table

if TYPE_CHECKING:
    from autopilot.core.camera import CameraModel
    from autopilot.core.markers import MarkerMap
    from autopilot.markermaps.survey import Survey


@click.group()
def markers() -> None:
    """Print marker boards, check and survey marker maps."""


@markers.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False), required=False)
@click.option("--rows", type=click.IntRange(1, 1000), help="Grid: rows,")
@click.option("--columns", type=click.IntRange(1, 1000), help="columns,")
@click.option(
    "--floor", nargs=2, type=click.FloatRange(min=0.0, min_open=True), metavar="NORTH EAST", help="or metres to fill."
)
@click.option(
    "--size", type=click.FloatRange(min=0.0, min_open=True), default=0.06, show_default=True, help="Black square [m]."
)
@click.option("--gap", type=click.FloatRange(min=0.0), default=0.02, show_default=True, help="White between them [m].")
@click.option("--dictionary", default="DICT_4X4_1000", show_default=True, help="OpenCV's name, AprilTags too.")
@click.option("--first-id", type=click.IntRange(min=0), default=0, show_default=True, help="Of the grid.")
@click.option("--seed", type=click.IntRange(min=0), default=7, show_default=True, help="Order of ids of a floor.")
@click.option(
    "--at", nargs=3, type=float, default=(0.0, 0.0, 0.0), metavar="N E D", help="Middle of the board in the map."
)
@click.option("--heading", type=float, default=0.0, show_default=True, help="Where the board's top points [deg].")
@click.option("--paper", default="A4", show_default=True, help="A0 to A4, or WIDTHxHEIGHT in mm.")
@click.option("--landscape", is_flag=True, help="Paper on its side.")
@click.option("--margin", type=click.FloatRange(min=0.0), default=8.0, show_default=True, help="The printer's, mm.")
@click.option("--out", type=click.Path(file_okay=False), required=True, help="Folder for board.pdf, sheets, map.toml.")
def board(file: str | None, **options: Any) -> None:
    """Make printable sheets in true size (PDF and SVG) and the map file, of a grid, a whole floor or the map FILE."""
    from autopilot.core.marker_files import load_marker_map, marker_file_text
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
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "board.pdf").write_bytes(pdf_bytes(pages))
    for number, page in enumerate(pages, start=1):
        (folder / f"sheet-{number:03d}.svg").write_text(svg_text(page), encoding="utf-8")
    notes = [
        f"{title}: {len(layout.ids)} markers on {len(pages)} sheets of {options['paper']}",
        "as printed; survey it once it is laid, or say with sigma_m and sigma_rad how well",
    ]
    (folder / "map.toml").write_text(marker_file_text(on_sheets(plane, paper), notes), encoding="utf-8")
    click.echo(f"{folder}: {len(layout.ids)} markers on {len(pages)} sheets (board.pdf, sheet-NNN.svg), map.toml")
    click.echo("print at 100 % and measure the scale bar")


def _grid(*, heading_rad: float, **options: Any) -> "MarkerMap":
    """The board or floor that the options ask for."""
    import numpy as np

    from autopilot.core.dictionaries import dictionary_size, resolve_dictionary
    from autopilot.core.errors import ConfigError
    from autopilot.core.frames import r_ned_from_frd
    from autopilot.core.marker_files import Board as BoardTable
    from autopilot.core.marker_files import PlacedMarker, board_offsets, make_map, placed_markers
    from autopilot.core.markers import grid_floor

    options["dictionary"] = resolve_dictionary(options["dictionary"], Path(), "--dictionary")
    r = r_ned_from_frd(np.array([0.0, 0.0, heading_rad]))
    middle = np.array(options["at"])
    if options["floor"] is not None:
        half = 0.5 * np.array(options["floor"])
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * half
        pitch_m = options["size"] + options["gap"]
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
        rows, columns = options["rows"] or 1, options["columns"] or 1
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


@markers.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False))
@click.option("--vehicle", default="lbv150", show_default=True, help="Whose camera looks at it: name or file.")
@click.option("--json", "as_json", is_flag=True, help="Machine-readable output.")
def check(file: str, vehicle: str, as_json: bool) -> None:
    """What the map FILE holds, and how much of it the camera sees. Exit 1 if it is wrong, 3 with warnings."""
    from autopilot.core.camera import CameraModel
    from autopilot.core.marker_files import load_marker_map
    from autopilot.core.vehicle import load_vehicle
    from autopilot.markermaps.check import describe_markers, map_warnings, view_shares

    layout = load_marker_map(Path(file))
    boat = load_vehicle(vehicle)
    rows = describe_markers(layout)
    shares = view_shares(layout, CameraModel.of_vehicle(boat)) if layout.level else []
    warnings = map_warnings(layout)
    if as_json:
        emit_json({**dict(rows), "view_shares": shares, "warnings": warnings})
    else:
        print_table(f"Marker map {file}", ("what", "value"), rows)
        if shares:
            print_table(
                f"Places over the floor from which {boat.name} sees whole markers",
                ("camera height m", "one or more", "two or more"),
                [(f"{h:g}", f"{100.0 * one:.0f} %", f"{100.0 * two:.0f} %") for h, one, two in shares],
            )
    for text in warnings:
        click.echo(f"warning: {text}", err=True)
    if warnings:
        raise click.exceptions.Exit(EXIT_LOSS)


@markers.command()
@click.argument("sources", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False))
@click.option(
    "--map", "rough", type=click.Path(exists=True, dir_okay=False), help="Rough map: ids, sizes, about where."
)
@click.option(
    "--rough-sigma",
    type=click.FloatRange(min=0.0, min_open=True),
    help="How good its places are [m]; default: not at all.",
)
@click.option(
    "--rough-turn",
    type=click.FloatRange(min=0.0, min_open=True),
    default=3.0,
    show_default=True,
    help="And its angles [deg].",
)
@click.option("--fix", multiple=True, metavar="ID", help="Marker whose pose in the rough map is right; repeatable.")
@click.option("--dictionary", help="Without a map: what to look for,")
@click.option("--size", type=click.FloatRange(min=0.0, min_open=True), help="the black squares' side [m],")
@click.option("--depth", type=float, default=0.0, show_default=True, help="and the floor's depth [m].")
@click.option(
    "--anywhere", is_flag=True, help="Markers on walls and boxes, in any pose, not face up on one level floor."
)
@click.option(
    "--length", nargs=3, metavar="ID ID M", help="Two markers and how far apart their middles are: fixes the scale."
)
@click.option("--vehicle", help="Vehicle file with the camera (images; default for logs: the log's),")
@click.option(
    "--camera", type=click.Path(exists=True, dir_okay=False), help="or a camera file (OpenCV's or ROS's YAML)."
)
@click.option("--fisheye", is_flag=True, help="That camera file is of a fisheye, and does not say so.")
@click.option(
    "--views", type=click.IntRange(min=2), default=300, show_default=True, help="Images of a log or film that are used."
)
@click.option("--out", type=click.Path(dir_okay=False), help="Write the map here.")
@click.option("--json", "as_json", is_flag=True, help="Machine-readable output.")
def survey(sources: tuple[str, ...], as_json: bool, **options: Any) -> None:
    """Where the markers really are, by bundle adjustment of a LOG (.mcap), of images or of films. Exit 3 with warnings.

    Without a map the marker seen most (or the one given with --fix) is the origin: face up, its top to the north."""
    import numpy as np

    from autopilot.core.marker_files import marker_file_text
    from autopilot.markermaps.survey import survey_map

    rough = _rough_map(**options)
    camera, views = _views(sources, rough, **options)
    fixed = np.array([_index_of(rough, text, "--fix") for text in options["fix"]], dtype=np.int64)
    sigma = (math.inf, math.inf)
    if options["rough_sigma"] is not None:
        sigma = (options["rough_sigma"], math.radians(options["rough_turn"]))
    if options["rough"] is None and len(fixed) > 1:
        raise click.UsageError("without a map one marker can be fixed; use --length for the scale")
    level = False if options["anywhere"] else None
    length = _length(rough, options["length"])
    result = survey_map(camera, views, rough, fixed=fixed, rough_sigma=sigma, level=level, length=length)
    if options["out"] is not None:
        notes = [
            f"surveyed from {len(sources)} file(s), {result.views} views, corners good to {result.sigma_px:.2f} px"
        ]
        remarks = [
            "pose given" if row.fixed else f"{row.sights} views, sigma {1e3 * row.sigma_m:.2f} mm"
            for row in result.rows
        ]
        Path(options["out"]).parent.mkdir(parents=True, exist_ok=True)
        Path(options["out"]).write_text(marker_file_text(result.markers, notes, remarks), encoding="utf-8")
    if as_json:
        emit_json(_survey_json(result))
    else:
        _print_survey(result, options["out"])
    warnings = _survey_warnings(result, known=options["rough"] is not None)
    for text in warnings:
        click.echo(f"warning: {text}", err=True)
    if warnings:
        raise click.exceptions.Exit(EXIT_LOSS)


@markers.command()
@click.argument("log", type=click.Path(exists=True, dir_okay=False))
@click.option("--map", "told", type=click.Path(exists=True, dir_okay=False), help="Another map than the log's.")
@click.option("--out", type=click.Path(dir_okay=False), required=True, help="The refined map (TOML).")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def refine(log: str, told: str | None, out: str, as_json: bool) -> None:
    """Where the sheets of the map really lie, as the estimator finds them in the flight LOG."""
    import numpy as np

    from autopilot.core.marker_files import load_marker_map, marker_file_text
    from autopilot.log.reader import open_log
    from autopilot.replay.estimation import refined_by
    from autopilot.replay.setup import read_markers, read_setup

    flight = open_log(Path(log))
    rough = read_markers(flight.attachments) if told is None else load_marker_map(Path(told))
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
    Path(out).write_text(marker_file_text(result, notes), encoding="utf-8")
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


def _rough_map(**options: Any) -> "MarkerMap":
    """The rough map of the options; without a file one of all ids of a dictionary, places unknown."""
    import numpy as np

    from autopilot.core.dictionaries import dictionary_size, resolve_dictionary
    from autopilot.core.marker_files import load_marker_map
    from autopilot.core.markers import CORNER_SIGNS, MarkerMap

    if options["rough"] is not None:
        return load_marker_map(Path(options["rough"]))
    dictionary, size = options["dictionary"], options["size"]
    if dictionary is None or size is None:
        raise click.UsageError("give a rough map with --map, or --dictionary and --size")
    dictionary = resolve_dictionary(dictionary, Path(), "--dictionary")
    if options["rough_sigma"] is not None:
        raise click.UsageError("--rough-sigma is about a rough map; give one with --map")
    count = dictionary_size(dictionary) or 0
    corners = np.zeros((count, 4, 3))
    corners[..., :2] = 0.5 * size * CORNER_SIGNS
    corners[..., 2] = options["depth"]
    return MarkerMap(dictionary=dictionary, size_m=size, ids=np.arange(count), corners_ned_m=corners)


def _length(rough: "MarkerMap", given: tuple[str, str, str] | None) -> tuple[int, int, float] | None:
    """Two ids and a distance. UsageError if they are none."""
    if given is None:
        return None
    first, second, text = given
    try:
        length_m = float(text)
    except ValueError:
        length_m = math.nan
    if not 0.0 < length_m < math.inf or first == second:
        raise click.UsageError(f"--length {' '.join(given)}: give two markers and metres between their middles")
    a, b = (int(rough.ids[_index_of(rough, text, "--length")]) for text in (first, second))
    return a, b, length_m


def _views(sources: tuple[str, ...], wanted: "MarkerMap", **options: Any) -> "tuple[CameraModel, list[Any]]":
    """Camera and views of one log, or of images and films."""
    from autopilot.core.camera import CameraModel
    from autopilot.core.vehicle import load_vehicle
    from autopilot.markermaps.sightings import log_camera, views_of_images, views_of_log

    camera, vehicle, most = None, options["vehicle"], options["views"]
    if vehicle is not None and options["camera"] is not None:
        raise click.UsageError("give --vehicle or --camera")
    if options["camera"] is not None:
        from autopilot.markermaps.camera_files import load_camera

        camera = load_camera(Path(options["camera"]), options["fisheye"])
    if vehicle is not None:
        boat = load_vehicle(vehicle)
        camera = CameraModel.of_vehicle(boat)
    if any(source.endswith(".mcap") for source in sources):
        if len(sources) > 1:
            raise click.UsageError("give one log, or images")
        views, log = views_of_log(Path(sources[0]), most)
        return camera or log_camera(log), views
    if camera is None:
        raise click.UsageError("images need their camera: --camera FILE, or --vehicle NAME or FILE")
    return camera, views_of_images([Path(source) for source in sources], camera, wanted, most)


def _index_of(rough: "MarkerMap", text: str, option: str) -> int:
    """Index of a marker by ``ID`` or ``DICTIONARY:ID``. ConfigError if there is none, or more than one."""
    from autopilot.core.errors import ConfigError
    from autopilot.core.marker_files import placed_markers

    dictionary, _, number = text.rpartition(":")
    found = [
        n
        for n, m in enumerate(placed_markers(rough))
        if str(m.id) == number.strip() and dictionary in ("", m.dictionary)
    ]
    if len(found) != 1:
        what = "is not in the map" if not found else f"is {len(found)} markers of the map"
        raise ConfigError(f"{option} {text!r} {what}; give the ID or DICTIONARY:ID of one that is there once")
    return found[0]


def _print_survey(result: "Survey", out: str | None) -> None:
    """Tables of a survey."""
    import numpy as np

    def mm(value: float) -> str:
        return "-" if math.isnan(value) else f"{1e3 * value:.2f}"

    print_table(
        "Markers",
        ("id", "dictionary", "views", "residual px", "sigma mm", "sigma yaw deg", "moved mm"),
        [
            (
                r.id,
                r.dictionary.removeprefix("DICT_") + (" (fixed)" if r.fixed else ""),
                r.sights,
                f"{r.rms_px:.2f}",
                mm(r.sigma_m),
                f"{math.degrees(r.sigma_yaw_rad):.3f}",
                mm(r.moved_m),
            )
            for r in result.rows
        ],
    )
    sigmas = np.array([r.sigma_m for r in result.rows])
    print_table(
        "Survey",
        ("what", "value"),
        [
            ("markers in the map", len(result.rows)),
            ("sights of markers, not believed", f"{result.sights}, {result.disbelieved}"),
            ("views used, left out", f"{result.views}, {result.left_out_views}"),
            ("corner noise", f"{result.sigma_px:.3f} px"),
            ("corners drawn inwards by", f"{result.shrink_px:.3f} px"),
            ("sigma of places, median and largest", f"{mm(float(np.median(sigmas)))} mm, {mm(float(sigmas.max()))} mm"),
            ("steps", result.steps),
        ],
    )
    if out is not None:
        click.echo(f"{out}: {len(result.rows)} markers")


def _some(names: list[str]) -> str:
    return ", ".join(names[:5]) + (" ..." if len(names) > 5 else "")


def _survey_warnings(result: "Survey", *, known: bool) -> list[str]:
    """What an operator should know of a survey. ``known``: there was a rough map, of markers that should be there."""
    found = []
    if not result.converged:
        found.append("the adjustment has not converged; take more views from more places")
    if known and result.unseen and len(result.unseen) < 10 * len(result.rows):
        some = _some(result.unseen)
        found.append(f"{len(result.unseen)} markers of the rough map were not seen twice and are left out: {some}")
    if result.left_out_views > 0.1 * (result.views + result.left_out_views):
        found.append(f"{result.left_out_views} views show too little of the rest; fly lanes that overlap")
    if result.disbelieved > 0.05 * result.sights:
        found.append(f"{result.disbelieved} of {result.sights} sights do not fit; has something moved meanwhile?")
    if result.repeated:
        found.append(f"several markers have the same id: {_some(result.repeated)}; take all but one of each away")
    if result.misread:
        found.append(
            f"two or more cells of these are wrong: {_some(result.misread)}; bad print, something on it, or none"
        )
    if not result.scaled:
        found.append("the scale is that of the printed size alone: measure between two markers and give --length")
    return found


def _survey_json(result: "Survey") -> dict[str, Any]:
    """All figures of a survey."""
    from dataclasses import asdict

    return {
        "markers": [asdict(row) for row in result.rows],
        "views": result.views,
        "left_out_views": result.left_out_views,
        "unseen": result.unseen,
        "sights": result.sights,
        "disbelieved": result.disbelieved,
        "sigma_px": result.sigma_px,
        "shrink_px": result.shrink_px,
        "converged": result.converged,
        "repeated": result.repeated,
        "misread": result.misread,
        "scaled": result.scaled,
    }
