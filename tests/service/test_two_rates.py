"""Decisions are taken and clients are served at 20 Hz; what cannot wait is decided on the tick on which it comes."""

import itertools

import pytest
from mission_world import MissionWorld
from pymavlink.dialects.v20 import development as mav

from autopilot.command.commander import Commander
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.core.clock import DECISION_TICKS
from autopilot.core.messages import DeviceRole, DeviceTrouble, Inputs
from tests.plan_items import waypoint

PHASES = range(DECISION_TICKS)
ATTITUDE, FASTEST_US = mav.MAVLINK_MSG_ID_ATTITUDE, 10_000.0


@pytest.fixture
def decided_us(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Times of the commander's decisions."""
    times: list[int] = []
    step = Commander.step

    def noted(commander: Commander, status: VehicleStatus) -> object:
        times.append(status.t_us)
        return step(commander, status)

    monkeypatch.setattr(Commander, "step", noted)
    return times


def afloat(phase: int = 0) -> MissionWorld:
    """Ready to be armed, so many ticks after a decision."""
    world = MissionWorld()
    world.run(1.5)
    go_on(world, phase)
    return world


def go_on(world: MissionWorld, phase: int) -> None:
    """To so many ticks after a decision."""
    while world.t_us // 10_000 % DECISION_TICKS != phase:
        world.tick()


def test_without_news_decisions_are_taken_20_times_a_second(decided_us: list[int]) -> None:
    world = afloat()
    decided_us.clear()
    world.run(2.0)
    assert len(decided_us) == 40
    assert len({after - before for before, after in itertools.pairwise(decided_us)}) == 1


def test_a_request_is_answered_and_acts_on_its_tick() -> None:
    world = afloat()
    for phase, armed in itertools.product(PHASES, (1.0, 0.0)):
        go_on(world, phase)
        world.inbox.clear()
        message = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, armed, *(0.0,) * 6)
        outputs = world.tick([world.pack(message)])
        assert [m.result for m in world.inbox if m.get_type() == "COMMAND_ACK"] == [mav.MAV_RESULT_ACCEPTED]
        assert outputs.command.armed == outputs.mode.armed == bool(armed)


def test_a_device_that_fails_is_decided_upon_at_once(decided_us: list[int]) -> None:
    world = afloat()
    trouble = DeviceTrouble(t_us=0, device=DeviceRole.SENSORS, text="cable")
    for phase in PHASES:
        go_on(world, phase)
        world.t_us += 10_000
        world.service.step(Inputs(t_us=world.t_us, samples=world.samples(), troubles=(trouble,)))
        assert decided_us[-1] == world.t_us, phase


def test_traffic_does_not_change_when_decisions_are_taken(decided_us: list[int]) -> None:
    world = afloat()
    decided_us.clear()
    for _ in range(100):
        world.tick([world.pack(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))])
    assert len(decided_us) == 20


def test_every_item_that_is_reached_is_reported_once() -> None:
    """Decisions, and with them what is reached on a tick, are older than the tick on which clients are served."""
    world = afloat(3)
    world.pos_ned_m[:] = (-1.2, 0.6, 0.4)
    world.run(1.0)
    world.fly([waypoint(k, -1.2, 0.6, 0.4) for k in range(7)], 3.0)
    assert world.reached == list(range(7))


def test_a_fast_stream_keeps_its_rate(decided_us: list[int]) -> None:
    world = afloat()
    assert world.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, float(ATTITUDE), FASTEST_US) == 0
    world.inbox.clear()
    world.run(1.0)
    assert len([m for m in world.inbox if m.get_msgId() == ATTITUDE]) == 100
    assert world.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, float(ATTITUDE), 0.0) == 0
    decided_us.clear()
    world.run(1.0)
    assert len(decided_us) == 20
