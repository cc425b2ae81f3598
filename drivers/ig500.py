"""SBG IG-500A attitude and heading reference on a serial line: 100 Hz attitude, rates and specific force."""

import math

import numpy as np

from autopilot.core.device_clock import DeviceClock
from autopilot.core.frames import rpy_from_quat
from autopilot.core.messages import Severity
from autopilot.core.samples import AhrsSample, ImuSample
from autopilot.drivers.ig500_protocol import (
    AHRS_MASK,
    CONTINUOUS_OUTPUT,
    GET_OUTPUT_MASK,
    RAW_MASK,
    RETURN_OUTPUT_MASK,
    STATUS_GOOD,
    Ig500Frame,
    Ig500Parser,
    Ig500Status,
    OutputCodec,
    OutputField,
    decode_output_mask,
    encode_continuous_mode,
    encode_frame,
    encode_output_mask,
)
from autopilot.drivers.protocols import BytePort
from autopilot.drivers.serial_sensor import SerialSensor

QUATERNION_TOLERANCE = 0.05
"""Samples whose quaternion's norm is farther from 1 are dropped."""
CLOCK_SPAN_US = (1 << 32) * 1000
"""The device's milliseconds begin anew after 50 days."""


class Ig500(SerialSensor[AhrsSample | ImuSample]):
    """The driver. Body frame: the device is mounted with its axes forward, right, down.

    A measurement does not identify its fields: none is used before the device has confirmed the requested output mask;
    after a reset of the device it is requested again.
    """

    def __init__(self, port: BytePort, latency_s: float, divider: int = 1, *, attitude: bool = True) -> None:
        """``attitude`` False: ask for the raw sensors only, magnetometer included."""
        super().__init__(port, Ig500Parser())
        self._latency_us = round(latency_s * 1e6)
        self._divider = divider
        self._mask = AHRS_MASK if attitude else RAW_MASK
        self._codec = OutputCodec(self._mask)
        parts = self._codec.parts
        self._quaternion, self._magnet = parts.get(OutputField.QUATERNION), parts.get(OutputField.MAG)
        self._gyro, self._accel = parts[OutputField.GYRO], parts[OutputField.ACCEL]
        self._time, self._status = parts[OutputField.TIME_SINCE_RESET].start, parts[OutputField.STATUS].start
        self._confirmed = False
        self.status: Ig500Status | None = None
        """What the device says of itself with its last measurement."""
        self._status_bits: int | None = None
        self.clock = DeviceClock(CLOCK_SPAN_US)
        """The device's, on the service's time."""
        self._last_device_us = -1
        self.configured_count = 0
        """How often the device was configured: 1 at opening, more when it fell silent."""

    def _begin(self) -> None:
        self.clock.begin()

    def _take(self, arrival_us: int, frame: Ig500Frame) -> AhrsSample | ImuSample | None:
        if frame.command == RETURN_OUTPUT_MASK:
            self._confirmed = decode_output_mask(frame.data) == self._mask
        if frame.command != CONTINUOUS_OUTPUT or not self._confirmed:
            return None
        sample = self._sample(arrival_us, frame.data)
        self.bad_samples += sample is None
        return sample

    def take_notices(self) -> list[tuple[Severity, str]]:
        return self.clock.take_notices()

    @property
    def warnings(self) -> list[str]:
        """Parts of the device that are not in order by its own account."""
        if self.status is None:
            return []
        return [str(bit.name).lower() for bit in Ig500Status if bit & STATUS_GOOD & ~self.status]

    def _configure(self) -> None:
        self._confirmed = False
        self._port.write(encode_output_mask(self._mask))
        self._port.write(encode_frame(GET_OUTPUT_MASK))
        self._port.write(encode_continuous_mode(self._divider))
        self.configured_count += 1

    def _sample(self, arrival_us: int, data: bytes) -> AhrsSample | ImuSample | None:
        numbers = self._codec.numbers(data)
        if numbers is None:
            return None
        quaternion = (1.0, 0.0, 0.0, 0.0) if self._quaternion is None else numbers[self._quaternion]
        w, x, y, z = quaternion
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        if abs(norm - 1.0) > QUATERNION_TOLERANCE:
            return None
        device_us = int(numbers[self._time]) * 1000
        reset, self._last_device_us = device_us < self._last_device_us, device_us
        stamped_us = self.clock.stamp(arrival_us, device_us)
        if reset:  # it may have been without power: its mask is its own again
            self._configure()
            return None
        if stamped_us is None:
            return None
        bits = int(numbers[self._status])
        if bits != self._status_bits:
            self._status_bits, self.status = bits, Ig500Status(bits & STATUS_GOOD)
        t_us = stamped_us - self._latency_us
        rate, accel = np.array(numbers[self._gyro]), np.array(numbers[self._accel])
        if self._magnet is not None:
            magnet = np.array(numbers[self._magnet])
            return ImuSample(t_us=t_us, rate_frd_rad_s=rate, accel_frd_m_s2=accel, mag_frd=magnet)
        rpy_rad = rpy_from_quat((w / norm, x / norm, y / norm, z / norm))
        return AhrsSample(t_us=t_us, rpy_rad=rpy_rad, rate_frd_rad_s=rate, accel_frd_m_s2=accel)
