"""The mission protocol, row by row, over a perfect and over a bad link."""

from collections.abc import Callable

import pytest
from mavlink_harness import (
    ORIGIN,
    Client,
    Uploader,
    World,
    base_view,
    both_ways,
    download,
    mav,
    same_items,
    upload,
    waypoint,
)

from autopilot.core.messages import MissionProgress, ProgressState
from autopilot.core.plan import MAX_ITEMS, MissionResult, PlanKind, PlanRejection
from autopilot.mavlink.api import CommandReply, CommandResult

R = MissionResult

MOST = MAX_ITEMS[PlanKind.MISSION]


def plan(count: int, kind: int = 0, north: int = 0) -> list:
    return [waypoint(n, kind, x=379_755_000 + north + 10 * n) for n in range(count)]


def count(n: int, kind: int = 0) -> object:
    return mav.MAVLink_mission_count_message(1, 1, n, kind)


# Upload and download


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_what_is_uploaded_comes_back(world: World, client: Client, kind: int) -> None:
    items = plan(12, kind)
    assert upload(client, items, kind) == R.ACCEPTED
    back = download(client, kind)
    assert back is not None and same_items(items, back)
    others = [k for k in PlanKind if k != kind]
    assert all(world.plans.items(k) == () for k in others)


def test_empty_plans_download_as_count_zero(client: Client) -> None:
    for kind in (0, 1, 2):
        (answer,) = client.ask(mav.MAVLink_mission_request_list_message(1, 1, kind), "MISSION_COUNT", 0.1)
        assert (answer.count, answer.mission_type) == (0, kind)
        assert (answer.target_system, answer.target_component) == (255, 190)


def test_requests_come_one_at_a_time_and_the_answer_at_once(client: Client) -> None:
    uploader = Uploader(client, plan(20))
    assert uploader.run(0.4) == R.ACCEPTED
    assert uploader.requests == list(range(20))
    assert uploader.results == [R.ACCEPTED]


def test_float_requests_are_answered_with_int_items(client: Client) -> None:
    upload(client, plan(3))
    (item,) = client.ask(mav.MAVLink_mission_request_message(1, 1, 2, 0), "MISSION_ITEM_INT", 0.1)
    assert item.seq == 2 and item.x == plan(3)[2].x


def test_the_current_item_is_marked(world: World, client: Client) -> None:
    upload(client, plan(4))
    back = download(client)
    assert back is not None and [m.current for m in back] == [0, 1, 0, 0]
    world.show(progress=MissionProgress(t_us=0, current_seq=3, reached_seq=2, lap=0, state=ProgressState.ACTIVE))
    back = download(client)
    assert back is not None and [m.current for m in back] == [0, 0, 0, 1]


def test_count_zero_and_clear_all_empty_a_plan(world: World, client: Client) -> None:
    for clear in (count(0), mav.MAVLink_mission_clear_all_message(1, 1, 0)):
        upload(client, plan(3))
        (ack,) = client.ask(clear, "MISSION_ACK", 0.1)
        assert ack.type == R.ACCEPTED and world.plans.items(PlanKind.MISSION) == ()


def test_clear_all_types(world: World, client: Client) -> None:
    for kind in (0, 1, 2):
        upload(client, plan(2, kind), kind)
    (ack,) = client.ask(mav.MAVLink_mission_clear_all_message(1, 1, 255), "MISSION_ACK", 0.1)
    assert (ack.type, ack.mission_type) == (R.ACCEPTED, 255)
    assert all(world.plans.items(kind) == () for kind in PlanKind)


@pytest.mark.parametrize("mission_type", [3, 7, 255])
def test_unknown_plan_types_are_unsupported(world: World, client: Client, mission_type: int) -> None:
    asked = [
        count(2, mission_type),
        mav.MAVLink_mission_request_list_message(1, 1, mission_type),
        mav.MAVLink_mission_request_int_message(1, 1, 0, mission_type),
    ]
    if mission_type != 255:
        asked.append(mav.MAVLink_mission_clear_all_message(1, 1, mission_type))
    for message in asked:
        (ack,) = client.ask(message, "MISSION_ACK", 0.1)
        assert (ack.type, ack.mission_type) == (R.UNSUPPORTED, mission_type)
    assert not world.server.missions.uploading


