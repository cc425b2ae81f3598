"""Views that fit any focal length are refused; plain chessboards and dictionaries out of files can be used."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from board_pictures import Printed, camera
from click.testing import CliRunner

from autopilot.calibrate.boards import BoardSpec, CalibrationBoard
from autopilot.calibrate.intrinsics import calibrate
from autopilot.calibrate.views import BoardView, Views, collect_views
from autopilot.cli.calibrate import calibrate as commands
from autopilot.core.errors import ConfigError

FOCAL = 742.0
MATRIX = np.array([[FOCAL, 0.0, 322.0], [0.0, FOCAL + 2.0, 238.0], [0.0, 0.0, 1.0]])
DISTORTION = np.array([-0.12, 0.06, 0.001, -0.0015, -0.01])
DICTIONARY = Path(__file__).parents[1] / "data" / "opencv_contrib" / "tutorial_dict.yml"


def views_of(tilt_deg: float, count: int, sigma_px: float, seed: int) -> Views:
    """Corners of a chessboard seen from many places, tilted by up to so much."""
    rng = np.random.default_rng(seed)
    points = np.array([[0.03 * c, 0.03 * r, 0.0] for r in range(1, 6) for c in range(1, 9)])
    views = []
    for number in range(count):
        about = rng.uniform(0.0, 2.0 * math.pi)
        turn = rng.uniform(0.3, 1.0) * math.radians(tilt_deg) * np.array([math.cos(about), math.sin(about), 0.0])
        turn[2] = rng.uniform(-0.4, 0.4)
        aim = rng.uniform(0.35, 0.6) * np.array([rng.uniform(-0.25, 0.25), rng.uniform(-0.2, 0.2), 1.0])
        shift = aim - np.asarray(cv2.Rodrigues(turn)[0]) @ points.mean(axis=0)
        pixels = np.asarray(cv2.projectPoints(points, turn, shift, MATRIX, DISTORTION)[0]).reshape(-1, 2)
        pixels = pixels + rng.normal(0.0, sigma_px, pixels.shape)
        seen = ((pixels > 2.0) & (pixels < [637.0, 477.0])).all(axis=1)
        views.append(BoardView(name=f"{number}", points_m=points[seen], pixels=pixels[seen]))
    return Views(width_px=640, height_px=480, views=tuple(views), left_out=())


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("tilt_deg", "sigma_px"), [(0.0, 0.02), (0.5, 0.1), (2.0, 0.3), (4.0, 0.1)])
def test_views_from_straight_above_are_refused(tilt_deg: float, sigma_px: float, seed: int) -> None:
    """Their least squares give any focal length, with a sigma of a thousandth where the truth is half as long."""
    with pytest.raises(ConfigError, match=r"do not tell focal length from distance.*tilted by 20 to 40 deg"):
        calibrate(views_of(tilt_deg, 12, sigma_px, seed))


@pytest.mark.parametrize("seed", range(8))
def test_what_is_not_refused_is_right(seed: int) -> None:
    """Random tilts and noise: taken are only those whose focal length is within 3 %."""
    rng = np.random.default_rng(100 + seed)
    try:
        result = calibrate(views_of(float(rng.uniform(0.0, 30.0)), 12, float(rng.uniform(0.02, 0.3)), seed))
    except ConfigError:
        return
    assert abs(result.values[0] / FOCAL - 1.0) < 0.03


def test_tilted_views_are_taken() -> None:
    result = calibrate(views_of(30.0, 12, 0.1, 3))
    assert abs(result.values[0] / FOCAL - 1.0) < 0.005


def test_plain_chessboard() -> None:
    """Squares are counted, not inner corners; the sheet is that of the pattern."""
    board = CalibrationBoard(BoardSpec(kind="chessboard", columns=9, rows=6, pitch_m=0.03))
    printed = Printed(board, camera())
    found = collect_views(board, printed.pictures(10, np.random.default_rng(2)), "test")
    assert len(found.views) >= 8
    assert all(len(view.pixels) == 40 for view in found.views)
    result = calibrate(found, fix_k3=True)
    assert result.values[0] == pytest.approx(520.0, abs=3.0)
    assert result.rms_px < 0.1
    assert "chessboard 9x6, pitch 30 mm;" in board.svg()
    with pytest.raises(ConfigError, match="board of 3 x 6: too small; use at least 4 x 4"):
        BoardSpec(kind="chessboard", columns=3, rows=6)


def test_board_of_a_dictionary_out_of_a_file(tmp_path: Path) -> None:
    sheet = tmp_path / "board.svg"
    options = ["--board", "grid", "--shape", "5x7", "--square", "0.03", "--marker", "0.02"]
    result = CliRunner().invoke(commands, ["board", *options, "--dictionary", str(DICTIONARY), str(sheet)])
    assert result.exit_code == 0, result.output
    assert sheet.exists()
