"""Places that no local metres can be given of: refused through the real service, and never shown."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mav
from service_world import ORIGIN, ServiceWorld

from autopilot.core.geodesy import MAX_RANGE_M, Origin, surface_distance_m

ACCEPTED, DENIED = mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_DENIED
WORLD = ServiceWorld()


def _shown(world: ServiceWorld, name: str) -> object:
    world.run(10.1 if name == "GPS_GLOBAL_ORIGIN" else 2.1)
    return next(m for m in reversed(world.inbox) if m.get_type() == name)


@given(lat=st.floats(-214.0, 214.0), lon=st.floats(-214.0, 214.0), alt=st.floats(width=32))
@example(lat=20.0, lon=-160.0, alt=0.0)
@example(lat=90.0, lon=0.0, alt=0.0)
@example(lat=-37.9755, lon=-156.221, alt=0.0)
@example(lat=37.9755, lon=23.7790 + 0.2, alt=0.0)
@example(lat=38.0, lon=23.7790, alt=math.inf)
@settings(max_examples=60)
def test_home_is_taken_near_and_refused_far(lat: float, lon: float, alt: float) -> None:
    before = WORLD.parts.plans.home
    WORLD.run(0.5)
    result = WORLD.command_int(mav.MAV_CMD_DO_SET_HOME, lat, lon, alt)
    away_m = surface_distance_m(ORIGIN, lat, lon)
    if abs(lat) <= 89.0 and abs(lon) <= 180.0 and away_m < 0.99 * MAX_RANGE_M:
        assert result in (ACCEPTED, DENIED)
    else:
        assert result == DENIED
        assert WORLD.parts.plans.home is before
    home = WORLD.parts.plans.home
    if result == ACCEPTED:
        assert (home.lat_deg, home.lon_deg) == pytest.approx((lat, lon), abs=2e-7)


def test_a_refusal_names_distance_limit_and_remedy() -> None:
    assert WORLD.command_int(mav.MAV_CMD_DO_SET_HOME, 20.0, -160.0, 0.0) == DENIED
    assert "limit 10" in WORLD.texts()
    assert "set the origin there first" in WORLD.texts()


@pytest.mark.parametrize("frame", [1, 0])
def test_local_home_beyond_the_plane_is_refused(frame: int) -> None:
    place = (30_000.0, 0.0) if frame == 1 else (38.3, 23.7790)
    assert WORLD.command_int(mav.MAV_CMD_DO_SET_HOME, *place, 0.4, frame=frame) == DENIED


def test_go_to_far_is_refused() -> None:
    world = ServiceWorld()
    world.run(2.0)
    assert world.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == ACCEPTED
    goal = world.tick().goal
    assert world.command_int(mav.MAV_CMD_DO_REPOSITION, 38.2, 23.7790, -0.4) == DENIED
    assert "Go-to denied" in world.texts()
    assert world.tick().goal is goal


def test_home_across_the_date_line_and_beside_a_pole_is_shown_where_it_is() -> None:
    for origin in (Origin(lat_deg=-17.0, lon_deg=179.99999), Origin(lat_deg=89.0, lon_deg=10.0)):
        world = ServiceWorld(origin=origin)
        world.pos_ned_m = np.array([2000.0, 1500.0, 0.4])
        world.run(2.0)
        assert world.command(mav.MAV_CMD_DO_SET_HOME, 1.0) == ACCEPTED
        shown = _shown(world, "HOME_POSITION")
        assert abs(shown.longitude) <= 1_800_000_000  # type: ignore[attr-defined]
        assert (shown.x, shown.y) == pytest.approx((2000.0, 1500.0), abs=0.1)  # type: ignore[attr-defined]


def test_an_origin_moves_only_where_plans_in_force_fit_and_heights_are_of_this_earth() -> None:
    world = ServiceWorld()
    world.run(0.2)
    for lat, lon, alt_mm in ((379755000, 237790000, 2_000_000_000), (899_000_000, 0, 0), (-2_000_000_000, 5, 0)):
        before = world.parts.plans.origin
        world.ask(mav.MAVLink_set_gps_global_origin_message(1, lat, lon, alt_mm))
        assert world.parts.plans.origin is before


def test_a_vehicle_that_believes_to_be_far_away_keeps_its_home_and_is_not_armed() -> None:
    world = ServiceWorld()
    world.pos_ned_m = np.array([25_000.0, 0.0, 0.4])
    world.run(2.0)
    home = world.parts.plans.home
    assert world.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == DENIED
    assert "25.0 km" in world.texts()
    assert world.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 21196.0) == ACCEPTED
    world.run(1.0)
    assert world.parts.plans.home is home
