"""A simulated camera in a process of its own: renders what the vehicle sees and sends it as a network camera does.

Rendering and packing take most of a core; what simulates or flies the vehicle must not lack it. The parent sends the
truth of every exposure through a pipe and never waits: what the process cannot follow is a lost picture.
"""

import contextlib
import json
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from queue import Empty, SimpleQueue
from typing import IO, Any, NamedTuple

import cv2

from autopilot.core.errors import ConfigError
from autopilot.core.frames import r_ned_from_frd, rpy_from_r
from autopilot.core.own_python import python_command
from autopilot.core.samples import CameraFrame
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.base import Closing
from autopilot.drivers.frame_clock import LoopTime, machine_us
from autopilot.sitl.camera_feed import CameraFeed, is_of_camera, simulated_camera
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Fault, Scenario
from autopilot.sitl.sitl_tuning import CAMERA_FEED

STREAM_US = 50_000
"""What encoder and network of an IP camera add at least."""
LOOK_S = 0.004
"""The process looks for pictures that are due this often."""
RECENT = 6
"""Exposures by which pictures are timed. A simulation that fell behind the clock stays behind: by the punctual ones of
some seconds its pictures would come before they are due."""
NICER = 5
"""On a busy computer pictures are lost, not control steps."""
END_S = 5.0
QUALITY = 90
BOUNDARY = b"frame"
_HEAD = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=" + BOUNDARY + b"\r\n\r\n"
SEND_S = 1.0
"""A client that takes nothing for so long is left."""
RTP_HZ = 90_000
KEY_EVERY = 30
"""Pictures between two that need no other: who listens later, or has lost one, sees after as many at most."""
BIT_RATE = 5_000_000
"""As these cameras are set up, for pictures of 640 x 480 as well."""
PACKET_BYTES = 1300


class RtpSender(Closing):
    """H.264 over RTP (RFC 6184): sends each picture at once; nobody need listen.

    Encoded by the library PyAV (extra ``rtp``). A stamp of RTP is the time of exposure at 90 kHz."""

    def __init__(self, host: str, port: int, rate_hz: float) -> None:
        self.port, self._host = port, host
        self._rate_hz = rate_hz
        self._container: Any = None
        self._stream: Any = None

    def open(self) -> None:
        """ConfigError without the library. OSError if nothing can be sent there."""
        try:
            import av
        except ImportError as error:
            raise ConfigError("H.264 needs PyAV; install underwater-autopilot[rtp], or use MJPEG") from error
        url = f"rtp://{self._host}:{self.port}?pkt_size={PACKET_BYTES}"
        self._container = av.open(url, "w", format="rtp")

    def close(self) -> None:
        container, self._container, self._stream = self._container, None, None
        if container is not None:
            with suppress(OSError):
                container.close()

    def show(self, frame: CameraFrame) -> None:
        """Send this picture; one that cannot be sent is lost."""
        import av

        if self._container is None:
            return
        if self._stream is None:
            self._stream = self._encoder(*frame.image_bgr.shape[:2])
        picture = av.VideoFrame.from_ndarray(frame.image_bgr, format="bgr24")
        picture.pts, picture.time_base = frame.t_us * RTP_HZ // 1_000_000, Fraction(1, RTP_HZ)
        with suppress(OSError):
            for packet in self._stream.encode(picture):
                self._container.mux(packet)

    def _encoder(self, height_px: int, width_px: int) -> Any:
        from av.codec.context import Flags

        stream = self._container.add_stream("libx264", rate=round(self._rate_hz))
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = width_px, height_px, "yuv420p", BIT_RATE
        stream.time_base = stream.codec_context.time_base = Fraction(1, RTP_HZ)
        stream.options = {
            "preset": "ultrafast",
            "tune": "zerolatency",
            "x264-params": f"repeat-headers=1:keyint={KEY_EVERY}",
        }
        stream.codec_context.flags &= ~Flags.global_header  # the stream itself tells what it is, again and again
        return stream