# Refusals leave the plan in force


def test_an_upload_changes_nothing_until_the_last_item(world: World, client: Client) -> None:
    upload(client, plan(5))
    before = world.plans.items(PlanKind.MISSION)
    uploader = Uploader(client, [*plan(7, north=5000), None])
    uploader.count()
    world.run(0.5)
    assert world.plans.items(PlanKind.MISSION) is before
    assert world.server.missions.uploading
    back = download(client)
    assert back is not None and same_items(plan(5), back)


@pytest.mark.parametrize(
    ("change", "result"), [({"command": 9999}, R.UNSUPPORTED), ({"x": 2_000_000_000}, R.INVALID_PARAM5_X)]
)
def test_a_bad_item_ends_the_upload_with_its_reason(world: World, change: dict, result: MissionResult) -> None:
    client = world.client()
    upload(client, plan(5))
    items = plan(6, north=9000)
    items[2] = waypoint(2, **change)
    assert upload(client, items) == result
    world.run(0.1)
    assert "item 2" in client.texts()
    back = download(client)
    assert back is not None and same_items(plan(5), back)
    assert upload(client, plan(6, north=9000)) == R.ACCEPTED


def test_a_refused_plan_is_explained(world: World, client: Client) -> None:
    upload(client, plan(5))
    reason = "item 1 is 0.12 m from the fence, needs 0.33 m: move it away from the cylinder in the middle of the tank"
    world.plans.veto = PlanRejection(seq=1, result=R.INVALID_PARAM6_Y, reason=reason)
    assert upload(client, plan(3)) == R.INVALID_PARAM6_Y
    world.run(0.1)
    chunks = [m for m in client.got("STATUSTEXT") if m.id]
    assert reason.replace("item 1", "item 1 (QGC 2)") in "".join(m.text for m in chunks)
    assert len(world.plans.items(PlanKind.MISSION)) == 5
    (ack,) = client.ask(mav.MAVLink_mission_clear_all_message(1, 1, 0), "MISSION_ACK", 0.1)
    assert ack.type == R.INVALID_PARAM6_Y and len(world.plans.items(PlanKind.MISSION)) == 5
    assert "Not cleared (mission): item 1 (QGC 2) is" in client.texts().replace("\n", "")


def test_too_many_items_are_refused_at_once(world: World, client: Client) -> None:
    upload(client, plan(2))
    (ack,) = client.ask(count(MOST + 2), "MISSION_ACK", 0.1)
    assert ack.type == R.NO_SPACE
    assert str(MOST) in client.texts()
    assert not client.got("MISSION_REQUEST_INT") and len(world.plans.items(PlanKind.MISSION)) == 2


def test_a_plan_of_the_greatest_size(world: World, client: Client) -> None:
    assert upload(client, plan(MOST)) == R.ACCEPTED
    assert len(world.plans.items(PlanKind.MISSION)) == MOST


def test_float_items_are_refused_as_too_coarse(world: World, client: Client) -> None:
    upload(client, plan(2))
    client.send(count(2))
    world.run(0.05)
    item = mav.MAVLink_mission_item_message(1, 1, 0, 3, 16, 0, 1, 0, 0, 0, 0, 37.9755, 23.779, -0.4, 0)
    (ack,) = client.ask(item, "MISSION_ACK", 0.1)
    assert ack.type == R.UNSUPPORTED and "MISSION_ITEM_INT" in client.texts()
    assert not world.server.missions.uploading and len(world.plans.items(PlanKind.MISSION)) == 2


