"""Water Linked DVL A50 on TCP: one JSON report per line.

Velocity in the device's frame (forward, right, down); position and orientation (``turned_rad``) are in the vehicle
file. A report contains its age at transmission, by the device's clock.
"""

import math
import socket
from collections import deque
from statistics import median
from typing import Annotated

import msgspec
import numpy as np

from autopilot.core.device_clock import DeviceClock
from autopilot.core.errors import DriverError
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Severity
from autopilot.core.samples import VelocityLock, VelocitySample
from autopilot.core.toml_table import Positive, Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.base import Closing

CONNECT_S = 2.0
CHUNK = 65536
MAX_LINE = 65536
"""Longer than any report: without an end of line it is not JSON."""
DEAD_US = 3_000_000
"""The device reports several times a second, locked or not: without a byte for so long the connection is dead."""
MOST_M_S = 10.0
MOST_DELAY_US = 2_000_000
USUAL_DELAYS = 9
"""Reports of which the median is the usual delay. It changes with the altitude, by less than"""
DELAY_BAND_US = 50_000
"""this from one report to the next: beyond it the clock has been set between measuring and sending."""


class Report(msgspec.Struct):
    """The used fields of a report; others are ignored."""

    type: str
    vx: float = 0.0
    vy: float = 0.0
    vz: float = 0.0
    fom: float = 0.0
    """Standard deviation of the velocity [m/s]."""
    covariance: tuple[tuple[float, ...], ...] = ()
    altitude: float = -1.0
    velocity_valid: bool = False
    status: int = 0
    tracking_mode: str = "bottom"
    time_of_validity: int = 0
    """Microseconds of the device's clock."""
    time_of_transmission: int = 0


class WaterLinkedA50Options(Table, frozen=True, kw_only=True):
    """``[devices.dvl]`` with ``driver = "waterlinked_a50"``."""

    host: str = "192.168.194.95"
    """The device's address; the default is the one it falls back to."""
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)] = 16171
    turned_rad: float = 0.0
    """Heading of the device's forward axis in the vehicle, clockwise from above."""
    least_sigma_m_s: Positive = 0.003
    """The device's own figure is taken no smaller than this."""


class WaterLinkedA50(Closing):
    """A :class:`autopilot.drivers.protocols.Sensor`."""

    Options = WaterLinkedA50Options

    def __init__(self, vehicle: Vehicle, options: WaterLinkedA50Options) -> None:
        self._options = options
        self._latency_us = round(vehicle.dvl.latency_s * 1e6)
        cos, sin = math.cos(options.turned_rad), math.sin(options.turned_rad)
        self._turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        self._socket: socket.socket | None = None
        self._buffer = b""
        self._last_received_us: int | None = None
        self._last_us = -(1 << 62)
        self._delays_us: deque[int] = deque(maxlen=USUAL_DELAYS)
        self.clock = DeviceClock()
        """Its clock (Unix time), on the service's time: only the age of a report is of use, but jumps are reported."""
        self._decoder = msgspec.json.Decoder(Report)
        self.bad_frames = 0
        """Lines that are no report."""
        self.bad_samples = 0
        """Reports that no vehicle gives."""

    def open(self) -> None:
        if self._socket is not None:
            return
        host, port = self._options.host, self._options.port
        try:
            self._socket = socket.create_connection((host, port), timeout=CONNECT_S)
            self._socket.setblocking(False)
        except OSError as error:
            why = error.strerror or str(error) or "no answer"
            raise DriverError(f"nobody answers at {host}:{port} ({why}); check address, cable and power") from error
        self._buffer, self._last_received_us = b"", None
        self._delays_us.clear()
        self.clock.begin()

    def close(self) -> None:
        connection, self._socket = self._socket, None
        if connection is not None:
            connection.close()

    def poll(self, t_us: int) -> list[VelocitySample]:
        if self._socket is None:
            return []
        self._last_received_us = t_us if self._last_received_us is None else self._last_received_us
        data = b""
        try:
            data = self._socket.recv(CHUNK)
            if not data:
                raise DriverError("connection closed by the device")
            self._last_received_us = t_us
        except BlockingIOError:
            if t_us - self._last_received_us > DEAD_US:
                raise DriverError("connection is dead; check cable and power") from None
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        if len(self._buffer) > MAX_LINE:
            self._buffer = b""
            self.bad_frames += 1
        samples = [self._sample(t_us, line) for line in lines if line.strip()]
        return [sample for sample in samples if sample is not None]

    def _sample(self, t_us: int, line: bytes) -> VelocitySample | None:
        try:
            report = self._decoder.decode(line)
        except (msgspec.DecodeError, UnicodeDecodeError):
            self.bad_frames += 1
            return None
        if report.type != "velocity":
            return None
        if report.time_of_transmission > 0:
            self.clock.stamp(t_us, report.time_of_transmission)
        if not report.velocity_valid:
            return None
        vel = np.array([report.vx, report.vy, report.vz])
        taken_us = t_us - self._delay_us(report)
        if not float(np.abs(vel).max()) <= MOST_M_S or taken_us <= self._last_us:
            self.bad_samples += 1
            return None
        self._last_us = taken_us
        return VelocitySample(
            t_us=taken_us,
            vel_frd_m_s=self._turn @ vel,
            sigma_m_s=self._sigma(report),
            lock=VelocityLock.WATER if report.tracking_mode == "water" else VelocityLock.BOTTOM,
        )

    def take_notices(self) -> list[tuple[Severity, str]]:
        return self.clock.take_notices()

    def _delay_us(self, report: Report) -> int:
        """Age of the report when it was sent: by its own stamps, unless its clock was set in between."""
        delay_us = report.time_of_transmission - report.time_of_validity
        if not 0 < delay_us <= MOST_DELAY_US:
            return round(median(self._delays_us)) if self._delays_us else self._latency_us
        self._delays_us.append(delay_us)
        usual_us = round(median(self._delays_us))
        return delay_us if abs(delay_us - usual_us) <= DELAY_BAND_US else usual_us

    def _sigma(self, report: Report) -> FloatArray:
        rows = report.covariance
        if len(rows) == 3 and all(len(row) == 3 for row in rows):
            turned = self._turn @ np.array(rows) @ self._turn.T
            sigma = np.sqrt(np.maximum(turned.diagonal(), 0.0))
        else:
            sigma = np.full(3, max(0.0, report.fom))
        result: FloatArray = np.maximum(sigma, self._options.least_sigma_m_s)
        return result
