"""Events and reports of arming checks over the real server, read as a ground station reads them."""

import json
import lzma
from typing import Any

import pytest
from event_client import EventReader
from event_reports import EventMetadata, Report
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mavlink_harness import World, both_ways, mav

from autopilot.core.arming_reasons import ALL_MODES, COMPONENT_OF, ArmingReason, HealthComponent, ModeGroup
from autopilot.core.messages import Failsafe
from autopilot.mavlink.dialect import extra
from autopilot.mavlink.event_metadata import TEXT_CODES, events_json
from autopilot.mavlink.event_text import GOES_ON, PIECES, spelled
from autopilot.mavlink.events import KEPT, MOST_REASONS, RESENT_PER_TICK
from autopilot.mavlink.flight_modes import POSITIONLESS, FlightMode
from autopilot.mavlink.metadata import EVENTS_FILE, GENERAL
from autopilot.mavlink.profiles import PROFILES
from tests.lossy_link import LinkConditions, LossyLink

BLIND = ArmingReason(
    "no position yet: markers must be in view", HealthComponent.POSITION, ModeGroup.POSITION | ModeGroup.MISSION
)
LEAK = ArmingReason("water in the hull: open and dry it", HealthComponent.HULL)
PLAN = ArmingReason("plan: item 3: the leg from item 2 leaves the fence", HealthComponent.MISSION, ModeGroup.MISSION)
GROUPS = {"position", "mission", "positionless"}
METADATA = EventMetadata(json.loads(json.dumps(events_json(PROFILES["px4"]))))


def battery(percent: int) -> ArmingReason:
    return ArmingReason(f"battery at {percent} %: charge it", HealthComponent.BATTERY)


def disarmed(*reasons: ArmingReason, profile: str = "px4", **kwargs: Any) -> World:
    world = World(profile, **kwargs)
    world.show(armed=False, mode=FlightMode.HOLD, intended_mode=FlightMode.HOLD, arming_reasons=reasons)
    return world


def run(world: World, readers: list[EventReader], seconds: float) -> None:
    for _ in range(round(seconds * 100)):
        world.tick()
        for reader in readers:
            reader.tick()


def reports(reader: EventReader) -> list[Report]:
    return METADATA.reports(reader.events)


def said(report: Report) -> list[str]:
    return [message for message, _, _ in report.reasons]


@pytest.mark.parametrize("profile", list(PROFILES))
def test_a_ground_station_reads_why_arming_is_refused(profile: str) -> None:
    world = disarmed(BLIND, LEAK, profile=profile)
    world.show(failsafes=1 << Failsafe.LEAK, power=None)
    reader = EventReader(world.client())
    run(world, [reader], 2.0)
    files = world.server._files._files
    general = json.loads(lzma.decompress(files[GENERAL]))
    assert [place["type"] for place in general["metadataTypes"]] == [1, 4]
    metadata = EventMetadata(json.loads(lzma.decompress(files[EVENTS_FILE])))
    assert metadata.protocols == ["health_and_arming_check"]
    (report,) = metadata.reports(reader.events)
    assert report.reasons == [
        (BLIND.text, "position", {"position", "mission"}),
        (LEAK.text, "hull", GROUPS),
    ]
    assert report.can_arm == report.can_run == set()
    assert (report.wrong, report.failing) == ({"position", "hull"}, {"hull"})
    assert "battery" not in report.present and {"ahrs", "position"} <= report.present
    modes = PROFILES[profile].custom_modes
    for mode in FlightMode:
        group = "mission" if mode is FlightMode.MISSION else "positionless" if mode in POSITIONLESS else "position"
        assert metadata.group_of(modes[mode]) == group


def test_modes_without_a_position_can_be_armed_without_one() -> None:
    world = disarmed(BLIND)
    reader = EventReader(world.client())
    run(world, [reader], 2.0)
    assert reports(reader)[-1].can_arm == {"positionless"}
    world.show(arming_reasons=())
    run(world, [reader], 0.6)
    assert reports(reader)[-1].can_arm == GROUPS and not said(reports(reader)[-1])
    world.show(armed=True, arming_reasons=(PLAN,))
    run(world, [reader], 0.6)
    assert reports(reader)[-1].can_run == GROUPS - {"mission"}


def test_a_long_reason_goes_on_in_further_events_and_all_of_many_are_bounded() -> None:
    long = "planar speed limit 0.5 m/s leaves too little beside the tube margin 0.52: smaller MPC_W_* or higher limit"
    world = disarmed(ArmingReason(long, HealthComponent.CONTROLLER))
    reader = EventReader(world.client())
    run(world, [reader], 2.0)
    lines = said(reports(reader)[-1])
    assert len(lines) > 1 and " ".join(line.removeprefix(GOES_ON) for line in lines) == long
    world.show(arming_reasons=tuple(ArmingReason(long + str(n), HealthComponent.DEVICES) for n in range(500)))
    run(world, [reader], 5.0)
    assert reader.lost == 0 and MOST_REASONS <= len(said(reports(reader)[-1])) < KEPT


