"""What single sensors say, and the messages that clients wait for."""

from typing import Any

import numpy as np
import pytest
from mavlink_harness import NAN, Client, World, mav, nav_state

from autopilot.core.messages import Failsafe, NavHealth
from autopilot.core.samples import AhrsSample, AltimeterSample, DepthSample, HullSample, LaserSample
from autopilot.core.sensed import Sensed, Vibration

BAUD_57600 = 5760.0


def ahrs(t_us: int, accel: Any = (0.1, -0.2, -9.81)) -> AhrsSample:
    return AhrsSample(
        t_us=t_us, rpy_rad=np.zeros(3), rate_frd_rad_s=np.array([0.01, 0.02, -0.03]), accel_frd_m_s2=np.array(accel)
    )


def sensed_all() -> Sensed:
    return Sensed(
        inertial=ahrs(10_000),
        newest={
            DepthSample: DepthSample(t_us=10_000, depth_m=2.0, sigma_m=0.01),
            LaserSample: LaserSample(t_us=10_000, range_m=0.8, sigma_m=0.02),
            HullSample: HullSample(t_us=10_000, pressure_pa=99_000.0, temperature_c=21.5),
        },
        power_w=50.0,
    )


@pytest.fixture(name="world")
def world_fixture() -> World:
    world = World()
    ahead = np.zeros((41, 8))
    ahead[:, 0] = np.linspace(-1.6, 1.0, 41)
    world.show(sensed=sensed_all(), energy_left_j=180_000.0, ahead=ahead)
    return world


def request(world: World, name: str) -> Any:
    """The message on request, None when there is nothing to say."""
    client = world.client()
    result = client.command(512, getattr(mav, f"MAVLINK_MSG_ID_{name}"))
    got = client.got(name)
    world.clients.remove(client)
    assert (result == 0) == bool(got) and result in (0, 1)
    return got[-1] if got else None


def test_sensors_are_told_in_the_units_of_the_messages(world: World) -> None:
    scaled, raw, fine = (request(world, name) for name in ("SCALED_IMU", "RAW_IMU", "HIGHRES_IMU"))
    assert (scaled.xacc, scaled.yacc, scaled.zacc) == (10, -20, -1000) == (raw.xacc, raw.yacc, raw.zacc)
    assert (scaled.xgyro, scaled.ygyro, scaled.zgyro) == (10, 20, -30)
    assert (fine.zacc, fine.zgyro) == (pytest.approx(-9.81), pytest.approx(-0.03)) and fine.fields_updated == 0x3F
    hull, water = request(world, "SCALED_PRESSURE"), request(world, "SCALED_PRESSURE2")
    assert (hull.press_abs, hull.temperature) == (pytest.approx(990.0), 2150)
    assert water.press_abs == pytest.approx(1013.25 + 196.13, abs=0.1)
    laser = request(world, "DISTANCE_SENSOR")
    assert (laser.current_distance, laser.orientation, laser.covariance) == (80, 25, 4)
    battery = request(world, "BATTERY_STATUS")
    assert battery.time_remaining == 3600
    path = request(world, "TRAJECTORY_REPRESENTATION_WAYPOINTS")
    assert path.valid_points == 5 and path.pos_x == pytest.approx([-1.6, -0.95, -0.3, 0.35, 1.0])


def test_an_odometry_is_the_estimate(world: World) -> None:
    message = request(world, "ODOMETRY")
    assert (message.x, message.y, message.z) == pytest.approx((-1.6, -0.35, 0.45))
    assert (message.vx, message.vy, message.vz) == pytest.approx((0.3, 0.0, 0.1))
    assert message.pose_covariance[0] == pytest.approx(1e-4) and np.linalg.norm(message.q) == pytest.approx(1.0)


