"""Camera against gyros: mounting rotation, time offset and gyro bias from how both saw the vehicle turn.

For frames i and j some tenths of a second apart the camera turned by d_cam = log(R_i^T R_j) in its own frame, the gyros
by d_frd, and (AX = XB, the hand-eye equation for rotations, Park and Martin 1994)

    M d_cam = d_frd(t_i - tau, t_j - tau) - b (t_j - t_i)

with the mounting M = R_frd_from_cam, the lateness tau of the pictures' stamps against the AHRS's, and the gyro bias b.
The unknown heading of the magnetic compass and the AHRS's slow tilt errors drop out.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from autopilot.calibrate.calibrate_tuning import MOTION_FIT
from autopilot.calibrate.gyro_path import GyroPath
from autopilot.calibrate.least_squares import covariance, huber_weights, robust_sigma, solve_weighted
from autopilot.calibrate.recorded_flight import CameraFlight
from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray

LEAST_SIGMA_S = 0.0005
"""Of the stamps: drivers jitter."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MotionFit:
    r_frd_from_cam: FloatArray
    """(3, 3)"""
    late_s: float
    """By how much the stamps of pictures are later than those of the AHRS for the same moment."""
    gyro_bias_rad_s: FloatArray
    """(3,)"""
    sigma_mounting_rad: FloatArray
    """(3,) standard deviations about the body's axes."""
    sigma_late_s: float
    residual_rad: FloatArray
    """(n, 3) of the increments, body frame."""
    turned_rad: FloatArray
    """(n, 3) increments that the gyros saw, bias taken off."""
    correlation: FloatArray
    """(m, 2) lateness [s] and correlation of the yaw rates, the scan that the fit began with."""


def fit_motion(flight: CameraFlight) -> MotionFit:
    """Mounting and lateness together. LogError if the vehicle hardly turned or pictures and AHRS do not overlap."""
    path = GyroPath(flight.ahrs, np.zeros(3))
    first, second = _pairs(flight.t_s)
    begin_s, end_s = flight.t_s[first], flight.t_s[second]
    good = path.covers(begin_s - MOTION_FIT.search_s, end_s + MOTION_FIT.search_s)
    first, second, begin_s, end_s = first[good], second[good], begin_s[good], end_s[good]
    if len(first) < MOTION_FIT.min_pairs:
        raise LogError(
            f"{len(first)} pairs of pictures with AHRS samples over their whole time, at least"
            f" {MOTION_FIT.min_pairs} are needed;"
            " fly longer with markers in view"
        )
    pose = Rotation.from_matrix(flight.r_ned_from_cam)
    seen_cam = (pose[first].inv() * pose[second]).as_rotvec()
    mounting = flight.camera.r_frd_from_cam
    span_s = (end_s - begin_s)[:, None]
    scan = _scan(path, begin_s, end_s, (seen_cam @ mounting.T)[:, 2] / span_s[:, 0])
    late_s = _peak(scan)
    bias = integrated = np.zeros(3)
    prior = np.array([MOTION_FIT.mounting_prior_rad**-2] * 3 + [MOTION_FIT.bias_prior_rad_s**-2] * 3 + [0.0])
    jacobian = np.zeros((len(first), 3, 7))
    for _ in range(MOTION_FIT.rounds):
        if float(np.abs(bias - integrated).max()) > MOTION_FIT.bias_moved_rad_s:
            path, integrated = GyroPath(flight.ahrs, bias), bias
        seen = seen_cam @ mounting.T
        turned = path.increments(begin_s - late_s, end_s - late_s)
        residual = turned - (bias - integrated) * span_s - seen
        later = path.increments(begin_s - late_s - MOTION_FIT.derivative_s, end_s - late_s - MOTION_FIT.derivative_s)
        earlier = path.increments(begin_s - late_s + MOTION_FIT.derivative_s, end_s - late_s + MOTION_FIT.derivative_s)
        # residual - J step: turning the mounting by theta adds theta x seen to what the camera saw.
        jacobian[:, :, :3] = -_cross_matrices(seen)
        jacobian[:, :, 3:6] = span_s[:, :, None] * np.eye(3)
        jacobian[:, :, 6] = -(later - earlier) / (2.0 * MOTION_FIT.derivative_s)
        weights = huber_weights(residual, robust_sigma(residual))
        step, inverse = solve_weighted(jacobian, residual, weights, prior)
        mounting = Rotation.from_rotvec(step[:3]).as_matrix() @ mounting
        bias = bias + step[3:6]
        late_s += float(np.clip(step[6], -0.02, 0.02))
        if float(np.abs(step).max()) < MOTION_FIT.converged:
            break
        if not abs(late_s) < MOTION_FIT.search_s:
            raise LogError(
                f"the lateness of the pictures is not between -{MOTION_FIT.search_s:g} and"
                f" {MOTION_FIT.search_s:g} s; check the log"
            )
    turned = GyroPath(flight.ahrs, bias).increments(begin_s - late_s, end_s - late_s)
    residual = turned - seen_cam @ mounting.T
    lags = 2 * round(MOTION_FIT.baseline_s / float(np.median(np.diff(flight.t_s))))
    sigma = MOTION_FIT.sigma_factor * np.sqrt(np.diag(covariance(jacobian, residual, weights, inverse, lags)))
    # The prior's share of the information does not come from the flight.
    held = prior * np.diag(inverse)
    sigma = np.where(held > 0.5, 1.0 / np.sqrt(np.maximum(prior, 1e-12)), sigma)
    return MotionFit(
        r_frd_from_cam=mounting,
        late_s=late_s,
        gyro_bias_rad_s=bias,
        sigma_mounting_rad=sigma[:3],
        sigma_late_s=float(sigma[6]),
        residual_rad=residual,
        turned_rad=turned,
        correlation=scan,
    )


