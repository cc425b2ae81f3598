"""Floors from a marker map file, and pictures through a flat port."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
from sensor_helpers import CAMERA, FLOOR_M, SCENARIO, floor, height, truth_at

from autopilot.core.errors import ConfigError
from autopilot.core.flat_port import FlatPort
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.marker_files import load_marker_map
from autopilot.core.markers import ID_SPAN
from autopilot.core.samples import CameraFrame
from autopilot.estimator.markers_pose import MarkerSolver
from autopilot.estimator.vision import Hint, MarkerDetector
from autopilot.sitl.camera_sensor import SimCamera, true_camera
from autopilot.sitl.floor import Floor, build_floor
from autopilot.sitl.scenario import load_scenario
from autopilot.sitl.scenario_tables import Markers, Scenario
from autopilot.sitl.sensor_tables import ImageModel, LaserSensor

BOARDS = f"""
[defaults]
size_m = 0.06

[[board]]
dictionary = "DICT_4X4_250"
rows = 4
columns = 5
gap_m = 0.02
first_id = 0
center_m = [0.12, 0.0, {FLOOR_M}]
yaw_rad = 0.15

[[board]]
dictionary = "DICT_APRILTAG_36h11"
size_m = 0.08
rows = 2
columns = 4
gap_m = 0.02
first_id = 100
center_m = [-0.26, 0.0, {FLOOR_M}]
yaw_rad = -2.95

[[marker]]
id = 5
dictionary = "DICT_APRILTAG_16h5"
size_m = 0.07
center_m = [-0.02, -0.32, {FLOOR_M}]
yaw_rad = 1.0
"""


def scenario_with(markers: Markers) -> Scenario:
    return msgspec.structs.replace(SCENARIO, markers=markers)


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> Floor:
    path = tmp_path_factory.mktemp("map") / "boards.toml"
    path.write_text(BOARDS, encoding="utf-8")
    built = build_floor(scenario_with(Markers(file=str(path))))
    assert built is not None
    return built


@pytest.mark.parametrize("yaw", [0.0, 1.3, -2.2])
def test_three_kinds_of_markers_in_one_picture(boards: Floor, yaw: float) -> None:
    """All that show are found, in their own dictionaries, with a hint and without one; the pose is right."""
    pos, rpy = np.array([0.0, 0.0, height(0.95)]), np.array([0.01, -0.02, yaw])
    frame = CameraFrame(
        t_us=0, image_bgr=SimCamera(CAMERA, boards, ImageModel(), 1).render(truth_at(tuple(pos), tuple(rpy)), 0)
    )
    markers = boards.markers
    assert len(markers.dictionaries) == 3
    shown = markers.visible(CAMERA, pos, r_ned_from_frd(rpy), 6.0)
    detector, solver = MarkerDetector(CAMERA, markers), MarkerSolver(CAMERA, markers)
    for hint in (None, Hint(pos_ned_m=pos + 0.01, rpy_rad=rpy + 0.01)):
        sighting = detector.detect(frame, hint)
        found = set(sighting.ids)
        assert found >= set(markers.ids[shown].tolist())
        assert {code // ID_SPAN for code in found} >= {code // ID_SPAN for code in markers.ids[shown].tolist()}
        fix = solver.locate(sighting, 0.01, -0.02)
        assert fix is not None
        assert np.abs(fix.z[:3] - pos).max() < 0.003
        assert abs(fix.z[3] - yaw) < math.radians(0.2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("center_m = [0.12, 0.0, 1.5]", "center_m = [0.12, 0.0, 1.2]"), "not flat on the floor, which lies at 1.5 m"),
        (("center_m = [0.12, 0.0, 1.5]", "center_m = [2.4, 0.0, 1.5]"), "outside of the tank"),
    ],
)
def test_what_the_floor_cannot_show_is_refused(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(BOARDS.replace(*change), encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        build_floor(scenario_with(Markers(file=str(path))))


def test_a_scenario_names_the_file_beside_it(tmp_path: Path) -> None:
    shipped = Path(__file__).resolve().parents[2] / "sitl" / "scenarios" / "paper-tank.toml"
    text = shipped.read_text(encoding="utf-8").replace('plan = "paper.plan"\n', "")
    (tmp_path / "tank.toml").write_text(text + '\n[markers]\nfile = "boards.toml"\n', encoding="utf-8")
    (tmp_path / "boards.toml").write_text(BOARDS, encoding="utf-8")
    built = build_floor(load_scenario(str(tmp_path / "tank.toml")))
    assert built is not None
    expected = load_marker_map(tmp_path / "boards.toml")
    np.testing.assert_array_equal(built.markers.corners_ned_m, expected.corners_ned_m)
    (tmp_path / "boards.toml").unlink()
    with pytest.raises(ConfigError, match=r"boards\.toml: cannot be read"):
        build_floor(load_scenario(str(tmp_path / "tank.toml")))


def corner_errors(told: str, height_m: float) -> FloatArray:
    """Detected minus projected corners in pictures through a pane 50 mm before the lens."""
    look = ImageModel(port=FlatPort(distance_m=0.05, thickness_m=0.006))
    true = true_camera(CAMERA, look, LaserSensor())
    pos, rpy = np.array([0.3, -0.2, height(height_m)]), np.array([0.02, -0.01, 0.7])
    frame = CameraFrame(t_us=0, image_bgr=SimCamera(true, floor(), look, 1).render(truth_at(tuple(pos), tuple(rpy)), 0))
    camera = true if told == "flat_port" else CAMERA
    markers = floor().markers
    sighting = MarkerDetector(camera, markers).detect(frame, Hint(pos_ned_m=pos, rpy_rad=rpy))
    seen = markers.visible(camera, pos, r_ned_from_frd(rpy), -60.0)
    where = {int(markers.ids[n]): n for n in seen}
    corners = markers.corners_ned_m[[where[i] for i in sighting.ids]]
    assert len(corners) >= 2
    result: FloatArray = sighting.corners_px - camera.project(camera.cam_from_ned(corners, pos, r_ned_from_frd(rpy)))
    return result


@pytest.mark.parametrize("height_m", [0.45, 0.9])
def test_pictures_through_a_flat_port_are_refracted(height_m: float) -> None:
    exact = corner_errors("flat_port", height_m)
    assert np.sqrt(np.square(exact).mean()) < 0.4
    assert np.abs(exact.mean(axis=(0, 1))).max() < 0.15
    pinhole = corner_errors("pinhole", height_m)
    assert np.sqrt(np.square(pinhole).mean()) > 3.0 * np.sqrt(np.square(exact).mean())
