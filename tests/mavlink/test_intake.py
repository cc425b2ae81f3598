"""Who is heard when: floods, fairness, order, answers between ticks, clients that share a port and even their ids."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_harness import Client, World, mav, upload, waypoint

from autopilot.core.clock import TICK_US
from autopilot.core.messages import MavlinkFrame
from autopilot.core.plan import MissionResult, PlanKind
from autopilot.mavlink.bounded_table import MAX_RECENT, RecentKeys
from autopilot.mavlink.inbox import CLIENT_WORK, FLOOD_AGAIN_US, MAX_INBOXES
from autopilot.mavlink.wire import MAX_BACKLOG_BYTES, LinkParser, Work, checksum

LOUD, QUIET = 3, 4
PATIENT_S = 9.0
"""An upload that stands still is given up before."""


def packed(message: object, sysid: int = 200, seq: int = 0) -> bytes:
    sender = mav.MAVLink(None, srcSystem=sysid, srcComponent=1)
    sender.seq = seq
    return bytes(message.pack(sender))  # type: ignore[attr-defined]


def ping(number: int) -> object:
    return mav.MAVLink_ping_message(number, number, 0, 0)


JUNK = {
    "0xFE": b"\xfe" * 2048,
    "0xFD": b"\xfd" * 2048,
    "headers": bytes((0xFE, 9, 0, 255, 190, 0)) * 340,
    "long headers": bytes((0xFD, 255, 0, 0, 0, 255, 190, 0, 0, 0)) * 200,
    "random": random.Random(1).randbytes(2048),
    "messages": b"".join(packed(ping(n)) for n in range(70)),
}


def flood(world: World, data: bytes) -> None:
    """One datagram from the loud client, and a tick."""
    frame = MavlinkFrame(link=0, client=LOUD, sender="192.0.2.7:5555", data=data)
    quiet = [out for client in world.clients for out in client.take_tx()]
    world.t_us += TICK_US
    tx = world.server.step(world.t_us, (frame, *quiet), world.view)
    for client in world.clients:
        client.deliver([out.data for out in tx if client.gets(out)])


@pytest.mark.parametrize("kind", sorted(JUNK))
@pytest.mark.parametrize("link", [0, 1])
def test_a_flood_is_throttled_and_named_and_others_are_served_at_once(kind: str, link: int) -> None:
    world = World(links=(0, 1))
    client = world.client(link=link, number=QUIET)
    for n in range(600):
        client.send(ping(n))
        flood(world, JUNK[kind])
    assert [message.seq for message in client.got("PING")] == list(range(600))
    named = [message for message in client.got("STATUSTEXT") if "192.0.2.7:5555 floods" in message.text]
    assert len(named) == 1 + (6_000_000 - TICK_US) // FLOOD_AGAIN_US
    assert all(message.severity == mav.MAV_SEVERITY_WARNING and len(message.text) <= 50 for message in named)
    intake = world.server._intake
    assert sum(inbox.parser.backlog for inbox in intake._inboxes.values()) <= MAX_BACKLOG_BYTES
    assert any("bytes dropped" in event.text for event in world.server.take_notices())


def test_what_is_not_for_us_is_passed_over_at_little_cost(world: World) -> None:
    """A router's whole traffic on our port: 200 kB/s of other vehicles' telemetry."""
    client = world.client(number=QUIET)
    traffic = b"".join(packed(mav.MAVLink_attitude_message(n, 0, 0, 0, 0, 0, 0)) for n in range(50))
    for n in range(100):
        client.send(ping(n))
        flood(world, traffic)
    assert len(client.got("PING")) == 100
    assert not any("floods" in message.text for message in client.got("STATUSTEXT"))


@given(st.lists(st.binary(min_size=1, max_size=3000), min_size=1, max_size=30), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_whatever_comes_costs_a_bounded_amount_of_work(pieces: list[bytes], seed: int) -> None:
    rng, parser = random.Random(seed), LinkParser()
    for piece in pieces:
        junk = bytearray(piece)
        for _ in range(rng.randrange(20)):
            junk[rng.randrange(len(junk))] = rng.choice((0xFD, 0xFE, 0, 1, 9))
        parser.push(bytes(junk))
    for _ in range(10_000):
        work = Work(CLIENT_WORK)
        before = parser.backlog
        while work.left > 0 and parser.take(work) is not None:
            pass
        # No junk is passed over for nothing, and the one who works always gets on.
        assert before - parser.backlog <= CLIENT_WORK or parser.received
        if work.left > 0:
            break
    else:
        raise AssertionError("never through")
    assert parser.backlog <= 300


@given(st.binary(max_size=300))
def test_the_checksum_is_mavlinks(data: bytes) -> None:
    assert checksum(data) == mav.x25crc(data).crc


@given(st.integers(0, 2**32 - 1), st.integers(1, 120))
@settings(max_examples=30, deadline=None)
def test_work_in_portions_finds_what_work_at_once_finds(seed: int, portion: int) -> None:
    rng = random.Random(seed)
    data = b"".join(
        rng.choice((packed(ping(n)), rng.randbytes(rng.randrange(40)), b"\xfe" * 9, b"\xfd\x05\x00")) for n in range(40)
    )
    cuts = sorted(rng.randrange(len(data)) for _ in range(6))
    pieces = [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]
    whole, parts = LinkParser(), LinkParser()
    expected = [m.get_msgbuf() for piece in pieces for m in whole.feed(piece)]
    for piece in pieces:
        parts.push(piece)
    got = []
    for _ in range(100_000):
        work = Work(portion)
        message = parts.take(work)
        if message is not None:
            got.append(message.get_msgbuf())
        elif work.left > 0:
            break
    assert got == expected
    assert (parts.dropped, parts.received) == (whole.dropped, whole.received)


def test_the_memory_for_clients_is_bounded(world: World) -> None:
    frames = [MavlinkFrame(link=0, client=n, data=b"\xfd\x20\x00") for n in range(10 * MAX_INBOXES)]
    world.server.step(TICK_US, frames, world.view)
    assert len(world.server._intake._inboxes) <= MAX_INBOXES


# Between ticks


def served(world: World, client: Client) -> list[MavlinkFrame]:
    """What the client has sent reaches the server between two ticks."""
    out = world.server.serve(world.t_us + TICK_US // 2, client.take_tx())
    client.deliver([frame.data for frame in out if client.gets(frame)])
    return list(out)


def transfer(world: World, client: Client, items: list) -> int:
    """Upload between ticks as far as that goes; how many ticks it took."""
    asked: list[int] = []

    def answer(message: object) -> None:
        if message.get_type() == "MISSION_REQUEST_INT":  # type: ignore[attr-defined]
            asked.append(message.seq)  # type: ignore[attr-defined]
            client.send(items[message.seq])  # type: ignore[attr-defined]

    client.on_message = answer
    client.send(mav.MAVLink_mission_count_message(1, 1, len(items), 0))
    for tick in range(1000):
        while client._tx and served(world, client):
            pass
        world.tick()
        if client.got("MISSION_ACK"):
            assert client.got("MISSION_ACK")[0].type == MissionResult.ACCEPTED
            assert asked == list(range(len(items)))
            return tick
    raise AssertionError("no answer")


def test_items_are_taken_between_ticks(world: World) -> None:
    client = world.client(number=1)
    items = [waypoint(n) for n in range(500)]
    assert transfer(world, client, items) <= 50
    assert len(world.plans.items(PlanKind.MISSION)) == 500


def test_a_download_goes_on_between_ticks(world: World) -> None:
    client = world.client(number=1)
    assert upload(client, [waypoint(n) for n in range(30)]) == 0
    client.on_message = None
    client.rx.clear()
    client.send(mav.MAVLink_mission_request_list_message(1, 1, 0))
    for seq in range(10):
        served(world, client)
        client.send(mav.MAVLink_mission_request_int_message(1, 1, seq, 0))
    served(world, client)
    assert [m.seq for m in client.got("MISSION_ITEM_INT")] == list(range(10))


def test_between_ticks_nothing_in_force_changes(world: World) -> None:
    client = world.client(number=1)
    client.send(mav.MAVLink_mission_count_message(1, 1, 1, 0))
    served(world, client)
    client.send(waypoint(0))
    assert served(world, client) == [] and world.plans.replaced == []
    client.send(mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0))
    assert served(world, client) == [] and world.vehicle.calls == []
    world.tick()
    assert len(world.plans.items(PlanKind.MISSION)) == 1
    assert [call[0] for call in world.vehicle.calls] == ["arm"]


def test_the_order_of_a_client_is_kept_and_others_pass(world: World) -> None:
    one, two = world.client(number=1, sysid=101), world.client(number=2, sysid=102)
    world.tick()
    one.send(mav.MAVLink_param_set_message(1, 1, b"SPD_CRUISE", 0.2, mav.MAV_PARAM_TYPE_REAL32))
    one.send(mav.MAVLink_param_request_read_message(1, 1, b"SPD_CRUISE", -1))
    one.send(ping(7))
    two.send(ping(8))
    assert served(world, one) == []
    served(world, two)
    assert [m.seq for m in two.got("PING")] == [8]
    world.tick()
    names = [m.get_type() for m in one.rx if m.get_type() in ("PARAM_VALUE", "PING")]
    assert names == ["PARAM_VALUE", "PARAM_VALUE", "PING"]
    assert all(m.param_value == pytest.approx(0.2) for m in one.got("PARAM_VALUE"))


def test_a_heartbeat_beside_the_ticks_changes_nothing() -> None:
    with_beats, without = World(links=(0, 1)), World(links=(0, 1))
    for n in range(300):
        if n % 7 == 0:
            beats = with_beats.server.beat()
            assert [(frame.link, frame.client) for frame in beats] == [(0, 0), (1, 0)]
            assert all(frame.data[7:10] == b"\0\0\0" for frame in beats)
        one, two = with_beats.tick(), without.tick()
        assert [frame.data for frame in one] == [frame.data for frame in two]


# Clients that share a port


def test_two_clients_with_the_same_ids_do_not_mix(world: World) -> None:
    first, second = world.client(number=1, sysid=245), world.client(number=2, sysid=245)
    plans = {first: [waypoint(n) for n in range(40)], second: [waypoint(n, x=379_756_000 + n) for n in range(40)]}
    for client, items in plans.items():

        def answer(message: object, client: Client = client, items: list = items) -> None:
            if message.get_type() == "MISSION_REQUEST_INT":  # type: ignore[attr-defined]
                client.send(items[message.seq])  # type: ignore[attr-defined]

        client.on_message = answer
        client.send(mav.MAVLink_mission_count_message(1, 1, 40, 0))
    world.run(3.0)
    assert [m.type for m in first.got("MISSION_ACK")] == [MissionResult.ACCEPTED]
    assert [m.type for m in second.got("MISSION_ACK")] == [MissionResult.DENIED]
    assert [m.seq for m in second.got("MISSION_REQUEST_INT")] == []
    assert [item.x for item in world.plans.items(PlanKind.MISSION)] == [item.x for item in plans[first]]
    # What everybody may know goes to everybody.
    assert first.got("HEARTBEAT") and len(first.got("HEARTBEAT")) == len(second.got("HEARTBEAT"))
    assert upload(second, plans[second]) == MissionResult.ACCEPTED


def test_answers_go_to_who_asked(world: World) -> None:
    one, two = world.client(number=1, sysid=245), world.client(number=2, sysid=245)
    world.tick()
    one.send(mav.MAVLink_param_request_list_message(1, 1))
    one.send(mav.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0))
    one.send(waypoint(0))  # nobody asked for it: an error, for that client
    world.run(2.0)
    got = one.got("PARAM_VALUE")
    assert len(got) == got[0].param_count >= len(world.params)
    for name in ("PARAM_VALUE", "COMMAND_ACK", "AUTOPILOT_VERSION", "MISSION_ACK"):
        assert one.got(name) and not two.got(name), name


def test_a_client_that_comes_back_on_another_port_is_not_locked_out(world: World) -> None:
    before = world.client(number=1, sysid=245)
    before.send(mav.MAVLink_mission_count_message(1, 1, 20, 0))
    world.run(0.5)
    after = world.client(number=2, sysid=245)
    world.run(PATIENT_S)
    assert upload(after, [waypoint(n) for n in range(5)]) == MissionResult.ACCEPTED


@pytest.mark.parametrize("told", ["a text each", "a datagram each"])
def test_a_client_that_is_different_every_time_is_remembered_up_to_a_limit(world: World, told: str) -> None:
    """Neither the texts that it is told nor the marks of what it sends pile up, and a tick costs what it did."""
    client = world.client(number=QUIET)
    context = world.server._ctx
    for n in range(3 * MAX_RECENT):
        client.send(mav.MAVLink_mission_count_message(1, 1, 10_000 + n if told == "a text each" else 1 + n % 200, 0))
        if n % 16 == 15:
            world.run(TICK_US * 1e-6)
        assert len(context._recent_texts) <= MAX_RECENT and len(context._datagrams) <= MAX_RECENT
    assert len(context._recent_texts if told == "a text each" else context._datagrams) > 100


def test_what_was_said_lately_is_known_and_what_was_said_before_is_not() -> None:
    recent: RecentKeys[str] = RecentKeys(100)
    recent.add("a", 0)
    recent.add("b", 50)
    assert recent.knows("a", 99) and recent.knows("b", 99)
    assert not recent.knows("a", 100) and recent.knows("b", 100)
    recent.add("a", 120)
    assert not recent.knows("b", 150) and recent.knows("a", 150)
    for n in range(2 * MAX_RECENT):
        recent.add(str(n), 150)
    assert len(recent) == MAX_RECENT
    assert recent.knows(str(2 * MAX_RECENT - 1), 150) and not recent.knows("a", 150)