def test_what_has_not_changed_is_not_sent_again() -> None:
    world = disarmed(BLIND, battery(12))
    reader = EventReader(world.client())
    run(world, [reader], 3.0)
    world.show(arming_reasons=(BLIND, battery(12)))
    run(world, [reader], 60.0)
    assert len(reports(reader)) == 1 and reader.asked == 0


def test_flickering_numbers_are_reported_at_most_every_two_seconds_and_a_new_result_at_once() -> None:
    world = disarmed(battery(12))
    reader = EventReader(world.client())
    run(world, [reader], 3.0)
    for n in range(100):
        world.show(arming_reasons=(battery(12 - n % 2),))
        run(world, [reader], 0.1)
    assert 4 <= len(reports(reader)) - 1 <= 6
    world.show(arming_reasons=())
    run(world, [reader], 0.55)
    assert reports(reader)[-1].can_arm == GROUPS
    world.show(arming_reasons=(LEAK,))
    run(world, [reader], 0.55)
    assert said(reports(reader)[-1]) == [LEAK.text]


def test_a_client_that_comes_late_asks_for_the_checks() -> None:
    world = disarmed(LEAK)
    world.run(30.0)
    reader = EventReader(world.client())
    run(world, [reader], 5.0)
    assert not reader.events and reader.latest is not None
    assert reader.client.command(mav.MAV_CMD_RUN_PREARM_CHECKS) == mav.MAV_RESULT_ACCEPTED
    run(world, [reader], 0.6)
    assert said(reports(reader)[-1]) == [LEAK.text]
    assert f"Arming check: {LEAK.text}" in reader.client.texts()


LINKS = st.lists(
    st.tuples(st.floats(0.0, 0.5), st.floats(0.0, 0.3), st.integers(0, 4), st.integers(0, 2)), min_size=1, max_size=3
)
NEWS = st.lists(
    st.tuples(st.lists(st.sampled_from((BLIND, LEAK, PLAN, battery(7))), max_size=4), st.floats(0.1, 4.0)), max_size=6
)


@settings(max_examples=15, deadline=None)
@given(links=LINKS, news=NEWS, seed=st.integers(0, 999))
@example(links=[(0.0, 0.0, 0, 0), (0.46875, 0.015625, 1, 0)], news=[], seed=493)  # hears nothing for two seconds
def test_lost_events_are_asked_for_by_each_client_in_its_own_time(
    links: list[tuple[float, float, int, int]], news: list[tuple[list[ArmingReason], float]], seed: int
) -> None:
    world = disarmed(links=(0, 1, 2))
    readers = []
    for number, (drop, twice, late, link) in enumerate(links, 1):
        ways = both_ways(seed + number, drop, twice, 0.01 * late)
        client = world.client(link=link, sysid=200 + number, number=number, **ways)
        readers.append(EventReader(client))
    run(world, readers, 2.0)
    while any(reader.latest is None for reader in readers):  # one whose first event is within a report never has it
        run(world, readers, 0.5)
    for reasons, seconds in news:
        world.show(arming_reasons=tuple(reasons))
        run(world, readers, seconds)
    world.show(arming_reasons=(LEAK, BLIND))
    for _ in range(120):
        run(world, readers, 0.5)
        if all(reader.events and reader.latest == world.server._events._latest for reader in readers):
            break
    for reader in readers:
        numbers = [event.sequence for event in reader.events]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), "each once, in order"
        assert reader.lost == 0 and said(reports(reader)[-1]) == [LEAK.text, BLIND.text]


def test_events_that_are_no_longer_kept_are_named_lost_and_the_newest_arrive() -> None:
    world = disarmed(LEAK)
    away, there = LossyLink(LinkConditions(), 1), EventReader(world.client(sysid=201))
    reader = EventReader(world.client(sysid=200, number=2, from_vehicle=away))
    run(world, [reader, there], 2.0)
    before, away.conditions = reader.latest, LinkConditions(loss=1.0)
    for n in range(60):
        world.show(arming_reasons=(battery(n),))
        run(world, [reader, there], 2.1)
    away.conditions = LinkConditions()
    run(world, [reader, there], 10.0)
    assert before is not None
    assert reader.lost == world.server._events._latest - before - KEPT > 0 == there.lost
    assert said(reports(reader)[-1]) == ["battery at 59 %: charge it"]


@pytest.mark.parametrize("uptime_s", [3.0, 40.0])
def test_after_a_restart_clients_go_on_with_the_new_numbers(uptime_s: float) -> None:
    world = disarmed(LEAK)
    reader = EventReader(world.client())
    run(world, [reader], uptime_s)
    for n in range(20):
        reader.client.send(mav.MAVLink_command_long_message(1, 1, 401, n, *(0.0,) * 7))
        run(world, [reader], 0.6)
    assert reader.latest is not None and reader.latest > 50
    anew = disarmed(BLIND)
    anew.clients, reader.client.world = [reader.client], anew
    reader.events.clear()
    run(anew, [reader], 3.0)
    assert said(reports(reader)[-1]) == [BLIND.text] and reader.lost == 0


