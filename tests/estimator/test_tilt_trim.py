"""The trim tells the AHRS's changing error from the camera's constant mounting."""

from dataclasses import replace

import numpy as np
import pytest

from autopilot.core.samples import AhrsSample
from autopilot.estimator.inertial import level
from autopilot.estimator.tilt import TiltTrim

EVERY_US = 33_333
MOUNTING_RAD = 0.0175
G_M_S2 = 9.81


def ahrs(t_us: int, pitch_rad: float) -> AhrsSample:
    return AhrsSample(
        t_us=t_us,
        rpy_rad=np.array([0.0, pitch_rad, 0.0]),
        rate_frd_rad_s=np.zeros(3),
        accel_frd_m_s2=np.array([0.0, 0.0, -G_M_S2]),
    )


def watched(trim: TiltTrim, start_us: int, seconds: float, ahrs_rad: float, mounting_rad: float) -> int:
    """Fixes of a level vehicle, as the trim learns from them; the time of the last."""
    t_us = start_us
    for _ in range(round(30.0 * seconds)):
        t_us += EVERY_US
        trim.learn(level(ahrs(t_us, ahrs_rad), (0.0, 0.0)), 0.0, -mounting_rad, 0.002, t_us)
    return t_us


def test_an_error_that_comes_in_flight_is_the_ahrs_s() -> None:
    trim = TiltTrim(MOUNTING_RAD)
    t_us = watched(trim, 0, 20.0, 0.0, 0.0)
    t_us = watched(trim, t_us, 3.0, 0.012, 0.0)
    assert trim.at(ahrs(t_us, 0.012))[1] == pytest.approx(0.012, abs=0.004)


def test_an_error_that_stays_is_the_mounting_s_and_reported_whole() -> None:
    trim = TiltTrim(MOUNTING_RAD)
    t_us = watched(trim, 0, 120.0, 0.0, 0.015)
    assert abs(trim.at(ahrs(t_us, 0.0))[1]) < 0.004
    assert trim.difference_rad == pytest.approx(0.015, abs=0.001)


def test_with_an_exact_mounting_every_error_is_the_ahrs_s() -> None:
    trim = TiltTrim(0.0)
    t_us = watched(trim, 0, 3.0, 0.012, 0.0)
    assert trim.at(ahrs(t_us, 0.012))[1] == pytest.approx(0.012, abs=0.001)


def test_without_fixes_it_decays_and_is_not_fresh() -> None:
    trim = TiltTrim(0.0)
    t_us = watched(trim, 0, 3.0, 0.012, 0.0)
    later_us = t_us + 20_000_000
    assert trim.fresh(t_us) and not trim.fresh(later_us)
    assert trim.at(ahrs(later_us, 0.0))[1] == pytest.approx(0.012 * np.exp(-1.0), abs=0.001)


@pytest.mark.parametrize("late_s", [-0.02, 0.0, 0.02])
def test_stamps_that_are_off_while_it_swings_are_not_the_ahrs_s_error(late_s: float) -> None:
    """A hull that swings by 0.2 rad; pictures come between two samples of the AHRS."""
    trim, worst_rad = TiltTrim(0.0), 0.0
    swing_rad, per_s, stamp_sigma_s = 0.2, 2.5, 0.01

    def pitch(t_s: float) -> float:
        return float(swing_rad * np.sin(per_s * t_s))

    for k in range(1, 300):
        ahrs_us = 10_000 * (EVERY_US * k // 10_000)
        t_s, rate = 1e-6 * EVERY_US * k, swing_rad * per_s * np.cos(per_s * 1e-6 * ahrs_us)
        sample = replace(ahrs(ahrs_us, pitch(1e-6 * ahrs_us)), rate_frd_rad_s=np.array([0.0, rate, 0.0]))
        trim.learn(level(sample, (0.0, 0.0)), 0.0, pitch(t_s - late_s), 0.002, EVERY_US * k, stamp_sigma_s)
        worst_rad = max(worst_rad, abs(trim.at(sample)[1]))
    assert worst_rad < (0.0003 if late_s == 0.0 else 0.005), "of 0.01 that the stamp makes of the swing"
