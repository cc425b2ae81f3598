"""What a network delivers twice, the second time late, acts once."""

import random
from pathlib import Path
from typing import Any

import pytest
from mavlink_harness import ORIGIN, World, mav, waypoint
from test_files import Ftp, a_log, world_with

from autopilot.mavlink.ftp import Op
from tests.lossy_link import LinkConditions, LossyLink

TICKS = 22
"""Most that a copy comes later than the first: 220 ms."""


def script(rng: random.Random) -> list[Any]:
    """A client's messages, one a tick; later ones take back what earlier ones did."""
    sent: list[Any] = []
    for _ in range(6):
        kind = rng.randrange(12)
        if kind == 0:
            sent.append(mav.MAVLink_param_set_message(1, 1, b"WP_ACCEPT_RADIUS", rng.uniform(0.2, 0.5), 9))
        elif kind == 1:
            sent.append(mav.MAVLink_mission_clear_all_message(1, 1, rng.choice((0, 1, 2, 255))))
        elif kind in (2, 3, 4):
            plan = rng.randrange(3)
            east = rng.randrange(1000)
            items = [waypoint(seq, plan, y=237_790_000 + east + seq) for seq in range(rng.randint(1, 4))]
            sent += [mav.MAVLink_mission_count_message(1, 1, len(items), plan), *items]
        elif kind == 5:
            sent.append(mav.MAVLink_command_long_message(1, 1, 400, 0, rng.randrange(2), 0, 0, 0, 0, 0, 0))
        elif kind == 6:
            sent.append(mav.MAVLink_set_mode_message(1, 1, rng.choice((3, 4)) << 16 | 4 << 24))
        elif kind == 7:
            sent.append(mav.MAVLink_mission_set_current_message(1, 1, rng.randrange(4)))
        elif kind == 8:
            lat = 10**7 * ORIGIN.lat_deg + rng.randrange(100)
            sent.append(mav.MAVLink_set_gps_global_origin_message(1, round(lat), 237_790_000, 0))
        elif kind == 9:
            sent.append(mav.MAVLink_command_long_message(1, 1, 32100, 0, rng.randrange(2), 1, 10, 0, 0, 0, 0))
        elif kind == 10:
            sent.append(mav.MAVLink_command_long_message(1, 1, 511, 0, 30, rng.choice((-1, 10**6)), 0, 0, 0, 0, 0))
        else:
            sent.append(mav.MAVLink_mission_ack_message(1, 1, mav.MAV_MISSION_OPERATION_CANCELLED, rng.randrange(3)))
    return sent


def outcome(sent: list[Any], copies: dict[int, list[int]]) -> tuple[Any, ...]:
    """What a script leads to; ``copies``: by tick, which of its messages come again."""
    world = World()
    client = world.client()
    frames = []
    for tick in range(len(sent) + TICKS + 2):
        if tick < len(sent):
            frames.append(client.send(sent[tick]))
        for index in copies.get(tick, ()):
            client.send_raw(frames[index])
        world.tick()
    world.run(0.3)
    plans = {kind: [(item.seq, item.x, item.y) for item in items] for kind, items in world.plans.stored.items()}
    interval_us = world.server._streams.interval_us(0, mav.MAVLINK_MSG_ID_ATTITUDE)
    asked = world.server._operators.owner, interval_us
    return world.vehicle.calls, plans, world.params["WP_ACCEPT_RADIUS"], world.plans.replaced, asked


@pytest.mark.parametrize("seed", range(10))
def test_files_that_are_read_one_after_the_other_are_not_mixed_by_copies(seed: int, tmp_path: Path) -> None:
    names = [f"2026-11-22/10_00_0{n}.mcap" for n in range(4)]
    logs = [a_log(tmp_path, name, 700, seed=n) for n, name in enumerate(names)]
    world = world_with(tmp_path)
    client = world.client(to_vehicle=LossyLink(LinkConditions(duplicate=0.7), seed))
    ftp = Ftp(client)
    for name, log in zip(names, logs, strict=True):
        opcode, size = ftp.ask(Op.OPEN_READ, data=f"@MAV_LOG/{name}".encode())
        assert (opcode, int.from_bytes(size, "little")) == (Op.ACK, len(log))
        pieces = [ftp.ask(Op.READ, offset=at, size=100) for at in range(0, len(log), 100)]
        assert b"".join(data for _, data in pieces) == log
        assert ftp.ask(Op.TERMINATE)[0] == Op.ACK


@pytest.mark.parametrize("seed", range(150))
def test_copies_that_come_late_change_nothing(seed: int) -> None:
    rng = random.Random(seed)
    sent = script(rng)
    copies: dict[int, list[int]] = {}
    for index in range(len(sent)):
        if rng.random() < 0.3:
            copies.setdefault(index + rng.randint(0, TICKS), []).append(index)
    assert outcome(sent, copies) == outcome(sent, {})
