"""What viewers draw: poses, transforms, body, current, camera and detections, parameters as they change."""

from typing import Any

import numpy as np
import pytest
from log_synthetic import DESCRIPTION, EPOCH_NS, Run, inputs_at, outputs_at, truth_at

from autopilot.core.camera import R_FRD_FROM_CAM
from autopilot.core.frames import r_ned_from_frd
from autopilot.core.params import ParamSet
from autopilot.core.samples import CameraFrame
from autopilot.log.log_session import open_run_log
from autopilot.log.reader import Log, open_log

SEEN_US = 60_000
"""How long after a picture its markers come (`inputs_at`)."""


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Log:
    path = tmp_path_factory.mktemp("viewers") / "a.mcap"
    log = open_run_log(
        path,
        epoch_ns=EPOCH_NS,
        description=DESCRIPTION,
        metadata={},
        attachments={},
        lossless=True,
        camera_period_us=200_000,
    )
    for t_us in range(10_000_000, 13_000_001, 20_000):
        truth = truth_at(t_us * 1e-6)
        log.inputs(inputs_at(t_us, truth))
        log.camera(CameraFrame(t_us=t_us, image_bgr=np.full((48, 64, 3), 90, np.uint8)))
        log.truth(t_us, truth)
        log.outputs(outputs_at(t_us, truth, Run()))
    log.close()
    return open_log(path)


def rotated(quaternion: dict[str, float]) -> Any:
    """(3, 3) of a ROS quaternion."""
    x, y, z, w = (quaternion[axis] for axis in "xyzw")
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_truth_and_estimate_are_poses_and_frames(drawn: Log) -> None:
    frames = {}
    for message in drawn.messages("/viz/tf"):
        for one in message.value["transforms"]:
            frames[one["child_frame_id"]] = (message.t_us, one)
    assert {name: one["header"]["frame_id"] for name, (_, one) in frames.items()} == {
        "ned": "map",
        "frd": "ned",
        "cam": "frd",
        "tru": "ned",
    }
    t_us, true = frames["tru"]
    expected = truth_at(t_us * 1e-6)
    np.testing.assert_allclose([true["transform"]["translation"][axis] for axis in "xyz"], expected.pos_ned_m)
    np.testing.assert_allclose(rotated(true["transform"]["rotation"]), r_ned_from_frd(expected.rpy_rad), atol=1e-12)
    np.testing.assert_allclose(rotated(frames["cam"][1]["transform"]["rotation"]), R_FRD_FROM_CAM, atol=1e-12)
    estimate, truth = drawn["/viz/pose"], drawn["/viz/truth"]
    assert len(truth) > 25 and abs(len(estimate) - len(truth)) <= 1
    by_time = {int(m.t_us): m.value["pose"]["position"]["x"] for m in drawn.messages("/viz/truth")}
    for t_us, x in by_time.items():
        assert x == pytest.approx(truth_at(t_us * 1e-6).pos_ned_m[0])


def test_body_and_current_are_drawn_for_both(drawn: Log) -> None:
    body = drawn.messages("/viz/body")[-1].value["markers"]
    assert {(m["ns"], m["header"]["frame_id"], m["frame_locked"]) for m in body} == {
        ("body frd", "frd", True),
        ("body tru", "tru", True),
    }
    message = drawn.messages("/viz/current")[-1]
    arrows = {m["ns"]: m["points"] for m in message.value["markers"]}
    truth = truth_at(message.t_us * 1e-6)
    for name, share in (("current", 0.9), ("true current", 1.0)):
        tail, tip = (np.array([p[axis] for axis in "xyz"]) for p in arrows[name])
        np.testing.assert_allclose((tip - tail) * 0.2, share * truth.current_ned_m_s, atol=1e-9)


def test_pictures_have_their_camera_and_what_was_found_in_them(drawn: Log) -> None:
    pictures = [m.t_us for m in drawn.messages("/in/camera")]
    assert len(pictures) == 16
    infos = drawn.messages("/in/camera_info")
    assert [m.t_us for m in infos] == pictures
    assert infos[0].value["k"] == [80.0, 0.0, 31.0, 0.0, 81.0, 23.5, 0.0, 0.0, 1.0]
    assert infos[0].value["header"]["frame_id"] == "cam"
    found = drawn.messages("/viz/detections")
    last = pictures[-1] if pictures[-1] + SEEN_US <= 13_000_000 else pictures[-2]
    assert [m.t_us for m in found] == [t for t in pictures if t <= last]
    points = found[0].value["points"]
    assert len(points) == 3 and points[1]["points"][0] == {"x": 8.5, "y": 9.5}
    assert [text["text"] for text in found[0].value["texts"]] == ["3", "7", "3"]
    assert found[0].value["circles"][0]["position"] == {"x": 321.0, "y": 240.75}


def test_parameters_are_logged_as_they_change(drawn: Log) -> None:
    changes = drawn["/sys/parameters"]
    assert changes["t_us"].tolist() == [12_000_000] and changes["value"].tolist() == [25.0]
    assert bytes(changes["name"][0]).rstrip(b"\0") == b"MPC_Q_POS"
    params = ParamSet({"MPC_Q_POS": 30.0})
    assert params.take_changes() == {}
    params.set("MPC_Q_POS", 30.0)
    assert params.take_changes() == {}
    params.set("MPC_Q_POS", 31.0)
    params.set("SPD_CRUISE", 0.2)
    assert params.take_changes() == {"MPC_Q_POS": 31.0, "SPD_CRUISE": 0.2}
    assert params.take_changes() == {}
