"""Messages passed on between clients: to whom, unchanged, and without loops."""

from __future__ import annotations

import random
from typing import Any

import pytest
from mavlink_harness import World, mav
from pymavlink.dialects.v20 import all as everybody

from autopilot.core.clients import Reach, Verbatim
from autopilot.core.messages import MavlinkFrame
from autopilot.drivers.numbering import Numbering

CAMERA, STATION, OTHER, SECOND = (1, 100), (255, 190), (2, 1), (254, 190)


class Net:
    """Clients by (link, number); what each gets of others, as packets."""

    def __init__(self, forward: bool = True) -> None:
        self.world = World(links=(0, 1, 2))
        self.world.params.set("MAV_FORWARD", float(forward))
        self.at: dict[tuple[int, int], tuple[int, int]] = {}
        self.codecs: dict[tuple[int, int], Any] = {}

    def join(self, link: int, number: int, who: tuple[int, int]) -> None:
        self.at[link, number] = who
        self.codecs[who] = mav.MAVLink(None, srcSystem=who[0], srcComponent=who[1])
        self.send(who, mav.MAVLink_heartbeat_message(18, 8, 0, 0, 0, 3))

    def pack(self, who: tuple[int, int], message: Any) -> bytes:
        codec = self.codecs[who]
        data = bytes(message.pack(codec))
        codec.seq = (codec.seq + 1) & 0xFF
        return data

    def send(self, who: tuple[int, int], message: Any) -> dict[tuple[int, int], list[bytes]]:
        """One tick; who gets what of others."""
        return self.give(next(at for at, name in self.at.items() if name == who), self.pack(who, message))

    def give(self, at: tuple[int, int], data: bytes) -> dict[tuple[int, int], list[bytes]]:
        world = self.world
        world.t_us += 10_000
        rx = [MavlinkFrame(link=at[0], client=at[1], data=data, reach=Reach.NETWORK)]
        got: dict[tuple[int, int], list[bytes]] = {}
        for frame in world.server.step(world.t_us, rx, world.view):
            for place, name in self.at.items():
                mine = frame.link == place[0] and frame.client in (0, place[1]) and place[1] not in frame.beside
                if mine and isinstance(frame.data, Verbatim):
                    got.setdefault(name, []).append(bytes(frame.data))
        return got


def net() -> Net:
    """A station and another vehicle on one port, a camera on a serial line, a second station on TCP."""
    found = Net()
    found.join(0, 1, STATION)
    found.join(0, 2, OTHER)
    found.join(1, 0, CAMERA)
    found.join(2, 3, SECOND)
    return found


def command(system: int, component: int) -> Any:
    return mav.MAVLink_command_long_message(system, component, 2000, 0, 0, 0, 0, 0, 0, 0, 0)


def test_nothing_is_passed_on_unless_it_is_asked_for() -> None:
    quiet = Net(forward=False)
    quiet.join(0, 1, STATION)
    quiet.join(1, 2, OTHER)
    assert quiet.send(STATION, mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)) == {}


def test_to_everyone_to_a_system_and_to_a_component() -> None:
    routes = net()
    assert set(routes.send(STATION, mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))) == {OTHER, CAMERA, SECOND}
    assert set(routes.send(CAMERA, mav.MAVLink_heartbeat_message(30, 8, 0, 0, 0, 3))) == {STATION, OTHER, SECOND}
    assert set(routes.send(STATION, command(1, 100))) == {CAMERA}
    assert set(routes.send(SECOND, command(2, 0))) == {OTHER}
    assert set(routes.send(SECOND, command(1, 0))) == {CAMERA}, "ours is handled here, and all of our system hears"
    assert routes.send(STATION, command(1, 1)) == {}
    assert routes.send(STATION, command(77, 1)) == {}, "nobody has heard of it"
    assert set(routes.send(CAMERA, mav.MAVLink_command_ack_message(2000, 0, 0, 0, 255, 190))) == {STATION}
    assert routes.send(STATION, mav.MAVLink_setup_signing_message(2, 1, [1] * 32, 5)) == {}


