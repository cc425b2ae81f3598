"""Recorded images as a camera: a folder of images, a video file, or the images of a log (MCAP).

They are delivered at their recorded times, counted from the first poll; the next one is decoded on a thread meanwhile,
and images that the machine cannot process in time are skipped.
"""

import struct
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from autopilot.core.daemon_executor import DaemonExecutor
from autopilot.core.errors import DriverError
from autopilot.core.samples import CameraFrame
from autopilot.core.toml_table import Positive, Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.base import Closing
from autopilot.drivers.opencv_camera import LATENCY_FRACTION

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
TOPIC = "/in/camera"

Picture = tuple[float, Any]
"""Time since the first [s], image (BGR)."""


class PlaybackOptions(Table, frozen=True, kw_only=True):
    """``[devices.camera]`` with ``driver = "playback"``."""

    path: str
    """A folder of images (in the order of their names), a video file, or a log (.mcap)."""
    rate_hz: Positive | None = None
    """Pictures per second; absent = as recorded, a folder at the vehicle file's rate."""
    repeat: bool = False
    """Begin again at the end."""


class Playback(Closing):
    """A :class:`autopilot.drivers.protocols.Sensor` of pictures."""

    Options = PlaybackOptions

    def __init__(self, vehicle: Vehicle, options: PlaybackOptions) -> None:
        self._options = options
        self._path = Path(options.path)
        self._folder_hz = options.rate_hz or vehicle.eye.rate_hz
        self._transport_us = round(1e6 * LATENCY_FRACTION * vehicle.eye.latency_s)
        self._executor: DaemonExecutor | None = None
        self._pictures: Iterator[Picture] = iter(())
        self._next: Future[Picture | None] | None = None
        self._start_us: int | None = None
        self.ended = False
        """Whether all pictures have been shown."""

    def open(self) -> None:
        """Begin at the first picture. DriverError if there is none."""
        if self._executor is not None:
            return
        pictures = self._all()
        first = next(pictures, None)
        if first is None:
            raise DriverError(
                f"{self._path} holds no pictures; give a folder of images, a video or a log with pictures"
            )
        self._pictures, self._start_us, self.ended = pictures, None, False
        self._executor = DaemonExecutor("playback")
        self._next = self._executor.submit(lambda: first)

    def close(self) -> None:
        executor, self._executor, self._next = self._executor, None, None
        if executor is not None:
            executor.shutdown(wait=False, cancel_futures=True)

    def poll(self, t_us: int) -> list[CameraFrame]:
        """The newest picture that is due and decoded."""
        newest: list[CameraFrame] = []
        while self._executor is not None and self._next is not None and self._next.done():
            picture = self._next.result()
            if picture is None:
                self.ended, self._next = True, None
                break
            self._start_us = t_us if self._start_us is None else self._start_us
            taken_us = self._start_us + round(1e6 * picture[0]) - self._transport_us
            if taken_us + self._transport_us > t_us:
                break
            newest = [CameraFrame(t_us=taken_us, image_bgr=picture[1])]
            self._next = self._executor.submit(lambda: next(self._pictures, None))
        return newest

    def _all(self) -> Iterator[Picture]:
        offset_s = 0.0
        while True:
            last_s = 0.0
            gap_s = 1.0 / self._folder_hz
            for time_s, image in self._once():
                gap_s = time_s - last_s if time_s > last_s else gap_s
                last_s = time_s
                yield offset_s + time_s, image
            offset_s += last_s + gap_s
            if not self._options.repeat or last_s == 0.0:
                return

    def _once(self) -> Iterator[Picture]:
        if self._path.is_dir():
            return _folder(self._path, self._folder_hz)
        if not self._path.is_file():
            raise DriverError(f"{self._path} is not there; correct `path`")
        if self._path.suffix == ".mcap":
            return _log(self._path, self._options.rate_hz)
        return _video(self._path, self._options.rate_hz)


def _folder(path: Path, rate_hz: float) -> Iterator[Picture]:
    import cv2

    names = sorted(name for name in path.iterdir() if name.suffix.lower() in IMAGES)
    for index, name in enumerate(names):
        image = cv2.imread(str(name), cv2.IMREAD_COLOR)
        if image is not None:  # one that cannot be read is left out, its time passes
            yield index / rate_hz, image


def _video(path: Path, rate_hz: float | None) -> Iterator[Picture]:
    import cv2

    capture = cv2.VideoCapture(str(path))
    try:
        rate_hz = rate_hz or float(capture.get(cv2.CAP_PROP_FPS)) or 30.0
        index = 0
        while capture.isOpened():
            good, image = capture.read()
            if not good:
                return
            yield index / rate_hz, image
            index += 1
    finally:
        capture.release()


def _log(path: Path, rate_hz: float | None) -> Iterator[Picture]:
    import cv2
    import numpy as np
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        start_ns: int | None = None
        index = 0
        try:
            for _, _, message in make_reader(stream).iter_messages(topics=[TOPIC]):
                data = compressed_picture(message.data)
                image = None if data is None else cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
                start_ns = message.log_time if start_ns is None else start_ns
                if image is not None:
                    yield index / rate_hz if rate_hz else 1e-9 * (message.log_time - start_ns), image
                index += 1
        except McapError as error:
            if index == 0:
                raise DriverError(f"{path} is no log that can be read ({error}); try autopilot log recover") from error


def compressed_picture(data: bytes) -> bytes | None:
    """The encoded picture in a sensor_msgs/CompressedImage (CDR, little-endian); None if that is none."""
    try:
        at = 4 + 8  # encapsulation, stamp
        for _ in range(2):  # frame id, format
            (length,) = struct.unpack_from("<I", data, at)
            at += 4 + length
            at += -(at - 4) % 4
        (length,) = struct.unpack_from("<I", data, at)
    except struct.error:
        return None
    picture = data[at + 4 : at + 4 + length]
    return picture if len(picture) == length else None
