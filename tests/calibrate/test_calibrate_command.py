"""The command line of ``autopilot calibrate``."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from board_pictures import Printed, camera

from autopilot.calibrate.boards import BoardSpec, CalibrationBoard
from autopilot.cli.calibrate import calibrate
from autopilot.cli.main import cli, run
from autopilot.core.vehicle import load_vehicle


def call(*arguments: str) -> int:
    return run(lambda: cli(["calibrate", *arguments], standalone_mode=False))


def test_camera_from_a_folder_to_a_vehicle_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed = Printed(CalibrationBoard(BoardSpec()), camera())
    folder = tmp_path / "views"
    folder.mkdir()
    for name, grey in printed.pictures(9, np.random.default_rng(3)):
        cv2.imwrite(str(folder / name), grey)
    (folder / "torn.png").write_bytes(b"no image")
    out, plot = tmp_path / "mine.toml", tmp_path / "plot.png"
    code = call("camera", str(folder), "--out", str(out), "--plot", str(plot), "--json")
    facts = json.loads(capsys.readouterr().out)
    assert code == 3, "few views and another lens than the LBV150's: remarks"
    assert facts["views"] == 9
    assert facts["left_out"] == {"torn.png": "cannot be read"}
    assert plot.is_file()
    assert load_vehicle(str(out)).camera.focal_px == pytest.approx((520.0, 522.0), abs=3.0)


def test_board_sheet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("board", str(tmp_path / "board.svg"), "--shape", "5x4") == 0
    assert "150 x 120 mm" in capsys.readouterr().out
    assert (tmp_path / "board.svg").read_text().startswith("<svg")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("camera", "/dev/video96"), "cannot be opened"),
        (("camera", ".", "--shape", "9by6"), "COLUMNSxROWS"),
        (("board", "no-such-folder/x.svg"), "choose another place"),
        (("latency", "no-such.mcap"), "cannot be read"),
        (("extrinsics", "no-such.mcap"), "cannot be read"),
        (("laser", "no-such.mcap"), "cannot be read"),
    ],
)
def test_errors_are_one_line(
    arguments: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert call(*arguments) == 1
    error = capsys.readouterr().err
    assert words in error
    assert error.startswith("error: ")
    assert len(error.splitlines()) == 1


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What people give instead of a folder of images."""
    folder = tmp_path_factory.mktemp("sources")
    rng = np.random.default_rng(1)
    for name in ("empty", "notes", "torn", "one"):
        (folder / name).mkdir()
    for path in ("notes/read.txt", "torn/a.png", "torn/b.jpg", "words.txt", "torn.png"):
        (folder / path).write_bytes(b"words")
    for path in ("one/a.png", "single.png"):
        cv2.imwrite(str(folder / path), rng.integers(0, 255, (480, 640), dtype=np.uint8))
    film = cv2.VideoWriter(str(folder / "film.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 5.0, (640, 480))
    for _ in range(4):
        film.write(rng.integers(0, 255, (480, 640, 3), dtype=np.uint8))
    film.release()
    return folder


FOLDER = "give the folder that holds the images"


@pytest.mark.parametrize(
    ("command", "source", "words", "code"),
    [
        ("camera", "single.png", f"is one image; {FOLDER}, or a film", 2),
        ("camera", "torn.png", f"is one image; {FOLDER}, or a film", 2),
        ("camera", "words.txt", f"is not a film that OpenCV reads; give a film, or {FOLDER[5:]}", 2),
        ("camera", "empty", f"holds no images (.png, .jpg, .jpeg); {FOLDER}", 2),
        ("camera", "notes", f"holds no images (.png, .jpg, .jpeg); {FOLDER}", 2),
        ("camera", "torn", "OpenCV reads none of 2 images (a.png, b.jpg)", 2),
        ("camera", "none", f"does not exist; {FOLDER}", 2),
        ("camera", "one", "is seen in none of 1 images", 1),
        ("camera", "film.avi", "is seen in no frame", 1),
        ("laser", "single.png", f"is one image; {FOLDER}, or a log", 2),
        ("laser", "empty", f"holds no images (.png, .jpg, .jpeg); {FOLDER}, or a log", 2),
        ("laser", "torn", "OpenCV reads none of 2 images (a.png, b.jpg)", 2),
        ("laser", "one", "no image shows both the board and a green dot", 1),
        ("laser", "film.avi", "is not an MCAP log", 1),
    ],
)
def test_what_is_no_folder_of_images_is_named(
    command: str, source: str, words: str, code: int, sources: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A single image was taken for a film, and the board sought in "none of 0 images"."""
    assert call(command, str(sources / source)) == code
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith(f"error: {sources / source}: ") and words in error


@pytest.mark.parametrize(
    ("options", "words", "code"),
    [
        (("b.svg", "--square", "30", "--marker", "22"), "squares of 30 m; give --square in metres, 0.002 to 1", 1),
        (("b.svg", "--square", "1e-6", "--marker", "1e-7"), "give --square in metres", 1),
        (("b.svg", "--board", "chessboard", "--square", "0"), "give --square in metres", 1),
        (("b.png",), "name it .svg", 2),
    ],
)
def test_a_board_that_cannot_be_is_not_written(
    options: tuple[str, ...], words: str, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A sheet of 270 m was written."""
    sheet = tmp_path / options[0]
    assert call("board", str(sheet), *options[1:]) == code
    assert words in capsys.readouterr().err and not sheet.exists()


def test_all_four_are_there() -> None:
    assert {"camera", "laser", "extrinsics", "latency", "board"} <= set(calibrate.commands)
