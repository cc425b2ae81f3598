"""MAVSDK's camera, gimbal and gripper plugins against a service in its own process, in real time."""

import time
from collections.abc import Callable
from typing import Any

import mavsdk
import pytest
from mavsdk.plugins.camera import Camera, CameraError, CameraResult, Mode
from mavsdk.plugins.gimbal import ControlMode, Gimbal, GimbalError
from mavsdk.plugins.gripper import Gripper, GripperError
from system_harness import RunningService


def _until(service: RunningService, done: Callable[[], Any]) -> Any:
    """What it gives as soon as it gives something."""
    while not (found := done()):
        service.keep_waiting(cpu_s=120.0)
        time.sleep(0.1)
    return found


@pytest.mark.long
def test_photos_refusals_and_a_gimbal_that_is_not_there(service: Callable[..., RunningService]) -> None:
    running = service("--sensors", "camera", speed=1.0)
    mavsdk.log_subscribe(lambda *args: True)
    configuration = mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION)
    with mavsdk.Mavsdk(configuration) as sdk:
        sdk.add_any_connection(f"udpout://127.0.0.1:{running.port}")
        system = _until(running, lambda: sdk.first_autopilot(5.0))
        camera = Camera(system)
        (about,) = _until(running, lambda: camera.camera_list().cameras)
        assert (about.horizontal_resolution_px, about.vertical_resolution_px) == (640, 480)
        # At once, not when MAVSDK asks for them some seconds later.
        storage = camera.get_storage(about.component_id)
        assert storage.storage_id == 1 and camera.get_mode(about.component_id) == Mode.PHOTO
        taken: list[Any] = []
        camera.subscribe_capture_info(lambda info, *_: taken.append(info))
        number = about.component_id
        camera.take_photo(number)
        first = _until(running, lambda: taken)[0]
        assert first.is_success and first.index == 0
        assert first.file_url.endswith("service.still-0000.png")
        camera.start_photo_interval(number, 0.5)
        _until(running, lambda: len(taken) >= 3)
        camera.stop_photo_interval(number)
        assert [info.index for info in taken[:3]] == [0, 1, 2]
        camera.set_mode(number, Mode.PHOTO)
        camera.reset_settings(number)
        for refused in (
            lambda: camera.set_mode(number, Mode.VIDEO),
            lambda: camera.start_video(number),
            lambda: camera.stop_video(number),
            lambda: camera.start_video_streaming(number, 1),
            lambda: camera.format_storage(number, 1),
            lambda: camera.zoom_in_start(number),
        ):
            with pytest.raises(CameraError) as said:
                refused()
            assert CameraResult.DENIED in said.value.args or "DENIED" in str(said.value)
        gimbal = Gimbal(system)
        assert gimbal.gimbal_list().gimbals == []
        with pytest.raises(GimbalError):
            gimbal.take_control(154, ControlMode.PRIMARY)
        gripper = Gripper(system)
        gripper.grab(1)
        gripper.release(1)
        with pytest.raises(GripperError):
            gripper.grab(3)
    running.child.end()
    assert len(list(running.log.parent.glob("service.still-*.png"))) >= 3
