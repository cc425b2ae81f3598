"""SBG Ellipse attitude and heading reference on a serial line (sbgECom)."""

import math
from typing import Annotated

import msgspec
import numpy as np

from autopilot.core.device_clock import DeviceClock
from autopilot.core.frames import rpy_from_quat
from autopilot.core.messages import Severity
from autopilot.core.samples import AhrsSample
from autopilot.core.toml_table import Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers import ellipse_protocol as wire
from autopilot.drivers.ig500 import QUATERNION_TOLERANCE
from autopilot.drivers.protocols import BytePort
from autopilot.drivers.serial_port import SerialPort
from autopilot.drivers.serial_sensor import SerialSensor

LOGS = (wire.IMU_DATA, wire.EKF_QUATERNION)
CLOCK_SPAN_US = 1 << 32
"""The device's microseconds begin anew after 71 minutes."""


class EllipseOptions(Table, frozen=True, kw_only=True):
    """``[devices.ahrs]`` with ``driver = "ellipse"``."""

    port: str
    """Serial device, e.g. /dev/ttyUSB0 (a name under /dev/serial/by-id stays the same when cables move)."""
    baud: Annotated[int, msgspec.Meta(gt=0)] = 115200
    divider: Annotated[int, msgspec.Meta(ge=1, le=200)] = 2
    """Of the main loop's 200 Hz; the device knows 1, 2, 4, 5, 8, 10, 20, 40 and 200."""

    def __post_init__(self) -> None:
        if self.divider not in (1, 2, 4, 5, 8, 10, 20, 40, 200):
            raise ValueError(f"`divider` = {self.divider}: the device knows 1, 2, 4, 5, 8, 10, 20, 40 and 200")


class Ellipse(SerialSensor[AhrsSample]):
    """The device is mounted with its axes forward, right, down."""

    Options = EllipseOptions

    def __init__(self, vehicle: Vehicle, options: EllipseOptions, *, port: BytePort | None = None) -> None:
        super().__init__(SerialPort(options.port, options.baud) if port is None else port, wire.EllipseParser())
        self._latency_us = round(vehicle.ahrs.latency_s * 1e6)
        self._mode = options.divider
        self.clock = DeviceClock(CLOCK_SPAN_US)
        """The device's, on the service's time."""
        self._imu: wire.Imu | None = None
        self._attitude: wire.Attitude | None = None
        self.confirmed: set[int] = set()
        """Logs that the device says it sends as asked."""
        self.configured_count = 0
        """How often the device was configured since the start."""

    def _begin(self) -> None:
        self.clock.begin()

    def take_notices(self) -> list[tuple[Severity, str]]:
        return self.clock.take_notices()

    def _configure(self) -> None:
        self.confirmed.clear()
        self.configured_count += 1
        for log in LOGS:
            self._port.write(wire.encode_output(log, self._mode))
            self._port.write(wire.encode_question(log))

    def _take(self, arrival_us: int, frame: wire.EllipseFrame) -> AhrsSample | None:
        if (frame.kind, frame.message) == (wire.COMMANDS, wire.OUTPUT_CONF):
            answer = wire.decode_output(frame.data)
            if answer is not None and answer[0] in LOGS and answer[1] == self._mode:
                self.confirmed.add(answer[0])
            return None
        if frame.kind != wire.LOGS or frame.message not in LOGS:
            return None
        if frame.message == wire.IMU_DATA:
            self._imu = wire.decode_imu(frame.data)
            useless = self._imu is None
        else:
            self._attitude = wire.decode_attitude(frame.data)
            useless = self._attitude is None
        if useless:
            self.bad_samples += 1
            return None
        imu, attitude = self._imu, self._attitude
        if imu is None or attitude is None or imu.device_us != attitude.device_us:
            return None
        sample = self._sample(arrival_us, imu, attitude)
        self.bad_samples += sample is None
        return sample

    def _sample(self, arrival_us: int, imu: wire.Imu, attitude: wire.Attitude) -> AhrsSample | None:
        if not (imu.status & wire.IMU_WORKS and attitude.status & wire.ATTITUDE_VALID):
            return None
        norm = math.sqrt(sum(part * part for part in attitude.quaternion))
        if abs(norm - 1.0) > QUATERNION_TOLERANCE:
            return None
        stamped_us = self.clock.stamp(arrival_us, imu.device_us)
        if stamped_us is None:
            return None
        return AhrsSample(
            t_us=stamped_us - self._latency_us,
            rpy_rad=rpy_from_quat([part / norm for part in attitude.quaternion]),
            rate_frd_rad_s=np.array(imu.rate_frd_rad_s),
            accel_frd_m_s2=np.array(imu.accel_frd_m_s2),
        )
