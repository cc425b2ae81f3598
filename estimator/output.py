"""From the filter state to the published estimate."""

import math

import numpy as np

from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import NavDoubt, NavHealth, NavState
from autopilot.estimator.filter_core import FilterCore
from autopilot.estimator.history import Node
from autopilot.estimator.inertial import ProcessNoiseMode, hold
from autopilot.estimator.motion import moved
from autopilot.estimator.options import EstimatorOptions
from autopilot.estimator.tilt import AHRS_SIGMA_RAD

TILT_VARIANCE_RAD2 = {
    ProcessNoiseMode.NOMINAL: AHRS_SIGMA_RAD**2,
    ProcessNoiseMode.COASTING: AHRS_SIGMA_RAD**2,
    ProcessNoiseMode.TRIMMED: math.radians(0.1) ** 2,
    ProcessNoiseMode.BLIND: math.radians(5.0) ** 2,
    ProcessNoiseMode.MODEL: math.radians(5.0) ** 2,
    ProcessNoiseMode.COMPASS: AHRS_SIGMA_RAD**2,
    ProcessNoiseMode.MODEL_COMPASS: math.radians(5.0) ** 2,
}
"""Roll and pitch: of the AHRS, trimmed by vision, or without AHRS level as the righting moment keeps the vehicle. An
accelerometer that is not believed may be right, and the tilt wrong."""
_TILT_VARIANCE_RAD2 = tuple(TILT_VARIANCE_RAD2[mode] for mode in sorted(ProcessNoiseMode))

LEAST_LESS = -0.9
"""What is known beyond the filter takes at most this share off its variances."""


def nav_state(
    core: FilterCore,
    node: Node,
    t_us: int,
    health: NavHealth,
    resets: int,
    more: FloatArray,
    doubts: frozenset[NavDoubt],
    mounting_rad2: float = 0.0,
) -> NavState:
    """The newest node carried on to ``t_us`` with the last rates.

    ``more`` (4,): variance of north, east, down and yaw beyond the filter's, or less than that. ``mounting_rad2``: how
    uncertain the tilt of the camera is that trims roll and pitch."""
    inertial = node.moment.inertial
    after_s = 1e-6 * (t_us - node.t_us)
    x = node.state.x.tolist() if after_s <= 0.0 else moved(node.state.x, hold(inertial, t_us, ProcessNoiseMode.NOMINAL))
    n, e, d, yaw, vn, ve, vd, gyro_bias, _, _, _, cn, ce, _, _, _, _, _, cd, _, _ = x
    p, q, r = inertial.rate_frd_rad_s.tolist()
    roll, pitch = inertial.roll_rad + p * after_s, inertial.pitch_rad + q * after_s
    sr, cr, sp, cp, sy, cy = (
        math.sin(roll),
        math.cos(roll),
        math.sin(pitch),
        math.cos(pitch),
        math.sin(yaw),
        math.cos(yaw),
    )

    def body(north: float, east: float, down: float) -> list[float]:
        """R' v for the rotation z-y-x."""
        forward, right = cy * north + sy * east, cy * east - sy * north
        below = sp * forward + cp * down
        return [cp * forward - sp * down, cr * right + sr * below, cr * below - sr * right]

    pn, pe, pd, pyaw, pu, pv, pw, pcn, pce, pcd = core.variance(node.state, cy, sy)
    more_n, more_e, more_d, more_yaw = more.tolist()
    pn += max(more_n, LEAST_LESS * pn)
    pe += max(more_e, LEAST_LESS * pe)
    pd += max(more_d, LEAST_LESS * pd)
    pyaw += max(more_yaw, LEAST_LESS * pyaw)
    mode = node.step.mode if node.step is not None else ProcessNoiseMode.NOMINAL
    tilt = _TILT_VARIANCE_RAD2[mode] + (mounting_rad2 if mode is ProcessNoiseMode.TRIMMED else 0.0)
    # One array and parts of it: seven arrays would take three times as long.
    place, velocities = [n, e, d, roll, pitch, wrap_pi(yaw)], body(vn, ve, vd) + body(vn - cn, ve - ce, vd - cd)
    variances = [pn, pe, pd, tilt, tilt, pyaw, pu, pv, pw, pcn, pce, pcd]
    numbers = np.array([*place, *velocities, p, q, r - gyro_bias, cn, ce, cd, *variances])
    return NavState(
        t_us=t_us,
        health=health,
        pos_ned_m=numbers[0:3],
        rpy_rad=numbers[3:6],
        vel_frd_m_s=numbers[6:9],
        vel_water_frd_m_s=numbers[9:12],
        rate_frd_rad_s=numbers[12:15],
        current_ned_m_s=numbers[15:18],
        variance=numbers[18:],
        reset_count=resets,
        doubts=doubts,
    )


def judge_health(
    node: Node,
    core: FilterCore,
    fix_age_us: int,
    options: EstimatorOptions,
    *,
    usual_us: int,
    tracked: bool,
    blind: bool,
    doubted: bool,
) -> NavHealth:
    """Good, dead reckoning (no fix or no AHRS for a while), or invalid.

    ``usual_us``: a fix of this age is none too late for the source. ``tracked``: the velocity over ground is being
    measured, so that only the growing variance ends the reckoning. ``blind``: no AHRS sample has come for a while.
    ``doubted``: the evidence is against the estimate, or against a sensor that it now lives on."""
    age_s = 1e-6 * fix_age_us
    timed_out = age_s > options.invalid_after_s and not tracked
    if timed_out or core.planar_variance(node.state) > options.sigma_limit_m**2:
        return NavHealth.INVALID
    if doubted or age_s > max(options.dead_reckoning_after_s, 1e-6 * usual_us) or blind:
        return NavHealth.DEAD_RECKONING
    return NavHealth.GOOD