@pytest.mark.parametrize("profile", ["ardusub", "px4"])
def test_an_item_that_is_a_go_to(world: World, client: Client, profile: str) -> None:
    """ArduPilot's, current = 2; QGroundControl sends an ArduSub no other."""

    def go_to(current: int = 2, command: int = 16) -> int:
        item = mav.MAVLink_mission_item_message(1, 1, 0, 3, command, current, 1, 0, 0, 0, 0, 37.9756, 23.7791, -0.4, 0)
        return int(client.ask(item, "MISSION_ACK", 0.1)[-1].type)

    assert go_to(0) == R.UNSUPPORTED and not world.vehicle.calls
    if profile == "px4":
        assert go_to() == R.UNSUPPORTED and not world.vehicle.calls
        return
    assert go_to(command=21) == R.DENIED and not world.vehicle.calls, "no place to land at is flown to"
    assert "use NAV_WAYPOINT 16" in client.texts()
    assert go_to() == R.ACCEPTED
    ((name, point, yaw),) = world.vehicle.calls
    assert (name, yaw, point.alt_m) == ("go_to", None, pytest.approx(ORIGIN.alt_m - 0.4))
    assert (point.lat_deg, point.lon_deg) == (pytest.approx(37.9756, abs=4e-6), pytest.approx(23.7791, abs=4e-6))
    world.vehicle.answers["go_to"] = CommandReply(result=CommandResult.DENIED, reason="Go-to denied: arm first")
    assert go_to() == R.DENIED and "arm first" in client.texts()


def test_partial_lists_are_unsupported(world: World, client: Client) -> None:
    upload(client, plan(3))
    for message in (mav.MAVLink_mission_write_partial_list_message, mav.MAVLink_mission_request_partial_list_message):
        (ack,) = client.ask(message(1, 1, 0, 1, 0), "MISSION_ACK", 0.1)
        assert ack.type == R.UNSUPPORTED and len(world.plans.items(PlanKind.MISSION)) == 3


# Sequence, repetition, time


def test_a_missing_item_is_asked_for_again_and_then_given_up(world: World, client: Client) -> None:
    upload(client, plan(2))
    items = plan(4, north=700)
    client.rx.clear()
    uploader = Uploader(client, [*items[:2], None, None])
    uploader.count()
    world.run(3.0)
    asked = [m.seq for m in client.got("MISSION_REQUEST_INT")]
    assert asked[:3] == [0, 1, 2] and 8 <= asked.count(2) <= 14
    world.run(6.0)
    assert uploader.results == [R.OPERATION_CANCELLED]
    assert "item 2 (QGC 3) of 4" in client.texts()
    assert len(world.plans.items(PlanKind.MISSION)) == 2 and not world.server.missions.uploading


def test_silence_ends_an_upload_after_eight_seconds(world: World, client: Client) -> None:
    client.send(count(3))
    world.run(7.9)
    assert world.server.missions.uploading and not client.got("MISSION_ACK")
    world.run(0.3)
    (ack,) = client.got("MISSION_ACK")
    assert ack.type == R.OPERATION_CANCELLED


def test_patience_stretches_the_times_of_a_fast_simulation() -> None:
    world = World(patience=10.0)
    client = world.client()
    client.send(count(3))
    world.run(20.0)
    assert world.server.missions.uploading
    assert 6 <= len(client.got("MISSION_REQUEST_INT")) <= 8


def test_items_out_of_turn_are_dropped_and_the_due_one_asked_for(world: World, client: Client) -> None:
    items = plan(4)
    client.send(count(4))
    world.run(0.02)
    client.send(items[0])
    world.run(0.02)
    client.rx.clear()
    client.send(items[3])
    world.run(0.02)
    assert [m.seq for m in client.got("MISSION_REQUEST_INT")] == [1]
    client.send(items[0])
    client.send(items[1])
    client.send(items[1])
    world.run(0.02)
    for item in items[2:]:
        client.send(item)
        world.run(0.02)
    assert [m.type for m in client.got("MISSION_ACK")] == [R.ACCEPTED]
    assert [i.x for i in world.plans.items(PlanKind.MISSION)] == [m.x for m in items]


def test_a_client_that_never_listens_is_given_up(world: World, client: Client) -> None:
    client.send(count(3))
    for _ in range(40):
        client.send(waypoint(2))
        world.run(0.02)
    (ack, *_) = client.got("MISSION_ACK")
    assert ack.type == R.INVALID_SEQUENCE and not world.server.missions.uploading


def test_the_last_item_again_gets_the_answer_again(world: World, client: Client) -> None:
    items = plan(3)
    assert upload(client, items) == R.ACCEPTED
    (ack,) = client.ask(items[2], "MISSION_ACK", 0.1)
    assert ack.type == R.ACCEPTED
    assert len(world.plans.replaced) == 1


