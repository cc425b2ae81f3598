"""Intrinsics from pictures of a board, and the sheet that is printed."""

import math
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from board_pictures import Printed, camera

from autopilot.calibrate.boards import BoardSpec, CalibrationBoard
from autopilot.calibrate.intrinsics import calibrate, camera_values, coverage, remarks
from autopilot.calibrate.intrinsics_plot import write_plot
from autopilot.calibrate.views import Views, collect_views, image_files, live_images, read_images
from autopilot.core.errors import ConfigError, DriverError
from autopilot.core.vehicle import load_vehicle

TRUE = np.array([520.0, 522.0, 322.0, 238.0, -0.12, 0.06, 0.001, -0.0015, -0.01])
PHOTO = Path(__file__).parents[1] / "data" / "opencv_contrib" / "choriginal.jpg"


@pytest.fixture(scope="module")
def printed() -> Printed:
    return Printed(CalibrationBoard(BoardSpec()), camera(tuple(TRUE.tolist())))


@pytest.fixture(scope="module")
def pictures(printed: Printed) -> list[tuple[str, Any]]:
    return printed.pictures(16, np.random.default_rng(1))


@pytest.fixture(scope="module")
def views(printed: Printed, pictures: list[tuple[str, Any]]) -> Views:
    return collect_views(printed.board, pictures, "test")


def test_known_intrinsics_come_back_within_their_sigmas(views: Views) -> None:
    result = calibrate(views)
    assert len(result.views) == 16
    assert result.rms_px < 0.06
    assert np.abs((result.values - TRUE) / result.sigma).max() < 3.5
    assert result.sigma[0] < 0.5
    assert result.field_of_view_deg[0] == pytest.approx(2.0 * math.degrees(math.atan(320.0 / 520.0)), abs=0.1)
    keys = camera_values(result)
    assert keys["camera.focal_px"] == pytest.approx([520.0, 522.0], abs=1.0)
    assert calibrate(views, fix_k3=True).values[8] == 0.0


def test_a_view_that_does_not_fit_is_left_out_and_named(views: Views) -> None:
    bent = views.views[3]
    wrong = type(bent)(
        name="bent.png", points_m=bent.points_m, pixels=bent.pixels + 0.004 * (bent.pixels - 300.0) ** 2 / 30.0
    )
    spoiled = Views(
        width_px=640, height_px=480, views=(*views.views[:3], wrong, *views.views[4:]), left_out=(("dark.png", "x"),)
    )
    result = calibrate(spoiled)
    assert [name for name, _ in result.left_out] == ["dark.png", "bent.png"]
    assert "does not fit" in result.left_out[1][1]
    assert np.abs((result.values - TRUE) / result.sigma).max() < 3.5


def test_remarks_name_what_is_missing(views: Views, tmp_path: Path) -> None:
    result = calibrate(views)
    spread = coverage(result)
    assert 0.5 < spread.coverage <= 1.0
    expected = load_vehicle("lbv150").camera
    as_flown = type(expected)(
        **{**{f: getattr(expected, f) for f in expected.__struct_fields__}, "focal_px": (520.0 * 1.333, 522.0 * 1.333)}
    )
    assert any("images taken in air" in text for text in remarks(result, spread, as_flown, "water"))
    in_air = remarks(result, spread, as_flown, "air")
    assert any("calibrate in water" in text for text in in_air)
    assert not any("another lens" in text for text in in_air)
    assert any("another lens" in text for text in remarks(result, spread, expected, "water"))
    flat = Views(width_px=640, height_px=480, views=views.views, left_out=())
    level = coverage(calibrate(flat))
    object.__setattr__(level, "tilt_rad", np.zeros(16))
    assert any("tilt the board" in text for text in remarks(result, level, None, "water"))
    assert write_plot(result, spread, tmp_path / "plot.png").stat().st_size > 10_000


def test_a_picture_counts_once(printed: Printed, pictures: list[tuple[str, Any]]) -> None:
    """Before: the sigma of the focal length fell with every copy."""
    noise = np.random.default_rng(2).normal(0.0, 2.0, pictures[0][1].shape)
    again = np.clip(pictures[0][1] + noise, 0, 255).astype(np.uint8)
    copies = [("again.png", again), *((f"copy-{name}", grey) for name, grey in pictures[1:])]
    once, twice = (calibrate(collect_views(printed.board, more, "test")) for more in (pictures, [*pictures, *copies]))
    assert len(twice.views) == 16 and twice.sigma == pytest.approx(once.sigma)
    assert ("again.png", f"shows the board where {pictures[0][0]} does") in twice.left_out
    with pytest.raises(ConfigError, match="at least 8 are needed"):
        calibrate(collect_views(printed.board, pictures[:4] * 4, "test"))


