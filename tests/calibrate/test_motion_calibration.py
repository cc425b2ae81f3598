"""Mounting, lever arm and lateness from made-up flights with known errors."""

import numpy as np
import pytest
from flights import Motion, make_flight

from autopilot.calibrate.extrinsics import check_attitude, extrinsic_values, fit_lever_arm, mounting_rpy_rad
from autopilot.calibrate.gyro_path import GyroPath
from autopilot.calibrate.motion_fit import fit_motion
from autopilot.core.errors import LogError

MOUNTING = (0.02, -0.03, 0.05)
ARM_M = (0.03, -0.02, 0.12)


def test_errors_come_back_within_their_sigmas() -> None:
    flight = make_flight(Motion(), mounting_rpy=MOUNTING, late_s=0.0237, arm_m=ARM_M, duration_s=40.0)
    fit = fit_motion(flight)
    assert abs(fit.late_s - 0.0237) < min(3.0 * fit.sigma_late_s, 0.001)
    off = mounting_rpy_rad(fit.r_frd_from_cam) - MOUNTING
    assert (np.abs(off) < 3.0 * fit.sigma_mounting_rad).all()
    assert fit.sigma_mounting_rad.max() < 0.002
    assert np.abs(fit.gyro_bias_rad_s - [0.004, 0.008, -0.01]).max() < 5e-4
    arm = fit_lever_arm(flight, fit)
    assert arm is not None
    assert arm.observable.all()
    assert (np.abs(arm.arm_frd_m - ARM_M) < 3.0 * arm.sigma_m).all()
    assert np.abs(arm.accel_bias_m_s2 - [0.05, -0.04, 0.02]).max() < 0.02
    attitude = check_attitude(flight, fit)
    assert attitude.mean_rad == pytest.approx([0.004, -0.003, 0.2], abs=0.004)
    values = extrinsic_values(flight, fit, arm)
    assert values["camera.mounting_rpy_rad"] == pytest.approx(MOUNTING, abs=0.004)
    assert values["camera.position_frd_m"] == pytest.approx(ARM_M, abs=0.01)


def test_without_noise_it_is_exact() -> None:
    flight = make_flight(Motion(), mounting_rpy=MOUNTING, late_s=-0.051, arm_m=ARM_M, noise=0.0, duration_s=12.0)
    fit = fit_motion(flight)
    assert fit.late_s == pytest.approx(-0.051, abs=2e-5)
    np.testing.assert_allclose(mounting_rpy_rad(fit.r_frd_from_cam), MOUNTING, atol=1e-4)
    arm = fit_lever_arm(flight, fit)
    assert arm is not None
    np.testing.assert_allclose(arm.arm_frd_m, ARM_M, atol=5e-4)


def test_the_correlation_alone_is_near() -> None:
    fit = fit_motion(make_flight(Motion(), late_s=0.08, duration_s=12.0))
    late_s, correlation = fit.correlation[fit.correlation[:, 1].argmax()]
    assert late_s == pytest.approx(0.08, abs=0.011)
    assert correlation > 0.99


def test_what_the_flight_does_not_show_is_said_and_kept() -> None:
    flight = make_flight(Motion(tilt=0.0), mounting_rpy=MOUNTING, duration_s=20.0)
    fit = fit_motion(flight)
    assert fit.sigma_mounting_rad[2] > 0.03, "yaw of the mounting shows only when the vehicle rolls or pitches"
    assert fit.sigma_mounting_rad[:2].max() < 0.01
    with pytest.raises(LogError, match=r"mounting yaw is known to .* turn it about at least two axes"):
        extrinsic_values(flight, fit, None)
    arm = fit_lever_arm(flight, fit)
    assert arm is not None
    assert not arm.observable[2]


def test_a_flight_without_turns_or_overlap_is_refused() -> None:
    with pytest.raises(LogError, match="hardly turned"):
        fit_motion(make_flight(Motion(yaw=0.0, tilt=0.01), duration_s=12.0))
    flight = make_flight(Motion(), duration_s=12.0)
    object.__setattr__(flight, "t_s", flight.t_s + 100.0)
    with pytest.raises(LogError, match="fly longer"):
        fit_motion(flight)
    other = make_flight(Motion(), duration_s=12.0)
    object.__setattr__(other, "r_ned_from_cam", make_flight(Motion(), duration_s=12.0, late_s=0.0).r_ned_from_cam[::-1])
    with pytest.raises(LogError, match=r"do not turn alike|is not between"):
        fit_motion(other)


def test_the_gyro_path_knows_its_gaps() -> None:
    ahrs = make_flight(Motion(), duration_s=5.0).ahrs
    keep = (ahrs.t_s < 2.0) | (ahrs.t_s > 2.5)
    gap = type(ahrs)(
        t_s=ahrs.t_s[keep],
        rpy_rad=ahrs.rpy_rad[keep],
        rate_frd_rad_s=ahrs.rate_frd_rad_s[keep],
        accel_frd_m_s2=ahrs.accel_frd_m_s2[keep],
    )
    path = GyroPath(gap, np.zeros(3))
    begin, end = np.array([0.0, 1.8, 2.6, -3.0]), np.array([1.0, 2.7, 3.0, 1.0])
    assert path.covers(begin, end).tolist() == [True, False, True, False]
