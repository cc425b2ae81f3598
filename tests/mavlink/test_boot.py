"""What a service says on its links before it can do anything: who gets which answer, and what is left for later."""

import random
import struct
import time
from typing import Any

import pytest
from mavlink_harness import World
from pymavlink.dialects.v20 import development as mav

from autopilot.core.clients import Reach
from autopilot.core.crc import file_crc32
from autopilot.core.errors import DriverError
from autopilot.drivers.protocols import Received
from autopilot.mavlink.boot import MAX_PARSERS, STARTING, BootLink, BootSigning
from autopilot.mavlink.boot_identity import BootIdentity
from autopilot.mavlink.context import VehicleIdentity
from autopilot.mavlink.dialect import extra
from autopilot.mavlink.ftp import Op
from autopilot.mavlink.profiles import profile_by_name
from autopilot.mavlink.wire import LinkParser
from autopilot.run.boot_links import MAX_KEPT, TURN_S, BootLinks

ARM = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
COUNT = mav.MAVLink_mission_count_message(1, 1, 3, 0)
FENCE_COUNT = mav.MAVLink_mission_count_message(1, 1, 5, 1)
SET_MODE = mav.MAVLink_set_mode_message(1, 217, 4)


def boot_link(profile: str = "generic", signing: BootSigning | None = None) -> BootLink:
    identity = VehicleIdentity(name="vehicle", version="1.2.3", git="0123abcd", uid=1)
    return BootLink(1, profile, BootIdentity(profile_by_name(profile), lambda: identity), signing)


def packed(*messages: Any) -> bytes:
    sender = mav.MAVLink(None, srcSystem=255, srcComponent=190)
    return b"".join(bytes(message.pack(sender)) for message in messages)


def kinds(*data: bytes) -> list[str]:
    parser = LinkParser()
    return [message.get_type() for piece in data for message in parser.feed(piece)]


def test_requests_beside_an_action_are_left_and_the_action_is_not() -> None:
    boot = boot_link()
    answers, left = boot.answer(packed(COUNT, ARM, FENCE_COUNT, COUNT))
    assert kinds(*answers) == ["STATUSTEXT", "COMMAND_ACK"]
    assert kinds(*left.values()) == ["MISSION_COUNT", "MISSION_COUNT"], "what is asked again is asked once"
    answers, left = boot.answer(packed(COUNT))
    assert (answers, list(left.values())) == ([], [packed(COUNT)])


def test_a_mode_is_put_off_as_well() -> None:
    answers, left = boot_link().answer(packed(SET_MODE))
    assert not left
    (text,) = LinkParser().feed(b"".join(answers))
    assert text.text == STARTING
    other = packed(mav.MAVLink_set_mode_message(7, 217, 4))
    answers, left = boot_link().answer(other)
    assert (answers, list(left.values())) == ([], [other]), "another vehicle's"


def asked(boot: BootLink, message: Any, *, reach: Reach = Reach.NETWORK, codec: Any = None) -> list[Any]:
    """What a client gets for a message."""
    sender = codec or mav.MAVLink(None, srcSystem=255, srcComponent=190)
    answers, _ = boot.answer(bytes(message.pack(sender)), 1, reach)
    return [found for answer in answers for found in LinkParser().feed(answer)]


def without_time(message: Any) -> dict[str, Any]:
    return {name: repr(value) for name, value in message.to_dict().items() if name not in ("time_boot_ms", "data")}


def request(number: int, index: float = 0.0, component: int = 1) -> Any:
    return mav.MAVLink_command_long_message(1, component, 512, 0, number, index, 0, 0, 0, 0, 0)


