"""Plan transfer, commands and watching over good and bad links, against the service's own server."""

import random

import pytest
from client_world import PERFECT, TICK_US, MemoryLink
from pymavlink.dialects.v20 import development as mav

from autopilot.client.client_session import CommandRefusedError, MissionStatus, VehicleConnection
from autopilot.client.exchange import Timers
from autopilot.client.plan_client import same_on_the_wire
from autopilot.core.errors import DriverError, PlanError
from autopilot.core.messages import Event, ProgressState
from autopilot.core.plan import PlanItem, PlanKind
from autopilot.mission.paper import paper_plan
from tests.lossy_link import LinkConditions

BAD = LinkConditions(loss=0.2, duplicate=0.2, reorder=0.2, reorder_s=0.06)


def session(link: MemoryLink) -> VehicleConnection:
    opened = VehicleConnection(link, clock_s=link.clock_s)
    opened.connect()
    return opened


def long_mission(count: int) -> tuple[PlanItem, ...]:
    first = paper_plan().mission[0]
    return tuple(
        PlanItem(seq=k, frame=3, command=16, param2=0.3, x=first.x + 3 * (k % 5), y=first.y, z=-0.5)
        for k in range(count)
    )


@pytest.mark.parametrize("seed", range(6))
def test_plans_arrive_whole_over_a_link_that_loses_doubles_and_swaps(seed: int) -> None:
    link = MemoryLink(BAD, seed)
    client = session(link)
    plan = paper_plan()
    for kind in (PlanKind.FENCE, PlanKind.RALLY, PlanKind.MISSION):
        client.upload(kind, plan.items(kind))
        assert same_on_the_wire(link.plans.items(kind), plan.items(kind))
        assert same_on_the_wire(client.download(kind), plan.items(kind))
    mission = long_mission(60)
    client.upload(PlanKind.MISSION, mission)
    assert same_on_the_wire(client.download(PlanKind.MISSION), mission)


@pytest.mark.parametrize("profile", ["generic", "px4", "ardusub"])
def test_every_profile_takes_and_gives_back_the_same_plan(profile: str) -> None:
    link = MemoryLink(profile=profile)
    client = session(link)
    plan = paper_plan()
    client.upload(PlanKind.FENCE, plan.fence)
    client.upload(PlanKind.MISSION, plan.mission)
    flown = [item for item in link.plans.items(PlanKind.MISSION) if not item.is_home]
    assert [item.seq for item in flown] == [seq + (profile == "ardusub") for seq in range(len(flown))]
    assert len(flown) == len(plan.mission)
    assert same_on_the_wire(client.download(PlanKind.MISSION), plan.mission)


def test_progress_grows_to_the_end(link: MemoryLink) -> None:
    seen: list[tuple[int, int]] = []
    session(link).upload(PlanKind.MISSION, long_mission(20), lambda done, total: seen.append((done, total)))
    assert seen == sorted(seen)
    assert seen[-1] == (20, 20)


def test_an_empty_plan_clears(link: MemoryLink) -> None:
    client = session(link)
    client.upload(PlanKind.MISSION, long_mission(3))
    client.upload(PlanKind.MISSION, ())
    assert link.plans.items(PlanKind.MISSION) == ()
    assert client.download(PlanKind.MISSION) == ()


@pytest.mark.parametrize("conditions", [PERFECT, BAD], ids=["good link", "bad link"])
def test_a_refusal_comes_with_the_vehicles_reason(conditions: LinkConditions) -> None:
    link = MemoryLink(conditions, 3)
    client = session(link)
    client.upload(PlanKind.FENCE, paper_plan().fence)
    good = long_mission(5)
    bad = (*good[:3], PlanItem(seq=3, frame=3, command=16, x=good[0].x, y=good[0].y, z=50.0), good[4])
    client.upload(PlanKind.MISSION, good)
    with pytest.raises(PlanError) as refusal:
        client.upload(PlanKind.MISSION, bad)
    if conditions is PERFECT:
        assert "item 3 (QGC 4): 50.00 m above the surface; altitude must be <= 0" in str(refusal.value)
    assert same_on_the_wire(link.plans.items(PlanKind.MISSION), good)


def test_a_plan_that_is_stored_and_not_flown_names_the_obstacle(link: MemoryLink) -> None:
    client = session(link)
    client.upload(PlanKind.FENCE, paper_plan().fence)
    circle = paper_plan().fence[5]
    inside = PlanItem(seq=0, frame=3, command=16, x=circle.x, y=circle.y, z=-0.5)
    assert client.plan_problem() == ""
    client.upload(PlanKind.MISSION, (inside,))
    for _ in range(2):  # who asks again is answered again
        assert client.plan_problem().startswith(
            "item 0 (QGC 1) is 0.16 m inside exclusion circle (fence item 5): move it"
        )
    assert same_on_the_wire(link.plans.items(PlanKind.MISSION), (inside,))


