"""Bad input over MAVLink against the whole service: one clear line, the right result, and what was before stays."""

import functools
import math
import random
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

import pytest
from pymavlink.dialects.v20 import development as mav
from system_harness import OpenSession
from wire_client import REMEDIES, Harbour, WireClient

from autopilot.core.messages import Outputs
from autopilot.core.plan import MAX_ITEMS, MissionResult, PlanItem, PlanKind
from autopilot.core.plan_wire import item_message
from autopilot.mission.paper import paper_plan
from autopilot.sitl.operator import ScriptedOperator

NO_NUMBER = -(2**31)
"""NaN as an integer coordinate: what a conversion of NaN gives on x86."""
INVALID = 2**31 - 1
"""INT32_MAX: the protocol's own "no coordinate"."""

PLAN = paper_plan(1)


def _local(seq: int, north_m: float, east_m: float, depth_m: float = 0.4) -> PlanItem:
    """A waypoint in local metres (MAV_FRAME_LOCAL_NED)."""
    return PlanItem(seq=seq, frame=1, command=16, x=round(north_m * 1e4), y=round(east_m * 1e4), z=depth_m)


def _circle(seq: int, north_m: float, east_m: float, radius_m: float) -> PlanItem:
    """MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION."""
    return PlanItem(
        seq=seq, frame=1, command=5004, param1=radius_m, x=round(north_m * 1e4), y=round(east_m * 1e4), z=0.0
    )


def _box(north_m: float, east_m: float, half_north_m: float, half_east_m: float) -> list[PlanItem]:
    """MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION, four of them."""
    corners = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return [
        replace(_circle(seq, north_m + a * half_north_m, east_m + b * half_east_m, 4.0), command=5002, param4=0.0)
        for seq, (a, b) in enumerate(corners)
    ]


def _key(item: PlanItem) -> tuple[object, ...]:
    """Comparable, with NaN equal to NaN, as wide as on the wire."""
    numbers = (item.param1, item.param2, item.param3, item.param4, item.z)
    rounded = tuple("nan" if math.isnan(value) else f"{value:.6g}" for value in numbers)
    return (item.seq, item.frame, item.command, item.x, item.y, item.autocontinue, *rounded)


def _keys(items: Any) -> list[tuple[object, ...]]:
    return [_key(item) for item in items]


MakeHarbour: TypeAlias = Callable[..., tuple[Harbour, WireClient]]


def with_plans(session: OpenSession, *others: WireClient) -> tuple[Harbour, WireClient]:
    """A vehicle in the tank with the paper's fence and mission in force, and a client."""
    client = WireClient()
    made = Harbour(session(sensors="pose", peers=(client, *others)))
    made.run(0.5)
    assert made.offer(client, PlanKind.FENCE, PLAN.fence) == MissionResult.ACCEPTED
    assert made.offer(client, PlanKind.MISSION, PLAN.mission) == MissionResult.ACCEPTED
    return made, client


@pytest.fixture
def harbour(session: OpenSession) -> MakeHarbour:
    """Makes a vehicle of the test's own."""
    return functools.partial(with_plans, session)


@pytest.fixture(scope="module")
def unmoved(module_session: OpenSession) -> tuple[Harbour, WireClient]:
    """The vehicle of all tests after which its plans are what they were."""
    return with_plans(module_session)


def _assert_one_line(client: WireClient, *named: str) -> None:
    lines = client.texts()
    assert len(lines) == 1, lines
    assert "\n" not in lines[0]
    for word in named:
        assert word in lines[0], lines[0]
    assert any(remedy in lines[0] for remedy in REMEDIES), f"no remedy in {lines[0]!r}"


def _assert_unchanged(made: Harbour, client: WireClient) -> None:
    for kind in PlanKind:
        assert _keys(made.download(client, kind)) == _keys(PLAN.items(kind))


GOOD = _local(0, -1.6, -0.35)

FORBIDDEN_WAYPOINTS = {
    "inside an obstacle": (_local(1, 0.9375, 0.1), ("item 1", "north 0.94, east 0.10 m", "inside", "circle")),
    "too near to an obstacle": (_local(1, 0.9375, 0.4), ("item 1", "only 0.24 m", "circle")),
    "outside the workspace": (_local(1, 3.2, 0.0), ("item 1", "north 3.20", "0.70 m outside")),
    "too near to a wall": (_local(1, 2.4, 0.0), ("item 1", "only 0.10 m inside")),
}


