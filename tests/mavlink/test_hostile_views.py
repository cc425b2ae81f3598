"""Whatever the service knows, however wrong: every message about it can be packed and read again."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mavlink_harness import NOT_PACKAGED, World, base_view, mav, nav_state

from autopilot.control.protocol import simple_output
from autopilot.core.arming_reasons import ArmingReason, HealthComponent, ModeGroup
from autopilot.core.geodesy import GeodeticPosition
from autopilot.core.messages import (
    Fallback,
    MavlinkFrame,
    MissionProgress,
    NavHealth,
    NmpcStatus,
    ProgressState,
    SolveStatus,
    ThrusterCommand,
)
from autopilot.core.samples import PowerSample
from autopilot.mavlink.api import FlightMode, VehicleView

anything = st.one_of(
    st.sampled_from((0.0, math.nan, math.inf, -math.inf, 1.7e308, -1.7e308, 3.4028236e38, -3.5e38, -2e68, 1e9, 5e-324)),
    st.floats(),
)
whole = st.one_of(st.integers(-(2**70), 2**70), st.integers(-3, 70_000))


def array(size: int) -> st.SearchStrategy[np.ndarray]:
    return st.lists(anything, min_size=size, max_size=size).map(np.array)


places = st.builds(GeodeticPosition, lat_deg=st.floats(-90, 90), lon_deg=st.floats(-180, 180), alt_m=anything)
navs = st.none() | st.builds(
    nav_state,
    health=st.sampled_from(NavHealth),
    pos_ned_m=array(3) | st.just(np.zeros(3)),
    rpy_rad=array(3) | st.just(np.zeros(3)),
    vel_frd_m_s=array(3) | st.just(np.zeros(3)),
    vel_water_frd_m_s=array(3) | st.just(np.zeros(3)),
    rate_frd_rad_s=array(3) | st.just(np.zeros(3)),
    current_ned_m_s=array(3),
    variance=array(12),
)
powers = st.none() | st.builds(
    PowerSample, t_us=st.just(0), voltage_v=anything, current_a=anything, energy_used_j=anything, remaining=anything
)
commands = st.none() | st.builds(
    ThrusterCommand,
    t_us=st.just(0),
    thrust_n=array(8),
    pwm_us=st.lists(whole, min_size=8, max_size=8).map(tuple),
)
controls = st.none() | st.builds(
    NmpcStatus,
    t_us=st.just(0),
    status=st.sampled_from(SolveStatus),
    fallback=st.sampled_from(Fallback),
    iterations=whole,
    solve_s=anything,
    cost=anything,
    slack_max=anything,
    margin_m=anything,
    tube_m=anything,
    penalty_use=anything,
)
progresses = st.none() | st.builds(
    MissionProgress,
    t_us=st.just(0),
    current_seq=st.integers(-1, 499),
    reached_seq=st.integers(-1, 499),
    lap=whole,
    state=st.sampled_from(ProgressState),
)
views = st.builds(
    base_view,
    armed=st.booleans(),
    mode=st.sampled_from(FlightMode),
    nav=navs,
    power=powers,
    command=commands,
    progress=progresses,
    target_ned_m=st.none() | array(3),
    origin=places.filter(lambda p: abs(p.lat_deg) <= 89 and abs(p.alt_m) <= 9000),
    home=places,
    failsafes=st.integers(0, 255),
    arming_reasons=st.lists(
        st.builds(ArmingReason, st.text(), st.sampled_from(HealthComponent), st.sampled_from(ModeGroup)), max_size=20
    ).map(tuple),
    cpu_load=anything,
    dropped_rx=st.integers(0, 2**70),
    aid_ratio=st.dictionaries(
        st.sampled_from(("markers", "external", "velocity", "depth", "heading", "laser")), anything
    ),
    nav_errors=st.tuples(whole, whole, whole, whole),
    control=controls,
)


SOLVED = simple_output(0, nav_state(), np.zeros(4)).status


def every_message(world: World) -> list[tuple[str, Any]]:
    """Name and content of all that the server can say of its view."""
    inside = world.server
    ids = sorted(inside._streams._builders)
    return [(str(msg_id), message) for msg_id in ids for message in inside._streams.build(msg_id)]


@given(view=views, t_us=st.integers(0, 2**62))
@example(view=base_view(control=replace(SOLVED, margin_m=-2e68)), t_us=10_000)
@settings(max_examples=150)
def test_every_message_can_be_packed_whatever_the_state(view: VehicleView, t_us: int) -> None:
    world = WORLD
    world.server._ctx.view = replace(view, t_us=t_us)
    world.server._ctx.t_us = t_us
    world.server._telemetry._nav = None
    reader = mav.MAVLink(None)
    for name, message in every_message(world):
        packed = bytes(message.pack(mav.MAVLink(None, srcSystem=1, srcComponent=1)))
        if f"UNKNOWN_{name}" not in NOT_PACKAGED:
            read = reader.decode(bytearray(packed))
            assert read.get_msgId() == int(name)


@given(view=views)
@settings(max_examples=15)
def test_a_tick_goes_on_whatever_the_state(view: VehicleView) -> None:
    world = World()
    for t_us in (*range(10_000, 120_000, 10_000), 2_000_000):
        frames = world.server.step(t_us, (), replace(view, t_us=t_us))
        assert all(isinstance(frame, MavlinkFrame) and 12 <= len(frame.data) <= 280 for frame in frames)


@pytest.mark.parametrize("north_m", [3e4, 1e6, 1e8])
def test_no_wrong_place_is_shown_for_an_estimate_that_has_run_off(north_m: float) -> None:
    WORLD.server._ctx.view = base_view(nav=nav_state(pos_ned_m=np.array([north_m, 0.0, 0.4])))
    WORLD.server._telemetry._nav = None
    assert WORLD.server._telemetry.global_position_int() is None
    assert WORLD.server._telemetry.local_position_ned() is not None


WORLD = World()