class MjpegServer(Closing):
    """MJPEG over HTTP: the newest picture to every client, each on a thread of its own; a slow one misses some."""

    def __init__(self, port: int = 0, host: str = "127.0.0.1") -> None:
        """``port`` 0: any that is free."""
        self.port, self._host = port, host
        self._listener: socket.socket | None = None
        self._newest: tuple[int, CameraFrame | None] = (0, None)
        self._fresh = threading.Condition()
        self.clients = 0

    @property
    def url(self) -> str:
        """URL for a camera driver."""
        return f"http://{self._host}:{self.port}/video.mjpg"

    def open(self) -> None:
        if self._listener is None:
            self._listener = socket.create_server((self._host, self.port))
            self.port = self._listener.getsockname()[1]
            threading.Thread(target=self._accept, args=(self._listener,), name="mjpeg", daemon=True).start()

    def close(self) -> None:
        listener, self._listener = self._listener, None
        if listener is not None:
            with suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)
            listener.close()
        with self._fresh:
            self._fresh.notify_all()

    def show(self, frame: CameraFrame) -> None:
        """Send this picture from now on. It is packed by those who send it."""
        with self._fresh:
            self._newest = self._newest[0] + 1, frame
            self._fresh.notify_all()

    def _accept(self, listener: socket.socket) -> None:
        with suppress(OSError):  # closed
            while True:
                client, _ = listener.accept()
                threading.Thread(target=self._serve, args=(client, listener), name="mjpeg", daemon=True).start()

    def _serve(self, client: socket.socket, listener: socket.socket) -> None:
        self.clients += 1
        with client, suppress(OSError):
            client.settimeout(SEND_S)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client.recv(4096)
            client.sendall(_HEAD)
            shown = 0
            while self._listener is listener:
                shown, jpeg = self._after(shown, listener)
                if jpeg:
                    size = str(len(jpeg)).encode()
                    head = b"--" + BOUNDARY + b"\r\nContent-Type: image/jpeg\r\nContent-Length: " + size + b"\r\n\r\n"
                    client.sendall(head + jpeg + b"\r\n")
        self.clients -= 1

    def _after(self, shown: int, listener: socket.socket) -> tuple[int, bytes]:
        """Wait for a picture that is newer than number ``shown``: its number and bytes; none after a while."""
        with self._fresh:
            self._fresh.wait_for(lambda: self._newest[0] != shown or self._listener is not listener, 1.0)
            number, frame = self._newest
        if number == shown or frame is None:
            return shown, b""
        good, jpeg = cv2.imencode(".jpg", frame.image_bgr, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        return number, jpeg.tobytes() if good else b""


class CameraPlace(NamedTuple):
    """Where pictures are had: MJPEG is served there over HTTP, H.264 is sent there over RTP."""

    host: str
    port: int
    """0 = any that is free; not for RTP."""
    rtp: bool = False


@dataclass(frozen=True, slots=True)
class CameraSetup:
    """What the process is told first."""

    scenario: Scenario
    vehicle: Vehicle
    seed: int
    place: CameraPlace


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    clock_us: int
    """Time by :func:`machine_us`."""
    truth: Truth
    off_rad: float
    """Tilt of the camera: see :meth:`CameraFeed.tilt`."""


class CameraProcess(Closing):
    """The parent's end."""

    def __init__(
        self,
        scenario: Scenario,
        vehicle: Vehicle,
        seed: int,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        rtp: bool = False,
    ) -> None:
        """See :class:`CameraPlace`. ConfigError if the scenario has no floor or the vehicle no camera."""
        if scenario.tank is None:
            raise ConfigError(f"scenario {scenario.scenario.name!r} has no [tank], so there is no floor for the camera")
        sensor, eye = scenario.sensors.camera, vehicle.eye
        self._setup = CameraSetup(scenario, vehicle, seed, CameraPlace(host, port, rtp))
        self._rate_hz = sensor.rate_hz or eye.rate_hz
        latency_s = eye.latency_s if sensor.latency_s is None else sensor.latency_s
        self.latency_s = CAMERA_FEED.transport_fraction * latency_s + 1e-6 * STREAM_US
        """Mean time from exposure to arrival, as a camera driver is told."""
        self._count = 0
        self._off_rad = 0.0
        self.lost = 0
        """Exposures that the process could not take."""
        self._child: subprocess.Popen[bytes] | None = None

    @property
    def next_us(self) -> int:
        """When the next picture is exposed."""
        return int(self._count * 1e6 / self._rate_hz)

    @property
    def url(self) -> str:
        """For a camera driver; the port is known once it is open."""
        place = self._setup.place
        if place.rtp:
            return f"rtp://{place.host}:{place.port}"
        return f"http://{place.host}:{place.port}/video.mjpg"

    def open(self) -> None:
        """Start it and wait until it serves. ConfigError if it cannot."""
        if self._child is not None:
            return
        child = subprocess.Popen(
            python_command("from autopilot.sitl.camera_process import serve; serve()"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self._child = child
        said = b""
        with contextlib.suppress(BrokenPipeError):
            to_child = _pipe(child.stdin)
            pickle.dump(self._setup, to_child)
            to_child.flush()
            said = _pipe(child.stdout).readline()
        place = self._setup.place
        answer = json.loads(said or '{"error": "it ended; its message is above"}')
        if "error" in answer:
            self.close()
            raise ConfigError(f"camera at {place.host}:{place.port}: {answer['error']}")
        os.set_blocking(_pipe(child.stdin).fileno(), False)
        self._setup = replace(self._setup, place=place._replace(port=answer["port"]))

    def close(self) -> None:
        child, self._child = self._child, None
        if child is None:
            return
        for end in (child.stdin, child.stdout):
            with contextlib.suppress(OSError):
                _pipe(end).close()
        try:
            child.wait(END_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()

    def restart(self) -> None:
        """Time begins anew."""
        self.close()
        self._count = 0
        self.open()

    def tilt(self, off_rad: float) -> None:
        """See :meth:`CameraFeed.tilt`."""
        self._off_rad = off_rad

    def observe(self, truth: Truth) -> None:
        """Expose what is due at ``truth.t_us`` or was since the truth before. ConfigError if the process has ended."""
        while truth.t_us >= self.next_us:
            exposed_us = self.next_us
            self._count += 1
            if truth.t_us < self.next_us:  # of several only the last: the others were due while nobody looked
                clock_us = machine_us() + exposed_us - truth.t_us
                self._send(Exposure(clock_us, _moved(truth, exposed_us), self._off_rad))

    def add(self, fault: Fault) -> bool:
        """A fault that begins while the simulation runs; whether it is one of this sensor."""
        if is_of_camera(fault):
            self._send(fault)
        return is_of_camera(fault)

    def _send(self, message: Exposure | Fault) -> None:
        if self._child is None:
            return
        data = pickle.dumps(message)
        try:
            os.write(_pipe(self._child.stdin).fileno(), data)  # less than PIPE_BUF: all of it or nothing
        except BlockingIOError:
            self.lost += 1
        except BrokenPipeError as error:
            raise ConfigError(f"the camera at {self.url} has ended; its message is above") from error


def opened_camera(
    scenario: Scenario, vehicle: Vehicle, seed: int, place: CameraPlace | None, tell: Callable[[str], None]
) -> CameraProcess | None:
    """One whose pictures are had there, None for None; ``tell`` is told what a configuration needs to know."""
    if place is None:
        return None
    camera = CameraProcess(scenario, vehicle, seed, **place._asdict())
    camera.open()
    tell(f'[devices.camera]\ndriver = "opencv"\nsource = "{camera.url}"\nlatency_s = {camera.latency_s:g}')
    return camera


def serve() -> None:
    """The process: reads its set-up and exposures from standard input, until that ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    os.nice(NICER)
    stream = sys.stdin.buffer
    setup: CameraSetup = pickle.load(stream)
    feed = simulated_camera(setup.scenario, setup.vehicle, setup.seed)
    feed.paced = True
    server = _sender(setup)
    try:
        server.open()
    except (OSError, ConfigError) as error:
        what = (
            str(error) if isinstance(error, ConfigError) else f"cannot listen there ({error.strerror}); choose another"
        )
        print(json.dumps({"error": what}), flush=True)
        return
    messages: SimpleQueue[Exposure | Fault | None] = SimpleQueue()
    threading.Thread(target=_read, args=(stream, messages.put), name="messages", daemon=True).start()
    with feed:
        print(json.dumps({"port": server.port}), flush=True)
        _run(feed, server, messages)
    server.close()


def _sender(setup: CameraSetup) -> MjpegServer | RtpSender:
    place = setup.place
    if not place.rtp:
        return MjpegServer(place.port, place.host)
    return RtpSender(place.host, place.port, setup.scenario.sensors.camera.rate_hz or setup.vehicle.eye.rate_hz)


def _run(feed: CameraFeed, server: MjpegServer | RtpSender, messages: "SimpleQueue[Exposure | Fault | None]") -> None:
    """Serve what is exposed, each picture at the end of its latency, until there are no more messages."""
    time: LoopTime | None = None
    while True:
        try:
            message = messages.get(timeout=LOOK_S)
        except Empty:
            pass
        else:
            if message is None:
                return
            if isinstance(message, Exposure):
                time = time or LoopTime(RECENT)
                time.observe(message.truth.t_us, message.clock_us)
                feed.tilt(message.off_rad)
                feed.observe(message.truth)
            else:
                feed.add(message)
        for frame in () if time is None else feed.poll(time.at(machine_us()) - STREAM_US):
            server.show(frame)


def _read(stream: IO[bytes], put: Callable[[Exposure | Fault | None], None]) -> None:
    """Every message, then None at the end of the stream."""
    with contextlib.suppress(EOFError, pickle.UnpicklingError, OSError):
        while True:
            put(pickle.load(stream))
    put(None)


def _pipe(end: IO[bytes] | None) -> IO[bytes]:
    assert end is not None, "made with PIPE"
    return end


def _moved(truth: Truth, t_us: int) -> Truth:
    """The truth a little before, at constant velocity and turn rate."""
    seconds = 1e-6 * (t_us - truth.t_us)
    r = r_ned_from_frd(truth.rpy_rad)
    rpy_rad = rpy_from_r(r @ r_ned_from_frd(seconds * truth.rate_frd_rad_s))  # the turn is small
    return replace(truth, t_us=t_us, pos_ned_m=truth.pos_ned_m + seconds * (r @ truth.vel_frd_m_s), rpy_rad=rpy_rad)
