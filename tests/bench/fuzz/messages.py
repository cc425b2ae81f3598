"""MAVLink traffic of clients that are sensible, mistaken, broken and hostile by turns, all from one seed."""

import math
import random
import struct
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Any

from pymavlink.dialects.v20 import all as everybody

from autopilot.core.clients import Reach
from autopilot.core.messages import MavlinkFrame
from autopilot.core.params import PARAMETERS
from autopilot.mavlink.dialect import extra, mav

HANDLED_NAMES = """
    HEARTBEAT COMMAND_LONG COMMAND_INT SET_MODE SET_GPS_GLOBAL_ORIGIN PARAM_REQUEST_LIST PARAM_REQUEST_READ PARAM_SET
    PARAM_EXT_REQUEST_READ PARAM_EXT_REQUEST_LIST PARAM_EXT_SET
    MISSION_COUNT MISSION_ITEM_INT MISSION_ITEM MISSION_CLEAR_ALL MISSION_REQUEST_LIST MISSION_REQUEST_INT
    MISSION_REQUEST MISSION_ACK MISSION_WRITE_PARTIAL_LIST MISSION_REQUEST_PARTIAL_LIST
    MISSION_SET_CURRENT PING TIMESYNC SYSTEM_TIME
    FILE_TRANSFER_PROTOCOL LOG_REQUEST_LIST LOG_REQUEST_DATA LOG_REQUEST_END LOG_ERASE
    MANUAL_CONTROL REQUEST_DATA_STREAM VISION_POSITION_ESTIMATE ODOMETRY
    SETUP_SIGNING GLOBAL_POSITION_INT ADSB_VEHICLE AIS_VESSEL OBSTACLE_DISTANCE
    RC_CHANNELS_OVERRIDE SET_POSITION_TARGET_LOCAL_NED SET_POSITION_TARGET_GLOBAL_INT SET_ATTITUDE_TARGET
    SET_ACTUATOR_CONTROL_TARGET
"""
EXTRA_NAMES = "COMMAND_CANCEL REQUEST_EVENT"
HANDLED = tuple(
    sorted(
        [getattr(mav, f"MAVLINK_MSG_ID_{name}") for name in HANDLED_NAMES.split()]
        + [getattr(extra, f"MAVLINK_MSG_ID_{name}") for name in EXTRA_NAMES.split()]
    )
)
"""Messages that the server has a handler for."""

COMMANDS = (
    *(400, 176, 262, 300, 193, 192, 20, 21, 17, 178, 179, 207, 410, 611, 224, 512, 511, 510, 520, 401, 185, 519),
    *(22, 34, 92, 186, 32100, 241, 245, 246),
    *(115, 195, 196, 197, 201, 209, 528, 2600),
)
"""Commands that the server knows."""
EQUIPMENT_COMMANDS = (181, 182, 183, 184, 187, 204, 205, 211, 1000, 1001)
"""To what the vehicle carries."""
CAMERA_COMMANDS = (
    *(200, 202, 203, 206, 214, 521, 522, 525, 526, 527, 529, 530, 531, 532, 2000, 2001, 2002, 2003, 2004, 2005, 2010),
    *(2500, 2501, 2502, 2503, 2504, 2505),
)
"""To its camera, where there is one."""
KNOWN_COMMANDS = (*COMMANDS, *EQUIPMENT_COMMANDS, *CAMERA_COMMANDS)
ALL_COMMANDS = tuple(sorted(number for number in mav.enums["MAV_CMD"] if number < 0x1_0000))

ODD_FLOATS = (
    *(0.0, 1.0, -1.0, 0.5, 2.0, 3.0, 129.0, 2989.0, 21196.0, 1e-45, 2.0**31, -(2.0**31), 2.0**32, 1e9, 360.0, 90.0),
    *(math.nan, math.inf, -math.inf, 3.4e38, -3.4e38),
)
ODD_WORDS = (0, 1, 2, 3, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFF)

LAT_E7, LON_E7 = 379_755_000, 237_790_000
"""The simulated tank."""
M_PER_E7_LAT, M_PER_E7_LON = 0.0111, 0.00877