def test_a_client_that_missed_the_restart_is_told_where_the_numbers_are() -> None:
    """Its number is ahead of ours by less than half of all numbers, or behind."""
    for latest in (40_000, 65_535, 900):
        world = disarmed(LEAK)
        world.run(30.0)
        reader = EventReader(world.client())
        reader.latest = latest
        run(world, [reader], 3.0)
        reader.client.send(mav.MAVLink_command_long_message(1, 1, 401, 0, *(0.0,) * 7))
        reader._boot_ms = 3_600_000
        run(world, [reader], 3.0)
        assert said(reports(reader)[-1]) == [LEAK.text]


def test_numbers_begin_again_after_the_last() -> None:
    world = disarmed(LEAK)
    world.server._events._latest = 65_530
    lossy = LossyLink(LinkConditions(loss=0.4), 3)
    reader = EventReader(world.client(from_vehicle=lossy))
    for n in range(8):
        run(world, [reader], 3.0)
        world.show(arming_reasons=(battery(n), LEAK))
    lossy.conditions = LinkConditions()
    run(world, [reader], 5.0)
    assert reader.latest == world.server._events._latest < 65_530 and reader.lost == 0
    assert said(reports(reader)[-1]) == [battery(7).text, LEAK.text]
    first = reader.events[-1].sequence
    reader.client.rx.clear()
    reader.client.send(extra.MAVLink_request_event_message(1, 1, 65_534, first))
    world.run(0.5)
    assert [event.sequence for event in reader.client.got("EVENT")][:3] == [65_534, 65_535, 0]


def test_the_event_to_come_is_not_missing() -> None:
    client = World().client()
    (error,) = client.ask(extra.MAVLink_request_event_message(1, 1, 5, 9), "RESPONSE_EVENT_ERROR", 0.1)
    assert (error.sequence, error.sequence_oldest_available, error.reason) == (5, 1, 0)
    assert not client.ask(extra.MAVLink_request_event_message(1, 1, 1, 1), "RESPONSE_EVENT_ERROR", 0.1)
    assert client.command(512, 411.0) == 0
    assert [(m.sequence, m.flags) for m in client.got("CURRENT_EVENT_SEQUENCE")][-1] == (0, 1)


def test_requests_for_all_numbers_are_answered_slowly() -> None:
    world = disarmed(LEAK)
    client = world.client()
    for n in range(50):
        world.show(arming_reasons=(battery(n),))
        world.run(2.1)
    client.rx.clear()
    for _ in range(12):
        client.send(extra.MAVLink_request_event_message(1, 1, 1, 0))
    world.tick()
    assert len(client.got("EVENT")) <= RESENT_PER_TICK and len(client.got("RESPONSE_EVENT_ERROR")) <= 12
    world.run(1.0)
    numbers = [event.sequence for event in client.got("EVENT")]
    assert len(numbers) == KEPT and numbers == sorted(numbers)


def test_a_slow_link_gets_its_events_when_it_has_room() -> None:
    reasons = tuple(ArmingReason(f"flight controller's check {n} fails", HealthComponent.DEVICES) for n in range(12))
    world = disarmed(*reasons, rates={0: 960.0})
    reader = EventReader(world.client())
    run(world, [reader], 60.0)
    assert said(reports(reader)[-1]) == [reason.text for reason in reasons]


def test_an_old_client_and_a_quiet_link_get_no_events() -> None:
    world = disarmed(LEAK)
    client = world.client()
    old = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    client.send_raw(bytes(old.pack(mav.MAVLink(None, srcSystem=9), force_mavlink1=True)))
    world.run(3.0)
    assert not client.got("EVENT")


@given(st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=300), st.integers(0, 20))
def test_text_is_spelled_whole_or_ends_in_dots(text: str, spaces: int) -> None:
    text = " ".join((text[:spaces], text[spaces:])).strip()
    lines = spelled(text, TEXT_CODES, 3)
    assert len(lines) <= 3 and all(0 < len(line) <= TEXT_CODES for line in lines)
    shown = ["".join(PIECES[code] for code in line) for line in lines]
    whole = "".join(line.removeprefix(GOES_ON) if n else line for n, line in enumerate(shown)).replace(" ", "")
    cut = whole.removesuffix("...") if len(lines) == 3 else whole
    assert whole == text.replace(" ", "") or (cut and text.replace(" ", "").startswith(cut))


def test_other_characters_are_question_marks_and_blanks() -> None:
    (line,) = spelled("10 °C\n", TEXT_CODES, 1)
    assert "".join(PIECES[code] for code in line) == "10 ?C "
    assert spelled("", TEXT_CODES, 3) == []


def test_every_failsafe_belongs_to_a_part_of_the_vehicle() -> None:
    assert set(COMPONENT_OF) == set(Failsafe)
    assert ModeGroup(7) == ALL_MODES and HealthComponent.NONE == 0
