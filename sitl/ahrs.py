"""A simulated SBG IG-500A: true motion in, the bytes of the real device's serial line out.

It understands the commands of the real driver (:mod:`drivers.ig500`) and stays silent until it is told to send, as the
device does. Errors: white noise and walking bias of gyros and accelerometers, slow errors of attitude, a magnetic
heading that is off by a constant and by an amount that depends on the place.
"""

import math
import struct
from collections import deque

import numpy as np

from autopilot.core.frames import FloatArray, quat_from_rpy
from autopilot.core.vehicle import Ahrs
from drivers.base import AlwaysOpen
from drivers.ig500_protocol import (
    ACKNOWLEDGE,
    CONTINUOUS_OUTPUT,
    SET_CONTINUOUS_MODE,
    SET_OUTPUT_MASK,
    Field,
    FrameParser,
    OutputCodec,
    encode_frame,
)
from sitl.plant import Truth
from sitl.scenario import AhrsFreeze, AhrsSensor, Fault

POWER_UP_MASK = Field.EULER | Field.GYRO | Field.ACCEL
"""What the device would send before it is told otherwise."""
STATUS_GOOD = 0
ACCURACY_RAD = 0.02
"""What the device says of its own attitude."""
NOISE_NUMBERS = 16
"""Random numbers drawn per sample, whatever becomes of it, so that one fault does not change all that follows."""


class SlowError:
    """First-order Gauss-Markov process with a given standard deviation and correlation time."""

    def __init__(self, sigma: float, time_s: float, first: float) -> None:
        self._sigma = sigma
        self._time_s = time_s
        self.value = sigma * first

    def step(self, dt_s: float, normal: float) -> float:
        """The value ``dt_s`` later; ``normal`` is a standard normal number."""
        keep = math.exp(-dt_s / self._time_s)
        self.value = keep * self.value + self._sigma * math.sqrt(1.0 - keep * keep) * normal
        return self.value


