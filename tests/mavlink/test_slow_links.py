"""A serial line of 57,600 baud: commands are answered at once however much telemetry is asked for."""

from __future__ import annotations

from itertools import pairwise

import pytest
from mavlink_harness import Client, World, mav

from autopilot.run.session import link_rates
from tests.lossy_link import LinkConditions, LossyLink

BYTES_PER_S = 5760.0


class Line(LossyLink):
    """Carries so many bytes a second; what is more waits in its buffer, in order."""

    def __init__(self) -> None:
        super().__init__(LinkConditions(rate_bytes_s=BYTES_PER_S), 0)
        self.carried = self.longest = self._inside = 0

    def put(self, t_us: int, data: bytes) -> None:
        super().put(t_us, data)
        self._inside += len(data)
        self.longest = max(self.longest, self._inside)

    def take(self, t_us: int) -> list[bytes]:
        arrived = super().take(t_us)
        size = sum(map(len, arrived))
        self.carried += size
        self._inside -= size
        return arrived


def slow_world(*, greedy: bool) -> tuple[World, Client, Line]:
    world = World(rates=link_rates(["/dev/ttyUSB0:57600"]))
    line = Line()
    client = world.client(from_vehicle=line)
    client.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
    world.run(0.5)
    if greedy:
        client.send(mav.MAVLink_request_data_stream_message(1, 1, 0, 50, 1))
        for number in (30, 31, 32, 33, 74):
            client.send(mav.MAVLink_command_long_message(1, 1, 511, 0, number, 10_000, 0, 0, 0, 0, 0))
            world.run(0.05)
    return world, client, line


@pytest.mark.parametrize("greedy", [False, True])
def test_commands_are_not_starved(greedy: bool) -> None:
    world, client, line = slow_world(greedy=greedy)
    client.send(mav.MAVLink_param_request_list_message(1, 1))
    waits, beats = [], []
    client.rx.clear()
    for _ in range(40):
        client.rx.clear()
        client.send(mav.MAVLink_command_long_message(1, 1, 300, 0, 0, 0, 0, 0, 0, 0, 0))
        ticks = 0
        while not client.got("COMMAND_ACK"):
            world.tick()
            ticks += 1
            assert ticks < 100
        waits.append(ticks)
        beats += [world.t_us] * len(client.got("HEARTBEAT"))
        client.rx.clear()
        world.run(0.1)
        beats += [world.t_us] * len(client.got("HEARTBEAT"))
    assert max(waits) <= 15, "150 ms"
    assert max(b - a for a, b in pairwise(beats)) <= 1_200_000
    assert line.longest < 0.25 * BYTES_PER_S, "what waits in the line"


def test_all_streams_become_slower_together_and_the_list_arrives() -> None:
    world, client, line = slow_world(greedy=True)
    client.rx.clear()
    before = line.carried
    client.send(mav.MAVLink_param_request_list_message(1, 1))
    world.run(10.0)
    names = {message.get_type() for message in client.rx}
    assert {"ATTITUDE", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "SYS_STATUS", "BATTERY_STATUS", "VFR_HUD"} <= names
    values = client.got("PARAM_VALUE")
    assert len({m.param_index for m in values}) == values[0].param_count >= len(tuple(world.params))
    counts = [len(client.got(name)) for name in ("ATTITUDE", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT")]
    assert min(counts) >= 0.7 * max(counts) > 20
    used = (line.carried - before) / 10.0
    assert 0.8 * BYTES_PER_S < used <= 1.01 * BYTES_PER_S


def test_a_fast_link_is_not_slowed_down_by_a_slow_one() -> None:
    world = World(rates=link_rates(["udpin:127.0.0.1:14550", "/dev/ttyUSB0:57600"]), links=(0, 1))
    fast, slow = world.client(link=0), world.client(link=1)
    for client in (fast, slow):
        client.send(mav.MAVLink_command_long_message(1, 1, 511, 0, 30, 10_000, 0, 0, 0, 0, 0))
    world.run(5.0)
    assert len(fast.got("ATTITUDE")) > 480
    assert sum(len(m.get_msgbuf()) for m in slow.rx) < 5.2 * BYTES_PER_S
