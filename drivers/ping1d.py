"""Blue Robotics Ping Sonar altimeter and echosounder on a serial line: range to the target in its beam."""

import math
import struct
from dataclasses import dataclass
from typing import Annotated

import msgspec

from autopilot.core.samples import AltimeterSample
from autopilot.core.toml_table import NonNegative, Positive, Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.framing import FrameParser
from autopilot.drivers.protocols import BytePort
from autopilot.drivers.serial_port import SerialPort
from autopilot.drivers.serial_sensor import SerialSensor

REQUEST_AGAIN_US = 1_000_000
"""After so long without a range the device is set up again: it has been without power, or was not there yet."""
LEAST_INTERVAL_MS = 30
"""Between two pings."""
LEAST_RANGE_M, MOST_RANGE_M = 0.3, 100.0
"""Of the device (its data sheet)."""
RANGE_FRACTION = 0.005
"""Resolution: 0.5 % of the range."""
GENERAL_REQUEST = 6
SET_RANGE, SET_SPEED_OF_SOUND, SET_MODE_AUTO, SET_PING_INTERVAL = 1001, 1002, 1003, 1004
DISTANCE_SIMPLE = 1211
CONTINUOUS_START = 1400
"""Message numbers of the Ping1D."""

START = b"BR"
HEADER = struct.Struct("<2sHHBB")
CHECKSUM_BYTES = 2
MAX_PAYLOAD = 512
"""The longest message (a profile) has 200 points and some numbers."""
_SIMPLE = struct.Struct("<IB")
LENGTHS = {DISTANCE_SIMPLE: _SIMPLE.size}
"""Of payloads that are always as long. A damaged length shows at once by that: waited for, it would hold up the
frames of seconds, which would be stamped too late."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PingFrame:
    """Ping Protocol of Blue Robotics' echosounders: frames in and out. https://docs.bluerobotics.com/ping-protocol/

    A frame is ``BR``, length of the payload (u16), number of the message (u16), sender and receiver (u8), payload, and
    the sum of all bytes before it (u16); little endian."""

    message: int
    payload: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Distance:
    """DISTANCE_SIMPLE."""

    range_m: float
    confidence: float
    """0..1"""


def encode(message: int, payload: bytes = b"", *, sender: int = 0, receiver: int = 0) -> bytes:
    frame = HEADER.pack(START, len(payload), message, sender, receiver) + payload
    return frame + (sum(frame) & 0xFFFF).to_bytes(CHECKSUM_BYTES, "little")


def encode_distance(distance: Distance) -> bytes:
    return encode(
        DISTANCE_SIMPLE, _SIMPLE.pack(round(1e3 * distance.range_m), round(100.0 * distance.confidence)), sender=1
    )


def decode_distance(payload: bytes) -> Distance | None:
    """None = these are not its bytes."""
    if len(payload) != _SIMPLE.size:
        return None
    range_mm, percent = _SIMPLE.unpack(payload)
    return Distance(range_m=1e-3 * range_mm, confidence=0.01 * percent) if percent <= 100 else None


class PingParser(FrameParser[PingFrame]):
    sync, head_bytes = START, HEADER.size

    def _size(self, head: bytes) -> int | None:
        _, length, message, _, _ = HEADER.unpack(head)
        if not LENGTHS.get(message, 0) <= length <= LENGTHS.get(message, MAX_PAYLOAD):
            return None
        return HEADER.size + int(length) + CHECKSUM_BYTES

    def _frame(self, data: bytes) -> PingFrame | None:
        body, checksum = data[:-CHECKSUM_BYTES], int.from_bytes(data[-CHECKSUM_BYTES:], "little")
        if checksum != sum(body) & 0xFFFF:
            return None
        return PingFrame(message=HEADER.unpack_from(body)[2], payload=body[HEADER.size :])


class Ping1dOptions(Table, frozen=True, kw_only=True):
    """``[devices.altimeter]`` with ``driver = "ping1d"``."""

    port: str
    """Serial device, e.g. /dev/ttyUSB0 (a name under /dev/serial/by-id stays the same when cables move)."""
    baud: Annotated[int, msgspec.Meta(gt=0)] = 115200
    speed_of_sound_m_s: Annotated[float, msgspec.Meta(ge=1300.0, le=1700.0)] = 1482.0
    """Of the water: 1482 fresh at 20 degC, about 1500 in the sea."""
    least_confidence: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.7
    """An echo of which the device is less sure is none."""
    most_range_m: Positive = MOST_RANGE_M
    """What lies farther is not looked for."""
    sigma_m: NonNegative = 0.01
    """Standard deviation close by; 0.5 % of the range comes on top."""


class Ping1d(SerialSensor[AltimeterSample]):
    """A :class:`autopilot.drivers.protocols.Sensor`."""

    Options = Ping1dOptions

    def __init__(self, vehicle: Vehicle, options: Ping1dOptions, *, port: BytePort | None = None) -> None:
        """At the rate of the vehicle file's ``[altimeter]``."""
        super().__init__(SerialPort(options.port, options.baud) if port is None else port, PingParser())
        self._options = options
        self._latency_us = round(1e6 * vehicle.altimeter.latency_s)
        self._interval_ms = max(LEAST_INTERVAL_MS, round(1e3 / vehicle.altimeter.rate_hz))
        self._received = False
        """Whether a range has come since the last poll, good or not."""
        self._last_request_us: int | None = None
        self._last_us = -(1 << 62)
        self.weak = 0
        """Echoes of which it was not sure enough."""

    def _begin(self) -> None:
        self._last_request_us = None

    def _too_silent(self, t_us: int, *, received: bool) -> bool:
        received, self._received = self._received, False
        if not received and self._last_request_us is not None and t_us - self._last_request_us < REQUEST_AGAIN_US:
            return False
        silent = not received and self._last_request_us is not None
        self._last_request_us = t_us
        return silent

    def _take(self, arrival_us: int, frame: PingFrame) -> AltimeterSample | None:
        if frame.message != DISTANCE_SIMPLE:
            return None
        self._received = True
        return self._sample(arrival_us, decode_distance(frame.payload))

    def _configure(self) -> None:
        options = self._options
        most_mm = round(1e3 * min(options.most_range_m, MOST_RANGE_M))
        automatic = options.most_range_m >= MOST_RANGE_M
        speed_mm_s = round(1e3 * options.speed_of_sound_m_s)
        self._port.write(encode(SET_SPEED_OF_SOUND, struct.pack("<I", speed_mm_s)))
        self._port.write(encode(SET_MODE_AUTO, bytes([automatic])))
        if not automatic:
            self._port.write(encode(SET_RANGE, struct.pack("<II", 0, most_mm)))
        self._port.write(encode(SET_PING_INTERVAL, struct.pack("<H", self._interval_ms)))
        self._port.write(encode(CONTINUOUS_START, struct.pack("<H", DISTANCE_SIMPLE)))

    def _sample(self, arrival_us: int, distance: Distance | None) -> AltimeterSample | None:
        taken_us = arrival_us - self._latency_us
        if distance is not None and distance.confidence < self._options.least_confidence:
            self.weak += 1
            return None
        if distance is None or not LEAST_RANGE_M <= distance.range_m <= MOST_RANGE_M or taken_us <= self._last_us:
            self.bad_samples += 1
            return None
        self._last_us = taken_us
        return AltimeterSample(
            t_us=taken_us,
            range_m=distance.range_m,
            sigma_m=math.hypot(self._options.sigma_m, RANGE_FRACTION * distance.range_m),
            confidence=distance.confidence,
        )
