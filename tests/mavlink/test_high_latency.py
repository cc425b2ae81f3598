"""Links that are slow or dear (HIGH_LATENCY2), and FLIGHT_INFORMATION."""

import math
from typing import Any

import numpy as np
import pytest
from mavlink_harness import Client, World, nav_state
from pymavlink.dialects.v20 import development as mav

from autopilot.core.messages import Event, Failsafe, NavHealth, Severity
from autopilot.mavlink.api import FlightMode

CONTROL = mav.MAV_CMD_CONTROL_HIGH_LATENCY


def kinds(client: Any, world: World, seconds: float) -> list[str]:
    client.rx.clear()
    world.run(seconds)
    return [m.get_type() for m in client.rx]


def test_a_quiet_link_says_one_message_every_five_seconds_and_the_others_go_on() -> None:
    world = World(links=(0, 1))
    slow, common = world.client(), world.client(link=1, sysid=254)
    common.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    world.run(3.0)
    assert slow.command(CONTROL, 1) == 0
    world.run(0.1)
    common.rx.clear()
    heard = kinds(slow, world, 20.0)
    assert heard == ["HIGH_LATENCY2"] * 4
    assert len(common.got("HEARTBEAT")) >= 19 and not common.got("HIGH_LATENCY2")
    assert all(frame.link == 1 for frame in world.server.beat()), "while the loop waits as well"
    assert slow.command(CONTROL, 0) == 0
    heard = kinds(slow, world, 3.0)
    assert "HEARTBEAT" in heard and heard.count("ATTITUDE") >= 29 and "HIGH_LATENCY2" not in heard


def test_rates_that_are_asked_for_on_a_quiet_link_begin_when_it_is_no_longer_one(world: World, client: Client) -> None:
    """Ground stations ask for them whenever they connect."""
    world.run(3.0)
    assert client.command(CONTROL, 1) == 0
    client.send(mav.MAVLink_request_data_stream_message(1, 1, mav.MAV_DATA_STREAM_ALL, 20, 1))
    assert client.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, mav.MAVLINK_MSG_ID_ATTITUDE, 20_000) == 0
    client.rx.clear()
    assert kinds(client, world, 20.0) == ["HIGH_LATENCY2"] * 4
    assert client.command(CONTROL, 0) == 0
    heard = kinds(client, world, 3.0)
    assert heard.count("ATTITUDE") >= 149 and heard.count("VFR_HUD") >= 59


def test_what_is_asked_for_on_a_quiet_link_is_answered(world: World, client: Client) -> None:
    world.run(3.0)
    assert client.command(CONTROL, 1) == 0
    client.rx.clear()
    assert client.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_ATTITUDE) == 0
    assert client.got("ATTITUDE")
    name, real32 = b"SPD_CRUISE", mav.MAV_PARAM_TYPE_REAL32
    (value,) = client.ask(mav.MAVLink_param_set_message(1, 1, name, 0.3, real32), "PARAM_VALUE")
    assert value.param_value == pytest.approx(0.3)
    assert client.ask(mav.MAVLink_mission_request_list_message(1, 1, 0), "MISSION_COUNT")
    client.rx.clear()
    assert client.command(mav.MAV_CMD_DO_FENCE_ENABLE, 0) == 2
    assert "fence cannot be switched off" in client.texts(), "a refusal has its reason there too"
    assert client.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, mav.MAVLINK_MSG_ID_HIGH_LATENCY2, 1e6) == 0
    assert kinds(client, world, 10.0).count("HIGH_LATENCY2") == 10


def test_of_texts_only_those_of_failsafes_go_there(world: World, client: Client) -> None:
    world.run(3.0)
    assert client.command(CONTROL, 1) == 0
    client.rx.clear()
    said = [(Severity.INFO, "Reached item 3"), (Severity.WARNING, "Something"), (Severity.CRITICAL, "Failsafe SURFACE")]
    world.tick(tuple(Event(t_us=world.t_us, severity=severity, text=text) for severity, text in said), reached=(3,))
    world.run(1.0)
    assert client.texts() == "Failsafe SURFACE" and not client.got("MISSION_ITEM_REACHED")


