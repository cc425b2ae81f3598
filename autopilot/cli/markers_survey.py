"""``autopilot markers survey``: actual marker positions from pictures or a log."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from autopilot.cli.click_types import Finite, FiniteRange
from autopilot.cli.completion import VEHICLE_NAME
from autopilot.cli.console_output import emit_json, print_table, warn
from autopilot.cli.markers_board import MARKER_SIZE
from autopilot.cli.shared_options import JSON, not_over

if TYPE_CHECKING:
    from autopilot.core.camera import CameraModel
    from autopilot.core.markers import MarkerMap
    from autopilot.markermaps.scale import Length
    from autopilot.markermaps.survey import Survey


@click.command()
@click.argument("sources", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False))
@click.option(
    "--map", "rough", type=click.Path(exists=True, dir_okay=False), help="Rough map: ids, sizes, about where."
)
@click.option(
    "--rough-sigma",
    type=FiniteRange(min=0.0, min_open=True),
    help="How good its places are [m]; default: not at all.",
)
@click.option(
    "--rough-turn",
    type=FiniteRange(min=0.0, min_open=True),
    default=3.0,
    show_default=True,
    help="And its angles [deg].",
)
@click.option("--fix", multiple=True, metavar="ID", help="Marker whose pose in the rough map is right; repeatable.")
@click.option("--dictionary", help="Without a map: what to look for,")
@click.option("--size", type=MARKER_SIZE, help="the black squares' side [m],")
@click.option("--depth", type=Finite(), default=0.0, show_default=True, help="and the floor's depth [m].")
@click.option(
    "--anywhere", is_flag=True, help="Markers on walls and boxes, in any pose, not face up on one level floor."
)
@click.option(
    "--length",
    nargs=3,
    multiple=True,
    metavar="ID ID M",
    help="Two markers and how far apart their middles are: fixes the scale; repeatable.",
)
@click.option(
    "--vehicle", type=VEHICLE_NAME, help="Vehicle file with the camera (images; default for logs: the log's),"
)
@click.option(
    "--camera", type=click.Path(exists=True, dir_okay=False), help="or a camera file (OpenCV's or ROS's YAML)."
)
@click.option("--fisheye", is_flag=True, help="That camera file is of a fisheye, and does not say so.")
@click.option(
    "--views", type=click.IntRange(min=2), default=300, show_default=True, help="Images of a log or film that are used."
)
@click.option("--out", type=click.Path(dir_okay=False), help="Write the map here.")
@JSON
def survey(sources: tuple[str, ...], as_json: bool, **options: Any) -> None:
    """Where the markers really are, by bundle adjustment of a LOG (.mcap), of images or of films. Exit 3 with warnings.

    Without a map the marker seen most (or the one given with --fix) is the origin: face up, its top to the north."""
    import numpy as np

    from autopilot.core.disk import write_result
    from autopilot.core.marker_files import marker_file_text
    from autopilot.markermaps.survey import survey_map

    if options["out"] is not None:
        given = [source for source in (*sources, options["rough"], options["camera"]) if source is not None]
        not_over(Path(options["out"]), *map(Path, given))
    rough = _rough_map(**options)
    camera, views = _views(sources, rough, **options)
    fixed = np.array([_index_of(rough, text, "--fix") for text in options["fix"]], dtype=np.int64)
    sigma = (math.inf, math.inf)
    if options["rough_sigma"] is not None:
        sigma = (options["rough_sigma"], math.radians(options["rough_turn"]))
    if options["rough"] is None and len(fixed) > 1:
        raise click.UsageError("without a map one marker can be fixed; use --length for the scale")
    level = False if options["anywhere"] else None
    lengths = [_length(rough, given) for given in options["length"]]
    result = survey_map(camera, views, rough, fixed=fixed, rough_sigma=sigma, level=level, lengths=lengths)
    if options["out"] is not None:
        notes = [
            f"surveyed from {len(sources)} file(s), {result.views} views, corners good to {result.sigma_px:.2f} px"
        ]
        remarks = [
            "pose given" if row.fixed else f"{row.sights} views, sigma {1e3 * row.sigma_m:.2f} mm"
            for row in result.rows
        ]
        write_result(Path(options["out"]), marker_file_text(result.markers, notes, remarks), folder=True)
    if as_json:
        emit_json(_survey_json(result))
    else:
        _print_survey(result, options["out"])
    warn(_survey_warnings(result, known=options["rough"] is not None))


def _rough_map(**options: Any) -> "MarkerMap":
    """The rough map of the options; without a file one of all ids of a dictionary, positions unknown."""
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


def _length(rough: "MarkerMap", given: tuple[str, str, str]) -> "Length":
    """Two ids and a distance. UsageError if they are none."""
    from autopilot.markermaps.scale import Length

    first, second, text = given
    try:
        length_m = float(text)
    except ValueError:
        length_m = math.nan
    a, b = (int(rough.ids[_index_of(rough, text, "--length")]) for text in (first, second))
    if not 0.0 < length_m < math.inf or a == b:
        raise click.UsageError(f"--length {' '.join(given)}: give two markers and metres between their middles")
    return Length(first=a, second=b, metres=length_m)


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
    """Index of a marker by ``ID`` or ``DICTIONARY:ID``. ConfigError if it is missing or ambiguous."""
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
    if result.dropped:
        print_table(
            "Seen, but not in the map",
            ("marker", "views", "reason"),
            [(marker.name, marker.views, marker.reason) for marker in result.dropped],
        )
    sigmas = np.array([r.sigma_m for r in result.rows])
    print_table(
        "Survey",
        ("what", "value"),
        [
            ("markers in the map", len(result.rows)),
            ("marker sightings, rejected", f"{result.sights}, {result.disbelieved}"),
            ("views used, left out", f"{result.views}, {result.left_out_views}"),
            ("corner noise", f"{result.sigma_px:.3f} px"),
            ("corners drawn inwards by", f"{result.shrink_px:.3f} px"),
            ("sigma of places, median and largest", f"{mm(float(np.median(sigmas)))} mm, {mm(float(sigmas.max()))} mm"),
            ("scale by --length", f"{result.scale:.4f}"),
            ("steps", result.steps),
        ],
    )
    if out is not None:
        click.echo(f"{out}: {len(result.rows)} markers")


def _some(names: list[str]) -> str:
    return ", ".join(names[:5]) + (" ..." if len(names) > 5 else "")


def _survey_warnings(result: "Survey", *, known: bool) -> list[str]:
    """Warnings about a survey. ``known``: there was a rough map, of markers that should be there."""
    from autopilot.markermaps.markermaps_tuning import ADJUSTMENT, SURVEY

    found = []
    if not result.converged:
        found.append("the adjustment has not converged; take more views from more places")
    if known and result.unseen and len(result.unseen) < 10 * len(result.rows):
        some = _some(result.unseen)
        found.append(f"{len(result.unseen)} markers of the rough map were not seen: {some}")
    # Without a rough map one view may be a mistake: no marker is known to be there.
    dropped = [marker.name for marker in result.dropped if known or marker.views > 1]
    if dropped:
        names = _some(dropped)
        found.append(f"{len(dropped)} markers were seen and are not in the map, for the reasons listed: {names}")
    if result.left_out_views > 0.1 * (result.views + result.left_out_views):
        found.append(f"{result.left_out_views} views show too little of the rest; fly lanes that overlap")
    if result.disbelieved > 0.05 * result.sights:
        found.append(
            f"{result.disbelieved} of {result.sights} sightings were rejected; check whether something has moved"
        )
    if result.repeated:
        found.append(f"several markers have the same id: {_some(result.repeated)}; take all but one of each away")
    if result.misread:
        found.append(
            f"two or more cells of these are wrong: {_some(result.misread)}; bad print, something on it, or none"
        )
    if abs(result.shrink_px - ADJUSTMENT.shrink_px) > SURVEY.shrink_sigmas * ADJUSTMENT.shrink_sigma_px:
        found.append(
            f"corners are drawn inwards by {result.shrink_px:.2f} px, which blur does not do: marker size, given places"
            " and camera do not fit together; measure a black square and two places again"
        )
    if not result.scaled:
        found.append("the scale is that of the printed size alone: measure between two markers and give --length")
    return found


def _survey_json(result: "Survey") -> dict[str, Any]:
    from dataclasses import asdict

    same = (
        *("views", "left_out_views", "unseen", "sights", "disbelieved", "sigma_px", "shrink_px", "converged"),
        *("repeated", "misread", "scaled", "scale"),
    )
    return {
        "markers": [asdict(row) for row in result.rows],
        "dropped": [asdict(marker) for marker in result.dropped],
        **{name: getattr(result, name) for name in same},
    }
