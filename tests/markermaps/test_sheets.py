"""Printed sheets: rasterised from their own SVG and PDF, every marker is read where the map says, in true size."""

import math
import re
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from autopilot.cli.main import cli, run
from autopilot.cli.markers_command import markers as command
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.marker_files import load_marker_map, placed_markers
from autopilot.core.markers import ID_SPAN, MarkerMap, grid_floor
from autopilot.markermaps.page import PT_PER_MM, pdf_bytes, svg_text
from autopilot.markermaps.sheets import make_sheets, paper_of, plane_of

PX_PER_MM = 6.0
TAGS = "DICT_APRILTAG_36h11"


def grid(side_m: float, pitch_m: float = 0.08) -> MarkerMap:
    """A square floor."""
    corners = side_m * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return grid_floor(polygon_m=corners, depth_m=1.5, pitch_m=pitch_m, size_m=0.06, seed=7)


def raster(shapes: list[list[FloatArray]], width_mm: float, height_mm: float) -> np.ndarray:
    """A white page with these black shapes, each a list of polygons in millimetres."""
    image = np.full((round(height_mm * PX_PER_MM), round(width_mm * PX_PER_MM)), 255, dtype=np.uint8)
    for shape in shapes:
        for polygon in shape:
            # fillPoly takes pixel centres as whole numbers; 4 bits of fraction.
            points = np.rint((polygon * PX_PER_MM - 0.5) * 16.0).astype(np.int32)
            cv2.fillPoly(image, [points], 0, shift=4)
    return image


def svg_shapes(text: str) -> tuple[list[list[FloatArray]], float, float]:
    """Black paths of an SVG in millimetres, and the page's size."""
    size = re.search(r'width="([\d.]+)mm" height="([\d.]+)mm" viewBox="0 0 ([\d.]+) ([\d.]+)"', text)
    assert size is not None
    width, height, box_width, box_height = (float(v) for v in size.groups())
    assert (width, height) == (box_width, box_height)  # one unit is one millimetre
    shapes = []
    for data in re.findall(r'<path d="([^"]+)" fill="#000"/>', text):
        polygons = [p for p in data.split("Z") if p]
        shapes.append([np.array([[float(v) for v in pair.split()] for pair in p[1:].split("L")]) for p in polygons])
    return shapes, width, height


def pdf_pages(data: bytes) -> list[tuple[list[list[FloatArray]], float, float]]:
    """The same of every page of a PDF, following its cross-reference table."""
    table = int(re.findall(rb"startxref\n(\d+)\n", data)[-1])
    assert data[table : table + 4] == b"xref"
    places = [int(m) for m in re.findall(rb"(\d{10}) 00000 n ", data[table:])]
    for number, place in enumerate(places, start=1):
        assert data[place:].startswith(b"%d 0 obj" % number)
    result = []
    for place in places:
        box = re.match(
            rb"\d+ 0 obj\n<< /Type /Page .*?/MediaBox \[0 0 ([\d.]+) ([\d.]+)\].*?/Contents (\d+) 0 R", data[place:]
        )
        if box is None:
            continue
        height_mm = float(box[2]) / PT_PER_MM
        body = data[places[int(box[3]) - 1] :]
        length = re.search(rb"/Length (\d+)", body)
        assert length is not None
        start = body.index(b"stream\n") + 7
        text = zlib.decompress(body[start : start + int(length[1])]).decode("latin-1")
        assert text.startswith(f"{PT_PER_MM:.8f} 0 0 {PT_PER_MM:.8f} 0 0 cm")
        shapes = []
        for block in text.split("0.45 g")[0].split("\nf")[:-1]:
            polygons = []
            for line in block.splitlines():
                if line.endswith(" h"):
                    points = np.array([[float(x), float(y)] for x, y in re.findall(r"(\S+) (\S+) [ml]", line)])
                    polygons.append(points * [1.0, -1.0] + [0.0, height_mm])
            shapes.append(polygons)
        result.append((shapes, float(box[1]) / PT_PER_MM, height_mm))
    return result


def read(image: np.ndarray, dictionary: str) -> dict[int, FloatArray]:
    """Ids and corners (4, 2) in millimetres that OpenCV finds on a page."""
    patterns = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    quads, ids, _ = cv2.aruco.ArucoDetector(patterns, parameters).detectMarkers(image)
    if ids is None:
        return {}
    corners = (np.array(quads, dtype=float).reshape(-1, 4, 2) + 0.5) / PX_PER_MM
    return dict(zip(np.asarray(ids).ravel().tolist(), corners, strict=True))


