"""Camera through OpenCV's VideoCapture: V4L2, RTSP and other network streams, or a GStreamer pipeline.

A thread grabs and stamps, so that a slow or hanging camera does not block the loop; of several images since the last
poll the newest is used. Stamps follow those of the stream, or the period of the grabs (:mod:`.drivers.frame_clock`);
the mean time from exposure to grab is ``latency_s``, and ``autopilot calibrate latency`` measures the remainder.
"""

import os
import re
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec

from autopilot.core.errors import DriverError
from autopilot.core.samples import CameraFrame
from autopilot.core.toml_table import NonNegative, Positive, Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.base import Closing
from autopilot.drivers.drivers_tuning import FRAMES
from autopilot.drivers.frame_clock import FrameClock, LoopTime, StreamClock, machine_us

DEAD_US = 3_000_000
"""Without a picture for so long the camera is gone."""
TIMEOUT_MS = 3000
"""For opening and reading network streams."""
JOIN_S = 0.5
HELD_PICTURES = 1
"""FFmpeg gives a picture of H.264 away when the next one begins."""
LATENCY_FRACTION = 0.5
"""Part of the vehicle file's camera latency that passes before the grab; the rest is for finding the markers."""
FFMPEG_OPTIONS = {
    "OPENCV_FFMPEG_CAPTURE_OPTIONS": "fflags;nobuffer|flags;low_delay|analyzeduration;200000|probesize;65536",
    "OPENCV_FFMPEG_LOGLEVEL": "-8",
}
"""For live streams; what FFmpeg would print when one ends stands in our own error."""

RTP_OPTIONS = {
    "OPENCV_FFMPEG_CAPTURE_OPTIONS": "protocol_whitelist;file,rtp,udp|fflags;nobuffer+discardcorrupt|flags;low_delay"
    "|max_delay;0|reorder_queue_size;0|analyzeduration;2500000|probesize;5000000"
}
"""What H.264 looks like is told with its key pictures only: wait for one."""
SDP = """v=0
o=- 0 0 IN IP4 {host}
s=camera
c=IN IP4 {host}
t=0 0
m=video {port} RTP/AVP 96
a=rtpmap:96 H264/90000
"""
"""RFC 8866, for pictures that are sent without a description."""
_RTP = re.compile(r"rtp://(?P<host>[0-9.]+):(?P<port>\d{1,5})")

_OPENING = threading.Lock()

_BACKENDS = {"v4l2": "CAP_V4L2", "ffmpeg": "CAP_FFMPEG", "gstreamer": "CAP_GSTREAMER"}


class OpenCvCameraOptions(Table, frozen=True, kw_only=True):
    """``[devices.camera]`` with ``driver = "opencv"``."""

    source: str
    """"/dev/video0", "rtsp://192.168.2.2:8554/video", "http://...", "rtp://0.0.0.0:5600" (H.264 that is sent to that
    port of this machine), or a pipeline that ends in "! appsink"."""
    backend: Literal["auto", "v4l2", "ffmpeg", "gstreamer"] = "auto"
    """auto: V4L2 for a device, GStreamer for a pipeline, FFmpeg for the rest."""
    format: Annotated[str, msgspec.Meta(pattern="^[A-Z0-9]{4}$")] | None = None
    """V4L2: four letters, e.g. "MJPG"."""
    exposure: float | None = None
    """V4L2: fixed exposure in the camera's own unit (often 0.1 ms); absent = left alone. Markers want a short one."""
    gain: float | None = None
    latency_s: NonNegative | None = None
    """Exposure to arrival; absent = half of the vehicle file's ``camera.latency_s``."""
    rate_hz: Positive | None = None
    """V4L2: absent = the vehicle file's."""

    @property
    def chosen(self) -> str:
        """The back end that "auto" stands for."""
        if self.backend != "auto":
            return self.backend
        if self.source.startswith("/dev/"):
            return "v4l2"
        return "gstreamer" if "!" in self.source else "ffmpeg"

    @property
    def is_rtp(self) -> bool:
        return self.source.startswith(("rtp://", "rtsp://"))

    @property
    def stamped(self) -> bool:
        """Whether each picture comes with the time at which it was taken; for others FFmpeg makes one up."""
        return self.is_rtp or self.chosen == "v4l2"


