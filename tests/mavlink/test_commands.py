"""Commands: what each asks of the vehicle, its answer, and what happens to retransmissions."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mavlink_harness import NAN, ORIGIN, Client, World, mav, nav_state, upload, waypoint

from autopilot.core.arming_reasons import ArmingReason, HealthComponent, ModeGroup
from autopilot.core.geodesy import GeodeticPosition
from autopilot.mavlink.api import CommandReply, CommandResult, FlightMode
from autopilot.mavlink.flight_modes import MODE_ROWS

R = CommandResult
PROFILES = ("generic", "px4", "ardusub")
INT32_MAX = 0x7FFF_FFFF


H, M, RET, S = FlightMode.HOLD, FlightMode.MISSION, FlightMode.RETURN, FlightMode.SURFACE

CASES: list[tuple[int, tuple[float, ...], tuple[Any, ...]]] = [
    (400, (1,), ("arm", False)),
    (400, (1, 2989), ("arm", True)),
    (400, (1, 21196), ("arm", True)),
    (400, (0,), ("disarm", False)),
    (400, (0, 21196), ("disarm", True)),
    (185, (1,), ("disarm", True)),
    (176, (129, 4, 3), ("set_mode", H)),
    (176, (129, 4, 4), ("set_mode", M)),
    (176, (1, 4, 5), ("set_mode", RET)),
    (176, (129, 4, 6), ("set_mode", S)),
    (176, (129, float((4 << 16) | (4 << 24))), ("set_mode", M)),
    (262, (1,), ("set_mode", FlightMode.POSHOLD)),
    (262, (4,), ("set_mode", FlightMode.ALT_HOLD)),
    (176, (129, 1), ("set_mode", FlightMode.MANUAL)),
    (176, (129, 6), ("set_mode", FlightMode.GUIDED)),
    (176, (129, 3, 1), ("set_mode", FlightMode.CIRCLE)),
    (92, (1,), ("set_mode", FlightMode.GUIDED)),
    (186, (-0.5, 3), ("change_depth", 0.5)),
    (186, (0.5, 1), ("change_depth", 0.5)),
    (20, (), ("set_mode", RET)),
    (21, (), ("set_mode", S)),
    (17, (), ("set_mode", H)),
    (300, (), ("start_mission", None)),
    (300, (2, 0), ("start_mission", 2)),
    (300, (0, 3), ("start_mission", None)),
    (193, (0,), ("pause",)),
    (193, (1,), ("resume",)),
    (224, (2,), ("set_current_item", 2)),
    (224, (-1, 1), ("set_current_item", 1, "reset")),
    (178, (1, 0.25), ("change_speed", 0.25)),
    (178, (0, 0.5), ("change_speed", 0.5)),
    (178, (1, -2), ("change_speed", None)),
    (179, (1,), ("set_home", None)),
]


@pytest.mark.parametrize("rest", [0.0, NAN, None])
@pytest.mark.parametrize(("command", "params", "call"), CASES)
def test_commands_reach_the_vehicle(
    world: World, client: Client, command: int, params: tuple[float, ...], call: tuple[Any, ...], rest: float | None
) -> None:
    """Unused parameters are 0 from QGroundControl's action buttons and NaN from MAVSDK; without any: COMMAND_INT."""
    upload(client, [waypoint(n) for n in range(4)])
    if rest is None:
        assert client.command_int(command, 0, (*params, 0.0, 0.0, 0.0, 0.0)[:4], 0, 0, 0.0) == R.ACCEPTED
    else:
        assert client.command(command, *params, rest=rest) == R.ACCEPTED
    assert world.vehicle.calls == [call]


