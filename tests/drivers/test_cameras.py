"""Cameras: over the network as it is, from files; what hangs, goes, comes back, and who wins when several wait."""

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import wait
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer

from autopilot.core.errors import DriverError
from autopilot.core.samples import CameraFrame
from autopilot.core.vehicle import load_vehicle
from autopilot.drivers.opencv_camera import OpenCvCamera, OpenCvCameraOptions
from autopilot.drivers.playback import Playback, PlaybackOptions, compressed_picture
from autopilot.drivers.retry import DeviceState, SteadySensor
from autopilot.log.visuals import compressed_image
from autopilot.sitl.camera_process import MjpegServer

VEHICLE = load_vehicle("lbv150")
TRANSPORT_US = 30_000
"""Half of the vehicle's camera latency."""


def picture(number: int) -> np.ndarray:
    """A picture that says its number by its grey level."""
    return np.full((480, 640, 3), 20 + 6 * number, np.uint8)


def number(frame: CameraFrame) -> int:
    """The number of a picture, whatever compression made of it."""
    return round((float(frame.image_bgr.mean()) - 20) / 6)


def until(look: Callable[[], bool]) -> None:
    """Wait for something that happens on other threads."""
    for _ in range(2000):
        if look():
            return
        time.sleep(0.005)
    raise AssertionError("it does not happen")


@pytest.fixture
def server() -> Iterator[MjpegServer]:
    with MjpegServer() as made:
        yield made


class Show:
    """Shows pictures of a number over and over, as a camera does."""

    def __init__(self, server: MjpegServer) -> None:
        self.number, self.hangs = 1, False
        self._server, self._stop = server, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.01):
            if not self.hangs:
                self._server.show(CameraFrame(t_us=0, image_bgr=picture(self.number)))

    def end(self) -> None:
        self._stop.set()
        self._thread.join()


@pytest.fixture
def show(server: MjpegServer) -> Iterator[Show]:
    made = Show(server)
    yield made
    made.end()


def test_the_newest_picture_wins_over_a_network(server: MjpegServer, show: Show) -> None:
    clock = time.monotonic()

    def now_us() -> int:
        return round(1e6 * (time.monotonic() - clock))

    with OpenCvCamera(VEHICLE, OpenCvCameraOptions(source=server.url)) as camera:
        found: list[CameraFrame] = []

        def look(wanted: int) -> bool:
            found.extend(camera.poll(now_us()))
            return bool(found) and number(found[-1]) == wanted

        until(lambda: look(1))
        assert found[-1].image_bgr.shape == (480, 640, 3)
        show.number = 15
        missed = camera.missed
        until(lambda: camera.missed > missed + 20)  # nobody takes them
        show.number = 30
        until(lambda: look(30))
        assert {number(frame) for frame in found} <= {1, 15, 30}
        stamps = [frame.t_us for frame in found]
        assert stamps == sorted(set(stamps))
        assert stamps[-1] <= now_us() - TRANSPORT_US


def test_a_camera_that_is_polled_late_says_when_the_picture_came(server: MjpegServer, show: Show) -> None:
    options = OpenCvCameraOptions(source=server.url, latency_s=0.0)
    with OpenCvCamera(VEHICLE, options) as camera:
        start_us = time.monotonic_ns() // 1000
        camera.poll(0)
        show.number = 15
        shown_us = time.monotonic_ns() // 1000 - start_us
        assert shown_us > 0
        found: list[CameraFrame] = []

        def look() -> bool:
            found.extend(camera.poll(1))  # ticks that are very late: what they say is not what it is
            return bool(found) and number(found[-1]) == 15

        until(look)
        assert shown_us - 5_000 <= found[-1].t_us <= time.monotonic_ns() // 1000 - start_us


