"""What goes out by itself: rates, values, texts, identity."""

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_harness import NAN, ORIGIN, Client, World, mav, nav_state

from autopilot.control.protocol import simple_output
from autopilot.core.arming_reasons import ArmingReason, HealthComponent
from autopilot.core.clock import TICK_US
from autopilot.core.errors import ConfigError
from autopilot.core.geodesy import GeodeticPosition
from autopilot.core.messages import Event, NavHealth, Severity
from autopilot.core.params import ParamSet
from autopilot.core.samples import PowerSample
from autopilot.mavlink.api import FlightMode
from autopilot.mavlink.dialect import extra
from autopilot.mavlink.server import MavlinkServer
from autopilot.mavlink.status import version_number

PROFILES = ("generic", "px4", "ardusub")


def one(world: World, name: str) -> object:
    """The last message of a type after two seconds."""
    client = world.client()
    world.run(2.1)
    return client.got(name)[-1]


# Identity


@pytest.mark.parametrize(("profile", "autopilot"), [("generic", 0), ("px4", 12), ("ardusub", 3)])
def test_heartbeat(world: World, client: Client, profile: str, autopilot: int) -> None:
    world.run(10.0)
    beats = client.got("HEARTBEAT")
    assert 10 <= len(beats) <= 11
    beat = beats[-1]
    assert (beat.type, beat.autopilot, beat.get_srcSystem(), beat.get_srcComponent()) == (12, autopilot, 1, 1)
    assert beat.base_mode & 128 and beat.base_mode & 1
    assert beat.custom_mode == world.server.custom_mode(FlightMode.MISSION)
    assert beat.system_status == mav.MAV_STATE_ACTIVE
    world.show(failsafes=1)
    world.run(1.0)
    assert client.got("HEARTBEAT")[-1].system_status == mav.MAV_STATE_CRITICAL
    world.show(armed=False)
    world.tick()
    beat = client.got("HEARTBEAT")[-1]
    assert beat.system_status == mav.MAV_STATE_STANDBY and not beat.base_mode & 128


@pytest.mark.parametrize("profile", PROFILES)
def test_autopilot_version(profile: str) -> None:
    client = World(profile).client()
    client.command(512, 148)
    (version,) = client.got("AUTOPILOT_VERSION")
    bits = version.capabilities
    encodings = (
        bits & mav.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE,
        bits & mav.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST,
    )
    assert [bool(bit) for bit in encodings] == [profile != "ardusub", profile == "ardusub"]
    offboard = ("SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET")
    for name in ("MISSION_INT", "COMMAND_INT", "MAVLINK2", "MISSION_FENCE", "MISSION_RALLY", "FTP", *offboard):
        assert bits & getattr(mav, f"MAV_PROTOCOL_CAPABILITY_{name}"), name
    for name in ("TERRAIN", "MISSION_FLOAT"):
        assert not bits & getattr(mav, f"MAV_PROTOCOL_CAPABILITY_{name}"), name
    least = {"px4": 0x010401, "ardusub": 0x040100}  # of which their plug-ins in QGroundControl do not warn
    assert version.flight_sw_version >> 8 == least.get(profile, 0x000100)
    assert version.middleware_sw_version >> 8 == 0x000100
    assert bytes(version.flight_custom_version) == b"01234567"
    assert version.uid == 0x1122334455667788


def test_version_numbers() -> None:
    assert version_number("2.3.4", (1, 4, 1)) == 0x020304FF
    assert version_number("0.1.0.dev3+g12", (0, 0, 0)) == 0x000100FF
    assert version_number("rubbish", (1, 4, 1)) == 0x010401FF


def test_unknown_profiles_are_refused() -> None:
    with pytest.raises(ConfigError, match="profile 'apm' is not known; use one of generic, px4, ardusub"):
        World("apm")