class Ig500Emulator(AlwaysOpen):
    """The device and its cable: a :class:`drivers.protocols.BytePort` for the driver."""

    def __init__(self, settings: AhrsSensor, ahrs: Ahrs, faults: list[Fault], seed: int) -> None:
        self._settings = settings
        self._rng = np.random.default_rng((seed, 10))
        self._rate_hz = settings.rate_hz or ahrs.rate_hz
        self._latency_s = ahrs.latency_s if settings.latency_s is None else settings.latency_s
        self._freezes = [fault for fault in faults if isinstance(fault, AhrsFreeze)]
        self._parser = FrameParser()
        self._codec = OutputCodec(POWER_UP_MASK)
        self._sending = False
        self._divider = 1
        self._count = 0
        self._queue: deque[tuple[int, bytes]] = deque()
        self._last_arrival_us = 0
        self._held: dict[Field, tuple[float, ...]] | None = None
        first = self._rng.standard_normal(12)
        self._gyro_bias: FloatArray = settings.gyro_bias_rad_s * first[0:3]
        self._accel_bias: FloatArray = settings.accel_bias_m_s2 * first[3:6]
        self._roll = SlowError(settings.tilt_error_rad, settings.tilt_error_time_s, float(first[6]))
        self._pitch = SlowError(settings.tilt_error_rad, settings.tilt_error_time_s, float(first[7]))
        self._yaw = SlowError(settings.yaw_error_rad, settings.yaw_error_time_s, float(first[8]))
        self._yaw_offset_rad = settings.yaw_offset_rad * float(first[9])
        self._field_phase: FloatArray = self._rng.uniform(0.0, 2.0 * math.pi, 2)

    # The device's side.

    @property
    def next_us(self) -> int:
        """When the device takes its next sample."""
        return round(self._count * 1e6 / self._rate_hz)

    def observe(self, truth: Truth) -> None:
        """Take the sample that is due at ``truth.t_us`` and put its frame on the line."""
        dt_s = 1.0 / self._rate_hz
        noise = self._rng.standard_normal(NOISE_NUMBERS)
        chance = self._rng.random(3)
        values = self._measured(truth, dt_s, noise)
        if any(fault.at_s <= truth.t_us / 1e6 < fault.at_s + fault.duration_s for fault in self._freezes):
            values = self._held or values
        self._held = values
        self._count += 1
        if not self._sending or self._count % self._divider:
            return
        stamped = {**values, Field.TIME_SINCE_RESET: (truth.t_us // 1000,)}
        data = bytearray(encode_frame(CONTINUOUS_OUTPUT, self._codec.encode(stamped)))
        if chance[0] < self._settings.corrupt_probability:
            data[int(chance[1] * len(data))] ^= 0x5A
        delay_s = self._latency_s + self._settings.latency_jitter_s * float(noise[15])
        arrival_us = max(self._last_arrival_us, truth.t_us + max(0, round(delay_s * 1e6)))
        if chance[2] >= self._settings.drop_probability:
            self._queue.append((arrival_us, bytes(data)))
            self._last_arrival_us = arrival_us

    def _measured(self, truth: Truth, dt_s: float, noise: FloatArray) -> dict[Field, tuple[float, ...]]:
        s = self._settings
        self._gyro_bias = self._gyro_bias + s.gyro_bias_walk_rad_s_rts * math.sqrt(dt_s) * noise[0:3]
        self._accel_bias = self._accel_bias + s.accel_bias_walk_m_s2_rts * math.sqrt(dt_s) * noise[3:6]
        gyro = truth.rate_frd_rad_s + self._gyro_bias + s.gyro_noise_rad_s_rthz / math.sqrt(dt_s) * noise[6:9]
        accel = truth.accel_frd_m_s2 + self._accel_bias + s.accel_noise_m_s2_rthz / math.sqrt(dt_s) * noise[9:12]
        roll_rad = self._roll.step(dt_s, float(noise[12]))
        pitch_rad = self._pitch.step(dt_s, float(noise[13]))
        yaw_rad = self._yaw.step(dt_s, float(noise[14])) + self._yaw_offset_rad + self._field_rad(truth.pos_ned_m)
        rpy = truth.rpy_rad + np.array([roll_rad, pitch_rad, yaw_rad])
        quat = quat_from_rpy(rpy)
        return {
            Field.QUATERNION: tuple(quat),
            Field.EULER: tuple(rpy),
            Field.GYRO: tuple(gyro),
            Field.ACCEL: tuple(accel),
            Field.STATUS: (STATUS_GOOD,),
            Field.ATTITUDE_ACCURACY: (ACCURACY_RAD,),
        }

    def _field_rad(self, pos_ned_m: FloatArray) -> float:
        """Magnetic disturbance of the heading at a place."""
        wave = 2.0 * math.pi / self._settings.yaw_field_length_m
        north, east = float(pos_ned_m[0]), float(pos_ned_m[1])
        pattern = math.sin(wave * north + self._field_phase[0]) + math.sin(wave * east + self._field_phase[1])
        return 0.5 * self._settings.yaw_field_rad * pattern

    # The cable's side.

    def read(self, t_us: int) -> list[tuple[int, bytes]]:
        """What has arrived up to ``t_us``."""
        arrived = []
        while self._queue and self._queue[0][0] <= t_us:
            arrived.append(self._queue.popleft())
        return arrived

    def write(self, data: bytes) -> None:
        """Commands of the driver. Each that is understood is acknowledged with error code 0."""
        for frame in self._parser.feed(data):
            if frame.command == SET_OUTPUT_MASK and len(frame.data) == 5:
                self._codec = OutputCodec(Field(struct.unpack(">BI", frame.data)[1]))
            elif frame.command == SET_CONTINUOUS_MODE and len(frame.data) == 3:
                _, mode, divider = frame.data
                self._sending, self._divider = mode == 1, max(1, divider)
            else:
                continue
            self._queue.append((self._last_arrival_us, encode_frame(ACKNOWLEDGE, struct.pack(">H", 0))))
