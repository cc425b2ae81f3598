"""Random bytes and random well-formed messages: no exception, no plan changed by halves, no state that stays broken."""

import random
import struct
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_harness import World, download, mav, same_items, upload, waypoint

from autopilot.core.messages import MavlinkFrame
from autopilot.core.plan import PlanKind
from tests.bench.fuzz.messages import field_codes

HANDLED_NAMES = """
    HEARTBEAT COMMAND_LONG COMMAND_INT SET_MODE SET_GPS_GLOBAL_ORIGIN PARAM_REQUEST_LIST PARAM_REQUEST_READ PARAM_SET
    MISSION_COUNT MISSION_ITEM_INT MISSION_ITEM MISSION_CLEAR_ALL MISSION_REQUEST_LIST MISSION_REQUEST_INT
    MISSION_REQUEST MISSION_ACK MISSION_WRITE_PARTIAL_LIST MISSION_SET_CURRENT PING TIMESYNC SYSTEM_TIME
    FILE_TRANSFER_PROTOCOL LOG_REQUEST_LIST LOG_REQUEST_DATA LOG_REQUEST_END LOG_ERASE REQUEST_DATA_STREAM
"""
HANDLED = sorted(getattr(mav, f"MAVLINK_MSG_ID_{name}") for name in HANDLED_NAMES.strip().split())
COMMANDS = (400, 176, 262, 300, 193, 192, 20, 21, 17, 178, 179, 410, 611, 224, 512, 511, 510, 520, 401, 185, 519)
ODD_FLOATS = (0.0, 1.0, -1.0, float("nan"), float("inf"), -float("inf"), 3.4e38, -3.4e38, 1e-45, 0.5, 129.0, 2.0**31)


def frame_of(msg_id: int, payload: bytes, seq: int) -> bytes:
    """A well-formed frame with any payload."""
    body = bytes((len(payload), 0, 0, seq & 0xFF, 255, 190)) + msg_id.to_bytes(3, "little") + payload
    crc = mav.x25crc(body + bytes((mav.mavlink_map[msg_id].crc_extra,))).crc
    return b"\xfd" + body + int(crc).to_bytes(2, "little")


def random_frames(rng: random.Random, count: int) -> Iterator[bytes]:
    """Frames of messages that the server handles, fields random, most of them addressed to it."""
    for n in range(count):
        msg_id = rng.choice(HANDLED)
        kind = mav.mavlink_map[msg_id]
        size = kind.unpacker.size
        payload = bytearray(rng.choice((rng.randbytes(size), bytes(size))))
        offset = 0
        for name, length, code in zip(
            kind.ordered_fieldnames, kind.array_lengths, field_codes(kind.unpacker.format), strict=True
        ):
            width = struct.calcsize("<" + code)
            if name in ("target_system", "target_component") and rng.random() < 0.95:
                payload[offset] = rng.choice((0, 1))
            elif name == "mission_type" and rng.random() < 0.9:
                payload[offset] = rng.choice((0, 1, 2, 255))
            elif name in ("seq", "count") and width == 2 and rng.random() < 0.9:
                payload[offset : offset + 2] = struct.pack("<H", rng.randrange(4))
            elif name == "command" and width == 2 and rng.random() < 0.9:
                payload[offset : offset + 2] = struct.pack("<H", rng.choice(COMMANDS))
            elif code == "f" and not length:
                payload[offset : offset + 4] = struct.pack("<f", rng.choice(ODD_FLOATS))
            offset += width
        cut = bytes(payload).rstrip(b"\0") or b"\0"
        yield frame_of(msg_id, cut, n)


@pytest.mark.parametrize("profile", ["generic", "px4", "ardusub"])
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_random_messages_neither_raise_nor_leave_a_broken_state(profile: str, seed: int) -> None:
    rng = random.Random(seed)
    world = World(profile)
    plans = world.plans
    for data in random_frames(rng, 150):
        before = dict(plans.stored)
        calls = len(plans.replaced)
        world.t_us += 10_000
        for frame in world.server.step(world.t_us, (MavlinkFrame(link=0, data=data),), world.view):
            assert 12 <= len(frame.data) <= 280
        if len(plans.replaced) == calls:
            assert plans.stored == before
        for kind in PlanKind:
            assert [item.seq for item in plans.stored[kind]] == list(range(len(plans.stored[kind])))
    for name, value in world.params.items():
        spec = world.params.spec(name)
        assert spec.minimum <= value <= spec.maximum
    world.run(9.0)
    client = world.client(sysid=77)
    items = [waypoint(n) for n in range(3)]
    assert upload(client, items) == 0
    back = download(client)
    skip = 1 if profile == "ardusub" else 0
    assert back is not None and same_items(items[skip:], back[skip:])


@given(st.lists(st.binary(max_size=400), max_size=12))
@settings(max_examples=100, deadline=None)
def test_random_bytes_change_nothing(datagrams: list[bytes]) -> None:
    world = World()
    frames = [MavlinkFrame(link=0, data=data) for data in datagrams]
    world.server.step(10_000, frames, world.view)
    assert world.plans.replaced == [] and world.vehicle.calls == []
    world.t_us = 10_000
    client = world.client()
    (answer,) = client.ask(mav.MAVLink_ping_message(1, 2, 0, 0), "PING", 0.05)
    assert answer.seq == 2


def test_a_flood_of_clients_does_not_grow_the_server(world: World) -> None:
    sender = mav.MAVLink(None)
    frames = []
    for sysid in range(2, 250):
        for compid in (1, 7, 190):
            sender.srcSystem, sender.srcComponent = sysid, compid
            asked = mav.MAVLink_command_long_message(1, 1, 193, 0, 0, 0, 0, 0, 0, 0, 0)
            listed = mav.MAVLink_mission_request_list_message(1, 1, 0)
            frames += [MavlinkFrame(link=0, data=bytes(m.pack(sender))) for m in (asked, listed)]
    world.server.step(10_000, frames, world.view)
    inside = world.server
    assert len(inside._announcements._greeted) <= 64 and len(inside._commands._last) <= 64
    assert len(inside.missions._downloads) <= 16


def test_the_harness_really_compares() -> None:
    """Guards the other tests: a changed item must be seen."""
    items = [waypoint(0), waypoint(1)]
    assert same_items(items, items)
    assert not same_items(items, [waypoint(0), waypoint(1, x=5)])
    assert not same_items(items, [waypoint(0), waypoint(1, param4=0.1)])
    assert not same_items(items, items[:1])
    assert np.isnan(items[0].param4)
