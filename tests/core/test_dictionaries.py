"""Marker dictionaries out of files."""

from pathlib import Path

import numpy as np
import pytest

from autopilot.core.dictionaries import (
    dictionary_label,
    dictionary_size,
    least_distance,
    opencv_dictionary,
    read_dictionary,
    resolve_dictionary,
)
from autopilot.core.errors import ConfigError
from autopilot.core.marker_files import load_marker_map, marker_file_text

FILE = Path(__file__).resolve().parents[1] / "data" / "opencv_contrib" / "tutorial_dict.yml"


def test_a_file_of_opencvs_format() -> None:
    """35 markers of 6 x 6 cells that differ in 14 cells or more: 6 can be corrected."""
    name = read_dictionary(FILE)
    assert dictionary_size(name) == 35
    assert dictionary_label(name) == "custom 6x6 of 35"
    assert least_distance(name) == 14
    words = opencv_dictionary(name)
    assert words.maxCorrectionBits == 6
    line = next(line for line in FILE.read_text(encoding="utf-8").splitlines() if line.startswith("marker_7:"))
    bits = type(words).getBitsFromByteList(words.bytesList[7][None], 6)
    assert "".join(str(bit) for bit in bits.ravel()) == line.split('"')[1]


def test_a_map_names_the_file_and_stands_for_itself_when_written(tmp_path: Path) -> None:
    (tmp_path / "mine.yml").write_bytes(FILE.read_bytes())
    text = '[defaults]\ndictionary = "mine.yml"\nsize_m = 0.05\n[[board]]\nrows = 5\ncolumns = 7\ngap_m = 0.01\n'
    (tmp_path / "map.toml").write_text(text + "first_id = 0\ncenter_m = [0.0, 0.0, 1.5]\n", encoding="utf-8")
    markers = load_marker_map(tmp_path / "map.toml")
    other = tmp_path / "elsewhere"
    other.mkdir()
    (other / "map.toml").write_text(marker_file_text(markers), encoding="utf-8")
    again = load_marker_map(other / "map.toml")
    assert again.dictionaries == markers.dictionaries
    np.testing.assert_allclose(again.corners_ned_m, markers.corners_ned_m, atol=1e-5)
    (tmp_path / "map.toml").write_text(text + "first_id = 1\ncenter_m = [0.0, 0.0, 1.5]\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="id 35 is not in custom 6x6 of 35; use 0 to 34"):
        load_marker_map(tmp_path / "map.toml")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "has no `nmarkers`"),
        ("nmarkers: 1\n", "has no `markersize`"),
        ("nmarkers: 0\nmarkersize: 4\n", "0 markers of 4 x 4 cells"),
        ("nmarkers: 1\nmarkersize: 40\n", "1 markers of 40 x 40 cells"),
        ('nmarkers: 1\nmarkersize: 3\nmarker_0: "10110"\n', "`marker_0` has 5 cells of 9"),
        ('nmarkers: 2\nmarkersize: 3\nmarker_0: "100000000"\n', "`marker_1` has 0 cells of 9"),
        ('nmarkers: 1\nmarkersize: 3\nmarker_0: "111111111"\n', "looks the same turned"),
        ('nmarkers: 2\nmarkersize: 3\nmarker_0: "100000000"\nmarker_1: "001000000"\n', "two markers are alike"),
    ],
)
def test_files_that_are_none(tmp_path: Path, content: str, says: str) -> None:
    path = tmp_path / "bad.yml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ConfigError, match=says):
        read_dictionary(path)


def test_names_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"--dictionary 'DICT_NONE' is not known; use a file .*DICT_4X4_50"):
        resolve_dictionary("DICT_NONE", tmp_path, "--dictionary")
    with pytest.raises(ConfigError, match="is no dictionary file"):
        resolve_dictionary("absent.yml", tmp_path, "--dictionary")
    with pytest.raises(ConfigError, match="is damaged"):
        resolve_dictionary("CUSTOM:6:12", tmp_path, "--dictionary")
