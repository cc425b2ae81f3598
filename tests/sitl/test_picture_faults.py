"""Pictures that look right and are not of here and now, by the camera and by the pose sensor."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from sensor_helpers import FLOOR_M, VEHICLE, height, renderer, truth_at

from autopilot.core.errors import ConfigError
from autopilot.core.samples import PoseSample
from autopilot.sitl.camera_feed import CameraFeed
from autopilot.sitl.fault_tables import (
    Delayed,
    Elsewhere,
    HalfFrozen,
    Mirrored,
    NearFrozen,
    PictureFault,
    Reflection,
    Repeated,
)
from autopilot.sitl.plant import Truth
from autopilot.sitl.pose_sensor import SimPoseSensor
from autopilot.sitl.scenario import load_scenario, scenario_path
from autopilot.sitl.sensor_tables import CameraSensor, LaserSensor, PoseSensor

AT_US, SPEED_M_S = 500_000, 0.3
EXACT = PoseSensor(drop_probability=0.0, sigma_xy_m=0.0, sigma_z_m=0.0, sigma_yaw_rad=0.0)


def moving(t_us: int) -> Truth:
    """Northwards at 0.3 m/s, turning at 0.1 rad/s."""
    t_s = 1e-6 * t_us
    return truth_at((SPEED_M_S * t_s - 0.5, 0.2, height(0.8)), (0.0, 0.0, 0.1 * t_s), t_us=t_us)


def pictures(fault: PictureFault | None, count: int) -> list[np.ndarray]:
    feed = CameraFeed(renderer(), CameraSensor(rate_hz=10.0, drop_probability=0.0), VEHICLE.eye, [], 1)
    assert fault is None or feed.add(fault)
    feed.open()
    for _ in range(count):
        feed.observe(moving(feed.next_us))
    found = feed.poll(10**9)
    feed.close()
    assert [frame.t_us for frame in found] == [100_000 * k for k in range(count)], "stamps go on"
    return [frame.image_bgr.astype(float) for frame in found]


def poses(fault: PictureFault) -> dict[int, PoseSample]:
    sensor = SimPoseSensor(EXACT, LaserSensor(enabled=False), VEHICLE, FLOOR_M, [fault], 1)
    while sensor.next_us < 2_000_000:
        sensor.observe(moving(sensor.next_us))
    return {sample.t_us: sample for sample in sensor.poll(10**9) if isinstance(sample, PoseSample)}


def test_near_frozen_differs_from_picture_to_picture_by_its_noise_alone() -> None:
    sound, near = pictures(None, 8), pictures(NearFrozen(at_s=0.5, noise_levels=2.0), 8)
    assert all(np.array_equal(a, b) for a, b in zip(sound[:5], near[:5], strict=True))
    steps = [near[k + 1] - near[k] for k in (5, 6)]
    assert all(1.5 < step.std() < 3.0 for step in steps), "two levels each"
    assert (sound[7] - near[7]).std() > 20.0


def test_a_loop_shows_the_last_pictures_again() -> None:
    sound, looped = pictures(None, 9), pictures(Repeated(at_s=0.5, pictures=2), 9)
    for k in range(5, 9):
        assert np.array_equal(looped[k], sound[3 + (k - 5) % 2])


def test_delayed_pictures_are_of_before() -> None:
    sound, late = pictures(None, 8), pictures(Delayed(at_s=0.5, delay_s=0.3), 8)
    assert all(np.array_equal(late[k], sound[k - 3]) for k in range(5, 8))


@pytest.mark.parametrize(("across", "axis"), [("columns", 1), ("rows", 0), ("both", -1)])
def test_mirrored_pictures(across: Any, axis: int) -> None:
    sound, mirrored = pictures(None, 6), pictures(Mirrored(at_s=0.5, across=across), 6)
    np.testing.assert_array_equal(mirrored[5], cv2.flip(sound[5], axis))


def test_half_of_the_picture_stands_still() -> None:
    sound = pictures(None, 8)
    half = pictures(HalfFrozen(at_s=0.5, part="left", share=0.25, noise_levels=0.0), 8)
    assert np.array_equal(half[7][:, 160:], sound[7][:, 160:])
    assert np.array_equal(half[7][:, :160], sound[5][:, :160])


def test_a_reflection_is_blended_in() -> None:
    sound, shining = pictures(None, 6), pictures(Reflection(at_s=0.5, strength=0.3), 6)
    beside = shining[5] - 0.7 * sound[5]
    assert np.abs(beside).max() <= 0.3 * 255 + 1 and beside.std() > 3.0
    assert np.array_equal(shining[4], sound[4])


def test_pictures_of_another_place_stand_or_follow() -> None:
    standing = poses(Elsewhere(at_s=0.5, offset_m=(1.0, 0.5, 0.0), yaw_rad=0.5))
    following = poses(Elsewhere(at_s=0.5, offset_m=(1.0, 0.5, 0.0), yaw_rad=0.5, follows=True))
    first = moving(min(t for t in standing if t >= AT_US))
    for t_us in (t for t in standing if t >= AT_US):
        there = first.pos_ned_m + np.array([1.0, 0.5, 0.0])
        np.testing.assert_allclose(standing[t_us].pos_ned_m, there, atol=1e-9)
        now = moving(t_us)
        way_m = now.pos_ned_m[0] - first.pos_ned_m[0]
        turned = there + way_m * np.array([np.cos(0.5), np.sin(0.5), 0.0])
        np.testing.assert_allclose(following[t_us].pos_ned_m, turned, atol=1e-9)
        assert following[t_us].yaw_rad == pytest.approx(now.rpy_rad[2] + 0.5)


def test_the_pose_sensor_has_them_as_the_camera_has() -> None:
    frozen, late = poses(NearFrozen(at_s=0.5, duration_s=0.5)), poses(Delayed(at_s=0.5, delay_s=0.3))
    held = [s.pos_ned_m[0] for t, s in frozen.items() if AT_US <= t < 1_000_000]
    assert len(held) > 10 and np.ptp(held) == 0.0
    assert frozen[1_000_000].pos_ned_m[0] == pytest.approx(moving(1_000_000).pos_ned_m[0])
    assert late[1_500_000].pos_ned_m[0] == pytest.approx(moving(1_200_000).pos_ned_m[0], abs=1e-6)
    assert max(poses(Mirrored(at_s=0.5))) < AT_US, "no pose of a mirrored picture"
    halves = [s.pos_ned_m[0] for t, s in poses(HalfFrozen(at_s=0.5)).items() if t >= 1_900_000]
    assert np.ptp(halves) > 0.3, "either half in turn"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('kind = "camera_near_frozen"\nat_s = 1.0\nnoise = 2.0', "unknown field `noise`"),
        ('kind = "camera_repeated"\nat_s = 1.0\npictures = 0', "pictures"),
        ('kind = "camera_delayed"\nat_s = 1.0', "delay_s"),
        ('kind = "camera_delayed"\nat_s = 1.0\ndelay_s = 60.0', "delay_s"),
        ('kind = "camera_half_frozen"\nat_s = 1.0\npart = "middle"', "part"),
        ('kind = "camera_mirrored"\nat_s = 1.0\nacross = "time"', "across"),
        ('kind = "camera_reflection"\nat_s = 1.0\nstrength = 1.5', "strength"),
        ('kind = "camera_elsewhere"\noffset_m = [1.0, 0.0, 0.0]', "at_s"),
    ],
)
def test_wrong_keys_and_values_are_named(tmp_path: Path, table: str, message: str) -> None:
    path = tmp_path / "scenario.toml"
    text = scenario_path("paper-tank").read_text(encoding="utf-8")
    path.write_text(f"{text}\n[[fault]]\n{table}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=message):
        load_scenario(str(path))
