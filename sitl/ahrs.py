"""A simulated SBG IG-500A: true motion in, the bytes of the real device's serial line out.

It implements the commands of the real driver (:mod:`.drivers.ig500`) and, like the device, sends nothing before it is
configured. Errors: white noise and random-walk bias of gyros and accelerometers, slow attitude errors, a magnetic
heading with a constant and a position-dependent error.
"""

import math
import struct
from collections.abc import Iterator

import numpy as np

from autopilot.core.frames import FloatArray, quat_from_rpy, r_ned_from_frd
from autopilot.core.vehicle import Ahrs
from autopilot.drivers.ig500_protocol import (
    ACKNOWLEDGE,
    CONTINUOUS_OUTPUT,
    GET_OUTPUT_MASK,
    RETURN_OUTPUT_MASK,
    SET_CONTINUOUS_MODE,
    SET_OUTPUT_MASK,
    STATUS_GOOD,
    Ig500Parser,
    OutputCodec,
    OutputField,
    encode_frame,
)
from autopilot.sitl.delayed import DelayedSensor
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import AhrsFreeze, Fault
from autopilot.sitl.sensor_faults import ImuFaults
from autopilot.sitl.sensor_tables import AhrsSensor
from autopilot.sitl.sitl_tuning import AHRS

POWER_UP_MASK = OutputField.EULER | OutputField.GYRO | OutputField.ACCEL
"""What the device sends until it is configured."""
DIP_RAD = math.radians(55.0)
"""Of the magnetic field below the horizontal, as in southern Europe. The field's horizontal part has size 1."""


class SlowError:
    """First-order Gauss-Markov process with a given standard deviation and correlation time."""

    def __init__(self, sigma: float, time_s: float, dt_s: float, first: float) -> None:
        self._keep = math.exp(-dt_s / time_s)
        self._fresh = sigma * math.sqrt(1.0 - self._keep * self._keep)
        self.value = sigma * first

    def step(self, normal: float) -> float:
        """The value ``dt_s`` later; ``normal`` is a standard normal number."""
        self.value = self._keep * self.value + self._fresh * normal
        return self.value