def board(folder: Path, *arguments: str, code: int = 0) -> MarkerMap:
    """Run ``autopilot markers board``; the map that it wrote."""
    done = CliRunner().invoke(command, ["board", *arguments, "--out", str(folder)], catch_exceptions=False)
    assert done.exit_code == code, done.output
    return load_marker_map(folder / "map.toml")


@pytest.mark.parametrize("form", ["svg", "pdf"])
@pytest.mark.parametrize(
    ("arguments", "dictionary"),
    [
        (("--rows", "7", "--columns", "5", "--at", "1", "-2", "1.5", "--heading", "90"), "DICT_4X4_1000"),
        (("--rows", "3", "--columns", "2", "--size", "0.1", "--dictionary", TAGS, "--paper", "A3"), TAGS),
    ],
)
def test_every_marker_is_read_from_the_sheets_in_true_size(
    tmp_path: Path, arguments: tuple[str, ...], dictionary: str, form: str
) -> None:
    """Relative places on one sheet are those of the map within 0.1 mm, whatever the heading."""
    layout = board(tmp_path, *arguments)
    if form == "pdf":
        pages = pdf_pages((tmp_path / "board.pdf").read_bytes())
    else:
        pages = [svg_shapes(path.read_text(encoding="utf-8")) for path in sorted(tmp_path.glob("sheet-*.svg"))]
    assert len(pages) == (1 if "A3" in arguments else 9)
    heading = math.radians(90.0 if "--heading" in arguments else 0.0)
    places = {int(i): corners for i, corners in zip(layout.ids, layout.corners_ned_m, strict=True)}
    found: list[int] = []
    for shapes, width, height in pages:
        assert (round(width), round(height)) == ((297, 420) if "A3" in arguments else (210, 297))
        on_page = read(raster(shapes, width, height), dictionary)
        assert len(on_page) == len(shapes)
        found += on_page
        seen = np.array(list(on_page.values())).reshape(-1, 2)
        flat = np.array([places[i] for i in on_page]).reshape(-1, 3)
        c, s = math.cos(heading), math.sin(heading)
        wanted = 1e3 * np.column_stack((c * flat[:, 1] - s * flat[:, 0], -c * flat[:, 0] - s * flat[:, 1]))
        error_mm = (seen - seen.mean(axis=0)) - (wanted - wanted.mean(axis=0))
        assert np.abs(error_mm).max() < 0.1
    assert sorted(found) == sorted(layout.ids.tolist())


def test_a_whole_floor_has_every_marker_once() -> None:
    floor = grid(2.0)
    pages = make_sheets(plane_of(floor, 0.0, 0.08), paper_of("A3", False, 5.0), "floor")
    assert sum(len(page.shapes) for page in pages) == len(floor.ids) == 625
    assert len(pages) == 9 * 7  # of 25 x 25 markers 3 x 4 fit on a sheet
    labels = [t.text for page in pages for t in page.texts if t.text.split()[0].isdigit() and "N" in t.text]
    assert sum(" E " in text and "mm;" not in text for text in labels) == 625


def test_the_map_names_the_sheets_that_were_printed(tmp_path: Path) -> None:
    """A plan fits one grid all over: without names it would pass for one sheet, and for exact."""
    layout = board(tmp_path, "--floor", "1.2", "0.9", "--paper", "A3", "--heading", "20")
    assert layout.errors is not None
    svg = sorted(tmp_path.glob("sheet-*.svg"))
    assert sorted(layout.errors.names) == sorted(f"{number}" for number in range(1, len(svg) + 1))
    assert (layout.errors.sigma[:, :2] == 0.005).all()
    for number, path in enumerate(svg, start=1):
        text = path.read_text(encoding="utf-8")
        assert f"sheet {number} of {len(svg)}" in text
        for n in np.flatnonzero(layout.errors.sheet == layout.errors.names.index(f"{number}")):
            assert f">{layout.ids[n]}  N " in text
    alone = board(tmp_path / "one", "--rows", "3", "--columns", "2")
    assert alone.errors is None