def latency_values(flight: CameraFlight, fit: MotionFit) -> dict[str, float]:
    """The keys of ``[camera]``."""
    return {
        "camera.time_offset_s": round(flight.vehicle.eye.time_offset_s - fit.late_s, 5),
        "camera.time_offset_sigma_s": round(max(fit.sigma_late_s, LEAST_SIGMA_S), 5),
    }


def _pairs(t_s: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of frames that are about BASELINE_S apart."""
    second = np.searchsorted(t_s, t_s + MOTION_FIT.baseline_s)
    first = np.arange(len(t_s))
    inside = second < len(t_s)
    first, second = first[inside], second[inside]
    close = np.abs(t_s[second] - t_s[first] - MOTION_FIT.baseline_s) < MOTION_FIT.baseline_slack_s
    return first[close], second[close]


def _scan(path: GyroPath, begin_s: FloatArray, end_s: FloatArray, yaw_rate: FloatArray) -> FloatArray:
    """Correlation (m, 2) of the camera's yaw rate with the gyros' for each lateness."""
    if float(yaw_rate.std()) < MOTION_FIT.min_turn_rate_rad_s:
        raise LogError(
            f"the vehicle hardly turned (yaw rate {yaw_rate.std():.3f} rad/s rms,"
            f" {MOTION_FIT.min_turn_rate_rad_s:g} are needed);"
            " fly a mission that turns to and fro, or turn it by hand over the markers"
        )
    span_s = end_s - begin_s
    out = []
    for late_s in np.arange(
        -MOTION_FIT.search_s, MOTION_FIT.search_s + 0.5 * MOTION_FIT.search_step_s, MOTION_FIT.search_step_s
    ).tolist():
        gyro = path.increments(begin_s - late_s, end_s - late_s)[:, 2] / span_s
        out.append((late_s, float(np.corrcoef(gyro, yaw_rate)[0, 1])))
    return np.array(out)


def _peak(scan: FloatArray) -> float:
    """Location of the correlation's maximum, by a parabola through the three largest. LogError without a clear
    maximum.
    """
    n = int(np.argmax(scan[:, 1]))
    if not scan[n, 1] > 0.5:
        raise LogError(
            f"camera and gyros do not turn alike (correlation {scan[n, 1]:.2f}); check axes and mounting of"
            " camera and AHRS"
        )
    if n in (0, len(scan) - 1):
        raise LogError(
            f"the lateness of the pictures is not between -{MOTION_FIT.search_s:g} and"
            f" {MOTION_FIT.search_s:g} s; check the clocks"
        )
    low, mid, high = scan[n - 1 : n + 2, 1].tolist()
    beside: float = 0.5 * (low - high) / min(low - 2.0 * mid + high, -1e-15)
    return float(scan[n, 0]) + MOTION_FIT.search_step_s * beside


def _cross_matrices(vectors: FloatArray) -> FloatArray:
    """(n, 3, 3) matrices that make v x w of w."""
    out = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    out[:, 0, 1], out[:, 0, 2] = -z, y
    out[:, 1, 0], out[:, 1, 2] = z, -x
    out[:, 2, 0], out[:, 2, 1] = -y, x
    return out


def degrees(values: FloatArray) -> list[float]:
    """Radians as a list of degrees."""
    return [math.degrees(v) for v in values.tolist()]
