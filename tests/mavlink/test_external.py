"""External poses over MAVLink become samples: frames, covariances, times, and what is refused."""

import math
from typing import Any

import numpy as np
import pytest
from mavlink_harness import NAN, Client, World
from pymavlink.dialects.v20 import development as mav

from autopilot.core.samples import ExternalFrame, ExternalPoseSample

TRIANGLE = [float(k + 1) for k in range(21)]
"""1 to 21: the diagonal of x, y, z, yaw is 1, 7, 12, 21."""


def vision(usec: int = 0, covariance: list[float] | None = None, reset: int = 0, x: float = 1.0) -> Any:
    return mav.MAVLink_vision_position_estimate_message(
        usec, x, -2.0, 0.5, 0.01, -0.02, 0.75, TRIANGLE if covariance is None else covariance, reset
    )


def odometry(frame: int = mav.MAV_FRAME_LOCAL_NED, yaw: float = 0.5, quality: int = 0, scale: float = 1.0) -> Any:
    q = [scale * math.cos(0.5 * yaw), 0.0, 0.0, scale * math.sin(0.5 * yaw)]
    unknown = [NAN] + [0.0] * 20
    return mav.MAVLink_odometry_message(
        0, frame, mav.MAV_FRAME_BODY_FRD, 3.0, 4.0, 1.0, q, *(0.0,) * 6, unknown, unknown, 7, 0, quality
    )


def taken(world: World, *messages: Any, wait_s: float = 0.0) -> tuple[ExternalPoseSample, ...]:
    client = world.client(sysid=42, compid=197)
    world.run(wait_s)
    for message in messages:
        client.send(message)
    world.tick()
    return world.server.take_samples()


def test_vision_position_estimate(world: World) -> None:
    (sample,) = taken(world, vision(usec=1_950_000, reset=3), wait_s=2.0)
    assert sample.t_us == 1_950_000
    np.testing.assert_allclose(sample.pos_m, [1.0, -2.0, 0.5])
    assert sample.yaw_rad == pytest.approx(0.75)
    assert (sample.frame, sample.reset_counter) == (ExternalFrame.NED, 3)
    assert sample.covariance is not None
    np.testing.assert_allclose(sample.covariance.diagonal(), [1.0, 7.0, 12.0, 21.0])
    np.testing.assert_allclose(sample.covariance, sample.covariance.T)
    assert sample.covariance[0, 3] == TRIANGLE[5]
    assert world.server.take_samples() == ()


def test_odometry_with_unknown_covariance() -> None:
    for scale in (1.0, 2.0):
        (sample,) = taken(World(), odometry(mav.MAV_FRAME_LOCAL_FRD, scale=scale))
        assert sample.covariance is None
        assert sample.yaw_rad == pytest.approx(0.5, abs=1e-6)
        assert (sample.frame, sample.reset_counter) == (ExternalFrame.FRD, 7)


def test_stamps_of_another_clock_count_from_arrival(world: World) -> None:
    world.params.set("EST_EXT_DELAY", 0.08)
    unix_us = 1_700_000_000_000_000
    (sample,) = taken(world, vision(usec=unix_us), wait_s=2.0)
    assert sample.t_us == world.t_us - 80_000
    # Once the ground station has told the time, a Unix stamp is exact.
    client = world.client()
    client.send(mav.MAVLink_system_time_message(unix_us, 0))
    world.tick()
    told_us = world.t_us
    (sample,) = taken(world, vision(usec=unix_us - 30_000))
    assert sample.t_us == told_us - 30_000


def test_what_is_not_used(world: World) -> None:
    listener = world.client()
    assert taken(world, odometry(mav.MAV_FRAME_LOCAL_ENU), odometry(mav.MAV_FRAME_LOCAL_ENU)) == ()
    assert taken(world, odometry(quality=-1)) == ()
    texts = [message.text for message in listener.rx if message.get_type() == "STATUSTEXT"]
    assert sum("ODOMETRY in frame 4" in text for text in texts) == 1


