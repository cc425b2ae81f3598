"""Rendered images as a network camera: MJPEG over HTTP."""

import socket
import threading
from contextlib import suppress

import cv2

from autopilot.core.samples import CameraFrame
from autopilot.drivers.base import Closing

QUALITY = 90
BOUNDARY = b"frame"
_HEAD = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=" + BOUNDARY + b"\r\n\r\n"
SEND_S = 1.0
"""A client that takes nothing for so long is left."""


class MjpegServer(Closing):
    """Serves the newest picture to every client, each on a thread of its own; a slow client misses pictures."""

    def __init__(self, port: int = 0, host: str = "127.0.0.1") -> None:
        """``port`` 0: any that is free."""
        self.port, self._host = port, host
        self._listener: socket.socket | None = None
        self._newest: tuple[int, CameraFrame | None] = (0, None)
        self._fresh = threading.Condition()
        self._clients = 0

    @property
    def url(self) -> str:
        """URL for a camera driver."""
        return f"http://{self._host}:{self.port}/video.mjpg"

    @property
    def clients(self) -> int:
        return self._clients

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
        self._clients += 1
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
        self._clients -= 1

    def _after(self, shown: int, listener: socket.socket) -> tuple[int, bytes]:
        """Wait for a picture that is newer than number ``shown``: its number and bytes; none after a while."""
        with self._fresh:
            self._fresh.wait_for(lambda: self._newest[0] != shown or self._listener is not listener, 1.0)
            number, frame = self._newest
        if number == shown or frame is None:
            return shown, b""
        good, jpeg = cv2.imencode(".jpg", frame.image_bgr, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        return number, jpeg.tobytes() if good else b""