def test_unsolicited_items_are_errors(world: World, client: Client) -> None:
    upload(client, plan(2))
    world.run(6.0)
    (ack,) = client.ask(waypoint(1), "MISSION_ACK", 0.1)
    assert ack.type == R.ERROR and len(world.plans.items(PlanKind.MISSION)) == 2


def test_who_takes_control_uploads_at_once_and_ends_the_upload_of_another(world: World) -> None:
    other, owner = world.client(sysid=254, number=1), world.client(number=2)
    other.send(count(3))
    world.run(0.1)
    assert owner.command(32100, 1.0) == 0
    world.run(0.1)
    (ack,) = other.got("MISSION_ACK")
    assert ack.type == R.DENIED and "another client has taken control" in other.texts()
    assert upload(owner, plan(2), seconds=1.0) == R.ACCEPTED


def test_requests_out_of_range_are_invalid_sequences(client: Client) -> None:
    upload(client, plan(2))
    (ack,) = client.ask(mav.MAVLink_mission_request_int_message(1, 1, 2, 0), "MISSION_ACK", 0.1)
    assert ack.type == R.INVALID_SEQUENCE


def test_the_client_can_cancel(world: World, client: Client) -> None:
    upload(client, plan(2))
    client.send(count(4))
    world.run(0.05)
    client.send(waypoint(0))
    world.run(0.05)
    client.send(mav.MAVLink_mission_ack_message(1, 1, R.OPERATION_CANCELLED, 0))
    world.run(0.05)
    assert not world.server.missions.uploading and len(world.plans.items(PlanKind.MISSION)) == 2


def test_a_duplicate_of_the_count_does_not_restart(world: World, client: Client) -> None:
    data = client.send(count(3))
    world.run(0.02)
    client.send(waypoint(0))
    world.run(0.02)
    client.send_raw(data)
    world.run(0.02)
    assert [m.seq for m in client.got("MISSION_REQUEST_INT")] == [0, 1]
    for n in (1, 2):
        client.send(waypoint(n))
        world.run(0.02)
    assert client.got("MISSION_ACK")[0].type == R.ACCEPTED


def test_the_same_client_starting_anew_replaces_its_own_upload(world: World, client: Client) -> None:
    client.send(count(3))
    world.run(0.02)
    client.send(waypoint(0, x=111))
    world.run(0.02)
    items = plan(3)
    assert upload(client, items) == R.ACCEPTED
    back = download(client)
    assert back is not None and same_items(items, back)


@pytest.mark.parametrize("arrived", range(3))
@pytest.mark.parametrize("second", [0, 1, 2, "clear 0", "clear 1", "clear 2", "clear 255"])
@pytest.mark.parametrize("first", [0, 1, 2])
def test_each_transfer_of_a_client_that_begins_another_gets_its_answer(
    world: World, client: Client, first: int, second: int | str, arrived: int
) -> None:
    client.send(count(3, first))
    world.run(0.02)
    for n in range(arrived):
        client.send(waypoint(n, first, x=111))
        world.run(0.02)
    items = plan(3, first)
    if isinstance(second, str):
        kind = int(second.split()[1])
        client.send(mav.MAVLink_mission_clear_all_message(1, 1, kind))
    else:
        kind = second
        client.send(count(2, kind))
    world.run(0.02)
    for _ in range(25):  # the rest of the first, sent without listening
        if kind != first:
            client.send(waypoint(2, first))
            world.run(0.01)
    for item in plan(2, kind) if isinstance(second, int) else ():
        client.send(item)
        world.run(0.02)
    world.run(0.1)
    acks = [(ack.mission_type, ack.type) for ack in client.got("MISSION_ACK")]
    superseded = [] if kind == first else [(first, R.OPERATION_CANCELLED)]
    late = [] if isinstance(second, int) or kind == first else [(first, R.ERROR)]  # nobody asks for them any more
    assert sorted(set(acks)) == sorted({*superseded, *late, (kind, R.ACCEPTED)})
    assert all(acks.count(ack) == 1 for ack in [*superseded, (kind, R.ACCEPTED)])
    stored = {k: len(world.plans.items(k)) for k in PlanKind}
    assert stored == {k: 2 if k == second else 0 for k in PlanKind}
    assert upload(client, items, first) == R.ACCEPTED