@pytest.mark.parametrize("profile", ["generic", "px4", "ardusub"])
def test_a_starting_vehicle_says_what_it_is_in_the_words_of_the_running_one(world: World, profile: str) -> None:
    """Version with fence and rally points, protocol, metadata, modes: each as the service says it later."""
    client = world.client(number=1, sysid=255)
    identity = world.server._ctx.identity
    boot = BootLink(1, profile, BootIdentity(profile_by_name(profile), lambda: identity))
    for number, index in ((148, 0), (300, 0), (395, 0), (397, 0), (435, 0), (435, 2)):
        ack, *early = asked(boot, request(number, index))
        assert (ack.get_type(), ack.command, ack.result) == ("COMMAND_ACK", 512, 0), number
        client.rx.clear()
        kind = early[0].get_type()
        assert client.command(512, float(number), float(index)) == 0
        late = [message for message in client.rx if message.get_type() == kind]
        assert [without_time(message) for message in early] == [without_time(message) for message in late]
        assert late, number
    version = asked(boot, request(148))[1]
    plans = mav.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE | mav.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    assert version.capabilities & plans == plans
    assert asked(boot, request(148, component=0))[1:] and not asked(boot, request(148, component=77))
    for command, kind in ((520, "AUTOPILOT_VERSION"), (519, "UNKNOWN_300")):
        ack, message = asked(boot, mav.MAVLink_command_long_message(1, 1, command, 0, 1, 0, 0, 0, 0, 0, 0))
        assert (ack.command, ack.result, message.get_type()) == (command, 0, kind)
    assert asked(boot, request(33)) == [], "a position is for the service to tell"
    assert asked(boot, request(float("nan"))) == asked(boot, request(2.5)) == []


def ftp(seq: int, opcode: int, data: bytes = b"", offset: int = 0, size: int | None = None) -> Any:
    head = struct.pack("<HBBBBBxI", seq, 0, opcode, len(data) if size is None else size, 0, 0, offset)
    return mav.MAVLink_file_transfer_protocol_message(0, 1, 1, list((head + data).ljust(251, b"\0")))


def test_the_files_about_parameters_can_be_read_while_the_vehicle_starts() -> None:
    boot = boot_link("px4")
    metadata = asked(boot, request(397))[1]
    name = metadata.uri.rpartition("/")[2].encode()
    (opened,) = asked(boot, ftp(1, Op.OPEN_READ, name))
    size = int.from_bytes(bytes(opened.payload[12:16]), "little")
    assert opened.payload[3] == Op.ACK and size
    answers, _ = boot.answer(packed(ftp(2, Op.BURST, size=239)), 1)
    content = b""
    sent = [(1, data) for data in answers] + [each for turn in range(10) for each in boot.tick(50_000 * turn)]
    for client, data in sent:
        (message,) = LinkParser().feed(data)
        if message.payload[3] == Op.ACK:
            assert client == 1
            content += bytes(message.payload[12 : 12 + message.payload[4]])
    assert len(content) == size and file_crc32(content) == metadata.file_crc
    answers, left = boot.answer(packed(ftp(3, Op.LIST, b"@MAV_LOG")), 1)
    assert not answers and len(left) == 1, "logs are for the service to tell"


def test_with_a_key_a_starting_vehicle_answers_signed_who_has_signed() -> None:
    key = bytes(range(32))
    boot = boot_link("px4", BootSigning(key, 10**12, False))
    friend = mav.MAVLink(None, srcSystem=255, srcComponent=190)
    friend.signing.secret_key, friend.signing.sign_outgoing, friend.signing.timestamp = key, True, 10**12
    assert asked(boot, request(148)) == []
    assert asked(boot, request(148), reach=Reach.MACHINE) == []
    beat = boot.heartbeat()
    answers, _ = boot.answer(bytes(request(148).pack(friend)), 1)
    messages = [message for data in (beat, *answers) for message in friend.parse_buffer(data)]
    assert [message.get_type() for message in messages] == ["HEARTBEAT", "COMMAND_ACK", "AUTOPILOT_VERSION"]
    assert all(message.get_signed() for message in messages)
    local = boot_link("px4", BootSigning(key, 10**12, True))
    assert len(asked(local, request(148), reach=Reach.MACHINE)) == 2


def test_half_a_message_of_one_client_does_not_meet_anothers() -> None:
    boot, data = boot_link(), packed(ARM)
    assert boot.answer(data[:20], 1)[0] == []
    assert boot.answer(b"\0" * 30, 2)[0] == []
    assert len(boot.answer(data[20:], 1)[0]) == 2
    for client in range(2 * MAX_PARSERS):
        boot.answer(data[:20], client)
    assert len(boot._parsers) == MAX_PARSERS


