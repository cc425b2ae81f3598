"""Devices at byte level that only tests need: each speaks its protocol and shows constant, known values."""

import json
import socket
import struct

import numpy as np

from autopilot.core.frames import quat_from_rpy
from autopilot.drivers import ellipse_protocol as ellipse
from autopilot.drivers import ping1d as ping
from autopilot.drivers.base import AlwaysOpen

RPY_RAD = (0.05, -0.08, 1.2)
RATE_RAD_S = (0.01, 0.02, 0.1)
ACCEL_M_S2 = (0.1, 0.2, -9.8)
DEPTH_M = 2.5
RANGE_M = 1.734
VELOCITY_M_S = (0.31, -0.12, 0.05)
VOLTAGE_V, CURRENT_A = 15.2, 4.4


class EllipseEmulator(AlwaysOpen):
    """SBG Ellipse: silent until a log is asked for, then at its divider of 200 Hz."""

    def __init__(self) -> None:
        self._parser = ellipse.EllipseParser()
        self._modes: dict[int, int] = {}
        self._queue: list[bytes] = []
        self._next_us = 0
        self.step_us = 5000
        """Of its main loop; shorter = a device gone mad."""

    def power_up(self) -> None:
        self._modes.clear()

    def write(self, data: bytes) -> None:
        for frame in self._parser.feed(data):
            if (frame.kind, frame.message) != (ellipse.COMMANDS, ellipse.OUTPUT_CONF):
                continue
            decoded = ellipse.decode_output(frame.data)
            if decoded is not None:
                self._modes[decoded[0]] = decoded[1]
                acknowledged = struct.pack("<BBH", frame.message, frame.kind, 0)
                self._queue.append(ellipse.encode_frame(ellipse.ACKNOWLEDGE, ellipse.COMMANDS, acknowledged))
            elif len(frame.data) == 3:
                answer = frame.data + struct.pack("<H", self._modes.get(frame.data[1], 0))
                self._queue.append(ellipse.encode_frame(ellipse.OUTPUT_CONF, ellipse.COMMANDS, answer))

    def read(self, t_us: int) -> list[tuple[int, bytes]]:
        sent, self._queue = [(t_us, data) for data in self._queue], []
        while self._next_us <= t_us:
            step = self._next_us // self.step_us
            sent += [(t_us, data) for log, data in self.logs(self._next_us) if self._due(log, step)]
            self._next_us += self.step_us
        return sent

    def _due(self, log: int, step: int) -> bool:
        mode = self._modes.get(log, 0)
        return mode > 0 and step % mode == 0

    @staticmethod
    def logs(t_us: int) -> list[tuple[int, bytes]]:
        device_us = (t_us + 4_000_000_000) % (1 << 32)  # it has been on for a while: its clock overflows in 295 s
        quat = tuple(quat_from_rpy(np.array(RPY_RAD)).tolist())
        return [
            (log, ellipse.encode_frame(log, ellipse.LOGS, data))
            for log, data in (
                (ellipse.IMU_DATA, struct.pack("<IH6f28x", device_us, 0x7F, *ACCEL_M_S2, *RATE_RAD_S)),
                (ellipse.EKF_QUATERNION, struct.pack("<I7fI", device_us, *quat, 0.0, 0.0, 0.0, 0x32)),
            )
        ]


class PingEmulator(AlwaysOpen):
    """Ping Sonar: silent until ranges are asked for, then at its interval."""

    def __init__(self) -> None:
        self._parser = ping.PingParser()
        self._queue: list[bytes] = []
        self.power_up()
        self._next_us = 0
        self.times = 1
        """So many ranges for one."""

    def power_up(self) -> None:
        self._sends, self._interval_us = False, 100_000

    def write(self, data: bytes) -> None:
        for frame in self._parser.feed(data):
            if frame.message == ping.SET_PING_INTERVAL:
                self._interval_us = 1000 * int.from_bytes(frame.payload, "little")
            elif frame.message == ping.CONTINUOUS_START:
                self._sends = int.from_bytes(frame.payload, "little") == ping.DISTANCE_SIMPLE
            self._queue.append(ping.encode(1, struct.pack("<H", frame.message), sender=1))

    def read(self, t_us: int) -> list[tuple[int, bytes]]:
        sent, self._queue = [(t_us, data) for data in self._queue], []
        while self._next_us <= t_us:
            if self._sends:
                shown = ping.encode_distance(ping.Distance(range_m=RANGE_M, confidence=0.97))
                sent += [(t_us, shown)] * self.times
            self._next_us += self._interval_us
        return sent


MS5837_WORDS = {
    "30ba": (0, 34982, 36352, 20328, 22354, 26646, 26146),
    "02ba": (0, 46372, 43981, 29059, 27842, 31553, 28165),
}
"""Calibrations of the data sheets' examples."""