class Ig500Emulator(DelayedSensor[bytes]):
    """The device and its cable: a :class:`autopilot.drivers.protocols.BytePort` for the driver."""

    def __init__(self, settings: AhrsSensor, ahrs: Ahrs, faults: list[Fault], seed: int) -> None:
        latency_s = ahrs.latency_s if settings.latency_s is None else settings.latency_s
        super().__init__(settings.rate_hz or ahrs.rate_hz, latency_s, settings.latency_jitter_s)
        self._settings = settings
        self._rng = np.random.default_rng((seed, 10))
        self._freezes = [fault for fault in faults if isinstance(fault, AhrsFreeze)]
        self._faults = ImuFaults(faults)
        self._parser = Ig500Parser()
        self._codec = OutputCodec(POWER_UP_MASK)
        self._sending = False
        self._divider = 1
        self.clock_ahead_us = 0
        """What its clock shows beyond the time [us]; a change of it is a jump of the device's clock."""
        self._held: dict[OutputField, tuple[float, ...]] | None = None
        first = self._rng.standard_normal(12).tolist()
        dt_s = 1.0 / self._rate_hz
        tilt, tilt_s = settings.tilt_error_rad, settings.tilt_error_time_s
        self._bias = [settings.gyro_bias_rad_s * n for n in first[0:3]]
        self._bias += [settings.accel_bias_m_s2 * n for n in first[3:6]]
        self._roll = SlowError(tilt, tilt_s, dt_s, first[6])
        self._pitch = SlowError(tilt, tilt_s, dt_s, first[7])
        self._yaw = SlowError(settings.yaw_error_rad, settings.yaw_error_time_s, dt_s, first[8])
        self._yaw_offset_rad = settings.yaw_offset_rad * first[9] + settings.yaw_bias_rad
        self._field_phase: list[float] = self._rng.uniform(0.0, 2.0 * math.pi, 2).tolist()
        root = math.sqrt(dt_s)
        self._walk = [settings.gyro_bias_walk_rad_s_rts * root] * 3 + [settings.accel_bias_walk_m_s2_rts * root] * 3
        self._white = [settings.gyro_noise_rad_s_rthz / root] * 3 + [settings.accel_noise_m_s2_rthz / root] * 3
        self._draws: Iterator[tuple[list[float], list[float]]] = iter(())

    # The device's side.

    def observe(self, truth: Truth) -> None:
        """Take the sample that is due at ``truth.t_us`` and put its frame on the line."""
        noise, chance = self._drawn()
        values = self._measured(truth, noise)
        if self._freezes and any(
            fault.at_s <= truth.t_us / 1e6 < fault.at_s + fault.duration_s for fault in self._freezes
        ):
            values = {**values, **(self._held or {})}
        self._held = values
        self._taken()
        if not self._sending or self._count % self._divider:
            return
        values[OutputField.TIME_SINCE_RESET] = ((truth.t_us + self.clock_ahead_us) // 1000 % AHRS.clock_span_ms,)
        data = encode_frame(CONTINUOUS_OUTPUT, self._codec.encode(values))
        if chance[0] < self._settings.corrupt_probability:
            broken = bytearray(data)
            broken[int(chance[1] * len(data))] ^= 0x5A
            data = bytes(broken)
        if chance[2] >= self._settings.drop_probability:
            self._send(truth.t_us, noise[15], data)

    def _drawn(self) -> tuple[list[float], list[float]]:
        """The next sample's random numbers: standard normal ones, and chances in [0, 1)."""
        draw = next(self._draws, None)
        if draw is None:
            noise = self._rng.standard_normal((AHRS.noise_samples, AHRS.noise_numbers)).tolist()
            self._draws = zip(noise, self._rng.random((AHRS.noise_samples, 3)).tolist(), strict=True)
            draw = next(self._draws)
        return draw

    def _measured(self, truth: Truth, noise: list[float]) -> dict[OutputField, tuple[float, ...]]:
        self._bias = [b + w * n for b, w, n in zip(self._bias, self._walk, noise[0:6], strict=True)]
        true = truth.rate_frd_rad_s.tolist() + truth.accel_frd_m_s2.tolist()
        measured = [t + b + w * n for t, b, w, n in zip(true, self._bias, self._white, noise[6:12], strict=True)]
        measured = self._faults.with_inertial(truth.t_us, measured)
        more_roll, more_pitch, more_yaw = self._faults.attitude_rad(truth.t_us)
        roll, pitch, yaw = truth.rpy_rad.tolist()
        roll += self._roll.step(noise[12]) + more_roll
        pitch += self._pitch.step(noise[13]) + more_pitch
        off = self._yaw.step(noise[14]) + self._yaw_offset_rad + self._field_rad(truth.pos_ned_m) + more_yaw
        yaw += off
        values: dict[OutputField, tuple[float, ...]] = {
            OutputField.QUATERNION: tuple(quat_from_rpy((roll, pitch, yaw)).tolist()),
            OutputField.EULER: (roll, pitch, yaw),
            OutputField.GYRO: tuple(measured[0:3]),
            OutputField.ACCEL: tuple(measured[3:6]),
            OutputField.STATUS: (STATUS_GOOD,),
            OutputField.ATTITUDE_ACCURACY: (AHRS.accuracy_rad,),
        }
        if OutputField.MAG in self._codec.parts:
            field = r_ned_from_frd(truth.rpy_rad).T @ np.array([math.cos(off), -math.sin(off), math.tan(DIP_RAD)])
            values[OutputField.MAG] = tuple(field.tolist())
        return values

    def _field_rad(self, pos_ned_m: FloatArray) -> float:
        """Magnetic disturbance of the heading at a place."""
        if self._settings.yaw_field_rad == 0.0:
            return 0.0
        wave = 2.0 * math.pi / self._settings.yaw_field_length_m
        north, east, _ = pos_ned_m.tolist()
        pattern = math.sin(wave * north + self._field_phase[0]) + math.sin(wave * east + self._field_phase[1])
        return 0.5 * self._settings.yaw_field_rad * pattern

    # The cable's side.

    def read(self, t_us: int) -> list[tuple[int, bytes]]:
        return self._arrived(t_us)

    def write(self, data: bytes) -> None:
        """Commands of the driver: questions are answered, orders that are understood acknowledged with error code 0."""
        for frame in self._parser.feed(data):
            if frame.command == SET_OUTPUT_MASK and len(frame.data) == 5:
                self._codec = OutputCodec(OutputField(struct.unpack(">BI", frame.data)[1]))
            elif frame.command == SET_CONTINUOUS_MODE and len(frame.data) == 3:
                _, mode, divider = frame.data
                self._sending, self._divider = mode == 1, max(1, divider)
            elif frame.command == GET_OUTPUT_MASK:
                answer = encode_frame(RETURN_OUTPUT_MASK, struct.pack(">I", self._codec.mask))
                self._queue.append((self._last_due_us, answer))
                continue
            else:
                continue
            self._queue.append((self._last_due_us, encode_frame(ACKNOWLEDGE, struct.pack(">H", 0))))