STEERING_NAMES = """
    MANUAL_CONTROL RC_CHANNELS_OVERRIDE SET_POSITION_TARGET_LOCAL_NED SET_POSITION_TARGET_GLOBAL_INT
    SET_ATTITUDE_TARGET SET_ACTUATOR_CONTROL_TARGET MISSION_SET_CURRENT HEARTBEAT
"""
STEERING = tuple(getattr(mav, f"MAVLINK_MSG_ID_{name}") for name in STEERING_NAMES.split())
"""Messages that move the vehicle and change nothing of what binds it."""

FOREIGN: dict[int, Any] = {n: kind for n, kind in everybody.mavlink_map.items() if n not in mav.mavlink_map}
"""Messages of other dialects (ArduPilot's, gimbals', airships' ...) that the service does not know."""
KINDS: dict[int, Any] = {**FOREIGN, **mav.mavlink_map}

CONVERSATIONS = 0.25
COMMAND_SHARE = 0.2
PARAM_SHARE = 0.1
DAMAGED_SHARE = 0.08
REPLAYED_SHARE = 0.05
"""Of signed frames: as they were sent before."""
UNKNOWN_SHARE = 0.05
FOREIGN_SHARE = 0.05
"""Shares of the traffic; the rest are messages of any content."""
MUTATED = 0.12
"""Share of plan items and command fields that are not what they should be."""


@dataclass(slots=True)
class Sender:
    """One client: where it is heard, and how it speaks."""

    sysid: int
    compid: int = 190
    link: int = 0
    client: int = 0
    old: bool = False
    """MAVLink 1, as far as it goes."""
    key: bytes | None = None
    """What it signs with, None = it does not sign."""
    reach: Reach = Reach.NETWORK
    seq: int = 0
    stamp: int = 0
    """Signing time of its last frame."""
    sent: deque[bytes] = field(default_factory=lambda: deque(maxlen=20))
    """Signed frames, to be sent again."""


SENDERS = (Sender(255), Sender(254, 1), Sender(7, 9), Sender(1, 1))
"""Clients of one link that share an address."""