def test_an_armed_vehicle_says_what_is_wrong_with_its_plans_to_every_client_and_only_while_it_is_so() -> None:
    """Not what it said once: the same plan again from a new client, and a better one from the same."""
    link = MemoryLink()
    link.vehicle.armed = True
    circle = paper_plan().fence[5]
    inside = PlanItem(seq=0, frame=3, command=16, x=circle.x, y=circle.y, z=-0.5)
    session(link).upload(PlanKind.FENCE, paper_plan().fence)
    for _ in range(2):
        client = session(link)
        client.upload(PlanKind.MISSION, (inside,))
        assert client.plan_problem().startswith("item 0 (QGC 1) is 0.16 m inside exclusion circle")
    client.upload(PlanKind.MISSION, paper_plan().mission)
    assert client.plan_problem() == ""


def test_a_vehicle_that_falls_silent_is_reported(link: MemoryLink) -> None:
    client = session(link)
    link.cut = True
    with pytest.raises(PlanError, match="did not answer for 10 s"):
        client.upload(PlanKind.MISSION, long_mission(3))
    with pytest.raises(PlanError, match="did not answer"):
        client.download(PlanKind.FENCE)
    with pytest.raises(CommandRefusedError, match="did not answer"):
        client.arm()


def test_no_vehicle_at_all(link: MemoryLink) -> None:
    link.cut = True
    with pytest.raises(DriverError, match="no vehicle heard on link within 2 s"):
        VehicleConnection(link, clock_s=link.clock_s).connect(2.0)


def _swallow(link: MemoryLink, message_id: int) -> None:
    """Make the link lose every message of one kind on its way from the vehicle."""
    receive = link.receive

    def without(timeout_s: float) -> bytes:
        data = receive(timeout_s)
        return b"" if data[7:10] == message_id.to_bytes(3, "little") else data

    link.receive = without  # type: ignore[method-assign]


def test_an_upload_whose_final_answer_is_lost_for_good_is_checked_by_reading_back(link: MemoryLink) -> None:
    client = session(link)
    _swallow(link, 47)  # MISSION_ACK
    client.upload(PlanKind.MISSION, long_mission(4))
    assert len(link.plans.items(PlanKind.MISSION)) == 4


def test_arm_refused_with_reasons_then_forced(link: MemoryLink) -> None:
    client = session(link)
    link.vehicle.not_ready = "no position estimate"
    with pytest.raises(CommandRefusedError, match="no position estimate"):
        client.arm()
    assert not link.vehicle.armed
    client.arm(force=True)
    assert link.vehicle.armed
    assert client.vehicle is not None
    assert client.vehicle.armed


@pytest.mark.parametrize("conditions", [PERFECT, BAD], ids=["good link", "bad link"])
def test_the_papers_mission_flown_from_the_client(conditions: LinkConditions) -> None:
    link = MemoryLink(conditions, 5)
    client = session(link)
    plan = paper_plan(3)
    client.upload(PlanKind.FENCE, plan.fence)
    client.upload(PlanKind.MISSION, plan.mission)
    with pytest.raises(CommandRefusedError, match="not armed"):
        client.start_mission()
    client.arm()
    client.start_mission()
    seen: list[MissionStatus] = []
    status = client.watch_mission(seen.append, timeout_s=120.0)
    assert status.state is ProgressState.COMPLETE
    if conditions is PERFECT:
        assert status.reached == (0, 1, 2, 1, 2, 1, 2)
    assert [len(s.reached) for s in seen] == sorted(len(s.reached) for s in seen)


def test_watching_ends_when_the_vehicle_disarms_or_time_is_up(link: MemoryLink) -> None:
    client = session(link)
    client.upload(PlanKind.MISSION, (*long_mission(1), _far(1)))
    client.arm()
    client.start_mission()
    with pytest.raises(DriverError, match="after 1 s"):
        client.watch_mission(timeout_s=1.0)
    link.vehicle.armed = False
    status = client.watch_mission()
    assert not status.armed
    assert status.state is ProgressState.ACTIVE
    client.arm()
    link.cut = True
    with pytest.raises(DriverError, match="silent"):
        client.watch_mission(silence_s=1.0)


def _far(seq: int) -> PlanItem:
    first = paper_plan().mission[0]
    return PlanItem(seq=seq, frame=3, command=16, x=first.x + 20_000, y=first.y, z=-0.5)


@pytest.mark.parametrize("seed", range(5))
def test_long_reasons_survive_doubled_and_swapped_chunks(seed: int) -> None:
    link = MemoryLink(LinkConditions(duplicate=0.5, reorder=0.5, reorder_s=0.06), seed)
    client = session(link)
    high = PlanItem(seq=0, frame=3, command=16, x=379755000, y=237790000, z=50.0)
    with pytest.raises(PlanError) as refusal:
        client.upload(PlanKind.MISSION, (high,))
    said = "item 0 (QGC 1): 50.00 m above the surface; altitude must be <= 0, -0.4 at 0.4 m"
    assert str(refusal.value).endswith(said)