# Two clients


@pytest.mark.parametrize("where", [{"link": 1}, {"sysid": 254}, {"compid": 191}])
@pytest.mark.parametrize("kind", [0, 1])
def test_a_second_client_is_denied_and_the_first_goes_on(where: dict, kind: int) -> None:
    world = World(links=(0, 1))
    first, second = world.client(), world.client(**where)
    items = plan(5)
    first.send(count(5))
    world.run(0.02)
    first.send(items[0])
    world.run(0.02)
    first.rx.clear()
    said = ""
    for message in (count(2, kind), mav.MAVLink_mission_clear_all_message(1, 1, kind)):
        (ack,) = [m for m in second.ask(message, "MISSION_ACK", 0.1) if m.target_component == second.compid]
        assert (ack.type, ack.mission_type) == (R.DENIED, kind)
        said += second.texts()
    assert said.count("255/190") == 1, "told, and not told again at once"
    for item in items[1:]:
        first.send(item)
        world.run(0.02)
    mine = [m for m in first.got("MISSION_ACK") if (m.target_system, m.target_component) == (255, 190)]
    assert [m.type for m in mine] == [R.ACCEPTED]
    assert len(world.plans.items(PlanKind.MISSION)) == 5
    assert upload(second, plan(2, kind), kind) == R.ACCEPTED


def test_a_second_client_reads_while_the_first_writes() -> None:
    world = World(links=(0, 1))
    first, second = world.client(), world.client(link=1, sysid=254)
    upload(first, plan(4))
    first.send(count(6))
    world.run(0.05)
    back = download(second)
    assert back is not None and same_items(plan(4), back)


def test_a_download_is_not_mixed_by_an_upload_in_its_midst() -> None:
    world = World(links=(0, 1))
    first, second = world.client(), world.client(link=1, sysid=254)
    upload(first, plan(4))
    second.ask(mav.MAVLink_mission_request_list_message(1, 1, 0), "MISSION_COUNT", 0.05)
    upload(first, plan(2, north=40_000))
    (item,) = second.ask(mav.MAVLink_mission_request_int_message(1, 1, 3, 0), "MISSION_ITEM_INT", 0.05)
    assert item.x == plan(4)[3].x
    back = download(second)
    assert back is not None and same_items(plan(2, north=40_000), back)


# Bad links


@pytest.mark.parametrize("seed", range(6))
def test_transfers_survive_loss_duplication_and_reordering(world: World, seed: int) -> None:
    client = world.client(**both_ways(seed))
    first, second, fence = plan(15), plan(9, north=3000), plan(6, 1)
    assert lossy_upload(client, first) == R.ACCEPTED
    assert same_items(first, download(client, retry_s=0.3) or [])
    assert lossy_upload(client, fence, 1) == R.ACCEPTED
    assert lossy_upload(client, second) == R.ACCEPTED
    assert same_items(second, download(client, retry_s=0.3) or [])
    assert same_items(fence, download(client, 1, retry_s=0.3) or [])


def lossy_upload(client: Client, items: list, kind: int = 0) -> int | None:
    """As a client over a bad link: when the answer is lost, the last item is sent again."""
    uploader = Uploader(client, items, kind)
    for n in range(6000):
        if n % 50 == 0 and not uploader.requests:
            uploader.count()
        elif n % 50 == 0 and max(uploader.requests) == len(items) - 1:  # what was asked for last may come late
            client.send(items[-1])
        client.world.tick()
        if uploader.results:
            client.on_message = None
            return uploader.results[0]
    return None


# Progress


def test_current_item_is_streamed_and_told_on_change(world: World, client: Client) -> None:
    upload(client, plan(4))
    client.rx.clear()
    world.run(5.0)
    steady = client.got("MISSION_CURRENT")
    assert 4 <= len(steady) <= 6
    assert {(m.seq, m.total, m.mission_state, m.mission_mode) for m in steady} == {(1, 4, 3, 1)}
    client.rx.clear()
    world.show(progress=MissionProgress(t_us=0, current_seq=2, reached_seq=1, lap=0, state=ProgressState.PAUSED))
    world.tick()
    (change,) = client.got("MISSION_CURRENT")
    assert (change.seq, change.mission_state) == (2, 4)


