"""Camera extrinsics: rotation against the AHRS (:mod:`autopilot.calibrate.motion_fit`), heading offset of the
AHRS, and the lever arm between the two from their accelerations.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from autopilot.calibrate.calibrate_tuning import EXTRINSICS, MOTION_FIT
from autopilot.calibrate.gyro_path import GyroPath
from autopilot.calibrate.least_squares import covariance, huber_weights, robust_sigma, solve_weighted
from autopilot.calibrate.motion_fit import MotionFit
from autopilot.calibrate.recorded_flight import CameraFlight
from autopilot.core.camera import R_FRD_FROM_CAM
from autopilot.core.errors import LogError
from autopilot.core.frames import FloatArray, rpy_from_r

GRAVITY_NED_M_S2 = np.array([0.0, 0.0, 9.81])
MAX_SIGMA_MOUNTING_RAD = math.radians(1.0)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AttitudeCheck:
    """AHRS attitude minus camera attitude with the new mounting, (3,) roll, pitch, yaw."""

    mean_rad: FloatArray
    """Yaw: the heading offset of the AHRS."""
    spread_rad: FloatArray
    """Standard deviations from picture to picture."""
    sigma_mean_rad: FloatArray
    """Standard deviations of the means: slow errors count once in twice their time."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LeverArm:
    arm_frd_m: FloatArray
    """(3,) camera minus AHRS, body frame."""
    sigma_m: FloatArray
    """(3,)"""
    accel_bias_m_s2: FloatArray
    """(3,) body frame."""

    @property
    def observable(self) -> np.ndarray:
        """(3,) which components are known well enough."""
        return self.sigma_m < EXTRINSICS.max_sigma_arm_m


def mounting_rpy_rad(r_frd_from_cam: FloatArray) -> FloatArray:
    """(3,) roll, pitch, yaw of FRD from the camera axes, as ``camera.mounting_rpy_rad``."""
    return rpy_from_r(r_frd_from_cam @ R_FRD_FROM_CAM.T)


def check_attitude(flight: CameraFlight, fit: MotionFit) -> AttitudeCheck:
    """Compare the attitudes themselves, which the fit did not use."""
    t_s = flight.t_s - fit.late_s
    ahrs = flight.ahrs
    inside = (t_s >= ahrs.t_s[0]) & (t_s <= ahrs.t_s[-1])
    t_s = t_s[inside]
    rpy = np.column_stack([np.interp(t_s, ahrs.t_s, np.unwrap(column)) for column in ahrs.rpy_rad.T])
    seen = Rotation.from_matrix(flight.r_ned_from_cam[inside] @ fit.r_frd_from_cam.T)
    yaw, pitch, roll = seen.as_euler("ZYX").T
    off = rpy - np.column_stack((roll, pitch, yaw))
    # The mean of an angle that may turn: about its circular mean.
    middle = np.arctan2(np.sin(off).mean(axis=0), np.cos(off).mean(axis=0))
    off = (off - middle + math.pi) % (2.0 * math.pi) - math.pi
    spread = off.std(axis=0)
    draws = max(1.0, float(t_s[-1] - t_s[0]) / (2.0 * EXTRINSICS.ahrs_error_time_s))
    sigma = np.sqrt(spread**2 / draws + fit.sigma_mounting_rad**2)
    return AttitudeCheck(mean_rad=middle + off.mean(axis=0), spread_rad=spread, sigma_mean_rad=sigma)


