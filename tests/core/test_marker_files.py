"""The marker map file: boards and single markers of all kinds, there and back, and what is refused."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.camera import CameraModel
from autopilot.core.errors import ConfigError
from autopilot.core.frames import r_ned_from_frd
from autopilot.core.marker_files import (
    PlacedMarker,
    load_marker_map,
    make_map,
    marker_file_text,
    placed_markers,
    rotation_of,
)
from autopilot.core.markers import ID_SPAN, MarkerMap
from autopilot.core.vehicle import load_vehicle

VEHICLE = load_vehicle("lbv150")
CAMERA = CameraModel.of_vehicle(VEHICLE)

MIXED = """
name = "two boards, a tag on a block and one on the wall"

[defaults]
dictionary = "DICT_4X4_50"
size_m = 0.06

[[board]]
rows = 2
columns = 3
gap_m = 0.02
first_id = 10
center_m = [0.0, 0.0, 1.5]

[[board]]
rows = 1
columns = 2
gap_m = 0.03
ids = [7, 3]
dictionary = "DICT_APRILTAG_36h11"
size_m = 0.10
center_m = [0.5, 0.0, 1.5]
yaw_rad = 1.5707963267948966

[[marker]]
id = 700
dictionary = "DICT_4X4_1000"
center_m = [-0.5, 0.2, 1.2]
yaw_rad = 0.3

[[marker]]
id = 2
dictionary = "DICT_APRILTAG_25h9"
size_m = 0.2
center_m = [1.0, 0.0, 1.0]
rpy_rad = [0.0, 1.2, 0.0]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "map.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_boards_and_markers_of_all_kinds(tmp_path: Path) -> None:
    markers = load_marker_map(written(tmp_path, MIXED))
    assert markers.dictionaries == ("DICT_4X4_1000", "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h11")
    by_place = dict(zip(markers.ids.tolist(), markers.centers_ned_m, strict=True))
    assert sorted(by_place) == [10, 11, 12, 13, 14, 15, 700, ID_SPAN + 2, 2 * ID_SPAN + 3, 2 * ID_SPAN + 7]
    np.testing.assert_allclose(by_place[10], [0.04, -0.08, 1.5], atol=1e-12)  # top left
    np.testing.assert_allclose(by_place[15], [-0.04, 0.08, 1.5], atol=1e-12)
    np.testing.assert_allclose(
        by_place[2 * ID_SPAN + 7], [0.565, 0.0, 1.5], atol=1e-12
    )  # top to the east, left is north
    assert markers.size_m == 0.06
    np.testing.assert_allclose(np.sort(markers.sizes_m), [0.06] * 7 + [0.1] * 2 + [0.2])
    assert not markers.level
    wall = markers.ids.tolist().index(ID_SPAN + 2)
    into = rotation_of(markers.corners_ned_m[wall])[:, 2]
    np.testing.assert_allclose(into, [math.sin(1.2), 0.0, math.cos(1.2)], atol=1e-12)


@settings(deadline=None, max_examples=40)
@given(
    rpy=st.tuples(st.floats(-3.0, 3.0), st.floats(-1.4, 1.4), st.floats(-3.1, 3.1)),
    size_m=st.floats(0.01, 1.0),
    center=st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(0.0, 9.0)),
)
def test_there_and_back(
    tmp_path_factory: pytest.TempPathFactory,
    rpy: tuple[float, float, float],
    size_m: float,
    center: tuple[float, float, float],
) -> None:
    marker = PlacedMarker(
        place="",
        dictionary="DICT_APRILTAG_16h5",
        id=29,
        size_m=size_m,
        center_ned_m=np.array(center),
        r_ned_from_marker=r_ned_from_frd(np.array(rpy)),
    )
    markers = make_map([marker], "test")
    path = written(tmp_path_factory.mktemp("map"), marker_file_text(markers, ["a note"], ["sigma 1 mm"]))
    again = load_marker_map(path)
    np.testing.assert_allclose(again.corners_ned_m, markers.corners_ned_m, atol=3e-6)
    assert again.ids.tolist() == [29]
    assert path.read_text(encoding="utf-8").startswith("# a note\n")