def test_no_mission_is_said_so(world: World, client: Client) -> None:
    world.show(progress=None)
    world.run(1.2)
    last = client.got("MISSION_CURRENT")[-1]
    assert (last.seq, last.total, last.mission_state) == (0, 0xFFFF, 1)


def test_items_reached_are_told_once_on_every_link() -> None:
    world = World(links=(0, 1))
    clients = [world.client(), world.client(link=1)]
    world.tick(reached=(0, 1))
    world.run(1.0)
    for client in clients:
        assert [m.seq for m in client.got("MISSION_ITEM_REACHED")] == [0, 1]


def test_set_current_by_message(world: World, client: Client) -> None:
    upload(client, plan(4))
    client.rx.clear()
    client.send(mav.MAVLink_mission_set_current_message(1, 1, 3))
    world.tick()
    world.show(progress=MissionProgress(t_us=0, current_seq=3, reached_seq=2, lap=0, state=ProgressState.ACTIVE))
    world.tick()
    assert world.vehicle.calls == [("set_current_item", 3)]
    assert client.got("MISSION_CURRENT")[-1].seq == 3


def test_set_current_to_the_same_item_is_answered_too(world: World, client: Client) -> None:
    upload(client, plan(4))
    world.run(0.05)
    client.rx.clear()
    client.send(mav.MAVLink_mission_set_current_message(1, 1, 1))
    world.run(0.03)
    assert [m.seq for m in client.got("MISSION_CURRENT")] == [1]


def test_a_refused_set_current_is_explained(world: World, refuse: Callable[[World, str, str], None]) -> None:
    client = world.client()
    refuse(world, "set_current_item", "Mission item 9 does not exist: plan has 4")
    client.send(mav.MAVLink_mission_set_current_message(1, 1, 9))
    world.run(0.1)
    assert "does not exist" in client.texts()


# ArduPilot's item 0


def test_home_is_item_0_under_the_ardusub_profile() -> None:
    world = World("ardusub")
    client = world.client()
    home = waypoint(0, frame=0, command=16, x=0, y=0, z=0.0)
    jump = waypoint(3, frame=2, command=177, param1=1.0, param2=2.0, x=0, y=0, z=0.0)
    items = [home, waypoint(1), waypoint(2), jump]
    assert upload(client, items) == R.ACCEPTED
    stored = world.plans.items(PlanKind.MISSION)
    assert [(i.seq, i.command, i.is_home) for i in stored] == [
        (0, 16, True),
        (1, 16, False),
        (2, 16, False),
        (3, 177, False),
    ]
    assert stored[3].param1 == 1.0
    back = download(client)
    assert back is not None and same_items(items[1:], back[1:])
    assert (back[0].frame, back[0].x, back[0].z) == (0, round(ORIGIN.lat_deg * 1e7), ORIGIN.alt_m)
    world.view = base_view(
        progress=MissionProgress(t_us=0, current_seq=2, reached_seq=1, lap=0, state=ProgressState.ACTIVE)
    )
    client.rx.clear()
    world.tick(reached=(1,))
    world.run(1.0)
    assert (client.got("MISSION_CURRENT")[-1].seq, client.got("MISSION_CURRENT")[-1].total) == (2, 3)
    assert client.got("MISSION_ITEM_REACHED")[0].seq == 1
    client.send(mav.MAVLink_mission_set_current_message(1, 1, 3))
    client.send(mav.MAVLink_mission_set_current_message(1, 1, 0))
    world.run(0.05)
    assert world.vehicle.calls == [("set_current_item", 3), ("set_current_item", 0)]


def test_one_dummy_waypoint_clears_under_the_ardusub_profile() -> None:
    """MAVSDK clears an ArduPilot mission by uploading home alone."""
    world = World("ardusub")
    client = world.client()
    upload(client, plan(3))
    assert upload(client, [waypoint(0, frame=3, x=0, y=0, z=0.0)]) == R.ACCEPTED
    assert world.plans.items(PlanKind.MISSION) == ()
    assert download(client) == []


