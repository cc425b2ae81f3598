"""Obstacles that others tell of: their positions, and a sensor's beams."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from mavlink_harness import ORIGIN, World, mav, nav_state

from autopilot.command.environment import Environment
from autopilot.core.geodesy import e7_from_deg, place_from_ned
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.params import ParamSet
from autopilot.core.samples import ObstacleTrack
from autopilot.core.vehicle import load_vehicle

HERE = np.array([-1.6, -0.35, 0.45])


def seen(world: World, message: Any, **client: Any) -> list[ObstacleTrack]:
    """What becomes of a message of system 2."""
    world.client(**{"sysid": 2, "compid": 1, **client}).send(message)
    world.tick()
    return list(world.server.take_tracks()[0])


def position(north: float, east: float, down: float, *, vx: int = 0, vy: int = 0) -> Any:
    """GLOBAL_POSITION_INT of a place."""
    place = place_from_ned(ORIGIN, north, east, down)
    assert place is not None
    lat, lon, alt = e7_from_deg(place.lat_deg), e7_from_deg(place.lon_deg), round(1e3 * place.alt_m)
    return mav.MAVLink_global_position_int_message(0, lat, lon, alt, round(-1e3 * down), vx, vy, 0, 0)


def test_other_vehicles_are_tracks_where_they_are(world: World) -> None:
    (track,) = seen(world, position(1.0, 0.5, 0.3, vx=30, vy=-10))
    assert track.pos_ned_m == pytest.approx([1.0, 0.5], abs=0.012)
    assert track.vel_ned_m_s == pytest.approx([0.3, -0.1])
    assert track.radius_m == pytest.approx(world.params["AVD_RADIUS"])
    (again,) = seen(world, position(1.1, 0.5, 0.3))
    assert again.track_id == track.track_id
    (third,) = seen(world, position(1.1, 0.5, 0.3), sysid=3)
    assert third.track_id != track.track_id


@pytest.mark.parametrize(
    ("message", "client"),
    [
        (position(1.0, 0.5, 8.0), {}),
        (position(700.0, 0.5, 0.3), {}),
        (position(1.0, 0.5, 0.3), {"sysid": 1}),
        (position(1.0, 0.5, 0.3), {"compid": 191}),
        (mav.MAVLink_global_position_int_message(0, 0, 0, 0, 0, 0, 0, 0, 0), {}),
    ],
    ids=["far below", "far away", "own echo", "not a vehicle", "no position"],
)
def test_what_is_no_concern_is_no_track(message: Any, client: dict[str, int]) -> None:
    assert seen(World(), message, **client) == []


def test_avoiding_others_can_be_turned_off_and_waits_for_a_position(world: World) -> None:
    world.show(nav=None)
    assert seen(world, position(1.0, 0.5, 0.3)) == []
    world.show(nav=nav_state())
    world.params.set("AVD_RADIUS", 0.0)
    assert seen(world, position(1.0, 0.5, 0.3)) == []


def adsb(place: Any, **changes: Any) -> Any:
    values = {
        "ICAO_address": 77,
        "lat": place.lat,
        "lon": place.lon,
        "altitude_type": 0,
        "altitude": place.alt,
        "heading": 9000,
        "hor_velocity": 40,
        "ver_velocity": 0,
        "callsign": b"AUV",
        "emitter_type": 0,
        "tslc": 1,
        "flags": 15,
        "squawk": 0,
    }
    return mav.MAVLink_adsb_vehicle_message(**{**values, **changes})


def test_adsb_and_ais_are_tracks_too(world: World) -> None:
    world.run(3.0)
    (track,) = seen(world, adsb(position(1.0, 0.5, 0.3)))
    assert track.vel_ned_m_s == pytest.approx([0.0, 0.4], abs=1e-9) and track.t_us == world.t_us - 1_000_000
    assert seen(world, adsb(position(1.0, 0.5, -300.0))) == [], "an aircraft"
    assert len(seen(world, adsb(position(1.0, 0.5, -300.0), flags=13))) == 1, "of unknown height"
    assert seen(world, adsb(position(1.0, 0.5, 0.3), flags=14)) == [], "without a place"
    at = position(50.0, 10.0, 0.0)
    ship = mav.MAVLink_ais_vessel_message(
        123456789, at.lat, at.lon, 9000, 9000, 500, 0, 70, 0, 30, 10, 5, 5, b"SHIP", b"SHIP", 0, 0
    )
    (track,) = seen(world, ship)
    assert track.radius_m == pytest.approx(0.5 * math.hypot(40.0, 10.0)) and track.vel_ned_m_s[1] == pytest.approx(5.0)
    world.show(nav=nav_state(pos_ned_m=np.array([0.0, 0.0, 40.0])))
    assert seen(world, ship) == [], "it is far above"


def beams(center: tuple[float, float], radius_m: float, *, frame: int, yaw: float) -> Any:
    """OBSTACLE_DISTANCE of 72 beams of 5 degrees round HERE, which meet one cylinder or nothing."""
    distances = []
    for n in range(72):
        angle = math.radians(5 * n) + (yaw if frame == mav.MAV_FRAME_BODY_FRD else 0.0)
        off = complex(center[0] - HERE[0], center[1] - HERE[1]) * complex(math.cos(angle), -math.sin(angle))
        hits = off.real > 0 and abs(off.imag) < radius_m
        distances.append(round(100 * (off.real - math.sqrt(radius_m**2 - off.imag**2))) if hits else 801)
    return mav.MAVLink_obstacle_distance_message(0, 0, distances, 5, 20, 800, 0.0, 0.0, frame)


@pytest.mark.parametrize("frame", [mav.MAV_FRAME_BODY_FRD, mav.MAV_FRAME_GLOBAL])
def test_beams_become_cylinders_until_a_beam_goes_through(world: World, frame: int) -> None:
    yaw = math.pi / 2
    (track,) = seen(world, beams((0.4, 0.3), 0.3, frame=frame, yaw=yaw))
    assert math.hypot(track.pos_ned_m[0] - 0.4, track.pos_ned_m[1] - 0.3) < 0.35
    assert 0.1 <= track.radius_m < 0.6 and not track.vel_ned_m_s.any()
    (again,) = seen(world, beams((0.45, 0.3), 0.3, frame=frame, yaw=yaw))
    assert again.track_id == track.track_id
    world.client(sysid=2, compid=1).send(beams((40.0, 0.3), 0.3, frame=frame, yaw=yaw))
    world.tick()
    assert world.server.take_tracks() == ((), (track.track_id,))


def test_a_companion_of_our_own_system_may_tell_of_obstacles() -> None:
    message = beams((0.4, 0.3), 0.3, frame=mav.MAV_FRAME_BODY_FRD, yaw=math.pi / 2)
    assert len(seen(World(), message, sysid=1, compid=196)) == 1


def test_what_beams_see_of_the_fence_is_known() -> None:
    walls = np.array([[-2.5, -1.5], [2.5, -1.5], [2.5, 1.5], [-2.5, 1.5]])
    fence = Fence(
        inclusions=(Polygon(vertices_ned_m=walls),),
        exclusions=(Circle(center_ned_m=np.array([0.94, 0.0]), radius_m=0.16),),
    )
    environment = Environment(load_vehicle("lbv150"), ParamSet())
    places = {1: (0.8, 0.05), 2: (2.5, 0.3), 3: (0.0, 0.7), 4: (0.2, -1.45)}
    tracks = [
        ObstacleTrack(t_us=0, track_id=(4 << 28) + n, pos_ned_m=np.array(at), vel_ned_m_s=np.zeros(2), radius_m=0.1)
        for n, at in places.items()
    ]
    vehicle = ObstacleTrack(
        t_us=0, track_id=(1 << 28) + 2, pos_ned_m=np.array([2.4, 0.0]), vel_ned_m_s=np.zeros(2), radius_m=0.3
    )
    environment.note_others(0, [*tracks, vehicle], (), fence)
    assert [t.track_id for t in environment.tracks.at(0)] == [vehicle.track_id, (4 << 28) + 3]
    environment.note_others(0, (), ((4 << 28) + 3,), fence)
    assert [t.track_id for t in environment.tracks.at(0)] == [vehicle.track_id]
