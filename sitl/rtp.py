"""Rendered images as an underwater vehicle's camera sends them: H.264 over RTP (RFC 6184), to one receiver.

Encoded by the library PyAV (extra ``rtp``). A stamp of RTP is the time of exposure at 90 kHz.
"""

from contextlib import suppress
from fractions import Fraction
from typing import Any

from autopilot.core.errors import ConfigError
from autopilot.core.samples import CameraFrame
from autopilot.drivers.base import Closing

RTP_HZ = 90_000
KEY_EVERY = 30
"""Pictures between two that need no other: who listens later, or has lost one, sees after as many at most."""
BIT_RATE = 5_000_000
"""As these cameras are set up, for pictures of 640 x 480 as well."""
PACKET_BYTES = 1300


class RtpSender(Closing):
    """Sends each picture at once; nobody need listen."""

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