def test_what_is_not_that_board_is_refused(pictures: list[tuple[str, Any]]) -> None:
    """Markers of a ChArUco board taken for those of a grid."""
    grid = CalibrationBoard(BoardSpec(kind="grid"))
    with pytest.raises(ConfigError, match=r"do not fit one camera: \d+\.\d px rms; check --board"):
        calibrate(collect_views(grid, pictures, "test"))


def test_air_becomes_water_near_the_axis(views: Views) -> None:
    """A ray that leaves the port at x in water comes from n x in air: both formulas give the same pixel."""
    result = calibrate(views)
    air = camera(tuple(result.values.tolist()))
    keys = camera_values(result, into_water=True)
    water = camera((*keys["camera.focal_px"], *keys["camera.center_px"], *keys["camera.distortion"]))
    x = np.array([[0.1, -0.05], [0.2, 0.15]])
    np.testing.assert_allclose(water.distort(x), air.distort(1.333 * x), atol=0.05)


def test_wrong_input_is_one_line(printed: Printed, pictures: list[tuple[str, Any]], tmp_path: Path) -> None:
    board = printed.board
    with pytest.raises(ConfigError, match="at least 8 are needed"):
        calibrate(collect_views(board, pictures[:5], "few"))
    blank = np.full((480, 640), 128, dtype=np.uint8)
    with pytest.raises(ConfigError, match="seen in none of 2 images"):
        collect_views(board, [("a.png", blank), ("b.png", None)], "dark")
    small = cv2.resize(pictures[1][1], (320, 240))
    with pytest.raises(ConfigError, match="has 320 x 240 pixels"):
        collect_views(board, [pictures[0], ("small.png", small)], "mixed")
    with pytest.raises(ConfigError, match="does not exist; give the folder"):
        image_files(tmp_path / "none")
    with pytest.raises(ConfigError, match="holds no images"):
        image_files(tmp_path)
    (tmp_path / "torn.png").write_bytes(b"\x89PNG\r\n\x1a\n torn")
    assert list(read_images(image_files(tmp_path))) == [("torn.png", None)]
    with pytest.raises(DriverError, match="cannot be opened"):
        list(live_images(board, "/dev/video97", 8, None))
    for wrong in ({"dictionary": "DICT_NONE"}, {"columns": 40, "rows": 40}):
        with pytest.raises(ConfigError):
            CalibrationBoard(BoardSpec(**wrong))  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="measure the print"):
        BoardSpec(pitch_m=0.02, marker_m=0.03)


def test_a_film_gives_different_still_views(printed: Printed, pictures: list[tuple[str, Any]], tmp_path: Path) -> None:
    film = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(film), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (640, 480))
    for _, grey in pictures[:4]:
        for _ in range(3):
            writer.write(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
    writer.release()
    taken = list(live_images(printed.board, str(film), 3, tmp_path / "kept"))
    assert len(taken) == 3
    assert sorted(path.name for path in (tmp_path / "kept").iterdir()) == [name for name, _ in taken]


@pytest.mark.parametrize("spec", [BoardSpec(), BoardSpec(legacy=True), BoardSpec(kind="grid", columns=4, rows=3)])
def test_the_sheet_is_true_to_scale_and_can_be_found(spec: BoardSpec) -> None:
    board = CalibrationBoard(spec)
    sheet = board.svg()
    width_mm, height_mm = (float(v) for v in re.search(r'width="([\d.]+)mm" height="([\d.]+)mm"', sheet).groups())  # type: ignore[union-attr]
    assert re.search(rf'viewBox="0 0 {width_mm:.3f} {height_mm:.3f}"', sheet), "one unit is one millimetre"
    px_per_m = 3000
    picture = np.full((round(height_mm * 3), round(width_mm * 3)), 255, dtype=np.uint8)
    for x, y, w, h in re.findall(r"M([\d.]+) ([\d.]+)h([\d.]+)v([\d.]+)h-[\d.]+z", sheet):
        left, top, right, bottom = (
            round(3 * v) for v in (float(x), float(y), float(x) + float(w), float(y) + float(h))
        )
        picture[top:bottom, left:right] = 0
    found = board.find(picture)
    assert found is not None
    points_m, pixels = found
    expected = (points_m[:, :2] + 0.008) * px_per_m - 0.5
    assert np.abs(pixels - expected).max() < 1.0


def test_a_real_photo_of_a_charuco_board() -> None:
    """OpenCV's tutorial photo: a 5 x 7 board with 10 squares' markers of 6x6 bits, drawn by the old rule."""
    grey = cv2.imread(str(PHOTO), cv2.IMREAD_GRAYSCALE)
    board = CalibrationBoard(
        BoardSpec(columns=5, rows=7, pitch_m=0.04, marker_m=0.02, dictionary="DICT_6X6_250", legacy=True)
    )
    found = board.find(grey)
    assert found is not None
    assert len(found[0]) == 24