class Ms5837Chip:
    """TE MS5837 at DEPTH_M and 20 degC: commands in, calibration and conversions out, after the data sheets."""

    def __init__(self, kind: str, depth_m: float = DEPTH_M) -> None:
        self._kind = kind
        words = list(MS5837_WORDS[kind])
        words[0] |= self.checksum(words) << 12
        self._words = words
        self._reply = b""
        self._converted = 0
        self.depth_m = depth_m
        self.commands: list[int] = []

    @staticmethod
    def checksum(words: list[int]) -> int:
        """The data sheet's C routine, shift by shift."""
        data = b"".join(word.to_bytes(2, "big") for word in [words[0] & 0xFFF, *words[1:], 0])
        rest = 0
        for count, byte in enumerate(data):
            assert count < 16
            rest ^= byte
            for _ in range(8):
                rest = ((rest << 1) ^ 0x3000) & 0xFFFF if rest & 0x8000 else (rest << 1) & 0xFFFF
        return rest >> 12

    def write(self, data: bytes) -> None:
        (command,) = data
        self.commands.append(command)
        if 0xA0 <= command <= 0xAC:
            self._reply = self._words[(command - 0xA0) // 2].to_bytes(2, "big")
        elif command & 0xF0 in (0x40, 0x50):
            self._converted = self.conversions()[0 if command & 0xF0 == 0x40 else 1]
        elif command == 0x00:
            self._reply, self._converted = self._converted.to_bytes(3, "big"), 0

    def read(self, count: int) -> bytes:
        return self._reply[:count]

    def conversions(self) -> tuple[int, int]:
        """D1, D2 by turning the first-order formulas round (the water is at 20 degC: nothing of second order)."""
        c1, c2, c5 = self._words[1], self._words[2], self._words[5]
        pascal = 101_325.0 + 998.0 * 9.80665 * self.depth_m
        d2 = c5 * 256
        if self._kind == "30ba":
            return round((pascal / 10 * 2**13 + c2 * 2**16) * 2**21 / (c1 * 2**15)), d2
        return round((pascal * 2**15 + c2 * 2**17) * 2**21 / (c1 * 2**16)), d2


class Ina219Chip:
    """TI INA219 over a shunt of 10 mOhm."""

    def __init__(self) -> None:
        self.power_up()

    def power_up(self) -> None:
        self._config, self._pointer = 0x399F, 0

    def write(self, data: bytes) -> None:
        self._pointer = data[0]
        if len(data) == 3 and self._pointer == 0:
            self._config = int.from_bytes(data[1:], "big")

    def read(self, count: int) -> bytes:
        shunt = round(CURRENT_A * 0.01 / 10e-6)
        bus = round(VOLTAGE_V / 4e-3) << 3 | 0b10
        return {0: self._config, 1: shunt & 0xFFFF, 2: bus}.get(self._pointer, 0).to_bytes(2, "big")[:count]


class Ads1115Chip:
    """TI ADS1115 behind Blue Robotics' Power Sense Module, single conversions."""

    def __init__(self) -> None:
        self.power_up()

    def power_up(self) -> None:
        self._config, self._pointer, self._value = 0x8583, 0, 0

    def write(self, data: bytes) -> None:
        self._pointer = data[0]
        if len(data) == 3 and self._pointer == 1:
            self._config = int.from_bytes(data[1:], "big")
            full_v = {0: 6.144, 1: 4.096, 2: 2.048}[self._config >> 9 & 7]
            volt = {6: CURRENT_A / 37.8788 + 0.33, 7: VOLTAGE_V / 11.0}.get(self._config >> 12 & 7, 0.0)
            if self._config & 0x8000:
                self._value = round(volt / full_v * 32768)

    def read(self, count: int) -> bytes:
        return {0: self._value, 1: self._config | 0x8000}.get(self._pointer, 0).to_bytes(2, "big")[:count]


class GpioEmulator(AlwaysOpen):
    """One line of a GPIO chip."""

    def __init__(self) -> None:
        self.level = False
        self.gone = False

    def open(self) -> None:
        self.get()

    def get(self) -> bool:
        if self.gone:
            raise OSError(19, "No such device")
        return self.level

    def set(self, active: bool) -> None:
        self.get()
        self.level = active


class A50Server:
    """Water Linked A50: a TCP server on this machine that sends a report per line to whoever connects."""

    def __init__(self) -> None:
        self._listener: socket.socket | None = None
        self._clients: list[socket.socket] = []
        self.port = 0
        self.plug()

    def plug(self) -> None:
        self.unplug()
        self._listener = socket.socket()
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._listener.bind(("127.0.0.1", self.port))
        self._listener.listen()
        self._listener.setblocking(False)
        self.port = self._listener.getsockname()[1]

    def unplug(self) -> None:
        for connection in (*self._clients, self._listener):
            if connection is not None:
                connection.close()
        self._clients, self._listener = [], None

    def send(self, data: bytes) -> None:
        if self._listener is not None:
            try:
                while True:
                    client, _ = self._listener.accept()
                    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    self._clients.append(client)
            except BlockingIOError:
                pass
        for client in list(self._clients):
            try:
                client.sendall(data)
            except OSError:
                client.close()
                self._clients.remove(client)

    @staticmethod
    def report(t_us: int, **other: object) -> bytes:
        """As the maker's manual shows it."""
        vx, vy, vz = VELOCITY_M_S
        beam = {"id": 0, "velocity": 0.1, "distance": 0.54, "rssi": -30.5, "nsd": -88.3, "beam_valid": True}
        decoded = {
            "time": 106.3, "vx": vx, "vy": vy, "vz": vz, "fom": 0.004,
            "covariance": [[1.6e-5, 0, 0], [0, 1.6e-5, 0], [0, 0, 4e-6]],
            "altitude": 0.49, "transducers": [{**beam, "id": n} for n in range(4)], "velocity_valid": True, "status": 0,
            "format": "json_v3.1", "type": "velocity",
            "time_of_validity": 1638191471000000 + t_us, "time_of_transmission": 1638191471000000 + t_us + 120_000,
        }  # fmt: skip
        return json.dumps({**decoded, **other}).encode() + b"\r\n"


def close_to(seen: object, true: object, tolerance: float) -> bool:
    """Whether numbers agree."""
    return bool(np.all(np.abs(np.asarray(seen, dtype=float) - np.asarray(true, dtype=float)) < tolerance))