def test_a_camera_that_goes_is_down_and_there_again(server: MjpegServer, show: Show) -> None:
    steady = SteadySensor(OpenCvCamera(VEHICLE, OpenCvCameraOptions(source=server.url)), "camera")
    t_us = 0

    def pictures() -> bool:
        nonlocal t_us
        t_us += 10_000
        found = steady.poll(t_us)
        if steady._opening is not None:
            wait([steady._opening], 10.0)
        return bool(found)

    until(pictures)
    for _ in range(2):
        server.close()
        until(lambda: not pictures() and steady.state is DeviceState.DOWN)
        assert "cannot be opened" in steady.problem or "no more pictures" in steady.problem
        server.open()
        until(pictures)
    assert steady.opened_count == 3
    show.hangs = True  # the connection stands, and nothing comes
    until(lambda: not pictures() and steady.state is DeviceState.DOWN)
    show.hangs = False
    until(pictures)
    steady.close()


@pytest.mark.parametrize("source", ["/dev/video-not-there", "rtsp://127.0.0.1:9/video", "nowhere ! appsink"])
def test_a_camera_that_is_not_there_is_a_driver_error(source: str) -> None:
    camera = OpenCvCamera(VEHICLE, OpenCvCameraOptions(source=source))
    with pytest.raises(DriverError, match=r"cannot be opened by (v4l2|ffmpeg|gstreamer); check name, cable"):
        camera.open()
    assert camera.poll(0) == []
    camera.close()


def folder(path: Path) -> Path:
    for index in range(1, 31):
        cv2.imwrite(str(path / f"{index:04d}.png"), picture(index))
    (path / "notes.txt").write_text("not a picture")
    (path / "0007.png").write_bytes(b"not a picture either")
    return path


def video(path: Path) -> Path:
    writer = cv2.VideoWriter(str(path / "dive.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (640, 480))
    for index in range(1, 31):
        writer.write(picture(index))
    writer.release()
    return path / "dive.avi"


def log(path: Path) -> Path:
    with (path / "dive.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("sensor_msgs/CompressedImage", "ros2msg", b"")
        channel = writer.register_channel("/in/camera", "cdr", schema)
        for index in range(1, 31):
            _, jpeg = cv2.imencode(".jpg", picture(index))
            stamp_ns = 10**18 + round(1e9 * index / 30)
            writer.add_message(channel, stamp_ns, compressed_image(stamp_ns, jpeg.tobytes()), stamp_ns)
        writer.finish()
    return path / "dive.mcap"


@pytest.mark.parametrize("make", [folder, video, log])
def test_recorded_pictures_come_as_they_were_taken(make: Callable[[Path], Path], tmp_path: Path) -> None:
    found = []
    with Playback(VEHICLE, PlaybackOptions(path=str(make(tmp_path)))) as camera:
        for t_us in range(0, 1_200_000, 10_000):
            until(lambda: camera._next is None or camera._next.done())
            frames = camera.poll(t_us)
            assert len(frames) <= 1
            found += frames
        assert camera.ended
    first = [n for n in range(1, 31) if not (make is folder and n == 7)]
    assert [number(frame) for frame in found] == first
    for frame in found:
        assert frame.t_us == pytest.approx((number(frame) - 1) / 30 * 1e6 - TRANSPORT_US, abs=2)


def test_pictures_that_the_machine_does_not_follow_are_skipped(tmp_path: Path) -> None:
    with Playback(VEHICLE, PlaybackOptions(path=str(folder(tmp_path)), rate_hz=30.0, repeat=True)) as camera:
        until(lambda: camera.poll(0) != [])
        found: list[CameraFrame] = []

        def late() -> bool:
            found.extend(camera.poll(700_000))
            return number(found[-1]) == 22 if found else False

        until(late)
        until(lambda: [n for f in camera.poll(1_100_000) for n in [number(f)] if n < 10] != [])  # it has begun again


def test_what_holds_no_pictures_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(40))
    for name, text in [("empty", "holds no pictures"), ("bad.mcap", "no log that can be read"), ("no", "not there")]:
        with pytest.raises(DriverError, match=text):
            Playback(VEHICLE, PlaybackOptions(path=str(tmp_path / name))).open()


@given(st.binary(max_size=200), st.integers(0, 200))
def test_a_picture_is_found_in_any_message_or_none(data: bytes, cut: int) -> None:
    message = compressed_image(5, data)
    assert compressed_picture(message) == data
    found = compressed_picture(message[:cut])
    assert found is None or (found == data and cut >= len(message))
    compressed_picture(data)