def test_what_is_written_is_what_was_read(tmp_path: Path) -> None:
    markers = load_marker_map(written(tmp_path, MIXED))
    text = marker_file_text(markers)
    again = load_marker_map(written(tmp_path, text))
    np.testing.assert_allclose(again.corners_ned_m, markers.corners_ned_m, atol=2e-6)
    assert again.ids.tolist() == markers.ids.tolist()
    assert again.dictionaries == markers.dictionaries
    assert marker_file_text(again) == text
    assert [m.id for m in placed_markers(again)][-2:] == [7, 3]


def test_only_faces_that_show_are_visible(tmp_path: Path) -> None:
    markers = load_marker_map(written(tmp_path, MIXED))
    over_the_boards = markers.visible(CAMERA, np.array([0.0, 0.0, 0.7]), np.eye(3))
    assert sorted(markers.ids[over_the_boards].tolist()) == [10, 11, 12, 13, 14, 15]
    ceiling = [
        PlacedMarker(
            place="",
            dictionary="DICT_4X4_50",
            id=1,
            size_m=0.1,
            center_ned_m=np.array([0.0, 0.0, 1.5]),
            r_ned_from_marker=r_ned_from_frd(np.array([roll, 0.0, 0.0])),
        )
        for roll in (0.0, math.pi)
    ]
    for marker, shows in zip(ceiling, (1, 0), strict=True):
        assert len(make_map([marker], "test").visible(CAMERA, np.array([0.0, 0.0, 0.7]), np.eye(3))) == shows


@settings(deadline=None, max_examples=60)
@given(
    pos=st.tuples(st.floats(-1.0, 1.5), st.floats(-0.8, 0.8), st.floats(0.0, 1.4)),
    rpy=st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-3.1, 3.1)),
    margin=st.floats(-60.0, 20.0),
)
def test_visible_is_what_projecting_every_marker_gives(
    tmp_path_factory: pytest.TempPathFactory,
    pos: tuple[float, float, float],
    rpy: tuple[float, float, float],
    margin: float,
) -> None:
    markers = load_marker_map(written(tmp_path_factory.mktemp("map"), MIXED))
    place, r = np.array(pos), r_ned_from_frd(np.array(rpy))
    corners = markers.corners_ned_m
    pixels = CAMERA.project(CAMERA.cam_from_ned(corners, place, r))
    into = np.array([rotation_of(c)[:, 2] for c in corners])
    eye = place + r @ CAMERA.position_frd_m
    faces = ((corners.mean(axis=1) - eye) * into).sum(axis=1) > 0.0
    expected = np.flatnonzero(CAMERA.inside(pixels, margin).all(axis=1) & faces)
    found = markers.visible(CAMERA, place, r, margin).tolist()
    assert set(found) <= set(np.flatnonzero(CAMERA.inside(pixels, margin).all(axis=1)).tolist())
    # Far out of the picture and seen at a grazing angle, the lens formula may turn a quadrilateral over.
    assert margin < 0.0 or found == expected.tolist()