def test_packets_are_not_changed_not_even_their_number() -> None:
    routes = net()
    data = routes.pack(CAMERA, mav.MAVLink_named_value_float_message(1, b"zoom", 2.5))
    got = routes.give((1, 0), data)
    assert got and all(packets == [data] for packets in got.values())
    numbering = Numbering()
    for own in (routes.pack(STATION, command(1, 1)) for _ in range(3)):
        numbering(own)
    assert numbering(Verbatim(data)) == data


def test_loops_end() -> None:
    """Links 0 and 1 meet in one network: whatever goes out on one comes in on the other, and the other way round."""
    world = World(links=(0, 1))
    world.params.set("MAV_FORWARD", 1.0)
    rng = random.Random(1)
    codec = mav.MAVLink(None, srcSystem=7, srcComponent=1)
    pending: list[MavlinkFrame] = []
    passed = sent = 0
    for tick in range(600):
        if tick % 10 == 0 and tick < 400:
            message = rng.choice((command(0, 0), mav.MAVLink_heartbeat_message(12, 8, 0, 0, 0, 3), command(9, 1)))
            data = bytes(message.pack(codec))
            codec.seq = (codec.seq + 1) & 0xFF
            pending += [MavlinkFrame(link=link, client=1, data=data) for link in (0, 1)]
            sent += 1
        world.t_us += 10_000
        out = world.server.step(world.t_us, pending, world.view)
        passed += sum(isinstance(frame.data, Verbatim) for frame in out)
        pending = [MavlinkFrame(link=1 - frame.link, client=1, data=bytes(frame.data)) for frame in out]
        assert len(out) < 200
    assert sent <= passed + 40 and passed <= 2 * sent
    assert not world.vehicle.calls, "what we said ourselves is no order"


def test_a_client_of_mavlink_1_gets_no_mavlink_2_of_others() -> None:
    routes = net()
    old = routes.codecs[SECOND]
    data = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3).pack(old, force_mavlink1=True)
    routes.world.server.remove_link(2)
    routes.at = {(2, 4) if name == SECOND else at: name for at, name in routes.at.items()}
    assert STATION in routes.give((2, 4), bytes(data)), "MAVLink 1 goes everywhere"
    assert SECOND not in routes.send(STATION, mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))


@pytest.mark.parametrize("old", [False, True])
def test_messages_of_other_dialects_are_counted_and_nothing_else(old: bool) -> None:
    """Their checksum's seed is not known here: whoever passes them on passes on damage. What comes behind is heard."""
    there = net()
    intake = there.world.server._intake
    foreign = [number for number in everybody.mavlink_map if number not in mav.mavlink_map]
    assert len(foreign) > 100
    sender = everybody.MAVLink(None, srcSystem=STATION[0], srcComponent=STATION[1])
    for number in foreign:
        kind = everybody.mavlink_map[number]
        if old and number > 255:
            continue
        names = kind.fieldnames
        message = kind(*(_value(kind, name) for name in names))
        data = bytes(message.pack(sender, force_mavlink1=old))
        sender.seq = (sender.seq + 1) & 0xFF
        received, dropped = intake.received, intake.dropped
        got = there.give((0, 1), data + there.pack(STATION, command(*CAMERA)))
        assert list(got) == [CAMERA] and len(got[CAMERA]) == 1, kind.msgname
        assert (intake.received, intake.dropped) == (received + 2, dropped), kind.msgname


def _value(kind: Any, name: str) -> Any:
    """Of a field: to everyone, and otherwise 1."""
    if name in ("target_system", "target_component"):
        return 0
    of_type = kind.fieldtypes[kind.fieldnames.index(name)]
    length = kind.array_lengths[kind.ordered_fieldnames.index(name)]
    if of_type == "char":
        return b"1"
    return [1] * length if length else 1