def fit_lever_arm(flight: CameraFlight, fit: MotionFit) -> LeverArm | None:
    """The lever arm by linear least squares, None if the pictures are too sparse.

    Over two hops from t0 by t1 to t2 the camera's places give the combination
    D = (p2 - p0) (t1 - t0) - (p1 - p0) (t2 - t0), from which the speed at t0 drops out. The same combination of the
    AHRS's path is an integral of its specific force, and the two differ by the lever arm, turned as the vehicle turned.
    """
    path = GyroPath(flight.ahrs, fit.gyro_bias_rad_s)
    t_s = flight.t_s
    hops = np.searchsorted(t_s, np.stack((t_s, t_s + EXTRINSICS.hop_s, t_s + 2.0 * EXTRINSICS.hop_s)))
    hops = hops[:, (hops < len(t_s)).all(axis=0)]
    when = t_s[hops]
    regular = (np.abs(np.diff(when, axis=0) - EXTRINSICS.hop_s) < 0.25 * EXTRINSICS.hop_s).all(axis=0)
    regular &= path.covers(when[0] - fit.late_s - 0.1, when[2] - fit.late_s + 0.1)
    hops, when = hops[:, regular], when[:, regular]
    if hops.shape[1] < 50:
        return None
    r_ned = flight.r_ned_from_cam @ fit.r_frd_from_cam.T
    places = flight.eye_ned_m[hops]
    first_s, whole_s = (when[1] - when[0])[:, None], (when[2] - when[0])[:, None]
    scale = first_s * whole_s
    force, bias_part = _double_integrals(flight, path, fit, r_ned[hops[0]], when)
    by_force = force[0] * first_s - force[1] * whole_s
    by_bias = bias_part[0] * first_s[:, :, None] - bias_part[1] * whole_s[:, :, None]
    seen = (places[2] - places[0]) * first_s - (places[1] - places[0]) * whole_s
    turn = (r_ned[hops[2]] - r_ned[hops[0]]) * first_s[:, :, None]
    turn -= (r_ned[hops[1]] - r_ned[hops[0]]) * whole_s[:, :, None]
    jacobian = np.concatenate((turn, -by_bias), axis=2) / scale[:, :, None]
    target = (seen - by_force) / scale
    start = flight.camera.position_frd_m - np.array(flight.vehicle.ahrs.position_frd_m)
    x = np.concatenate((start, np.zeros(3)))
    prior = np.array([EXTRINSICS.arm_prior_m**-2] * 3 + [EXTRINSICS.accel_bias_prior_m_s2**-2] * 3)
    for _ in range(EXTRINSICS.rounds):
        residual = target - jacobian @ x
        weights = huber_weights(residual, robust_sigma(residual))
        step, inverse = solve_weighted(jacobian, residual, weights, prior)
        x = x + step
    lags = round(3.0 * EXTRINSICS.hop_s / float(np.median(np.diff(t_s))))
    sigma = MOTION_FIT.sigma_factor * np.sqrt(
        np.diag(covariance(jacobian, target - jacobian @ x, weights, inverse, lags))
    )
    return LeverArm(arm_frd_m=x[:3], sigma_m=sigma[:3], accel_bias_m_s2=x[3:])


def _double_integrals(
    flight: CameraFlight, path: GyroPath, fit: MotionFit, r0_ned: FloatArray, when: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Twice integrated acceleration (2, n, 3) from t0 to t2 and to t1, NED, and its derivatives (2, n, 3, 3) by minus
    the bias of the accelerometers; attitude from the camera at t0 and the gyros from there."""
    ahrs = flight.ahrs
    begin_s = when[0] - fit.late_s
    start = path.at(begin_s).inv()
    force, by_bias = np.zeros((2, len(begin_s), 3)), np.zeros((2, len(begin_s), 3, 3))
    for which, end_s in enumerate((when[2] - fit.late_s, when[1] - fit.late_s)):
        count = max(2, round(float((end_s - begin_s).max()) / EXTRINSICS.step_s))
        dt_s = (end_s - begin_s) / count
        for k in range(count):
            t_s = begin_s + (k + 0.5) * dt_s
            body = np.column_stack([np.interp(t_s, ahrs.t_s, column) for column in ahrs.accel_frd_m_s2.T])
            turned = (start * path.at(t_s)).as_matrix()
            r = r0_ned @ turned
            reach = (dt_s * (end_s - t_s))[:, None]
            force[which] += reach * (np.einsum("nij,nj->ni", r, body) + GRAVITY_NED_M_S2)
            by_bias[which] += reach[:, :, None] * r
    return force, by_bias


def extrinsic_values(flight: CameraFlight, fit: MotionFit, arm: LeverArm | None) -> dict[str, list[float]]:
    """The keys of ``[camera]``; components of the lever arm that the flight does not show stay as they are.

    LogError if the rotation is not known well enough."""
    sigma = float(fit.sigma_mounting_rad.max())
    if sigma > MAX_SIGMA_MOUNTING_RAD:
        axis = ("roll", "pitch", "yaw")[int(fit.sigma_mounting_rad.argmax())]
        rms = [math.degrees(v) for v in fit.turned_rad.std(axis=0).tolist()]
        raise LogError(
            f"mounting {axis} is known to {math.degrees(sigma):.1f} deg only: between pictures the vehicle turned by"
            f" {rms[0]:.2f} (roll), {rms[1]:.2f} (pitch), {rms[2]:.2f} deg (yaw) rms; turn it about at least two axes,"
            " by hand if need be"
        )
    values = {
        "camera.mounting_rpy_rad": [round(v, 6) for v in mounting_rpy_rad(fit.r_frd_from_cam).tolist()],
        "camera.mounting_sigma_rad": [round(v, 6) for v in fit.sigma_mounting_rad.tolist()],
    }
    if arm is not None and arm.observable.any():
        new = arm.arm_frd_m + np.array(flight.vehicle.ahrs.position_frd_m)
        place = np.where(arm.observable, new, flight.camera.position_frd_m)
        values["camera.position_frd_m"] = [round(v, 4) for v in place.tolist()]
        sigma_m = np.where(arm.observable, arm.sigma_m, flight.vehicle.eye.position_sigma_m)
        values["camera.position_sigma_m"] = [round(v, 4) for v in sigma_m.tolist()]
    return values