ONE = "[[marker]]\nid = 1\ncenter_m = [0.0, 0.0, 1.0]\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"holds 0 markers"),
        (ONE, r"`\$\.marker\[0\]` has no `dictionary`; give it there or in \[defaults\]"),
        (ONE + 'dictionary = "DICT_4X4_50"', r"has no `size_m`"),
        (ONE + 'dictionary = "DICT_9X9_50"\nsize_m = 0.1', r"\$\.marker\[0\]\.dictionary` 'DICT_9X9_50' is not known"),
        (ONE + 'dictionary = "DICT_4X4_50"\nsize_m = nan', r"\$\.marker\[0\]\.size_m` = nan is not a finite number"),
        (ONE + 'dictionary = "DICT_4X4_50"\nsize_m = 0.0', r"size_m"),
        (ONE + 'dictionary = "DICT_4X4_50"\nsize_m = 0.1\nyaw = 1', r"yaw"),
        (
            ONE + 'dictionary = "DICT_4X4_50"\nsize_m = 0.1\nyaw_rad = 1.0\nrpy_rad = [0.0, 0.0, 0.0]',
            r"either `yaw_rad` or `rpy_rad`",
        ),
        (
            ONE.replace("id = 1", "id = 50") + 'dictionary = "DICT_4X4_50"\nsize_m = 0.1',
            r"id 50 is not in DICT_4X4_50; use 0 to 49",
        ),
        (
            MIXED + '[[marker]]\nid = 11\ndictionary = "DICT_4X4_250"\ncenter_m = [0.3, 0.3, 1.5]',
            r"markers of one id must lie 0\.9 m apart",
        ),
        (
            MIXED + '[[marker]]\nid = 12\ndictionary = "DICT_5X5_50"\ncenter_m = [0.0, 0.05, 1.5]',
            r"id 12 of DICT_5X5_50\).* overlap",
        ),
        (MIXED.replace("ids = [7, 3]", "ids = [7]"), r"`ids` has 1 entries; 1 x 2 markers need one each"),
        (MIXED.replace("ids = [7, 3]", ""), r"either `first_id` or `ids`"),
        (MIXED.replace("first_id = 10", "first_id = 996"), r"id 50|id 996"),
    ],
)
def test_wrong_files_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        load_marker_map(written(tmp_path, text))
    assert "\n" not in str(caught.value)
    assert "map.toml" in str(caught.value)


def test_one_above_the_other_is_no_overlap(tmp_path: Path) -> None:
    block = "[[marker]]\nid = 1\ncenter_m = [0.0, 0.0, 1.3]\n[[marker]]\nid = 2\ncenter_m = [0.0, 0.0, 1.5]\n"
    text = '[defaults]\ndictionary = "DICT_4X4_50"\nsize_m = 0.1\n' + block
    assert len(load_marker_map(written(tmp_path, text)).ids) == 2


@pytest.mark.parametrize(
    ("second", "overlap"),
    [
        ("center_m = [0.02, 0.0, 1.309]", True),
        ("center_m = [0.02, 0.0, 1.291]", True),
        ("center_m = [0.02, 0.0, 1.311]", False),
        ("center_m = [0.02, 0.0, 1.289]", False),
        # On edge, across the first: its lower edge in the plane of that, 9 mm beside it and 11 mm.
        ("center_m = [0.0, 0.0, 1.25]\nrpy_rad = [1.5707963, 0.0, 0.0]", True),
        ("center_m = [0.0, 0.0, 1.241]\nrpy_rad = [1.5707963, 0.0, 0.0]", True),
        ("center_m = [0.0, 0.0, 1.239]\nrpy_rad = [1.5707963, 0.0, 0.0]", False),
    ],
)
def test_squares_overlap_in_one_plane(tmp_path: Path, second: str, overlap: bool) -> None:
    block = f"[[marker]]\nid = 1\ncenter_m = [0.0, 0.0, 1.3]\n[[marker]]\nid = 2\n{second}\n"
    path = written(tmp_path, '[defaults]\ndictionary = "DICT_4X4_50"\nsize_m = 0.1\n' + block)
    if overlap:
        with pytest.raises(ConfigError, match="overlap"):
            load_marker_map(path)
    else:
        assert len(load_marker_map(path).ids) == 2


def test_a_map_of_one_dictionary_has_that_dictionarys_ids(tmp_path: Path) -> None:
    text = '[defaults]\ndictionary = "DICT_APRILTAG_36h11"\nsize_m = 0.1\n' + ONE
    markers: MarkerMap = load_marker_map(written(tmp_path, text))
    assert markers.ids.tolist() == [1]
    assert markers.level
    assert markers.floor_m == 1.0
