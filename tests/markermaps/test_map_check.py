"""``autopilot markers check``: what a map holds, what is wrong with it, what it may disappoint with."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from autopilot.cli.markers_command import markers as command
from autopilot.core.errors import ConfigError

BOARD = """
[[board]]
dictionary = "DICT_4X4_50"
size_m = 0.06
rows = 5
columns = 5
gap_m = 0.02
first_id = 0
center_m = [0.0, 0.0, 1.5]
"""


def check(folder: Path, text: str) -> tuple[int, dict[str, object]]:
    """Exit code and report."""
    path = folder / "map.toml"
    path.write_text(text, encoding="utf-8")
    done = CliRunner().invoke(command, ["check", str(path), "--json"], catch_exceptions=False)
    return done.exit_code, json.loads(done.stdout)


def test_a_good_board(tmp_path: Path) -> None:
    code, report = check(tmp_path, BOARD)
    assert code == 0
    assert report["markers"] == 25
    assert report["DICT_4X4_50"] == "25 markers, 25 ids, 60.0 mm"
    assert report["attitude"] == "face up on one level"
    shares = report["view_shares"]
    assert isinstance(shares, list)
    assert [row[0] for row in shares] == [0.3, 0.45, 0.8, 1.2]
    assert shares[3][1] == 1.0


@pytest.mark.parametrize(
    ("text", "warning"),
    [
        (BOARD.replace("gap_m = 0.02", "gap_m = 0.005"), "less than one cell of white between them, least 5.0 mm"),
        (
            BOARD + '[[marker]]\nid = 3\nsize_m = 0.1\ndictionary = "DICT_APRILTAG_16h5"\ncenter_m = [1.0, 0.0, 1.5]',
            "same number of cells are mixed",
        ),
        (BOARD.replace("1.5]", "-1.5]"), "1.500 m above the water"),
    ],
)
def test_warnings(tmp_path: Path, text: str, warning: str) -> None:
    code, report = check(tmp_path, text)
    assert code == 3
    assert warning in str(report["warnings"])


def test_a_wrong_map_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="overlap"):
        check(tmp_path, BOARD + BOARD.replace("first_id = 0", "first_id = 25"))


@pytest.mark.parametrize("line", ["yaw_rad = 90.0", "rpy_rad = [0.0, 0.0, 90]", "sigma_m = 5.0", "sigma_rad = 2.0"])
def test_a_number_in_another_unit_is_refused_with_the_range(tmp_path: Path, line: str) -> None:
    with pytest.raises(ConfigError, match=r"board\[0\].{}.* it is ".format(line.split(" ")[0])):
        check(tmp_path, BOARD + line)


@pytest.mark.filterwarnings("error")
def test_the_same_marker_twice_is_refused_without_another_word(tmp_path: Path) -> None:
    twice = '[defaults]\ndictionary = "DICT_4X4_50"\nsize_m = 0.06\n' + 2 * "[[marker]]\nid = 1\ncenter_m = [0, 0, 1]\n"
    with pytest.raises(ConfigError, match="apart"):
        check(tmp_path, twice)