@contextmanager
def _ffmpeg_source(source: str) -> Iterator[str]:
    """What FFmpeg opens for a source. OpenCV takes its options from the environment only: set while a stream is
    opened, unless set by the user.
    """
    rtp = _RTP.fullmatch(source)
    options = FFMPEG_OPTIONS if rtp is None else FFMPEG_OPTIONS | RTP_OPTIONS
    with _OPENING, tempfile.TemporaryDirectory(prefix="camera-") as folder:
        if rtp is not None:
            description = Path(folder) / "camera.sdp"
            description.write_text(SDP.format(host=rtp["host"], port=rtp["port"]), encoding="ascii")
            source = str(description)
        ours = {name: value for name, value in options.items() if name not in os.environ}
        os.environ.update(ours)
        try:
            yield source
        finally:
            for name in ours:
                del os.environ[name]


class _Grabbed(NamedTuple):
    """A picture; times by :func:`machine_us`."""

    grabbed_us: int
    beat_us: int
    """The grab at the mean delay,"""
    sigma_us: float
    """and its standard deviation."""
    image: Any


class _Grabber:
    """The thread of one opening: it owns its capture and lets go of it when it ends, even late."""

    def __init__(self, capture: Any, *, stamped: bool) -> None:
        self._capture, self._stamped = capture, stamped
        self._lock = threading.Lock()
        self._newest: _Grabbed | None = None
        self.stopped = False
        self.failed = ""
        self.missed = 0
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    def take(self) -> "_Grabbed | None":
        """The newest picture that has not been taken."""
        with self._lock:
            newest, self._newest = self._newest, None
        return newest

    def stop(self) -> None:
        """End soon; a camera that hangs is left to its thread."""
        self.stopped = True
        self._thread.join(JOIN_S)

    def _run(self) -> None:
        import cv2

        beat, stream = FrameClock(), StreamClock()
        try:
            while not self.stopped:
                if not self._capture.grab():
                    self.failed = "gives no more pictures"
                    return
                grabbed_us = machine_us()
                beat_us, stamped_us = beat.stamp(grabbed_us), None
                if self._stamped:
                    stamped_us = stream.stamp(grabbed_us, 1e3 * self._capture.get(cv2.CAP_PROP_POS_MSEC))
                if stamped_us is None:
                    sigma_us = beat.sigma_us
                else:
                    beat_us, sigma_us = stamped_us, FRAMES.stream_sigma_us
                good, image = self._capture.retrieve()
                if not good or image is None:
                    self.missed += 1
                    continue
                with self._lock:
                    self.missed += self._newest is not None
                    self._newest = _Grabbed(grabbed_us, beat_us, sigma_us, image)
        except Exception as error:  # noqa: BLE001 - OpenCV raises errors of its own; poll reports them to the loop
            self.failed = str(error) or type(error).__name__
        finally:
            self._capture.release()