@pytest.mark.parametrize(("sysid", "whose"), [(51, "50/197"), (50, "another one")])
def test_of_two_senders_one_is_used_and_the_other_told_until_the_first_is_silent(
    world: World, sysid: int, whose: str
) -> None:
    """They measure in frames of their own and count resets of their own, also two that are set up alike."""
    first, second = world.client(sysid=50, compid=197), world.client(sysid=sysid, compid=197, number=1)

    def used() -> list[float]:
        first.send(vision(x=1.0))
        second.send(vision(x=2.0))
        world.tick()
        return [float(sample.pos_m[0]) for sample in world.server.take_samples()]

    assert [used() for _ in range(50)] == [[1.0]] * 50
    texts = [message.text for message in second.rx if message.get_type() == "STATUSTEXT"]
    assert texts == [f"Poses of {sysid}/197 not used: {whose} sends some"]
    world.run(2.1)
    second.send(vision(x=2.0))
    world.tick()
    (sample,) = world.server.take_samples()
    assert sample.pos_m[0] == 2.0
    assert used() == [2.0], "whose turn it is now"


def test_bad_numbers_are_passed_on_for_the_estimator_to_count() -> None:
    nothing = mav.MAVLink_odometry_message(
        0, mav.MAV_FRAME_LOCAL_NED, 12, NAN, 4.0, 1.0, [0.0] * 4, *(0.0,) * 6, TRIANGLE, TRIANGLE, 7, 0, 0
    )
    (sample,) = taken(World(), nothing)
    assert math.isnan(sample.pos_m[0]) and math.isnan(sample.yaw_rad)


def test_health_and_test_ratios_are_shown(world: World, client: Client) -> None:
    """SYS_STATUS carries the estimator's error counts, ESTIMATOR_STATUS its test ratios."""
    world.show(
        aid_ratio={"markers": 0.5, "heading": 0.25, "velocity": 2.0, "laser": 0.125}, nav_errors=(1, 2, 3, 70_000)
    )
    world.run(1.5)
    status = [m for m in client.rx if m.get_type() == "SYS_STATUS"][-1]
    assert [getattr(status, f"errors_count{k}") for k in range(1, 5)] == [1, 2, 3, 0xFFFF]
    assert status.onboard_control_sensors_health & mav.MAV_SYS_STATUS_AHRS
    estimator = [m for m in client.rx if m.get_type() == "ESTIMATOR_STATUS"][-1]
    assert (estimator.vel_ratio, estimator.pos_horiz_ratio, estimator.pos_vert_ratio) == (2.0, 0.5, 0.5)
    assert (estimator.mag_ratio, estimator.hagl_ratio, estimator.tas_ratio) == (0.25, 0.125, 0.0)
    world.show(failsafes=1 << 3 | 1 << 6)
    world.run(1.5)
    status = [m for m in client.rx if m.get_type() == "SYS_STATUS"][-1]
    lost = mav.MAV_SYS_STATUS_AHRS | mav.MAV_SYS_STATUS_SENSOR_VISION_POSITION
    assert status.onboard_control_sensors_health & lost == 0


def test_of_poses_that_come_at_once_with_stamps_of_nobody_the_last_is_of_now(world: World) -> None:
    """After a pause of the loop or of the network: the others are older, and nobody knows by how much."""
    world.run(2.0)
    told = [mav.MAVLink_vision_position_estimate_message(0, x, 0.0, 0.5, 0.0, 0.0, 0.0, TRIANGLE, 0) for x in (1, 2, 3)]
    (sample,) = taken(world, *told)
    assert sample.pos_m[0] == 3.0
    # Stamps of our clock say when: all of them count.
    now_us = world.t_us
    stamped = [vision(usec=now_us - late) for late in (50_000, 40_000, 30_000)]
    assert [sample.t_us for sample in taken(world, *stamped)] == [now_us - late for late in (50_000, 40_000, 30_000)]