def test_timers_can_be_patient(link: MemoryLink) -> None:
    client = VehicleConnection(link, Timers(give_up_s=1.0), clock_s=link.clock_s)
    client.connect()
    link.cut = True
    begun = link.clock_s()
    with pytest.raises(PlanError, match="for 1 s"):
        client.download(PlanKind.MISSION)
    assert link.clock_s() - begun == pytest.approx(1.0, abs=0.1)


class StarvedLink(MemoryLink):
    """A vehicle whose machine is busy: its clock goes ``slower`` times slower than the client's."""

    slower = 1.0
    wall_us = 0

    def wall_s(self) -> float:
        return self.wall_us * 1e-6

    def tick(self, events: tuple[Event, ...] = ()) -> None:
        self.wall_us += round(self.slower * TICK_US)
        super().tick(events)


@pytest.mark.parametrize("slower", [1.0, 30.0, 300.0])
def test_waiting_follows_the_vehicles_clock(slower: float) -> None:
    """30: the client's 20 ms are a fraction of a tick. 300: a tick takes 3 s, a heartbeat comes every five minutes."""
    link = StarvedLink()
    client = VehicleConnection(link, clock_s=link.wall_s)
    client.connect()
    client.poll(0.5)
    link.slower = slower
    client.upload(PlanKind.MISSION, (*long_mission(1), _far(1)))
    client.arm()
    client.start_mission()
    begun_us = link.t_us
    with pytest.raises(DriverError, match="after 8 s"):
        client.watch_mission(timeout_s=8.0, silence_s=400.0)
    assert (link.t_us - begun_us) * 1e-6 == pytest.approx(8.0, abs=0.5)


def test_an_exchange_is_given_up_in_the_vehicles_time() -> None:
    link = StarvedLink()
    client = VehicleConnection(link, clock_s=link.wall_s)
    client.connect()
    client.poll(0.5)
    link.slower = 40.0
    _swallow(link, 77)  # COMMAND_ACK
    begun_us = link.t_us
    with pytest.raises(CommandRefusedError, match="did not answer for 10 s"):
        client.command(31999)
    assert (link.t_us - begun_us) * 1e-6 > 5.0


def test_silence_of_a_process_that_is_at_work_is_waited_out(link: MemoryLink) -> None:
    asked: list[float] = []

    def at_work() -> bool:
        asked.append(link.clock_s())
        link.cut = link.clock_s() < 60.0
        return True

    client = VehicleConnection(link, clock_s=link.clock_s, at_work=at_work)
    client.connect()
    link.cut = True
    client.upload(PlanKind.MISSION, long_mission(3))
    assert link.clock_s() > 60.0
    assert len(asked) < 200
    link.cut = True
    client = VehicleConnection(link, clock_s=link.clock_s, at_work=lambda: False)
    with pytest.raises(DriverError, match="within 3 s"):
        client.connect(3.0)


@pytest.mark.parametrize("seed", range(8))
def test_a_client_that_is_itself_held_up_outlasts_a_process_at_work(link: MemoryLink, seed: int) -> None:
    """Its clock jumps at any reading, also between looking for messages and judging the silence."""
    rng = random.Random(seed)
    jumped_s, cut_until = 0.0, 0

    def clock_s() -> float:
        nonlocal jumped_s
        jumped_s += rng.choice((0.0, 0.0, 0.1, 0.4, 0.9, 2.0)) * link.cut
        return link.clock_s() + jumped_s

    def at_work() -> bool:
        nonlocal cut_until
        cut_until -= 1
        link.cut = cut_until > 0
        return True

    client = VehicleConnection(link, Timers(give_up_s=1.0), clock_s=clock_s, at_work=at_work)
    link.cut, cut_until = True, 10
    client.connect(1.0)
    for _ in range(5):
        link.cut, cut_until = True, 10
        client.upload(PlanKind.MISSION, long_mission(2))
        link.cut, cut_until = True, 10
        assert not client.watch_mission(silence_s=1.0).armed


def test_a_vehicle_that_never_ends_its_start_is_given_up() -> None:
    class Starting(MemoryLink):
        def receive(self, timeout_s: float) -> bytes:
            super().receive(timeout_s)
            self.turn = not getattr(self, "turn", False)
            beat = mav.MAVLink_heartbeat_message(12, 12, 1, 0, mav.MAV_STATE_BOOT, 3)
            return bytes(beat.pack(mav.MAVLink(None, srcSystem=1, srcComponent=1))) if self.turn else b""

    link = Starting()
    client = VehicleConnection(link, clock_s=link.clock_s)
    with pytest.raises(DriverError, match="starts and does not get ready"):
        client.connect(3.0)
    assert 100.0 < link.clock_s() < 400.0