@pytest.mark.parametrize(
    ("command", "params", "result"),
    [
        (400, (2,), R.DENIED),
        (400, (NAN,), R.DENIED),
        (185, (0,), R.DENIED),
        (176, (128, 4, 4), R.DENIED),  # no custom flag
        (176, (129, 9, 9), R.DENIED),
        (176, (129, 5, 0), R.DENIED),  # PX4's ACRO does not exist here
        (176, (129, -1, 0), R.DENIED),
        (176, (129, 4.5, 3), R.DENIED),
        (176, (NAN, NAN, NAN), R.DENIED),
        (262, (3,), R.FAILED),
        *((262, (number,), R.FAILED) for number in range(5, 10)),
        (186, (-0.5, 10), R.UNSUPPORTED_FRAME),
        (34, (1.0, 0.2, 4), R.DENIED),
        (262, (0,), R.FAILED),
        (300, (-1,), R.DENIED),
        (300, (0, 2), R.DENIED),
        (300, (1e30,), R.DENIED),
        (193, (2,), R.DENIED),
        (193, (NAN,), R.DENIED),
        (224, (-3,), R.DENIED),
        (224, (1.5,), R.DENIED),
        (224, (NAN,), R.DENIED),
        (178, (2, 0.3), R.DENIED),
        (178, (1, 0.0), R.DENIED),
        (178, (1, NAN), R.DENIED),
        (178, (1, math.inf), R.DENIED),
        (179, (7,), R.DENIED),
        (17, (0, 0, 0, 0, 37.9, 23.7, 0), R.DENIED),
        (512, (99_999,), R.UNSUPPORTED),
        (512, (NAN,), R.TEMPORARILY_REJECTED),
        (512, (396,), R.UNSUPPORTED),
        (511, (12_345, 1000), R.UNSUPPORTED),
        (511, (30, NAN), R.DENIED),
        (511, (30, -5), R.DENIED),
        (511, (0, 100_000), R.DENIED),
        (510, (-1,), R.DENIED),
    ],
)
def test_wrong_parameters_are_refused_and_reach_nobody(
    world: World, client: Client, command: int, params: tuple[float, ...], result: CommandResult
) -> None:
    upload(client, [waypoint(n) for n in range(4)])
    if command == 512 and math.isnan(params[0]):
        world.show(nav=None)
        params = (30,)  # ATTITUDE without an estimate
    assert client.command(command, *params) == result
    assert world.vehicle.calls == []
    remedies = ("use ", "send ", "give ", "first", "cannot", "lists them")
    assert result != R.DENIED or any(remedy in client.texts() for remedy in remedies), client.texts()


@pytest.mark.parametrize("command", [23, 201, 519 + 1000, 2510, 31_999, 65_535, 0])
def test_everything_else_is_unsupported(world: World, client: Client, command: int) -> None:
    assert client.command(command) == R.UNSUPPORTED
    assert client.command_int(command, 0, (0, 0, 0, 0), 0, 0, 0.0) == R.UNSUPPORTED
    assert world.vehicle.calls == []


def test_the_vehicles_reason_is_passed_on(world: World, client: Client) -> None:
    reason = "Arming denied: no position; battery at 5 %"
    world.vehicle.answers["arm"] = CommandReply(result=R.DENIED, reason=reason)
    assert client.command(400, 1) == R.DENIED
    assert client.texts().count(reason) == 1
    assert [event.text for event in world.server.take_notices()] == [reason]


# Retransmission


def test_a_retransmission_gets_the_answer_but_is_not_executed_again(world: World, client: Client) -> None:
    world.vehicle.answers["arm"] = CommandReply(result=R.DENIED, reason="no position")
    assert client.command(400, 1) == R.DENIED
    del world.vehicle.answers["arm"]
    for confirmation in (1, 2):
        assert client.command(400, 1, confirmation=confirmation) == R.DENIED
    assert len(world.vehicle.calls) == 1
    assert client.command(400, 1, confirmation=0) == R.ACCEPTED
    assert len(world.vehicle.calls) == 2


def test_a_first_transmission_that_was_lost_is_made_good(world: World, client: Client) -> None:
    assert client.command(400, 1, confirmation=1) == R.ACCEPTED
    assert world.vehicle.calls == [("arm", False)]


def test_other_parameters_are_another_command(world: World, client: Client) -> None:
    client.command(400, 1)
    assert client.command(400, 0, confirmation=1) == R.ACCEPTED
    assert [call[0] for call in world.vehicle.calls] == ["arm", "disarm"]


def test_two_clients_with_the_same_command_are_two_commands(world: World, client: Client) -> None:
    other = world.client(sysid=254)
    client.send(mav.MAVLink_command_long_message(1, 1, 193, 0, 0, 0, 0, 0, 0, 0, 0))
    other.send(mav.MAVLink_command_long_message(1, 1, 193, 1, 0, 0, 0, 0, 0, 0, 0))
    world.run(0.05)
    assert len(world.vehicle.calls) == 2


