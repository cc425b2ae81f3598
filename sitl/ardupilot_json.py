"""ArduPilot's JSON interface to an external physics backend, as bytes: servo packets in, lines of JSON out.

ArduPilot's simulation (``--model JSON``) sends its servo outputs by UDP to port 9002, little endian: magic (18458 with
16 channels, 29569 with 32), requested loop rate [Hz], frame number, pulses [us]. It waits for one line of JSON in
reply, to the address it sent from: ``timestamp`` [s], ``imu`` with ``gyro`` [rad/s] and ``accel_body`` (specific force
[m/s^2]) in body axes, ``position`` NED from home [m], ``attitude`` [rad] and ``quaternion``, ``velocity`` NED [m/s]. A
frame whose reply was lost is sent again with the same number; a restart of the numbers is a restarted ArduPilot.
(ArduPilot's documentation, libraries/SITL/examples/JSON/readme.md; none of its code is used here.)
"""

import json
import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import r_ned_from_frd
from autopilot.sitl.plant import Truth
from autopilot.sitl.sitl_tuning import ARDUPILOT_JSON

CHANNELS_OF = {18458: 16, 29569: 32}
"""Magic -> channels."""
_HEAD = struct.Struct("<HHI")


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoPacket:
    rate_hz: int
    frame: int
    pwm_us: tuple[int, ...]
    """Per channel, 0 = off."""


def parse_servos(data: bytes) -> ServoPacket | None:
    """The packet, None if these bytes are none."""
    if len(data) < _HEAD.size:
        return None
    magic, rate_hz, frame = _HEAD.unpack_from(data)
    channels = CHANNELS_OF.get(magic)
    if (
        channels is None
        or len(data) != _HEAD.size + 2 * channels
        or not ARDUPILOT_JSON.rates_hz[0] <= rate_hz <= ARDUPILOT_JSON.rates_hz[1]
    ):
        return None
    pulses = struct.unpack_from(f"<{channels}H", data, _HEAD.size)
    return ServoPacket(
        rate_hz=rate_hz, frame=frame, pwm_us=tuple(p if p >= ARDUPILOT_JSON.off_us else 0 for p in pulses)
    )


def state_line(truth: Truth, t_s: float, floor_m: float | None, pressure_frd_m: tuple[float, float, float]) -> bytes:
    """The reply. ``floor_m``: depth of the floor for a down-looking range finder; None = no range finder.
    ``pressure_frd_m``: where the pressure sensor is, of which ArduPilot knows nothing: it reads the depth of the
    position.
    """
    r = r_ned_from_frd(truth.rpy_rad)
    velocity = r @ truth.vel_frd_m_s
    north, east, down = truth.pos_ned_m.tolist()
    state: dict[str, object] = {
        "timestamp": t_s,
        "imu": {"gyro": truth.rate_frd_rad_s.tolist(), "accel_body": truth.accel_frd_m_s2.tolist()},
        "position": [north, east, truth.depth_of(np.array(pressure_frd_m))],
        "attitude": truth.rpy_rad.tolist(),
        "quaternion": truth.quat.tolist(),
        "velocity": velocity.tolist(),
        "battery": {"voltage": truth.voltage_v, "current": truth.current_a},
    }
    if floor_m is not None:
        state["rng_1"] = max(0.0, floor_m - down) / max(0.1, float(r[2, 2]))
    # ArduPilot's parser needs no space after a colon, and one line per message.
    return b"\n" + json.dumps(state, separators=(",", ":")).encode() + b"\n"


class JsonPhysics:
    """Packets in, answers out, in lockstep: every new frame moves the plant on by one period of the asked rate."""

    def __init__(
        self,
        make: Callable[[], Callable[[int, tuple[int, ...]], Truth]],
        floor_m: float | None,
        pressure_frd_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        """``make``: a fresh vehicle; a call moves it on to a time [us] with pulses held, the result is its truth.
        The others: see :func:`state_line`.
        """
        self._make = make
        self._go = make()
        self._floor_m, self._pressure_frd_m = floor_m, pressure_frd_m
        self._t_s = 0.0
        self._frame: int | None = None
        self._answer = b""
        self.truth: Truth | None = None
        """After the last frame."""
        self.frames = self.repeated = self.missed = self.restarts = self.refused = 0
        """Counters: frames answered anew, asked again, never seen, restarts of ArduPilot, packets that are none."""

    @property
    def t_us(self) -> int:
        """Time since the start of ArduPilot."""
        return round(1e6 * self._t_s)

    def answer(self, data: bytes) -> bytes | None:
        """Reply to a packet; None for invalid bytes."""
        packet = parse_servos(data)
        if packet is None:
            self.refused += 1
            return None
        if packet.frame == self._frame:
            self.repeated += 1
            return self._answer
        if self._frame is not None and packet.frame < self._frame:
            self.restarts += 1
            self._go, self._t_s = self._make(), 0.0
        elif self._frame is not None:
            self.missed += packet.frame - self._frame - 1
        self._frame = packet.frame
        self.frames += 1
        self._t_s += 1.0 / packet.rate_hz
        self.truth = self._go(self.t_us, packet.pwm_us)
        self._answer = state_line(self.truth, self._t_s, self._floor_m, self._pressure_frd_m)
        return self._answer