def test_a_link_that_others_use_is_not_made_silent(world: World) -> None:
    one, two = world.client(number=1), world.client(number=2, sysid=254)
    two.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    world.run(1.0)
    assert one.command(CONTROL, 1) == 2
    assert "others use this link" in one.texts()
    world.run(6.0)
    assert one.command(CONTROL, 1) == 0, "the other one has gone"
    assert "HEARTBEAT" not in kinds(one, world, 3.0)
    two.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    assert "HEARTBEAT" in kinds(two, world, 0.1), "he waits for it"


@pytest.mark.parametrize("wrong", [2.0, -1.0, 0.5, math.nan])
def test_other_values_are_invalid(world: World, client: Client, wrong: float) -> None:
    assert client.command(CONTROL, wrong) == 2
    assert "HEARTBEAT" in kinds(client, world, 1.1)


@pytest.mark.parametrize(("profile", "mode"), [("px4", 4 | 4 << 8), ("generic", 4 | 4 << 8), ("ardusub", 3)])
def test_its_fields(world: World, client: Client, profile: str, mode: int) -> None:
    world.run(1.0)
    beat, place, current = (client.got(name)[-1] for name in ("HEARTBEAT", "GLOBAL_POSITION_INT", "MISSION_CURRENT"))
    assert client.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_HIGH_LATENCY2) == 0
    (told,) = client.got("HIGH_LATENCY2")
    assert (told.type, told.autopilot, told.custom_mode) == (beat.type, beat.autopilot, mode)
    assert told.custom0 & 0xFF == beat.base_mode and beat.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED
    assert (told.latitude, told.longitude) == (place.lat, place.lon)
    assert (told.altitude, told.target_altitude, told.custom1) == (12, 12, 4), "0.45 m deep, bound for 0.3 m"
    assert told.heading == 45 and told.battery == 80 and told.wp_num == current.seq
    # 0.5 m/s through the water, the current 0.1 north and 0.2 west.
    assert (told.airspeed, told.windspeed) == (2, 1) and told.wind_heading == round((360 - 63.43) / 2)
    assert told.throttle == 42 and told.climb_rate == 1 and told.failure_flags == 0


def test_what_is_wrong_is_told_and_the_fastest_climb_until_then(world: World, client: Client) -> None:
    world.show(nav=nav_state(vel_frd_m_s=np.array([0.0, 0.0, -0.9])))
    world.run(0.5)
    world.show(nav=nav_state(health=NavHealth.INVALID), failsafes=1 << Failsafe.CAGE_HARD | 1 << Failsafe.BATTERY)
    world.run(0.5)
    assert client.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_HIGH_LATENCY2) == 0
    (told,) = client.got("HIGH_LATENCY2")
    wanted = ("GPS", "ESTIMATOR", "GEOFENCE", "BATTERY")
    assert told.failure_flags == sum(getattr(mav, f"HL_FAILURE_FLAG_{name}") for name in wanted)
    assert told.climb_rate == 9 and (told.latitude, told.longitude, told.eph) == (0, 0, 255)


def test_flight_information_from_arming_to_disarming(world: World, client: Client) -> None:
    world.show(armed=False, under_way=False)
    world.run(1.0)

    def told() -> Any:
        client.rx.clear()
        assert client.command(528, 1) == 0
        return client.got("FLIGHT_INFORMATION")[-1]

    flight = told()
    assert (flight.arming_time_utc, flight.takeoff_time_utc, flight.landing_time, flight.flight_uuid) == (0, 0, 0, 0)
    armed_us = world.t_us + 10_000
    world.show(armed=True, mode=FlightMode.HOLD)
    world.run(1.0)
    flight = told()
    assert (flight.arming_time_utc, flight.takeoff_time_utc, flight.flight_uuid) == (armed_us, 0, 1)
    began_us = world.t_us + 10_000
    world.show(under_way=True)
    world.run(1.0)
    assert told().takeoff_time_utc == began_us
    ended_us = world.t_us + 10_000
    world.show(armed=False, under_way=False)
    world.run(1.0)
    flight = told()
    assert flight.landing_time == ended_us // 1000 and flight.arming_time_utc == armed_us
    world.show(armed=True)
    world.run(1.0)
    flight = told()
    assert (flight.flight_uuid, flight.takeoff_time_utc, flight.landing_time) == (2, 0, 0)
    assert client.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, mav.MAVLINK_MSG_ID_FLIGHT_INFORMATION, 1e6) == 0
    assert kinds(client, world, 5.0).count("FLIGHT_INFORMATION") == 5