class OpenCvCamera(Closing):
    """A :class:`autopilot.drivers.protocols.Sensor` of pictures."""

    Options = OpenCvCameraOptions

    def __init__(self, vehicle: Vehicle, options: OpenCvCameraOptions) -> None:
        eye = vehicle.eye
        self._options = options
        self._size = eye.width_px, eye.height_px
        self._rate_hz = options.rate_hz or eye.rate_hz
        latency_s = LATENCY_FRACTION * eye.latency_s if options.latency_s is None else options.latency_s
        held_s = HELD_PICTURES / self._rate_hz if options.is_rtp else 0.0
        self._latency_us = round(1e6 * (latency_s + held_s))
        self._grabber: _Grabber | None = None
        self._time = LoopTime()
        self._last_frame_us: int | None = None
        self._last_us = -(1 << 62)
        self.remarks: list[str] = []
        """Settings refused by the camera."""

    @property
    def missed(self) -> int:
        """Pictures that were replaced by newer ones, or were damaged, since the camera was opened."""
        return 0 if self._grabber is None else self._grabber.missed

    def open(self) -> None:
        """Open the camera, which may take seconds. DriverError if it is not there."""
        if self._grabber is not None:
            return
        import cv2

        options, backend = self._options, self._options.chosen
        # Our own error contains what OpenCV would print at every attempt.
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        times = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, TIMEOUT_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, TIMEOUT_MS]
        # Each further thread of FFmpeg's decoder delays pictures by one.
        params = [*times, cv2.CAP_PROP_N_THREADS, 1] if backend == "ffmpeg" else []
        try:
            with _ffmpeg_source(options.source) as source:
                capture = cv2.VideoCapture(source, getattr(cv2, _BACKENDS[backend]), params)
        except cv2.error as error:
            raise DriverError(f"{options.source}: {error}; check `source` and `backend`") from error
        if not capture.isOpened():
            raise DriverError(f"{options.source} cannot be opened by {backend}; check name, cable and users of it")
        self.remarks = self._set_up(capture, cv2) if backend == "v4l2" else []
        self._last_frame_us, self._grabber = None, _Grabber(capture, stamped=options.stamped)

    def close(self) -> None:
        grabber, self._grabber = self._grabber, None
        if grabber is not None:
            grabber.stop()

    def poll(self, t_us: int) -> list[CameraFrame]:
        """The newest picture, if there is a new one. DriverError when the camera is gone."""
        self._time.observe(t_us, machine_us())
        grabber = self._grabber
        if grabber is None:
            return []
        newest = grabber.take()
        if newest is None:
            if grabber.failed:
                raise DriverError(f"{self._options.source} {grabber.failed}; check cable and power")
            self._last_frame_us = t_us if self._last_frame_us is None else self._last_frame_us
            if t_us - self._last_frame_us > DEAD_US:
                raise DriverError(f"{self._options.source} hangs; check cable and power")
            return []
        self._last_frame_us = t_us
        taken_us = min(self._time.at(newest.beat_us) - self._latency_us, self._time.at(newest.grabbed_us))
        if taken_us <= self._last_us:
            return []
        self._last_us = taken_us
        return [CameraFrame(t_us=taken_us, image_bgr=newest.image, stamp_sigma_s=1e-6 * newest.sigma_us)]

    def _set_up(self, capture: Any, cv2: Any) -> list[str]:
        """Set size, rate, exposure, and a buffer of one image; returns the refused settings."""
        options, width_height = self._options, self._size
        wanted: list[tuple[str, int, float]] = []
        if options.format is not None:
            code = cv2.VideoWriter_fourcc(*options.format)
            wanted.append((f"format {options.format}", cv2.CAP_PROP_FOURCC, code))
        wanted += [
            (f"width {width_height[0]}", cv2.CAP_PROP_FRAME_WIDTH, width_height[0]),
            (f"height {width_height[1]}", cv2.CAP_PROP_FRAME_HEIGHT, width_height[1]),
            (f"rate {self._rate_hz:g} Hz", cv2.CAP_PROP_FPS, self._rate_hz),
        ]
        if options.exposure is not None:
            capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, 1)  # V4L2: manual
            wanted.append((f"exposure {options.exposure:g}", cv2.CAP_PROP_EXPOSURE, options.exposure))
        if options.gain is not None:
            wanted.append((f"gain {options.gain:g}", cv2.CAP_PROP_GAIN, options.gain))
        for _, number, value in wanted:
            capture.set(number, value)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        found = [(name, value, float(capture.get(number))) for name, number, value in wanted]
        return [
            f"{name}: the camera says {got:g}" for name, value, got in found if abs(got - value) > 0.02 * abs(value)
        ]