class Traffic:
    """An endless supply of frames."""

    def __init__(self, seed: int, senders: Sequence[Sender] = SENDERS, stamp: Callable[[], int] = lambda: 0) -> None:
        """``stamp``: signing time of the service, as the clients' clocks have it."""
        self._rng = random.Random(seed)
        self._senders = tuple(senders)
        self._stamp = stamp
        self._packer = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        self._talk: list[Any] = []
        self._talker = self._senders[0]
        self._names = [spec.name for spec in PARAMETERS]
        self.steering = False
        """Only what moves the vehicle: no plans, no parameters, no origin, no disarming."""

    def frame(self) -> MavlinkFrame:
        """One datagram: mostly one message."""
        rng = self._rng
        sender, message = self._message()
        data = self._spoken_by(sender, message)
        if rng.random() < DAMAGED_SHARE:
            data = self._damaged(data)
        if sender.sent and rng.random() < REPLAYED_SHARE:
            data = rng.choice(sender.sent)
        return MavlinkFrame(
            link=sender.link, client=sender.client, data=data, reach=sender.reach, sender=f"{sender.sysid}"
        )

    def any_of(self, msg_id: int) -> bytes:
        """A frame of that type by one of the senders, its fields of any content."""
        return self._spoken_by(self._rng.choice(self._senders), self._any(msg_id))

    def _message(self) -> tuple[Sender, Any]:
        rng, dice = self._rng, self._rng.random()
        if self.steering:
            return rng.choice(self._senders), self._steer()
        kinds: tuple[tuple[float, Callable[[], Any]], ...] = (
            (COMMAND_SHARE, self._command),
            (PARAM_SHARE, self._param_set),
            (UNKNOWN_SHARE, lambda: self._any(rng.choice(list(mav.mavlink_map)))),
            (FOREIGN_SHARE, self._foreign),
        )
        if dice < CONVERSATIONS:
            if not self._talk:
                self._talk, self._talker = self._upload(), rng.choice(self._senders)
            return self._talker, self._talk.pop(0)
        dice -= CONVERSATIONS
        for weight, make in kinds:
            if dice < weight:
                return rng.choice(self._senders), make()
            dice -= weight
        return rng.choice(self._senders), self._any(rng.choice(HANDLED))

    def _spoken_by(self, sender: Sender, message: Any) -> bytes:
        """A message, or a frame without sender, as one client sends it."""
        frame = message if isinstance(message, bytes) else bytes(message.pack(self._packer))
        sender.seq = (sender.seq + 1) & 0xFF
        number = int.from_bytes(frame[7:10], "little")
        payload = frame[10:-2]
        kind = KINDS.get(number)
        crc_extra, size = (0, len(payload)) if kind is None else (kind.crc_extra, kind.unpacker.size)
        if sender.old and number < 256 and len(payload) <= size:
            body = bytes((size, sender.seq, sender.sysid, sender.compid, number)) + payload.ljust(size, b"\0")
            return b"\xfe" + body + _crc(body, crc_extra)
        flags = 0 if sender.key is None else 1
        body = bytes((len(payload), flags, 0, sender.seq, sender.sysid, sender.compid)) + frame[7:-2]
        frame = b"\xfd" + body + _crc(body, crc_extra)
        if sender.key is None:
            return frame
        sender.stamp = max(sender.stamp + 1, self._stamp())
        frame += bytes((sender.link,)) + sender.stamp.to_bytes(6, "little")
        frame += sha256(sender.key + frame).digest()[:6]
        sender.sent.append(frame)
        return frame

    def _damaged(self, frame: bytes) -> bytes:
        """Cut off, bits turned, bytes put in or taken out, too long, two run together, or nothing that ever was a
        frame."""
        rng = self._rng
        data = bytearray(frame)
        at = rng.randrange(len(data))
        match rng.randrange(9):
            case 0:
                return bytes(data[:at])
            case 1:
                for _ in range(rng.randint(1, 8)):
                    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            case 2:
                return bytes(data[at:]) + self._spoken_by(*self._message())
            case 3:
                return rng.randbytes(rng.randrange(300))
            case 4:
                return b"\xfd" * rng.randrange(300)
            case 5:
                data[at:at] = rng.randbytes(rng.randint(1, 20))
            case 6:
                del data[at : at + rng.randint(1, 20)]
            case 7:
                return b"".join(self._spoken_by(*self._message()) for _ in range(rng.randint(2, 40))) + bytes(data[:at])
            case _ if data[0] == 0xFD:
                return _sized(bytes(data), rng.randrange(256), rng)
        return bytes(data)

    def _any(self, msg_id: int) -> bytes:
        """A well-formed frame of a type, its fields of any content; most are addressed to the vehicle."""
        kind = KINDS[msg_id]
        payload = bytearray()
        names = kind.ordered_fieldnames
        for name, length, code in zip(names, kind.array_lengths, field_codes(kind.unpacker.format), strict=True):
            payload += self._field(name, length, code)
        if self._rng.random() < 0.1:  # fields that a sender does not know of are left out
            del payload[self._rng.randint(1, len(payload)) :]
        body = bytes((len(payload), 0, 0, 0, 255, 190)) + msg_id.to_bytes(3, "little") + bytes(payload)
        return b"\xfd" + body + _crc(body, kind.crc_extra)

    def _foreign(self) -> bytes:
        """A sound frame of another dialect's message, or of one that no dialect has."""
        rng = self._rng
        if rng.random() < 0.8:
            return self._any(rng.choice(list(FOREIGN)))
        payload = rng.randbytes(rng.randint(1, 255))
        body = bytes((len(payload), 0, 0, 0, 255, 190)) + rng.randrange(1 << 24).to_bytes(3, "little") + payload
        return b"\xfd" + body + _crc(body, rng.randrange(256))

    def _steer(self) -> Any:
        """What moves the vehicle: sensible as operators, pilots and programs send it, or of any content."""
        rng = self._rng
        if rng.random() < 0.4:
            return self._any(rng.choice(STEERING))
        sticks = [rng.choice((0, 0, 1000, -1000, rng.randint(-1000, 1000))) for _ in range(3)]
        north, east, down = rng.uniform(-2.6, 2.6), rng.uniform(-1.6, 1.6), rng.uniform(0.0, 1.4)
        speed = rng.choice((0.2, 0.5, 3.0))
        vel = [rng.uniform(-speed, speed) for _ in range(3)]
        mask = rng.choice((0b0000_1101_1111_1000, 0b0000_1101_1100_0111, 0b0000_0101_1100_0111, 0b0000_1001_1111_1000))
        return rng.choice(
            (
                lambda: mav.MAVLink_manual_control_message(1, sticks[0], sticks[1], rng.randrange(1001), sticks[2], 0),
                lambda: mav.MAVLink_rc_channels_override_message(
                    1, 1, *(rng.choice((0, 1100, 1500, 1900, 65535)) for _ in range(8))
                ),
                lambda: mav.MAVLink_set_position_target_local_ned_message(
                    0,
                    1,
                    1,
                    rng.choice((1, 7, 8, 9)),
                    mask,
                    north,
                    east,
                    down,
                    *vel,
                    0.0,
                    0.0,
                    0.0,
                    rng.uniform(-3, 3),
                    0.5,
                ),
                self._order,
            )
        )()

    def _order(self) -> Any:
        """A command that moves the vehicle."""
        rng = self._rng
        lat, lon = self._place(1.3)
        nan = math.nan
        command, params, z = rng.choice(
            (
                (400, (1.0, 0.0), 0.0),
                (300, (), 0.0),
                (176, (1.0, float(rng.randint(1, 7)), float(rng.randint(0, 6))), 0.0),
                (193, (float(rng.randrange(2)),), 0.0),
                (192, (-1.0, 1.0, 0.0, rng.choice((nan, 1.0))), rng.uniform(-1.4, 0.1)),
                (178, (rng.randrange(2), rng.uniform(0.0, 0.6)), 0.0),
                (
                    34,
                    (rng.choice((0.0, 0.3, -0.8, 2.0)), rng.uniform(0.0, 0.5), rng.choice((0, 1, 2, 3, 5)), 0.0),
                    -0.5,
                ),
                (186, (rng.uniform(-1.5, 0.1), 3.0), 0.0),
                (22, (), rng.uniform(-1.2, 1.0)),
                (92, (1.0,), 0.0),
                (20, (), 0.0),
                (17, (), 0.0),
                (224, (rng.randrange(6),), 0.0),
                (209, (rng.randint(1, 5), rng.randrange(3), rng.choice((0.0, 30.0, 100.0, 1600.0)), rng.random()), 0.0),
            )
        )
        fields = [float(value) for value in (*params, 0, 0, 0, 0)[:4]]
        return mav.MAVLink_command_int_message(1, 1, 3, command, 0, 0, *fields, lat, lon, z)

    def _field(self, name: str, length: int, code: str) -> bytes:
        rng = self._rng
        size = struct.calcsize("<" + code)
        if name in ("target_system", "target_component") and rng.random() < 0.93:
            return bytes((rng.choice((0, 1)),))
        if name == "mission_type" and rng.random() < 0.9:
            return bytes((rng.choice((0, 1, 2, 255)),))
        if name in ("seq", "count", "start_index", "end_index") and size == 2 and rng.random() < 0.9:
            return struct.pack("<H", rng.randrange(5))
        if name == "command" and size == 2:
            return struct.pack("<H", rng.choice(KNOWN_COMMANDS if rng.random() < 0.6 else ALL_COMMANDS))
        if name == "frame" and rng.random() < 0.8:
            return bytes((rng.choice((0, 1, 2, 3, 5, 6, 20)),))
        if code[-1] in "fd":
            count = max(length, 1)
            values = [rng.choice(ODD_FLOATS) if rng.random() < 0.7 else rng.uniform(-10.0, 10.0) for _ in range(count)]
            return struct.pack(f"<{count}{code[-1]}", *values)
        if length == 0 and code[-1] in "bBhHiIqQ" and rng.random() < 0.6:
            return (rng.choice(ODD_WORDS) & ((1 << 8 * size) - 1)).to_bytes(size, "little")
        return rng.choice((rng.randbytes(size), bytes(size)))

    # Sensible requests, now and then with a mistake

    def _param_set(self) -> Any:
        """Every parameter from limit to limit, beyond them, and names that do not exist."""
        rng = self._rng
        spec = rng.choice(PARAMETERS)
        inside = rng.uniform(spec.minimum, spec.maximum)
        edges = (spec.minimum, spec.maximum, spec.default, inside, float(round(inside)))
        value = rng.choice(edges) if rng.random() < 0.85 else rng.choice(ODD_FLOATS)
        name = spec.name if rng.random() < 0.95 else spec.name[:-1] + "?"
        return mav.MAVLink_param_set_message(1, 1, name.encode(), value, rng.choice((9, 9, 6, 1, 10)))

    def _command(self) -> Any:
        rng = self._rng
        lat, lon = LAT_E7 + round(rng.gauss(0, 300)), LON_E7 + round(rng.gauss(0, 300))
        command, params, z = rng.choice(
            (
                (400, (1, rng.choice((0, 0, 21196))), 0.0),
                (400, (rng.random() < 0.9, 0), 0.0),
                (300, (0, 0), 0.0),
                (176, (rng.choice((1, 209)), rng.randrange(8), rng.randrange(8)), 0.0),
                (193, (rng.randrange(2),), 0.0),
                (192, (-1, 1, 0, rng.choice((math.nan, 1.0))), rng.uniform(-1.2, 0.0)),
                (178, (rng.randrange(2), rng.uniform(0.0, 0.6)), 0.0),
                (179, (rng.randrange(2),), 0.0),
                (224, (rng.randrange(6),), 0.0),
                (20, (), 0.0),
                (21, (), 0.0),
                (17, (), 0.0),
                (512, (rng.choice((1, 24, 30, 32, 33, 147, 148, 242, 435, 436)),), 0.0),
                (511, (rng.randrange(300), rng.choice((-1, 0, 10_000, 1e6))), 0.0),
                (401, (), 0.0),
                (410, (), 0.0),
                (611, (), 0.0),
                (183, (rng.choice((1, 17, 18)), rng.uniform(1000.0, 2000.0)), 0.0),
                (182, (0, rng.randrange(4), rng.uniform(0.0, 2.0)), 0.0),
                (211, (1, rng.randrange(2)), 0.0),
                (2000, (0, rng.uniform(0.0, 1.0), rng.randrange(4)), 0.0),
            )
        )
        fields = [float(value) for value in (*params, 0, 0, 0, 0)[:4]]
        if rng.random() < MUTATED:
            fields[rng.randrange(4)] = rng.choice(ODD_FLOATS)
        if rng.random() < MUTATED:
            lat, lon = rng.choice(((rng.randrange(-(2**31), 2**31),) * 2, (2**31 - 1, lon), (lat + 10**8, lon), (0, 0)))
            z = rng.choice(ODD_FLOATS)
        if rng.random() < 0.5:
            return mav.MAVLink_command_long_message(1, 1, command, 0, *fields, 0.0, 0.0, z)
        frame = rng.choice((0, 3, 5, 6, 1))
        if frame == 1:
            lat, lon = round(rng.gauss(0, 2e4)), round(rng.gauss(0, 1e4))
        return mav.MAVLink_command_int_message(1, 1, frame, command, 0, 0, *fields, lat, lon, z)

    def _upload(self) -> list[Any]:
        rng = self._rng
        kind = rng.choice((0, 0, 1, 1, 2))
        items = (self._mission, self._fence, self._rally)[kind]()
        if rng.random() < MUTATED:
            items = items[: rng.randrange(len(items) + 1)]
        if rng.random() < 0.1:
            return [mav.MAVLink_mission_clear_all_message(1, 1, rng.choice((0, 1, 2, 255)))]
        talk: list[Any] = [mav.MAVLink_mission_count_message(1, 1, len(items), kind)]
        for seq, (command, frame, params, x, y, z) in enumerate(items):
            fields = list(params)
            if rng.random() < MUTATED / 3:
                fields[rng.randrange(4)] = rng.choice(ODD_FLOATS)
            if rng.random() < MUTATED / 3:
                x, y = rng.randrange(-(2**31), 2**31), rng.choice((y, rng.randrange(-(2**31), 2**31)))
            if rng.random() < MUTATED / 3:
                z = rng.choice(ODD_FLOATS)
            talk.append(mav.MAVLink_mission_item_int_message(1, 1, seq, frame, command, 0, 1, *fields, x, y, z, kind))
        return talk

    def _place(self, spread_m: float = 1.0) -> tuple[int, int]:
        rng = self._rng
        north, east = rng.uniform(-2.2, 2.2) * spread_m, rng.uniform(-1.2, 1.2) * spread_m
        return LAT_E7 + round(north / M_PER_E7_LAT), LON_E7 + round(east / M_PER_E7_LON)

    def _mission(self) -> list[tuple[int, int, Sequence[float], int, int, float]]:
        rng = self._rng
        items: list[tuple[int, int, Sequence[float], int, int, float]] = []
        for _ in range(rng.randint(1, 8)):
            draw = rng.random()
            if draw < 0.75:
                yaw = rng.choice((math.nan, rng.uniform(-180.0, 180.0)))
                items.append((16, 3, (rng.choice((0.0, 0.5)), 0.3, 0.0, yaw), *self._place(), -rng.uniform(0.1, 1.1)))
            elif draw < 0.8:
                items.append(
                    rng.choice(
                        (
                            (2000, 2, (0.0, 0.5, float(rng.randrange(3)), 0.0), 0, 0, 0.0),
                            (206, 2, (rng.uniform(0.0, 1.0), 0.0, 1.0, 0.0), 0, 0, 0.0),
                            (211, 2, (1.0, float(rng.randrange(2)), 0.0, 0.0), 0, 0, 0.0),
                            (184, 2, (17.0, 1500.0, 2.0, 0.5), 0, 0, 0.0),
                        )
                    )
                )
            elif draw < 0.9:
                items.append((178, 2, (1.0, rng.uniform(0.05, 0.5), -1.0, 0.0), 0, 0, 0.0))
            else:
                target = float(rng.randrange(max(len(items), 1)))
                items.append((177, 2, (target, float(rng.randrange(-1, 3)), 0.0, 0.0), 0, 0, 0.0))
        return items

    def _fence(self) -> list[tuple[int, int, Sequence[float], int, int, float]]:
        rng = self._rng
        items: list[tuple[int, int, Sequence[float], int, int, float]] = []
        for _ in range(rng.randint(1, 3)):
            if rng.random() < 0.5:
                command = rng.choice((5004, 5004, 5003))
                radius = rng.uniform(0.1, 0.5) if command == 5004 else rng.uniform(3.0, 10.0)
                items.append((command, 3, (radius, 0.0, 0.0, 0.0), *self._place(), 0.0))
                continue
            count, command = rng.randint(3, 8), rng.choice((5001, 5001, 5002))
            size = rng.uniform(2.0, 4.0) if command == 5001 else rng.uniform(0.1, 0.4)
            middle = (0, 0) if command == 5001 else (rng.uniform(-2, 2), rng.uniform(-1, 1))
            for k in range(count):
                angle = 2.0 * math.pi * k / count
                x = LAT_E7 + round((middle[0] + size * math.cos(angle)) / M_PER_E7_LAT)
                y = LON_E7 + round((middle[1] + size * math.sin(angle)) / M_PER_E7_LON)
                items.append((command, 3, (float(count), 0.0, 0.0, 0.0), x, y, 0.0))
        return items

    def _rally(self) -> list[tuple[int, int, Sequence[float], int, int, float]]:
        return [(5100, 3, (0.0, 0.0, 0.0, 0.0), *self._place(), -0.4) for _ in range(self._rng.randint(1, 3))]


def _crc(body: bytes, crc_extra: int) -> bytes:
    return int(mav.x25crc(body + bytes((crc_extra,))).crc).to_bytes(2, "little")


def _sized(frame: bytes, size: int, rng: random.Random) -> bytes:
    """A MAVLink 2 frame whose payload has another length, with a checksum that is right."""
    end = 10 + frame[1]
    number = int.from_bytes(frame[7:10], "little")
    payload = (frame[10:end] + rng.randbytes(256))[:size]
    body = bytes((size,)) + frame[2:10] + payload
    kind = KINDS.get(number)
    return b"\xfd" + body + _crc(body, 0 if kind is None else kind.crc_extra) + frame[end + 2 :]


def field_codes(text: str) -> list[str]:
    """A struct format cut into its fields: "<I4sB" is I, 4s and B."""
    out, number = [], ""
    for char in text.lstrip("<"):
        if char.isdigit():
            number += char
        else:
            out.append(number + char)
            number = ""
    return out
