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
        (("camera", "no-such-folder"), "is not a folder"),
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


def test_all_four_are_there() -> None:
    assert {"camera", "laser", "extrinsics", "latency", "board"} <= set(calibrate.commands)
