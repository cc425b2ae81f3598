"""What a marker map says of its own errors, and what it shows without saying."""

import dataclasses
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.frames import r_ned_from_frd
from autopilot.core.map_errors import SHEET_SIGMA_M, SHEET_SIGMA_RAD, error_arrays, errors_of_arrays
from autopilot.core.marker_files import load_marker_map, make_map, marker_file_text, placed_markers
from autopilot.core.markers import MarkerMap, grid_floor
from autopilot.sitl.floor import build_markers, given_floor_m, given_markers
from autopilot.sitl.scenario import load_scenario

POLYGON = np.array([[-0.9, -0.6], [0.9, -0.6], [0.9, 0.6], [-0.9, 0.6]])


def laid(seed: int, pitch_m: float) -> tuple[MarkerMap, np.ndarray]:
    """A floor of six sheets that were laid by hand, by its markers alone, and the sheet of each."""
    rng = np.random.default_rng(seed)
    floor = grid_floor(polygon_m=POLYGON, depth_m=1.5, pitch_m=pitch_m, size_m=0.7 * pitch_m, seed=seed)
    sheet = np.floor((floor.centers_ned_m[:, :2] - POLYGON[0]) / 0.6).astype(int) @ [2, 1]
    corners = floor.corners_ned_m.copy()
    for k in np.unique(sheet):
        middle = floor.centers_ned_m[sheet == k].mean(axis=0)
        turn = r_ned_from_frd(np.array([0.0, 0.0, rng.normal(0.0, 0.004)]))
        shift = np.append(rng.normal(0.0, 0.001, 2), 0.0)
        corners[sheet == k] = middle + (corners[sheet == k] - middle) @ turn.T + shift
    return dataclasses.replace(floor, corners_ned_m=corners), sheet


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.06, 0.08, 0.1]))
def test_sheets_show_by_their_lattice(seed: int, pitch_m: float) -> None:
    floor, sheet = laid(seed, pitch_m)
    found = make_map(placed_markers(floor), "test").errors
    assert found is not None
    assert len(found.names) == len(np.unique(sheet))
    for k in range(len(found.names)):
        assert len(np.unique(sheet[found.sheet == k])) == 1
    assert (found.sigma == [SHEET_SIGMA_M, SHEET_SIGMA_M, 0.001, SHEET_SIGMA_RAD]).all()


def test_one_sheet_is_its_own_frame() -> None:
    floor = grid_floor(polygon_m=POLYGON, depth_m=1.5, pitch_m=0.08, size_m=0.06, seed=3)
    assert make_map(placed_markers(floor), "test").errors is None


def test_a_file_says_it_all_and_says_it_again(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text(
        """
[defaults]
dictionary = "DICT_4X4_1000"
size_m = 0.06
sigma_m = 0.004
[frame]
sigma_m = 0.001
[[board]]
rows = 2
columns = 3
gap_m = 0.02
first_id = 0
center_m = [0.0, 0.0, 1.5]
sheet = 'left "A"'
[[board]]
rows = 2
columns = 3
gap_m = 0.02
first_id = 10
center_m = [0.3, 0.0, 1.5]
sigma_m = 0.002
sigma_rad = 0.003
[[marker]]
id = 20
center_m = [0.6, 0.0, 1.5]
sigma_m = 0.0
[[marker]]
id = 21
center_m = [0.65, 0.31, 1.5]
""",
        encoding="utf-8",
    )
    first = load_marker_map(path).errors
    path.write_text(marker_file_text(load_marker_map(path)), encoding="utf-8")
    for errors in (first, load_marker_map(path).errors):
        assert errors is not None
        sheets = {name: sigma.tolist() for name, sigma in zip(errors.names, errors.sigma, strict=True)}
        assert sheets['left "A"'] == [0.004, 0.004, 0.001, SHEET_SIGMA_RAD]
        assert sheets["board 2"] == [0.002, 0.002, 0.001, 0.003]
        assert errors.sheet.tolist()[0] == -1, "said to be exact"
        assert len(errors.names) == 3
        assert errors.frame_sigma == (0.001, 0.0, 0.0)
    assert first is not None
    back = errors_of_arrays({name: np.asarray(value) for name, value in error_arrays(first).items()})
    assert back.names == first.names
    assert back.loose == first.loose
    np.testing.assert_array_equal(back.sigma, first.sigma)


def test_the_scenario_lays_another_floor_than_it_tells() -> None:
    scenario = load_scenario("hand-laid")
    true, told = build_markers(scenario), given_markers(scenario)
    assert true is not None
    assert told is not None
    assert told.errors is not None
    assert true.errors is None, "nobody is told the truth"
    off_m = np.linalg.norm((true.centers_ned_m - told.centers_ned_m)[:, :2], axis=1)
    assert 0.002 < float(np.sqrt((off_m**2).mean())) < 0.004
    assert (np.bincount(told.errors.sheet) > 10).all()
    assert float(told.errors.sigma[0, 0]) == pytest.approx(0.0017)


def test_the_vehicle_of_a_campaign_is_told_what_a_person_knows() -> None:
    """Another depth than the true one, the default of ruler and tape; the print is smaller than it was planned."""
    scenario = load_scenario("by-hand")
    laid = scenario.markers.laid
    assert laid is not None
    laid = msgspec.structs.replace(laid, print_scale=0.99, sigma_m=0.0, sigma_rad=0.0, print_sigma_m=0.0)
    markers = msgspec.structs.replace(scenario.markers, laid=laid, told_deeper_m=0.01)
    scenario = msgspec.structs.replace(scenario, markers=markers)
    true, told = build_markers(scenario), given_markers(scenario)
    assert true is not None
    assert told is not None
    assert told.errors is not None
    assert true.sizes_m == pytest.approx(0.99 * told.sizes_m)
    np.testing.assert_allclose(told.corners_ned_m[..., 2], true.corners_ned_m[..., 2] + 0.01)
    assert given_floor_m(scenario) == pytest.approx(1.51)
    assert (told.errors.sigma[:, [0, 3]] == [SHEET_SIGMA_M, SHEET_SIGMA_RAD]).all()
    for k in range(len(told.errors.names)):
        mine = told.errors.sheet == k
        np.testing.assert_allclose(true.centers_ned_m[mine].mean(axis=0)[:2], told.errors.pivot_ned_m[k, :2], atol=1e-9)
    other = msgspec.structs.replace(scenario.scenario, seed=2)
    again = load_scenario("by-hand"), msgspec.structs.replace(load_scenario("by-hand"), scenario=other)
    floors = [build_markers(one) for one in again]
    assert floors[0] is not None
    assert floors[1] is not None
    assert np.abs(floors[0].corners_ned_m - floors[1].corners_ned_m).max() > 0.001, "each run has a floor of its own"