def test_fences_have_no_home_item() -> None:
    world = World("ardusub")
    client = world.client()
    assert upload(client, plan(2, 1), 1) == R.ACCEPTED
    assert len(world.plans.items(PlanKind.FENCE)) == 2


def test_a_plan_is_called_accepted_when_it_is_on_disk(world: World) -> None:
    client, items = world.client(), plan(3)
    world.plans.kept = False
    uploader = Uploader(client, items)
    assert uploader.run(0.5) is None
    assert len(world.plans.items(PlanKind.MISSION)) == 3, "it is in force"
    world.plans.kept = True
    assert uploader.run(0.5) == R.ACCEPTED


def test_a_disk_that_does_not_answer_is_spoken_of(world: World, client: Client) -> None:
    world.plans.kept = False
    assert upload(client, plan(3)) == R.ACCEPTED
    assert "Plan in force, not on disk yet" in client.texts()


# Found by the fuzzer


@pytest.mark.parametrize("way", ["cancelled", "another", "cleared"])
@pytest.mark.parametrize("served", [False, True])
def test_a_plan_that_is_in_force_is_acknowledged_whatever_its_client_says_then(way: str, served: bool) -> None:
    """It came into force between two ticks, and its client began something else before it was told: the old plan was
    gone, and nobody had said so."""
    world = World()
    client = world.client()
    world.plans.slow = True
    items = [waypoint(n) for n in range(2)]
    client.send(mav.MAVLink_mission_count_message(1, 1, 2, 0))
    world.run(0.1)
    for item in items:
        client.send(item)
        world.run(0.1)
    world.plans.decide(world.plans.waiting.pop())
    client.rx.clear()
    revision = world.server.missions.revision
    message = {
        "cancelled": mav.MAVLink_mission_ack_message(1, 1, mav.MAV_MISSION_OPERATION_CANCELLED, 0),
        "another": mav.MAVLink_mission_count_message(1, 1, 3, 0),
        "cleared": mav.MAVLink_mission_clear_all_message(1, 1, 1),
    }[way]
    if served:
        client.send(message)
        (frame,) = client.take_tx()
        sent = world.server.serve(world.t_us + 1000, (frame,))
        heard = [m for each in sent for m in mav.MAVLink(None).parse_buffer(each.data) or ()]
        acks = [m.type for m in heard if m.get_type() == "MISSION_ACK"]
    else:
        client.send(message)
        world.tick()
        acks = [m.type for m in client.got("MISSION_ACK")]
    assert acks[:1] == [mav.MAV_MISSION_ACCEPTED] and len(world.plans.stored[PlanKind.MISSION]) == 2
    assert world.server.missions.revision == revision + 1


def test_a_plan_in_force_that_the_disk_has_not_got_is_told_of_when_its_client_goes_on() -> None:
    world = World()
    client = world.client()
    world.plans.kept = False
    items = [waypoint(n) for n in range(2)]
    client.send(mav.MAVLink_mission_count_message(1, 1, 2, 0))
    for item in items:
        world.run(0.1)
        client.send(item)
    world.run(0.1)
    assert not client.got("MISSION_ACK") and len(world.plans.stored[PlanKind.MISSION]) == 2
    client.send(mav.MAVLink_mission_count_message(1, 1, 3, 1))
    world.run(0.1)
    assert "Mission plan accepted: 2 items" in client.texts()


def test_a_client_hears_of_a_check_that_takes_longer_than_it_waits(world: World, client: Client) -> None:
    """QGroundControl and MAVSDK give up 1.5 s after the last thing they heard of an upload."""
    world.plans.slow = True
    uploader = Uploader(client, plan(3))
    assert uploader.run(3.0) is None
    assert uploader.requests[:3] == [0, 1, 2] and set(uploader.requests[3:]) == {2}
    assert 4 <= len(uploader.requests[3:]) <= 6, "twice a second"
    assert len(world.plans.waiting) == 1, "nothing begins anew"
    world.plans.decide(world.plans.waiting.pop())
    assert uploader.run(0.5) == R.ACCEPTED
    world.run(2.0)
    assert uploader.results == [R.ACCEPTED] and len(world.plans.stored[PlanKind.MISSION]) == 3