def test_every_client_is_told_the_true_name_once() -> None:
    world = World(links=(0, 1))
    one_, two = world.client(), world.client(link=1, sysid=254)
    for client in (one_, two):
        client.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        world.run(1.9)
        assert client.texts() == "", "QGroundControl does not listen yet"
        for _ in range(3):
            client.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            world.run(0.3)
        assert client.texts() == "Underwater Autopilot 0.1.0, px4 profile, not PX4"


def test_the_ground_stations_heartbeat_is_noted(world: World, client: Client) -> None:
    client.send(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, 12, 0, 0, 4, 3))
    world.tick()
    assert world.server.last_gcs_t_us is None
    client.send(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, 8, 0, 0, 4, 3))
    world.tick()
    assert world.server.last_gcs_t_us == world.t_us


def test_the_dialect_is_not_imported_with_the_vehicles_side() -> None:
    code = (
        "import sys, autopilot.mavlink.api, autopilot.mavlink.profiles;"
        "sys.exit(any(name.startswith('pymavlink') for name in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# Rates and values

RATES = {
    "ATTITUDE": 10,
    "LOCAL_POSITION_NED": 10,
    "GLOBAL_POSITION_INT": 5,
    "ATTITUDE_QUATERNION": 4,
    "VFR_HUD": 4,
    "SERVO_OUTPUT_RAW": 4,
    "POSITION_TARGET_LOCAL_NED": 2,
    "NAV_CONTROLLER_OUTPUT": 2,
    "ALTITUDE": 2,
    "HEARTBEAT": 1,
    "SYS_STATUS": 1,
    "EXTENDED_SYS_STATE": 1,
    "ESTIMATOR_STATUS": 1,
    "MISSION_CURRENT": 1,
    "WIND_COV": 1,
    "BATTERY_STATUS": 0.5,
    "HOME_POSITION": 0.5,
    "CURRENT_MODE": 0.5,
    "AVAILABLE_MODES_MONITOR": 0.2,
}


def test_default_rates_on_every_link() -> None:
    world = World(links=(0, 1))
    clients = [world.client(), world.client(link=1)]
    world.run(1.0)
    for client in clients:
        client.rx.clear()
    world.run(20.0)
    for client in clients:
        for name, rate in RATES.items():
            assert len(client.got(name)) == pytest.approx(20 * rate, abs=1), name


def test_rates_are_set_per_link() -> None:
    world = World(links=(0, 1))
    fast, other = world.client(), world.client(link=1)
    fast.send(mav.MAVLink_request_data_stream_message(1, 1, mav.MAV_DATA_STREAM_EXTRA1, 25, 1))
    other.send(mav.MAVLink_request_data_stream_message(1, 1, mav.MAV_DATA_STREAM_POSITION, 0, 0))
    world.run(0.2)
    fast.rx.clear()
    other.rx.clear()
    world.run(2.0)
    assert len(fast.got("ATTITUDE")) == 50 and len(other.got("ATTITUDE")) == 20
    assert len(fast.got("LOCAL_POSITION_NED")) == 20 and not other.got("LOCAL_POSITION_NED")


def test_all_streams_at_once_leave_slow_ones_alone(world: World, client: Client) -> None:
    """MAVProxy asks for ALL at 4 Hz every 15 s."""
    client.send(mav.MAVLink_request_data_stream_message(1, 1, mav.MAV_DATA_STREAM_ALL, 4, 1))
    world.run(0.5)
    client.rx.clear()
    world.run(4.0)
    assert len(client.got("ATTITUDE")) == 16 and len(client.got("ALTITUDE")) == 16
    assert len(client.got("SYS_STATUS")) == 4 and len(client.got("HOME_POSITION")) == 2


def test_the_raw_sensors_are_a_group_too(world: World, client: Client) -> None:
    client.send(mav.MAVLink_request_data_stream_message(1, 1, mav.MAV_DATA_STREAM_RAW_SENSORS, 20, 1))
    world.run(0.5)
    for name in ("RAW_IMU", "SCALED_IMU", "SCALED_PRESSURE", "SCALED_PRESSURE2"):
        number = getattr(mav, f"MAVLINK_MSG_ID_{name}")
        assert client.command(mav.MAV_CMD_GET_MESSAGE_INTERVAL, number) == 0
        (interval,) = client.got("MESSAGE_INTERVAL")
        assert interval.interval_us == 50_000, name


def test_a_link_that_opens_or_closes(world: World) -> None:
    client = world.client(link=5)
    world.run(0.5)
    assert not client.rx
    client.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    world.run(2.0)
    assert client.got("ATTITUDE") and client.got("HEARTBEAT")
    world.server.remove_link(5)
    client.rx.clear()
    world.run(1.0)
    assert not client.rx
    world.server.add_link(5)
    world.run(1.1)
    assert client.got("HEARTBEAT")


def test_the_live_margin_is_sent_while_controlled(world: World, client: Client) -> None:
    world.run(3.0)
    assert not client.got("DEBUG_VECT"), "nothing is controlled yet"
    status = simple_output(0, nav_state(), np.zeros(4)).status
    world.show(control=replace(status, margin_m=0.25, tube_m=0.0625, penalty_use=0.5))
    world.run(10.0)
    sent = client.got("DEBUG_VECT")
    assert len(sent) == pytest.approx(10, abs=1)
    assert (sent[-1].name, sent[-1].x, sent[-1].y, sent[-1].z) == ("margin", 0.25, 0.0625, 0.5)


def test_position_and_velocity(world: World, client: Client) -> None:
    world.run(2.0)
    local, globe = client.got("LOCAL_POSITION_NED")[-1], client.got("GLOBAL_POSITION_INT")[-1]
    assert (local.x, local.y, local.z) == pytest.approx((-1.6, -0.35, 0.45))
    # Heading east: surge goes east; the small roll and pitch turn some of it.
    assert (local.vx, local.vy, local.vz) == pytest.approx((0.002, 0.297, 0.109), abs=2e-3)
    assert globe.relative_alt == -450 and globe.alt == 11_550 and globe.hdg == 9000
    assert (globe.lat - round(ORIGIN.lat_deg * 1e7)) * 1.11e-2 == pytest.approx(-1.6, abs=0.01)
    hud, alt = client.got("VFR_HUD")[-1], client.got("ALTITUDE")[-1]
    assert hud.airspeed == pytest.approx(0.5) and hud.heading == 90 and hud.throttle == 42
    assert hud.alt == pytest.approx(11.55) and alt.altitude_relative == pytest.approx(-0.45)
    wind = client.got("WIND_COV")[-1]
    assert (wind.wind_x, wind.wind_y) == pytest.approx((0.1, -0.2))
    nav = client.got("NAV_CONTROLLER_OUTPUT")[-1]
    assert nav.wp_dist == 3 and nav.target_bearing == 6 and nav.alt_error == pytest.approx(0.15)
    target = client.got("POSITION_TARGET_LOCAL_NED")[-1]
    assert (target.x, target.y, target.z, target.type_mask & 7) == (1.75, 0.0, pytest.approx(0.3), 0)
    servo = client.got("SERVO_OUTPUT_RAW")[-1]
    assert (servo.servo1_raw, servo.servo3_raw, servo.servo5_raw) == (1600, 1550, 0)


@pytest.mark.parametrize(
    ("offset", "distance_m", "bearing_deg"),
    [
        ((30.0, 0.0), 30, 0),
        ((0.0, 40.0), 40, 90),
        ((-30.0, -40.0), 50, 233),
        ((0.0, -7.0), 7, 270),
        ((-5.0, 12.0), 13, 113),
    ],
)
def test_the_target_lies_where_it_is_told(offset: tuple[float, float], distance_m: int, bearing_deg: int) -> None:
    world = World()
    client = world.client()
    world.show(target_ned_m=np.array([-1.6 + offset[0], -0.35 + offset[1], 1.45]))
    world.run(2.0)
    nav = client.got("NAV_CONTROLLER_OUTPUT")[-1]
    assert nav.wp_dist == distance_m
    assert abs(nav.target_bearing - bearing_deg) <= 1
    assert nav.alt_error == pytest.approx(-1.0)


def test_severities_are_mavlinks() -> None:
    for severity in Severity:
        assert getattr(mav, f"MAV_SEVERITY_{severity.name}") == severity


def test_quaternion_and_angles_agree(world: World, client: Client) -> None:
    world.run(1.0)
    q, a = client.got("ATTITUDE_QUATERNION")[-1], client.got("ATTITUDE")[-1]
    assert math.atan2(2 * (q.q1 * q.q4 + q.q2 * q.q3), 1 - 2 * (q.q3**2 + q.q4**2)) == pytest.approx(a.yaw, abs=1e-5)
    assert math.asin(2 * (q.q1 * q.q3 - q.q4 * q.q2)) == pytest.approx(a.pitch, abs=1e-5)


def test_sys_status(world: World) -> None:
    status = one(world, "SYS_STATUS")
    prearm, vision = mav.MAV_SYS_STATUS_PREARM_CHECK, mav.MAV_SYS_STATUS_SENSOR_VISION_POSITION
    gps = mav.MAV_SYS_STATUS_SENSOR_GPS  # stands for a good estimate, as GPS_RAW_INT does
    assert status.onboard_control_sensors_present & prearm and status.onboard_control_sensors_health & prearm
    assert status.onboard_control_sensors_present & status.onboard_control_sensors_health & gps
    assert (status.load, status.voltage_battery, status.current_battery, status.battery_remaining) == (
        250,
        23_500,
        400,
        80,
    )
    blind = ArmingReason("no position", HealthComponent.POSITION)
    world.show(arming_reasons=(blind,), nav=nav_state(health=NavHealth.DEAD_RECKONING), dropped_rx=9, power=None)
    status = one(world, "SYS_STATUS")
    assert not status.onboard_control_sensors_health & (prearm | vision | gps)
    assert not status.onboard_control_sensors_present & gps
    assert (status.errors_comm, status.drop_rate_comm, status.voltage_battery) == (9, 10_000, 0xFFFF)


def test_battery(world: World) -> None:
    battery = one(world, "BATTERY_STATUS")
    assert battery.voltages[0] == 23_500 and set(battery.voltages[1:]) == {0xFFFF}
    assert (battery.current_battery, battery.energy_consumed, battery.battery_remaining) == (400, 36, 80)
    assert battery.charge_state == mav.MAV_BATTERY_CHARGE_STATE_OK
    world.show(power=PowerSample(t_us=0, voltage_v=99.0, current_a=1e9, energy_used_j=NAN, remaining=0.05))
    battery = one(world, "BATTERY_STATUS")
    assert battery.charge_state == mav.MAV_BATTERY_CHARGE_STATE_LOW and battery.voltages[0] == 0xFFFE


@pytest.mark.parametrize(
    ("armed", "under_way", "mode", "state"),
    [
        (False, False, FlightMode.HOLD, mav.MAV_LANDED_STATE_ON_GROUND),
        (False, False, FlightMode.MISSION, mav.MAV_LANDED_STATE_ON_GROUND),
        (True, False, FlightMode.HOLD, mav.MAV_LANDED_STATE_ON_GROUND),
        (True, True, FlightMode.MISSION, mav.MAV_LANDED_STATE_IN_AIR),
        (True, True, FlightMode.HOLD, mav.MAV_LANDED_STATE_IN_AIR),
        (True, True, FlightMode.SURFACE, mav.MAV_LANDED_STATE_LANDING),
    ],
)
def test_landed_state(world: World, armed: bool, under_way: bool, mode: FlightMode, state: int) -> None:
    world.show(armed=armed, under_way=under_way, mode=mode)
    assert one(world, "EXTENDED_SYS_STATE").landed_state == state


def test_estimator_status(world: World) -> None:
    status = one(world, "ESTIMATOR_STATUS")
    assert status.flags & mav.ESTIMATOR_POS_HORIZ_ABS
    assert status.pos_horiz_accuracy == pytest.approx(math.sqrt(2e-4)) and status.pos_vert_accuracy == pytest.approx(
        0.01
    )
    world.show(nav=nav_state(health=NavHealth.DEAD_RECKONING))
    assert not one(world, "ESTIMATOR_STATUS").flags & mav.ESTIMATOR_POS_HORIZ_ABS
    world.show(nav=nav_state(health=NavHealth.INVALID))
    assert one(world, "ESTIMATOR_STATUS").flags == 0


@pytest.mark.parametrize("broken", [NAN, math.inf, 1e300])
def test_what_is_not_known_is_not_sent(world: World, broken: float) -> None:
    world.show(nav=nav_state(rpy_rad=np.array([0.0, 0.0, broken]), variance=np.full(12, broken)))
    client = world.client()
    world.run(2.0)
    assert not client.got("ATTITUDE") and not client.got("GLOBAL_POSITION_INT")
    world.show(nav=None, power=None, command=None, progress=None, target_ned_m=None)
    world.run(2.0)
    assert client.got("HEARTBEAT") and client.got("SYS_STATUS")


def test_origin_and_home_are_told_when_they_change(world: World, client: Client) -> None:
    world.run(1.0)
    client.rx.clear()
    world.show(home=GeodeticPosition(lat_deg=37.97551, lon_deg=23.77901, alt_m=11.0))
    world.tick()
    (home,) = client.got("HOME_POSITION")
    assert home.z == pytest.approx(1.0) and home.x == pytest.approx(1.11, abs=0.01)


# Texts


def sent(world: World, text: str) -> list:
    client = world.client()
    world.tick(events=(Event(t_us=0, severity=4, text=text),))
    return client.got("STATUSTEXT")


def test_events_become_texts(world: World) -> None:
    (message,) = sent(world, "Battery at 9 %")
    assert (message.severity, message.text, message.id, message.chunk_seq) == (4, "Battery at 9 %", 0, 0)


@given(st.text(min_size=0, max_size=400))
@settings(max_examples=40, deadline=None)
def test_long_texts_come_in_chunks_that_add_up(text: str) -> None:
    world = World()
    expected = text.replace("\0", " ").encode("ascii", errors="replace").decode()
    messages = sent(world, text)
    assert "".join(m.text for m in messages) == expected
    if len(expected) > 50:
        assert [m.chunk_seq for m in messages] == list(range(len(messages)))
        assert len({m.id for m in messages}) == 1 and messages[0].id > 0
        assert all(len(m.text) == 50 for m in messages[:-1]) and len(messages[-1].text) < 50


def test_two_long_texts_have_different_ids(world: World) -> None:
    assert sent(world, "a" * 80)[0].id != sent(world, "b" * 80)[-1].id


# Small services


def test_ping_is_answered_and_answers_are_not(client: Client) -> None:
    (answer,) = client.ask(mav.MAVLink_ping_message(77, 5, 0, 0), "PING", 0.1)
    assert (answer.time_usec, answer.seq, answer.target_system, answer.target_component) == (77, 5, 255, 190)
    assert not client.ask(mav.MAVLink_ping_message(77, 5, 1, 1), "PING", 0.1)


def test_timesync_is_in_nanoseconds_and_answers_are_not_answered(world: World, client: Client) -> None:
    world.run(0.2)
    (request,) = client.got("TIMESYNC")
    assert request.tc1 == 0 and request.ts1 <= world.t_us * 1000, "ours, every ten seconds: the log has its answers"
    (answer,) = client.ask(mav.MAVLink_timesync_message(0, 123_456), "TIMESYNC", 0.01)
    assert (answer.tc1, answer.ts1) == (world.t_us * 1000, 123_456)
    assert not client.ask(mav.MAVLink_timesync_message(5, 123_456), "TIMESYNC", 0.1)


@pytest.mark.parametrize("system", [0, 1, 2, 255])
@pytest.mark.parametrize("component", [0, 1, 191, 250])
def test_a_request_for_time_is_answered_by_whom_it_asks_and_to_who_asked(
    world: World, client: Client, system: int, component: int
) -> None:
    request = extra.MAVLink_timesync_message(0, 2**62, system, component)
    answers = client.ask(request, "TIMESYNC", 0.01)
    assert bool(answers) is (system in (0, 1) and component in (0, 1))
    assert all((a.ts1, a.target_system, a.target_component) == (2**62, 255, 190) for a in answers)


def test_an_answer_of_the_very_first_moment_is_no_request(world: World, client: Client) -> None:
    world.t_us = -TICK_US
    (answer,) = (m for m in client.ask(mav.MAVLink_timesync_message(0, 77), "TIMESYNC", 0.01) if m.ts1 == 77)
    assert answer.tc1 > 0


@pytest.mark.parametrize("unix_us", [0, 1, 10**15, 5 * 10**15, 2**63, 2**64 - 1])
def test_a_time_of_day_that_cannot_be_is_not_learnt(world: World, client: Client, unix_us: int) -> None:
    client.send(mav.MAVLink_system_time_message(unix_us, 5))
    world.run(0.5)
    assert world.server.utility.utc_offset_us is None


def test_the_time_of_day_is_learnt(world: World, client: Client) -> None:
    assert world.server.utility.utc_offset_us is None
    client.send(mav.MAVLink_system_time_message(1_800_000_000_000_000, 5))
    world.run(0.5)
    client.command(512, mav.MAVLINK_MSG_ID_SYSTEM_TIME)
    assert client.got("SYSTEM_TIME")[0].time_unix_usec == pytest.approx(1_800_000_000_500_000, abs=60_000)
    assert world.server.utility.utc_offset_us == 1_800_000_000_000_000 - 10_000


def test_of_two_times_of_day_the_first_is_believed_and_none_of_another_vehicle(world: World, client: Client) -> None:
    vehicle, second = world.client(sysid=2, compid=1, number=1), world.client(sysid=254, number=2)

    def told(sender: Client, unix_s: int) -> int | None:
        sender.send(mav.MAVLink_system_time_message(unix_s * 1_000_000, 5))
        world.run(0.1)
        offset_us = world.server.utility.utc_offset_us
        return None if offset_us is None else round(1e-6 * (offset_us + world.t_us))

    assert told(vehicle, 1_500_000_000) is None
    assert told(client, 1_800_000_000) == 1_800_000_000
    assert told(second, 1_900_000_000) == told(vehicle, 1_500_000_000) == 1_800_000_000
    assert told(client, 1_850_000_000) == 1_850_000_000, "it was set"
    world.run(10.0)
    assert told(second, 1_900_000_000) == 1_900_000_000, "the first is silent"


@pytest.mark.parametrize(
    ("opcode", "reply", "error"), [(4, 129, 10), (3, 129, 10), (15, 129, 4), (99, 129, 7), (1, 128, 0), (2, 128, 0)]
)
def test_file_transfer_of_what_is_not_there_is_declined_at_once(
    world: World, opcode: int, reply: int, error: int
) -> None:
    payload = bytearray(251)
    payload[0:5] = bytes((0xFF, 0xFF, 3, opcode, 7))
    payload[12:19] = b"nothing"
    client = world.client()
    (answer,) = client.ask(
        mav.MAVLink_file_transfer_protocol_message(0, 1, 1, list(payload)), "FILE_TRANSFER_PROTOCOL", 0.1
    )
    data = bytes(answer.payload)
    assert (answer.target_system, answer.target_component) == (255, 190)
    assert (data[0:2], data[2], data[3], data[5]) == (b"\0\0", 3, reply, opcode)
    assert (data[4], data[12]) == ((1, error) if error else (0, 0))


# Same input, same output


def test_a_server_needs_no_links_to_start() -> None:
    world = World(links=())
    assert isinstance(world.server, MavlinkServer) and world.tick() == ()
    assert isinstance(world.params, ParamSet)