def _assert_not_flown(made: Harbour, client: WireClient, *named: str) -> None:
    """The plans in force are told to be unfit, and nothing arms or starts the vehicle."""
    _assert_one_line(client, "No start: ", *named)
    (line,) = client.texts()
    assert any(remedy in line[:90] for remedy in REMEDIES), line
    made.run(1.0)
    assert made.command(client, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == mav.MAV_RESULT_DENIED
    _assert_one_line(client, "Arming denied: plan: ", *named)
    assert not client.received("SYS_STATUS") or not _ready(client)
    assert made.command(client, mav.MAV_CMD_MISSION_START) == mav.MAV_RESULT_DENIED


def _ready(client: WireClient) -> bool:
    return bool(client.received("SYS_STATUS")[-1].onboard_control_sensors_health & mav.MAV_SYS_STATUS_PREARM_CHECK)


@pytest.mark.parametrize("name", FORBIDDEN_WAYPOINTS)
def test_waypoint_that_the_fence_forbids(harbour: MakeHarbour, name: str) -> None:
    item, named = FORBIDDEN_WAYPOINTS[name]
    made, client = harbour()
    mission = (GOOD, item, _local(2, 1.75, 0.0))
    assert made.offer(client, PlanKind.MISSION, mission) == MissionResult.ACCEPTED
    _assert_not_flown(made, client, *named)
    assert _keys(made.download(client, PlanKind.MISSION)) == _keys(mission)
    assert made.offer(client, PlanKind.MISSION, PLAN.mission) == MissionResult.ACCEPTED
    assert "Plan ok" in client.texts(least=mav.MAV_SEVERITY_INFO)
    made.run(1.0)
    assert made.command(client, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == mav.MAV_RESULT_ACCEPTED


def test_no_path_between_waypoints(harbour: MakeHarbour) -> None:
    """Two pools: each waypoint is free, the way from one to the other is not."""
    made, client = harbour()
    pools = [
        (_local(0, -2.4, -1.4), _local(1, 0.0, -1.4), _local(2, 0.0, 1.4), _local(3, -2.4, 1.4)),
        (_local(0, 0.0, -1.4), _local(1, 2.4, -1.4), _local(2, 2.4, 1.4), _local(3, 0.0, 1.4)),
    ]
    fence = tuple(
        replace(corner, seq=4 * pool + i, command=5001, param1=4.0, param4=0.0, z=0.0)
        for pool, corners in enumerate(pools)
        for i, corner in enumerate(corners)
    )
    assert made.offer(client, PlanKind.FENCE, fence) == MissionResult.INVALID
    _assert_one_line(client, "Fence refused")
    _assert_unchanged(made, client)
    door = tuple(replace(corner, seq=4 + i) for i, corner in enumerate(_box(0.0, 0.0, 0.1, 1.6)))
    assert made.offer(client, PlanKind.FENCE, (*FENCE[:4], *door)) == MissionResult.ACCEPTED
    _assert_not_flown(made, client, "no free path from item 0 (QGC 1) to item 1 (QGC 2)", "open the fence")


def test_too_many_items(unmoved: tuple[Harbour, WireClient]) -> None:
    made, client = unmoved
    for kind in PlanKind:
        assert made.offer(client, kind, (), count=MAX_ITEMS[kind] + 2) == MissionResult.NO_SPACE
        _assert_one_line(
            client, f"{kind.name.capitalize()} refused", f"{MAX_ITEMS[kind] + 2} items", f"{MAX_ITEMS[kind]}"
        )
        _assert_unchanged(made, client)


def test_unknown_plan_type(unmoved: tuple[Harbour, WireClient]) -> None:
    made, client = unmoved
    client.inbox.clear()
    client.send(mav.MAVLink_mission_count_message(1, 1, 3, 7))
    made.run(0.3)
    assert [(m.type, m.mission_type) for m in client.received("MISSION_ACK")] == [(MissionResult.UNSUPPORTED, 7)]
    _assert_unchanged(made, client)


FENCE = PLAN.fence


def test_rally_point_in_an_obstacle(harbour: MakeHarbour) -> None:
    made, client = harbour()
    rally = replace(_local(0, 0.9375, 0.0), command=5100)
    assert made.offer(client, PlanKind.RALLY, (rally,)) == MissionResult.ACCEPTED
    _assert_not_flown(made, client, "rally point 0", "inside")


def test_fence_over_a_waypoint_of_the_mission_in_force(harbour: MakeHarbour) -> None:
    made, client = harbour()
    assert made.offer(client, PlanKind.FENCE, (*FENCE[:4], _circle(4, 1.75, 0.0, 0.1))) == MissionResult.ACCEPTED
    _assert_not_flown(made, client, "fence item 4", "item 1 (QGC 2) is")


def test_second_client_uploads_at_the_same_time(harbour: MakeHarbour) -> None:
    second = WireClient(sysid=254)
    made, first = harbour(second)
    first.inbox.clear()
    new = (GOOD, _local(1, 1.75, 0.0))
    first.send(mav.MAVLink_mission_count_message(1, 1, len(new), 0))
    made.until(lambda: bool(first.received("MISSION_REQUEST_INT")))
    for kind in PlanKind:
        assert made.offer(second, kind, PLAN.fence) == MissionResult.DENIED
        _assert_one_line(second, "denied", "255/190", "try again later")
    second.inbox.clear()
    second.send(mav.MAVLink_mission_clear_all_message(1, 1, 255))
    made.until(lambda: bool(second.received("MISSION_ACK")))
    assert second.received("MISSION_ACK")[0].type == MissionResult.DENIED
    _assert_unchanged(made, second)
    for item in new:
        first.send(item_message(item, PlanKind.MISSION))
        made.run(0.1)
    assert [m.type for m in first.received("MISSION_ACK")] == [MissionResult.ACCEPTED]
    assert first.texts() == []
    assert _keys(made.download(second, PlanKind.MISSION)) == _keys(new)
    assert made.offer(second, PlanKind.MISSION, PLAN.mission) == MissionResult.ACCEPTED


def test_bad_plans_while_flying_change_nothing(harbour: MakeHarbour) -> None:
    made, client = harbour()
    made.run(1.0)
    assert made.command(client, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == mav.MAV_RESULT_ACCEPTED
    assert made.command(client, mav.MAV_CMD_MISSION_START) == mav.MAV_RESULT_ACCEPTED
    made.run(2.0)
    assert made.offer(client, PlanKind.MISSION, (GOOD, _local(1, 0.9375, 0.0, 9.0))) == MissionResult.INVALID_PARAM7
    _assert_one_line(client, "Mission refused", "item 1")
    assert made.offer(client, PlanKind.FENCE, (*FENCE[:4], _circle(4, 1.75, 0.0, 0.1))) == MissionResult.DENIED
    _assert_one_line(client, "Fence refused", "armed", "item 1", "item 4")
    _assert_unchanged(made, client)
    commander = made.session.parts.commander
    assert commander.armed
    assert commander.mode.name == "MISSION"


# Garbage


class Vandal:
    """Fills a link with rubbish: noise, headers without frames, damaged frames, frames for nobody."""

    def __init__(self, seed: int) -> None:
        self._rng = random.Random(seed)
        self._mav = mav.MAVLink(None, srcSystem=66, srcComponent=66)
        self.frames_heard = 0
        self.bad_texts = 0

    def step(self, _t_us: int, received: Any) -> list[bytes]:
        for data in received:
            for message in self._mav.parse_buffer(data) or ():
                self.frames_heard += 1
                self.bad_texts += message.get_type() == "STATUSTEXT" and message.severity <= mav.MAV_SEVERITY_WARNING
        return [self._rubbish() for _ in range(self._rng.randrange(3))]

    def _rubbish(self) -> bytes:
        rng = self._rng
        kind = rng.randrange(6)
        if kind == 0:
            return rng.randbytes(rng.choice((1, 7, 40, 280, 2048)))
        if kind == 1:
            return bytes((rng.choice((0xFD, 0xFE)), rng.randrange(256))) + rng.randbytes(rng.randrange(40))
        message: Any = rng.choice(
            (
                mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, 21196, 0, 0, 0, 0, 0),
                mav.MAVLink_mission_clear_all_message(1, 1, 255),
                mav.MAVLink_mission_count_message(1, 1, 3, 0),
                mav.MAVLink_param_set_message(1, 1, b"SPD_CRUISE", 0.01, 9),
            )
        )
        frame = bytearray(message.pack(self._mav))
        if kind in (2, 3):  # one bit wrong behind the marker
            frame[rng.randrange(1, len(frame))] ^= 1 << rng.randrange(8)
            return bytes(frame)
        if kind == 4:
            return bytes(frame[: rng.randrange(1, len(frame))])
        return bytes(self._for_somebody_else())

    def _for_somebody_else(self) -> bytes:
        other = mav.MAVLink_command_long_message(9, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, 21196, 0, 0, 0, 0, 0)
        return bytes(other.pack(self._mav))


def _flight(session: OpenSession, *others: Any) -> tuple[list[Outputs], Any]:
    outputs: list[Outputs] = []
    operator = ScriptedOperator(1)
    run = session(sensors="pose", peers=(operator, *others), on_tick=outputs.append)
    for kind in (PlanKind.FENCE, PlanKind.MISSION):
        assert run.parts.plans.replace(kind, PLAN.items(kind)) is None
    harbour = Harbour(run)
    harbour.run(8.0)
    assert operator.started
    return outputs, run


def test_garbage_while_flying_is_counted_and_nothing_else(session: OpenSession) -> None:
    """The flight with a vandal on a second link is the flight without him, bit for bit."""
    vandal = Vandal(seed=4)
    quiet, _ = _flight(session)
    noisy, run = _flight(session, vandal)
    assert run.parts.server.dropped_rx > 130
    assert vandal.frames_heard > 100  # telemetry goes on
    assert vandal.bad_texts == 0
    assert any(abs(n) > 0.5 for n in noisy[-1].command.thrust_n)
    for a, b in zip(quiet, noisy, strict=True):
        assert a.command.pwm_us == b.command.pwm_us
        assert (a.mode.armed, a.mode.custom_mode) == (b.mode.armed, b.mode.custom_mode)
        assert [event.text for event in a.events] == [event.text for event in b.events]


def test_good_messages_between_garbage_are_heard(harbour: MakeHarbour) -> None:
    made, client = harbour()
    rng = random.Random(8)
    for _ in range(40):
        client.send_bytes(rng.randbytes(rng.randrange(1, 300)))
        made.tick()
    made.run(1.0)
    assert made.command(client, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == mav.MAV_RESULT_ACCEPTED
    assert client.texts() == []
    made.run(2.1)
    counted = made.session.parts.server.dropped_rx
    assert counted > 0
    assert client.received("SYS_STATUS")[-1].errors_comm == counted


def test_well_formed_nonsense_never_stops_the_service(harbour: MakeHarbour) -> None:
    """Every message of the dialect with random content, commands and parameters with extreme values, while armed."""
    made, client = harbour()
    made.run(1.0)
    assert made.command(client, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == mav.MAV_RESULT_ACCEPTED
    rng = random.Random(15)
    extremes = (0.0, -1.0, 1.0, 2.0, 1e38, -1e38, math.nan, math.inf, -math.inf, 1e-40, 21196.0)
    commands = [int(c) for c in mav.enums["MAV_CMD"]]
    names = list(made.session.parts.params)
    kinds = sorted(mav.mavlink_map)
    for number in range(1500):
        params = [rng.choice(extremes) for _ in range(7)]
        pick = number % 4
        if pick == 0:
            kind = mav.mavlink_map[rng.choice(kinds)]
            payload = rng.randbytes(kind.unpacker.size)
            client.send_bytes(_frame(rng, kind.id, kind.crc_extra, payload))
        elif pick == 1:
            client.send(mav.MAVLink_command_long_message(1, 1, rng.choice(commands), 0, *params))
        elif pick == 2:
            x, y = rng.choice((0, INVALID, NO_NUMBER, 379755000)), rng.choice((0, INVALID, NO_NUMBER, 237790000))
            frame = rng.randrange(256)
            client.send(
                mav.MAVLink_command_int_message(1, 1, frame, rng.choice(commands), 0, 0, *params[:4], x, y, params[6])
            )
        else:
            client.send(mav.MAVLink_param_set_message(1, 1, rng.choice(names).encode(), params[0], 9))
        made.tick()
    made.run(0.5)
    assert client.received("HEARTBEAT")


def _frame(rng: random.Random, msg_id: int, crc_extra: int, payload: bytes) -> bytes:
    """A MAVLink 2 frame with a right checksum, addressed to us where the message has an address."""
    payload = payload.rstrip(b"\0") or b"\0"
    head = bytes((len(payload), 0, 0, rng.randrange(256), 255, 190)) + msg_id.to_bytes(3, "little")
    crc = mav.x25crc(head + payload + bytes((crc_extra,))).crc
    return b"\xfd" + head + payload + int(crc).to_bytes(2, "little")
