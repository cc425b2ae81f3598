"""Random bytes and random well-formed messages: no exception, no plan changed by halves, no state that stays broken."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_harness import World, download, mav, same_items, upload, waypoint

from autopilot.core.plan import PlanKind
from tests.bench.fuzz.messages import Traffic


@pytest.mark.parametrize("profile", ["generic", "px4", "ardusub"])
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=12, deadline=None)
def test_random_messages_neither_raise_nor_leave_a_broken_state(profile: str, seed: int) -> None:
    traffic, world = Traffic(seed), World(profile)
    plans = world.plans
    for _ in range(150):
        before = dict(plans.stored)
        calls = len(plans.replaced)
        world.t_us += 10_000
        for frame in world.server.step(world.t_us, (traffic.frame(),), world.view):
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


@pytest.mark.parametrize(
    "order",
    [
        mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0, 21196, 0, 0, 0, 0, 0),
        mav.MAVLink_mission_clear_all_message(1, 1, 255),
        mav.MAVLink_mission_count_message(1, 1, 3, 0),
        mav.MAVLink_param_set_message(1, 1, b"SPD_CRUISE", 0.01, 9),
    ],
)
def test_an_order_that_is_damaged_anywhere_is_none(world: World, order: Any) -> None:
    """One bit turned, or the end lost; what comes behind it is heard."""
    frame, parameters = bytes(order.pack(mav.MAVLink(None, srcSystem=66, srcComponent=66))), dict(world.params)
    turned = [
        bytes(byte ^ (at == bit // 8) << bit % 8 for at, byte in enumerate(frame)) for bit in range(8 * len(frame))
    ]
    client = world.client(number=1)
    for data in (*turned, *(frame[:length] for length in range(len(frame)))):
        client.send_raw(data)
        world.tick()
    world.run(1.0)
    assert (world.plans.replaced, world.vehicle.calls, dict(world.params)) == ([], [], parameters)
    assert world.server.dropped_rx > 0
    assert client.ask(mav.MAVLink_ping_message(1, 2, 0, 0), "PING", 0.05)


def test_the_harness_really_compares() -> None:
    """Guards the other tests: a changed item must be seen."""
    items = [waypoint(0), waypoint(1)]
    assert same_items(items, items)
    assert not same_items(items, [waypoint(0), waypoint(1, x=5)])
    assert not same_items(items, [waypoint(0), waypoint(1, param4=0.1)])
    assert not same_items(items, items[:1])
    assert np.isnan(items[0].param4)