def test_sheets_meet_in_the_middle_of_the_gaps() -> None:
    floor = grid(0.8)
    for page in make_sheets(plane_of(floor, 0.0, 0.08), paper_of("A4", False, 5.0), "floor"):
        marks = np.array(page.lines[:8]).reshape(-1, 2)
        low, high = marks.min(axis=0) + 4.0, marks.max(axis=0) - 4.0
        ink = np.concatenate([polygon for shape in page.shapes for polygon in shape])
        assert ink.min(axis=0) == pytest.approx(low + 10.0, abs=1e-6)  # half a gap
        assert (ink.max(axis=0) <= high - 10.0 + 1e-6).all()


def test_a_map_of_mixed_kinds_is_printed_too(tmp_path: Path) -> None:
    text = (
        '[defaults]\nsize_m = 0.05\n[[board]]\ndictionary = "DICT_5X5_50"\nrows = 3\ncolumns = 3\ngap_m = 0.02\n'
        "first_id = 0\ncenter_m = [0.0, 0.0, 1.0]\nyaw_rad = 0.3\n"
        '[[marker]]\nid = 4\ndictionary = "DICT_APRILTAG_25h9"\nsize_m = 0.08\ncenter_m = [0.25, 0.1, 1.0]\n'
    )
    (tmp_path / "mixed.toml").write_text(text, encoding="utf-8")
    layout = board(tmp_path / "out", str(tmp_path / "mixed.toml"), code=3)  # two dictionaries of 7 x 7 cells
    found = set()
    for path in sorted((tmp_path / "out").glob("sheet-*.svg")):
        image = raster(*svg_shapes(path.read_text(encoding="utf-8")))
        for kind, dictionary in enumerate(layout.dictionaries):
            found |= {ID_SPAN * kind + i for i in read(image, dictionary)}
    assert found == set(layout.ids.tolist())
    assert next(m.id for m in placed_markers(layout)) == 4


def test_same_page_same_bytes() -> None:
    floor = grid(0.3, 0.1)
    first, again = (make_sheets(plane_of(floor, 0.1, None), paper_of("A4", True, 8.0), "(x) \\ ü €") for _ in range(2))
    assert pdf_bytes(first) == pdf_bytes(again)
    assert [svg_text(page) for page in first] == [svg_text(page) for page in again]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--rows", "2", "--columns", "2", "--size", "0.3"), "a marker takes 300 x 300 mm"),
        (("--rows", "40", "--columns", "40", "--dictionary", "DICT_4X4_50"), "needs ids up to 1599"),
        (("--rows", "1", "--columns", "1", "--dictionary", "DICT_9X9"), "'DICT_9X9' is not known"),
        (("--rows", "1", "--columns", "1", "--paper", "A9"), "paper 'A9' is not known"),
        (("--rows", "1", "--columns", "1", "--paper", "20x20"), "leaves no room"),
        (("--rows", "1", "--columns", "1", "--gap", "0.02", "--first-id", "1000"), "needs ids up to 1000"),
    ],
)
def test_what_cannot_be_printed_is_refused(tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        CliRunner().invoke(command, ["board", *arguments, "--out", str(tmp_path)], catch_exceptions=False)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "words", "code"),
    [
        (("--rows", "1", "--columns", "2", "--size", "60"), "'--size': 60.0 is not in the range", 2),
        (("--rows", "1", "--columns", "2", "--size", "0.0005"), "'--size': 0.0005 is not in the range", 2),
        (("--rows", "1", "--columns", "2", "--gap", "20"), "'--gap': 20.0 is not in the range", 2),
        (("--floor", "1000", "1000"), "12500 x 12500 markers are more than the 20000 of a map", 1),
        (("--rows", "1000", "--columns", "1000"), "1000 x 1000 markers are more than the 20000 of a map", 1),
        (("--rows", "1", "--columns", "2", "--gap", "0"), "less than one cell of white", 3),
    ],
)
def test_numbers_that_cannot_be_meant(
    tmp_path: Path, arguments: tuple[str, ...], words: str, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Millimetres for metres made sheets with exit 0, and a floor of 1 km took minutes."""
    out = tmp_path / "out"
    command = ["markers", "board", *arguments, "--out", str(out)]
    assert run(lambda: cli(command, standalone_mode=False)) == code
    assert words in capsys.readouterr().err
    assert out.exists() is (code == 3)