def test_requests_are_answered_every_time(client: Client) -> None:
    for confirmation in (0, 1, 2):
        assert client.command(512, 148, confirmation=confirmation) == R.ACCEPTED
        assert len(client.got("AUTOPILOT_VERSION")) == 1


# Addressing


def test_our_own_echo_is_not_obeyed(world: World) -> None:
    echo = world.client(sysid=1, compid=1)
    echo.send(mav.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
    world.run(0.05)
    assert world.vehicle.calls == [] and not echo.got("COMMAND_ACK")


# Mode by message


@pytest.mark.parametrize(
    ("profile", "custom", "mode"),
    [
        ("px4", (4 << 16) | (4 << 24), M),
        ("generic", (4 << 16) | (6 << 24), S),
        ("ardusub", 3, M),
        ("ardusub", 16, FlightMode.POSHOLD),
    ],
)
def test_legacy_set_mode(world: World, client: Client, profile: str, custom: int, mode: FlightMode) -> None:
    client.send(mav.MAVLink_set_mode_message(1, 1, custom))
    world.run(0.05)
    assert world.vehicle.calls == [("set_mode", mode)]
    client.send(mav.MAVLink_set_mode_message(1, 1, 0x7777))
    world.run(0.05)
    assert len(world.vehicle.calls) == 1 and "no mode" in client.texts()


@pytest.mark.parametrize(
    ("number", "mode"), [(3, M), (4, H), (16, FlightMode.POSHOLD), (19, FlightMode.MANUAL), (9, S), (6, RET)]
)
def test_ardusub_mode_numbers(number: int, mode: FlightMode) -> None:
    world = World("ardusub")
    assert world.client().command(176, 1, number) == R.ACCEPTED
    assert world.vehicle.calls == [("set_mode", mode)]


@pytest.mark.parametrize("rest", [0.0, NAN])
def test_a_takeoff_is_a_dive_whatever_its_altitude_means(world: World, client: Client, rest: float) -> None:
    """MAVSDK and QGroundControl send heights above the water, or none; the water lies 12 m above the sea here."""
    for altitude, depth in ((rest, None), (2.0, None), (14.5, None), (11.5, 0.5), (-0.5, None)):
        world.vehicle.calls.clear()
        assert client.command(22, 0, 0, 0, rest, rest, rest, altitude) == R.ACCEPTED
        assert world.vehicle.calls == [("take_off", depth, None)]
    for frame, altitude, depth in ((3, -0.75, 0.75), (1, 0.25, 0.25), (3, 2.5, None)):
        world.vehicle.calls.clear()
        assert client.command_int(22, frame, (0, 0, 0, NAN), 0, 0, altitude) == R.ACCEPTED
        assert world.vehicle.calls == [("take_off", depth, None)]
    world.vehicle.calls.clear()
    assert client.command_int(22, 10, (0, 0, 0, 0), 0, 0, -0.5) == R.UNSUPPORTED_FRAME and not world.vehicle.calls


def test_a_takeoff_takes_its_heading(world: World, client: Client) -> None:
    """Zeros of a COMMAND_LONG are what its sender has not filled in; a COMMAND_INT means north."""
    assert client.command(22, 0, 0, 0, 270.0, 0, 0, NAN) == R.ACCEPTED
    assert client.command_int(22, 3, (0, 0, 0, 0.0), 0, 0, -0.5) == R.ACCEPTED
    assert world.vehicle.calls == [("take_off", None, pytest.approx(-math.pi / 2)), ("take_off", 0.5, 0.0)]


@pytest.mark.parametrize("command", [192, 34, 179])
def test_half_a_place_is_refused(world: World, client: Client, command: int) -> None:
    place = e7(37.9755)
    for x, y in ((place, INT32_MAX), (INT32_MAX, place)):
        assert client.command_int(command, 3, (0, 1, 0, 0), x, y, NAN) == R.DENIED
        assert "latitude or longitude is missing" in client.texts()
        world.server._ctx.begin_anew()
    assert world.vehicle.calls == []


def test_modes_of_ardusub_that_are_not_here_are_refused() -> None:
    world = World("ardusub")
    client = world.client()
    for number in (1, 20, 22, 99):
        assert client.command(176, 1, number) == R.DENIED


def test_a_mode_change_shows_at_once(world: World, client: Client) -> None:
    world.run(1.0)
    client.rx.clear()
    world.show(mode=S, intended_mode=M)
    world.tick()
    (beat,) = client.got("HEARTBEAT")
    (mode,) = client.got("CURRENT_MODE")
    assert beat.custom_mode == world.server.custom_mode(S) == mode.custom_mode
    assert mode.intended_custom_mode == world.server.custom_mode(M) and mode.standard_mode == 0


# Mission start under ArduPilot's numbering


def test_mission_start_counts_home_under_ardusub() -> None:
    world = World("ardusub")
    client = world.client()
    upload(client, [waypoint(n) for n in range(4)])
    assert client.command(300, 2, 3) == R.ACCEPTED
    assert client.command(300, 0, 0) == R.ACCEPTED
    assert world.vehicle.calls == [("start_mission", 2), ("start_mission", None)]  # home is item 0 of the plan, too


# Places


def e7(deg: float) -> int:
    return round(deg * 1e7)


def test_reposition_takes_exact_coordinates(world: World, client: Client) -> None:
    x, y = e7(37.97550123), e7(23.77900456)
    assert client.command_int(192, 0, (-1, 1, 0, NAN), x, y, 11.5) == R.ACCEPTED
    ((name, point, yaw),) = world.vehicle.calls
    assert (name, e7(point.lat_deg), e7(point.lon_deg), point.alt_m, yaw) == ("go_to", x, y, 11.5, None)


def test_reposition_frames(world: World, client: Client) -> None:
    x, y = e7(37.9756), e7(23.7791)
    assert client.command_int(192, 3, (-1, 1, 0, 1.5), x, y, -0.5) == R.ACCEPTED
    assert client.command_int(192, 1, (-1, 1, 0, NAN), 10_000, -20_000, 0.7) == R.ACCEPTED
    assert client.command_int(192, 12, (-1, 1, 0, NAN), x, y, 0.0) == R.UNSUPPORTED_FRAME
    (_, point, yaw), (_, local, _) = world.vehicle.calls
    assert point.alt_m == ORIGIN.alt_m - 0.5 and yaw == 1.5
    north_m = (local.lat_deg - ORIGIN.lat_deg) * 110_990.0
    east_m = (local.lon_deg - ORIGIN.lon_deg) * 111_320.0 * math.cos(math.radians(ORIGIN.lat_deg))
    assert (north_m, east_m) == pytest.approx((1.0, -2.0), abs=0.01)
    assert local.alt_m == pytest.approx(ORIGIN.alt_m - 0.7)


def test_reposition_without_a_position_is_pause(world: World, client: Client) -> None:
    """QGroundControl's pause button under the PX4 identity."""
    assert client.command(192, -1, 1, 0, NAN, NAN, NAN, NAN) == R.ACCEPTED
    world.show(mode=RET)
    assert client.command(192, -1, 1, 0, NAN, NAN, NAN, NAN) == R.ACCEPTED
    assert client.command_int(192, 0, (-1, 1, 0, NAN), INT32_MAX, INT32_MAX, NAN) == R.ACCEPTED
    assert world.vehicle.calls == [("go_to", None, None)] * 3
    world.vehicle.calls.clear()
    world.show(mode=M)
    assert client.command(192, -1, 1, 0, 1.5, NAN, NAN, NAN) == R.ACCEPTED
    assert world.vehicle.calls == [("go_to", None, 1.5)], "a turn here, also out of a mission"


def test_reposition_with_an_altitude_only_is_a_new_depth_here(world: World, client: Client) -> None:
    """QGroundControl's change-altitude under the PX4 identity."""
    assert client.command(192, -1, 1, 0, NAN, NAN, NAN, 11.0) == R.ACCEPTED
    ((_, point, _),) = world.vehicle.calls
    assert point.alt_m == 11.0
    assert (point.lat_deg - ORIGIN.lat_deg) * 110_990.0 == pytest.approx(-1.6, abs=0.01)
    world.show(nav=None)
    assert client.command(192, -1, 1, 0, NAN, NAN, NAN, 10.0) == R.DENIED


def test_reposition_with_a_speed(world: World, client: Client) -> None:
    assert client.command_int(192, 0, (0.2, 1, 0, NAN), e7(37.9756), e7(23.7791), 11.0) == R.ACCEPTED
    assert world.vehicle.calls[1] == ("change_speed", pytest.approx(0.2))


def test_reposition_needs_the_flag_outside_hold(world: World, client: Client) -> None:
    assert client.command_int(192, 0, (-1, 0, 0, NAN), e7(37.9756), e7(23.7791), 11.0) == R.DENIED
    world.show(mode=H)
    assert client.command_int(192, 0, (-1, 0, 0, NAN), e7(37.9756), e7(23.7791), 11.0) == R.ACCEPTED


def test_positions_by_command_long_are_too_coarse(world: World, client: Client) -> None:
    assert client.command(192, -1, 1, 0, NAN, 37.9756, 23.7791, 11.0) == R.COMMAND_INT_ONLY
    assert client.command(611, 0, 0, 0, 0, 37.9756, 23.7791, 11.0) == R.COMMAND_INT_ONLY
    assert client.command(179, 0, 0, 0, 0, 37.9756, 23.7791, 11.0) == R.COMMAND_INT_ONLY
    assert world.vehicle.calls == []


@pytest.mark.parametrize(("x", "y"), [(0, 0), (910_000_000, 0), (0, 1_810_000_000), (-900_000_000, 5)])
def test_places_that_are_none(world: World, client: Client, x: int, y: int) -> None:
    assert client.command_int(192, 0, (-1, 1, 0, NAN), x, y, 0.0) == R.DENIED
    assert client.command_int(611, 0, (0, 0, 0, 0), x, y, 0.0) == R.DENIED
    assert world.vehicle.calls == []


def test_set_home_to_a_place(world: World, client: Client) -> None:
    assert client.command_int(179, 0, (0, 0, 0, 0), e7(37.9756), e7(23.7791), 12.0) == R.ACCEPTED
    assert world.vehicle.calls == [("set_home", GeodeticPosition(lat_deg=37.9756, lon_deg=23.7791, alt_m=12.0))]
    world.run(0.05)
    assert client.got("HOME_POSITION")


def test_get_home(world: World, client: Client) -> None:
    world.run(0.1)
    assert client.command(410) == R.ACCEPTED
    (home,) = client.got("HOME_POSITION")
    assert (home.latitude, home.longitude, home.altitude) == (e7(ORIGIN.lat_deg), e7(ORIGIN.lon_deg), 12_000)


def test_origin_by_command(world: World, client: Client) -> None:
    world.run(0.1)
    assert client.command_int(611, 0, (0, 0, 0, 0), e7(38.0), e7(24.0), 3.0) == R.ACCEPTED
    assert world.vehicle.calls == [("set_origin", GeodeticPosition(lat_deg=38.0, lon_deg=24.0, alt_m=3.0))]
    assert len(client.got("GPS_GLOBAL_ORIGIN")) == 1
    assert client.command_int(611, 3, (0, 0, 0, 0), e7(38.0), e7(24.0), 3.0) == R.UNSUPPORTED_FRAME
    assert client.command_int(611, 0, (0, 0, 0, 0), INT32_MAX, e7(24.0), 3.0) == R.DENIED


def test_an_origin_without_an_altitude_keeps_that_of_the_old_one(world: World, client: Client) -> None:
    """A place of QGroundControl's map has no altitude."""
    world.run(0.1)
    kept = GeodeticPosition(lat_deg=38.0, lon_deg=24.0, alt_m=world.view.origin.alt_m)
    assert client.command_int(611, 0, (0, 0, 0, 0), e7(38.0), e7(24.0), NAN) == R.ACCEPTED
    client.send(mav.MAVLink_set_gps_global_origin_message(1, e7(38.0), e7(24.0), -0x8000_0000))
    world.run(0.1)
    assert world.vehicle.calls == [("set_origin", kept)] * 2


def test_origin_by_message_is_answered_with_the_new_one(world: World, client: Client) -> None:
    """MAVSDK waits 0.5 s for GPS_GLOBAL_ORIGIN."""
    world.run(0.1)
    client.rx.clear()
    client.send(mav.MAVLink_set_gps_global_origin_message(1, e7(38.0), e7(24.0), 3000))
    world.tick()
    world.show(origin=GeodeticPosition(lat_deg=38.0, lon_deg=24.0, alt_m=3.0))
    world.run(0.05)
    (origin,) = client.got("GPS_GLOBAL_ORIGIN")
    assert (origin.latitude, origin.longitude, origin.altitude) == (380_000_000, 240_000_000, 3000)
    assert len(client.got("HOME_POSITION")) == 1


def test_a_refused_origin_message_is_not_confirmed(
    world: World, client: Client, refuse: Callable[[World, str, str], None]
) -> None:
    refuse(world, "set_origin", "Origin denied: disarm first")
    world.run(0.1)
    client.rx.clear()
    client.send(mav.MAVLink_set_gps_global_origin_message(1, e7(38.0), e7(24.0), 3000))
    world.run(0.1)
    assert not client.got("GPS_GLOBAL_ORIGIN") and "disarm first" in client.texts()


# Requests


def test_acknowledgement_comes_before_the_message(client: Client) -> None:
    for params, name in (
        ((512, 148), "AUTOPILOT_VERSION"),
        ((520, 1), "AUTOPILOT_VERSION"),
        ((512, 242), "HOME_POSITION"),
    ):
        assert client.command(*params) == R.ACCEPTED
        kinds = [m.get_type() for m in client.rx if m.get_type() in ("COMMAND_ACK", name)]
        assert kinds[:2] == ["COMMAND_ACK", name]


@pytest.mark.parametrize("profile", PROFILES)
def test_available_modes(world: World, client: Client, profile: str) -> None:
    """ArduPilot's GUIDED is Hold and set points in one: it has one number and one line."""
    assert client.command(512, 435, 0) == R.ACCEPTED
    modes = client.got("AVAILABLE_MODES")
    listed = [mode for mode in FlightMode if profile != "ardusub" or mode is not FlightMode.GUIDED]
    assert [(m.mode_index, m.number_modes) for m in modes] == [(n + 1, len(listed)) for n in range(len(listed))]
    numbers = {m.custom_mode: m.standard_mode for m in modes}
    assert numbers == {world.server.custom_mode(mode): MODE_ROWS[mode].standard for mode in listed}
    named = {"px4": ["Return", "Land"], "ardusub": ["RTL", "Surface"], "generic": ["Return", "Surface"]}
    assert [m.mode_name for m in modes[1:4]] == ["Mission", *named[profile]]
    assert len({m.mode_name for m in modes}) == len(modes)
    assert client.command(512, 435, 3) == R.ACCEPTED
    assert [m.mode_index for m in client.got("AVAILABLE_MODES")] == [3]
    assert client.command(512, 435, len(modes) + 1) == R.DENIED


OLD_STANDARD_MODES = {1: "Position", 2: "Orbit", 4: "Depth hold", 5: "Return", 7: "Mission", 8: "Surface"}
"""MAV_STANDARD_MODE of development.xml, 2022 to January 2025, by what they are called here."""
NEW_STANDARD_MODES = {1: "Position", 2: "Orbit", 4: "Depth hold", 6: "Mission", 7: "Surface", 8: "Takeoff"}
"""The same of common.xml since; 5, safe recovery, is no return home."""


@pytest.mark.parametrize("profile", PROFILES)
def test_a_standard_mode_is_the_same_to_older_and_newer_clients(profile: str) -> None:
    """Whichever numbering a client goes by, no mode is taken for another one, shown or asked for."""
    packaged = {n: entry.name for n, entry in mav.enums["MAV_STANDARD_MODE"].items()}
    assert packaged[6].endswith("_MISSION") and packaged[7].endswith("_LAND"), "the numbering that is called new here"
    world = World(profile)
    client = world.client()
    assert client.command(512, 435, 0) == R.ACCEPTED
    name_of = {m.custom_mode: m.mode_name for m in client.got("AVAILABLE_MODES")}
    shown = {m.custom_mode: m.standard_mode for m in client.got("AVAILABLE_MODES")}
    for mode in FlightMode:
        world.show(mode=mode, intended_mode=mode)
        world.tick()
        current = client.got("CURRENT_MODE")[-1]
        assert current.standard_mode == shown[current.custom_mode]
    for custom, standard in shown.items():
        if standard:
            name = name_of[custom].replace("Circle", "Orbit")
            assert OLD_STANDARD_MODES[standard] == NEW_STANDARD_MODES[standard] == name
    assert sorted(filter(None, shown.values())) == [1, 2, 4], "as many as both agree on"
    for number in range(12):
        world.vehicle.calls.clear()
        taken = client.command(mav.MAV_CMD_DO_SET_STANDARD_MODE, number) == R.ACCEPTED
        assert taken == (number in (1, 2, 4)) == bool(world.vehicle.calls)
        if taken:
            ((_, mode),) = world.vehicle.calls
            assert shown[world.server.custom_mode(mode)] == number


def test_protocol_version_is_answered(client: Client) -> None:
    for command in ((512, 300), (519, 1)):
        assert client.command(*command) == R.ACCEPTED
        assert client.got("UNKNOWN_300")


def test_message_intervals(world: World, client: Client) -> None:
    assert client.command(511, mav.MAVLINK_MSG_ID_ATTITUDE, 20_000) == R.ACCEPTED
    client.rx.clear()
    world.run(1.0)
    assert len(client.got("ATTITUDE")) == 50
    assert client.command(510, mav.MAVLINK_MSG_ID_ATTITUDE) == R.ACCEPTED
    assert client.got("MESSAGE_INTERVAL")[0].interval_us == 20_000
    assert client.command(512, 244, mav.MAVLINK_MSG_ID_ATTITUDE) == R.ACCEPTED
    assert client.got("MESSAGE_INTERVAL")[0].interval_us == 20_000
    assert client.command(511, mav.MAVLINK_MSG_ID_ATTITUDE, -1) == R.ACCEPTED
    client.rx.clear()
    world.run(1.0)
    assert not client.got("ATTITUDE")
    assert client.command(510, mav.MAVLINK_MSG_ID_ATTITUDE) == R.ACCEPTED
    assert client.got("MESSAGE_INTERVAL")[0].interval_us == -1
    assert client.command(510, 12_345) == R.ACCEPTED
    assert client.got("MESSAGE_INTERVAL")[0].interval_us == 0
    assert client.command(511, mav.MAVLINK_MSG_ID_ATTITUDE, 0) == R.ACCEPTED
    client.rx.clear()
    world.run(1.0)
    assert len(client.got("ATTITUDE")) == 10


def test_prearm_checks(world: World, client: Client) -> None:
    assert client.command(401) == R.TEMPORARILY_REJECTED
    world.show(
        armed=False,
        arming_reasons=(
            ArmingReason("no position", HealthComponent.POSITION, ModeGroup.POSITION | ModeGroup.MISSION),
            ArmingReason("battery low", HealthComponent.BATTERY),
        ),
    )
    assert client.command(401) == R.ACCEPTED
    assert "no position" in client.texts() and "battery low" in client.texts()
    client.rx.clear()
    world.show(intended_mode=FlightMode.MANUAL)
    assert client.command(401) == R.ACCEPTED
    assert "no position" not in client.texts() and "battery low" in client.texts()
    world.show(arming_reasons=())
    assert client.command(401) == R.ACCEPTED
    assert "passed" in client.texts()


def test_diverged_estimates_do_not_break_commands(world: World, client: Client) -> None:
    world.show(nav=nav_state(pos_ned_m=np.array([math.inf, 0.0, 1e300])))
    assert client.command(192, -1, 1, 0, NAN, NAN, NAN, 10.0) == R.DENIED
    assert client.command(512, mav.MAVLINK_MSG_ID_ATTITUDE) == R.TEMPORARILY_REJECTED


@pytest.mark.parametrize(
    ("command", "way"),
    [(115, "DO_REPOSITION"), (195, "item"), (196, "item"), (197, "item"), (201, "item")],
)
def test_what_is_done_in_another_way_is_refused_with_that_way(
    world: World, client: Client, command: int, way: str
) -> None:
    assert client.command(command, 1, 0, 10, 1) == R.UNSUPPORTED
    assert way in client.texts()
    assert client.command_int(command, 5, (0, 0, 0, 0), 0, 0, 0.0) == R.UNSUPPORTED
    assert not world.vehicle.calls
