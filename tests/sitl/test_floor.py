"""The picture of the floor: every printed marker is the dictionary's, where the map says it is."""

import cv2
import msgspec
import numpy as np
import pytest
from sensor_helpers import SCENARIO, floor

from autopilot.sitl.floor import build_floor, build_markers
from autopilot.sitl.scenario import load_scenario
from autopilot.sitl.scenario_tables import Markers, Tank
from autopilot.sitl.sitl_tuning import FLOOR

MARKER_CELLS = 6
"""A 4x4 marker with its border of one cell."""


def cell_levels(picture: np.ndarray, index: int) -> np.ndarray:
    """Mean grey level of every cell of a marker, read through the floor's own coordinates."""
    markers = floor().markers
    corners = markers.corners_ned_m[index]
    centres = (np.arange(MARKER_CELLS) + 0.5) / MARKER_CELLS
    north = corners[0, 0] + (corners[3, 0] - corners[0, 0]) * np.repeat(centres[:, None], MARKER_CELLS, axis=1)
    east = corners[0, 1] + (corners[1, 1] - corners[0, 1]) * np.repeat(centres[None, :], MARKER_CELLS, axis=0)
    where = floor().pixel_map(north, east, 0)
    levels: np.ndarray = cv2.remap(cv2.blur(picture, (5, 5)), where, None, cv2.INTER_LINEAR).astype(float)
    return levels


@pytest.mark.parametrize("index", [0, 1, 500, 1111, 2200, -1])
def test_markers_are_printed_where_the_map_says(index: int) -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, floor().markers.dictionary))
    expected = cv2.aruco.generateImageMarker(dictionary, int(floor().markers.ids[index]), MARKER_CELLS)
    levels = cell_levels(floor().levels[0], index)
    assert np.array_equal(levels > 117, expected > 0)
    assert levels[expected > 0].min() - levels[expected == 0].max() > 60


def test_print_is_exact_where_cells_are_not_whole_pixels() -> None:
    corners = [(0.0, 0.0), (0.3, 0.0), (0.3, 0.3), (0.0, 0.3)]
    layout, tank = Markers(pitch_m=0.0853, size_m=0.0617), Tank(polygon_m=corners, depth_m=1.0)
    odd = msgspec.structs.replace(SCENARIO, markers=layout, tank=tank)
    built = build_floor(odd)
    assert built is not None
    shown = built.levels[0].astype(float)
    white = 1.0 - (shown - 34.0) / (200.0 - 34.0)  # ink in 0..1 but for the sand
    scale = 1.0 / built.px_per_m
    rows, columns = np.mgrid[0 : shown.shape[0], 0 : shown.shape[1]]
    for marker in built.markers.corners_ned_m[:4]:
        # The border cells are black all round, so the centre of the frame's ink is the centre of the marker.
        north, east = built.north_m - (rows + 0.5) * scale, built.east_m + (columns + 0.5) * scale
        centre = marker.mean(axis=0)
        inside = np.abs(north - centre[0]) < 0.036
        inside &= np.abs(east - centre[1]) < 0.036
        edge = np.maximum(np.abs(north - centre[0]), np.abs(east - centre[1])) > 0.0617 / 3
        ring = np.clip(white, 0.0, 1.0) * inside * edge
        assert (ring * north).sum() / ring.sum() == pytest.approx(centre[0], abs=0.0006)
        assert (ring * east).sum() / ring.sum() == pytest.approx(centre[1], abs=0.0006)


def test_coarser_levels_show_the_same_place() -> None:
    fine, coarse = floor().levels[0], floor().levels[1]
    north, east = np.mgrid[-1.0:1.0:60j, -1.0:1.0:60j]
    shown = [
        cv2.remap(cv2.blur(picture, (size, size)), floor().pixel_map(north, east, level), None, cv2.INTER_LINEAR)
        for level, picture, size in ((0, fine, 6), (1, coarse, 3))
    ]
    assert np.abs(shown[0].astype(float) - shown[1]).mean() < 12.0
    assert np.corrcoef(shown[0].ravel(), shown[1].ravel())[0, 1] > 0.97


def test_level_follows_the_resolution_that_is_needed() -> None:
    assert floor().level_for(900.0) == 0
    assert floor().level_for(500.0) == 1
    assert floor().level_for(1.0) == len(floor().levels) - 1


def test_a_large_basin_gets_a_coarser_picture_instead_of_all_the_memory() -> None:
    basin = load_scenario("harbour").tank
    scenario = msgspec.structs.replace(SCENARIO, markers=Markers(pitch_m=0.5, size_m=0.4), tank=basin)
    built = build_floor(scenario)
    assert built is not None
    assert built.levels[0].size <= 1.02 * FLOOR.max_px


def test_open_water_has_no_floor() -> None:
    assert build_markers(load_scenario("open-water")) is None
    assert build_floor(load_scenario("open-water")) is None