def test_a_fix_stands_for_the_estimate(world: World) -> None:
    fix = request(world, "GPS_RAW_INT")
    assert (fix.fix_type, fix.satellites_visible, fix.eph, fix.epv) == (3, 255, 0xFFFF, 0xFFFF)
    assert (fix.h_acc, fix.v_acc) == (14, 10), "1 cm each way [mm]"
    world.show(nav=nav_state(health=NavHealth.DEAD_RECKONING))
    assert request(world, "GPS_RAW_INT").fix_type == 2
    for nav in (None, nav_state(health=NavHealth.INVALID), nav_state(pos_ned_m=np.array([NAN, 0, 0]))):
        world.show(nav=nav)
        found = request(world, "GPS_RAW_INT")
        assert (found.fix_type, found.lat, found.lon) == (1, 0, 0)


def test_what_is_not_there_or_is_old_is_not_told(world: World) -> None:
    names = ("SCALED_IMU", "SCALED_PRESSURE", "SCALED_PRESSURE2", "DISTANCE_SENSOR", "VIBRATION")
    for name in names:
        assert request(world, name) is not None
    world.run(4.0)
    for name in names:
        assert request(world, name) is None, name
    world.show(sensed=Sensed(), ahead=None, energy_left_j=None)
    for name in (*names, "TRAJECTORY_REPRESENTATION_WAYPOINTS"):
        assert request(world, name) is None, name
    assert request(world, "BATTERY_STATUS").time_remaining == 0


def test_breaches_of_the_fence_are_counted(world: World) -> None:
    assert request(world, "FENCE_STATUS").breach_status == 0
    for n in range(3):
        world.show(failsafes=1 << Failsafe.CAGE_SOFT)
        world.run(0.1)
        status = request(world, "FENCE_STATUS")
        assert (status.breach_status, status.breach_count, status.breach_type) == (1, n + 1, 3)
        world.show(failsafes=0)
        world.run(0.1)
    world.show(failsafes=1 << Failsafe.CAGE_HARD, nav=nav_state(pos_ned_m=np.array([0.0, 0.0, 9.0])))
    world.run(0.1)
    assert request(world, "FENCE_STATUS").breach_type == 1


def test_vibration_is_what_shakes_and_not_what_moves() -> None:
    shaken, turned = Vibration(), Vibration()
    for n in range(1000):
        shaken.note(np.array([2.0 * (-1) ** n, 0.0, -9.81]))
        turned.note(np.array([0.5 * np.sin(0.01 * n), 0.0, -9.81]))
    assert 1.5 < shaken.rms_m_s2[0] < 2.5 and shaken.rms_m_s2[2] < 1e-6
    assert turned.rms_m_s2[0] < 0.05
    before = shaken.rms_m_s2
    shaken.note(np.array([NAN, 1e308, -np.inf]))
    assert shaken.rms_m_s2 == before


def test_default_telemetry_fits_half_a_slow_serial_line(world: World, client: Client) -> None:
    world.run(10.0)
    sent = 0
    for _ in range(1000):
        world.view.sensed.inertial = ahrs(world.t_us)
        world.show(sensed=sensed_all())
        for sample in (world.view.sensed.inertial, *world.view.sensed.newest.values()):
            object.__setattr__(sample, "t_us", world.t_us)
        sent += sum(len(frame.data) for frame in world.tick())
    assert client.got("ODOMETRY") and client.got("DISTANCE_SENSOR")
    assert 2000.0 < sent / 10.0 < 0.7 * BAUD_57600, sent / 10.0


def test_an_altimeter_tells_the_height_before_the_laser_does(world: World) -> None:
    laser = request(world, "DISTANCE_SENSOR")
    assert (laser.type, laser.id, laser.current_distance) == (mav.MAV_DISTANCE_SENSOR_LASER, 0, 80)
    sample = AltimeterSample(t_us=world.t_us, range_m=12.34, sigma_m=0.06, confidence=0.9)
    world.view.sensed.newest[AltimeterSample] = sample
    sonar = request(world, "DISTANCE_SENSOR")
    assert (sonar.type, sonar.id, sonar.current_distance) == (mav.MAV_DISTANCE_SENSOR_ULTRASOUND, 1, 1234)
    assert sonar.orientation == mav.MAV_SENSOR_ROTATION_PITCH_270