class Line:
    """A link in memory; raises what it is told to."""

    name, problem, dropped_tx = "line", None, 0

    def __init__(self) -> None:
        self.error: Exception | None = None
        self.inbox: list[bytes] = []
        self.sent: list[bytes] = []

    def recv(self, t_us: int) -> list[Received]:
        if self.error is not None:
            raise self.error
        received, self.inbox = self.inbox, []
        return [Received(data, 5, "somebody") for data in received]

    def send(self, data: bytes, client: int = 0) -> None:
        self.sent.append(data)

    def filenos(self) -> list[int]:
        return []

    def close(self) -> None:
        pass


def hostile_pieces(rng: random.Random) -> list[bytes]:
    """Every message of the dialect with fields of all zeros, of all ones and random ones, whole, cut and bent; junk."""
    pieces = []
    for number, kind in {**mav.mavlink_map, **extra.mavlink_map}.items():
        size = kind.unpacker.size
        for payload in (bytes(size), b"\xff" * size, rng.randbytes(size)):
            cut = payload.rstrip(b"\0") or b"\0"
            body = bytes((len(cut), 0, 0, rng.randrange(256), rng.randrange(256), rng.randrange(256)))
            body += number.to_bytes(3, "little") + cut
            frame = b"\xfd" + body + mav.x25crc(body + bytes((kind.crc_extra,))).crc.to_bytes(2, "little")
            bent = bytearray(frame)
            bent[rng.randrange(len(bent))] ^= 1 << rng.randrange(8)
            pieces += [frame, frame[: rng.randrange(len(frame))], bytes(bent), rng.randbytes(rng.randrange(60))]
    rng.shuffle(pieces)
    return pieces


@pytest.mark.parametrize("seed", range(3))
def test_whatever_comes_the_heart_of_a_starting_vehicle_beats(seed: int, capfd: pytest.CaptureFixture[str]) -> None:
    """From the first turn on: every message of the dialect, trajectories with arrays among them, and junk."""
    pieces = hostile_pieces(random.Random(seed))
    trajectory = mav.mavlink_map[mav.MAVLINK_MSG_ID_TRAJECTORY_REPRESENTATION_WAYPOINTS]
    body = bytes((1, 0, 0, 0, 255, 190)) + (332).to_bytes(3, "little") + b"\0"
    crc = mav.x25crc(body + bytes((trajectory.crc_extra,))).crc.to_bytes(2, "little")
    line, now_s = Line(), 0.0
    boot = BootLinks([line], 1, "px4", now_s=lambda: now_s)
    turns = 0
    while pieces:
        line.inbox = [b"\xfd" + body + crc, *pieces[:20]]
        del pieces[:20]
        boot._turn()
        turns += 1
        now_s += TURN_S
        assert len(boot._kept) <= MAX_KEPT
    beats = [kind for kind in kinds(*line.sent) if kind == "HEARTBEAT"]
    assert turns * TURN_S > 5.0 and len(beats) >= turns * TURN_S - 1.0
    assert "Traceback" not in capfd.readouterr().err
    line.inbox = [packed(COUNT)]
    boot._turn()
    assert "MISSION_COUNT" in [kind for frame in boot.take_unanswered() for kind in kinds(frame.data)]


@pytest.mark.parametrize("error", [DriverError("gone"), OSError(), ValueError("a fault")])
def test_a_link_that_breaks_takes_no_other_with_it(error: Exception, capfd: pytest.CaptureFixture[str]) -> None:
    broken, good = Line(), Line()
    broken.error = error
    with BootLinks([broken, good], 1, "generic") as boot:
        assert kinds(*good.sent) == ["HEARTBEAT"]
        good.inbox.append(packed(ARM, COUNT))
        while "COMMAND_ACK" not in kinds(*good.sent):
            assert boot._thread.is_alive()
            time.sleep(TURN_S)
        broken.error = None
        while not broken.sent:
            assert boot._thread.is_alive()
            time.sleep(TURN_S)
        kept = boot.take_unanswered()
    assert [(frame.link, frame.client, kinds(frame.data)) for frame in kept] == [(1, 5, ["MISSION_COUNT"])]
    assert capfd.readouterr().err.count("Traceback") == isinstance(error, ValueError)
