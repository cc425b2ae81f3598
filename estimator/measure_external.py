"""Pose from an external source (motion capture, acoustic positioning, a companion computer's vision).

Transformed to the local frame and the centre of gravity it is the same measurement as a pose from markers. A source
with a frame of its own (FRD: level, with its own origin and heading) is aligned with the estimate when it starts and
at every change of its reset counter; from then on it bounds the drift.
"""

import math
from typing import NamedTuple

import numpy as np

from autopilot.core.frames import FloatArray, r_ned_from_frd, wrap_pi
from autopilot.core.samples import ExternalFrame, ExternalPoseSample
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.fix_aid import FixAid
from autopilot.estimator.history import Node
from autopilot.estimator.inertial import Inertial
from autopilot.estimator.measure_pose import MAX_DISTANCE_M, MAX_YAW_RAD, PoseFix
from autopilot.estimator.measurement import MAX_SIGMA_M
from autopilot.estimator.states import POS, VEL, YAW

MIN_SIGMA_M, MIN_SIGMA_RAD = 0.002, math.radians(0.1)
"""Floors of what a source claims."""
UNKNOWN_SIGMA_M, UNKNOWN_SIGMA_RAD = 0.1, 0.1
"""Taken when the source gives no covariance (the defaults of PX4's EKF2_EVP_NOISE and EKF2_EVA_NOISE)."""
MAX_SIGMA_RAD = math.pi


class Alignment(NamedTuple):
    """Transformation from a source's frame to the local one."""

    turn_rad: float
    """Heading of its x axis."""
    origin_ned_m: tuple[float, float, float]

    def to_ned(self, pos_m: FloatArray, yaw_rad: float) -> tuple[FloatArray, float]:
        return self.rotation() @ pos_m + np.array(self.origin_ned_m), yaw_rad + self.turn_rad

    def rotation(self) -> FloatArray:
        """(3, 3) from its frame to ours."""
        c, s = math.cos(self.turn_rad), math.sin(self.turn_rad)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


OURS = Alignment(0.0, (0.0, 0.0, 0.0))


def aligned(sample: ExternalPoseSample, pos_ned_m: FloatArray, yaw_rad: float) -> Alignment:
    """The alignment that puts the sample at this pose of the tracked point."""
    turn_rad = wrap_pi(yaw_rad - sample.yaw_rad)
    turned = Alignment(turn_rad, (0.0, 0.0, 0.0)).to_ned(np.asarray(sample.pos_m, dtype=float), 0.0)[0]
    n, e, d = (pos_ned_m - turned).tolist()
    return Alignment(turn_rad, (n, e, d))


def well_formed(sample: ExternalPoseSample) -> bool:
    """Check of shape, finite numbers, a valid covariance and a known frame."""
    pos = np.asarray(sample.pos_m, dtype=float)
    # Comparisons with NaN are false, so a NaN anywhere is malformed as well.
    if pos.shape != (3,) or not (abs(pos) <= MAX_DISTANCE_M).all() or not abs(sample.yaw_rad) <= MAX_YAW_RAD:
        return False
    if sample.frame not in tuple(ExternalFrame):
        return False
    return sample.covariance is None or _covariance(sample.covariance) is not None


def fix_from_external(
    sample: ExternalPoseSample, inertial: Inertial, mount_frd_m: tuple[float, float, float], frame: Alignment = OURS
) -> PoseFix | None:
    """The measurement of an external pose; None if it is malformed.

    ``mount_frd_m`` is the tracked point; it is taken off with the tilt of ``inertial`` and the heading of the sample.
    """
    if not well_formed(sample):
        return None
    if sample.covariance is None:
        noise = np.diag([UNKNOWN_SIGMA_M**2] * 3 + [UNKNOWN_SIGMA_RAD**2])
    else:
        checked = _covariance(sample.covariance)
        assert checked is not None
        turn = np.eye(4)
        turn[:3, :3] = frame.rotation()
        noise = turn @ checked @ turn.T
    pos, yaw = frame.to_ned(np.asarray(sample.pos_m, dtype=float), float(sample.yaw_rad))
    lever: FloatArray = r_ned_from_frd(np.array([inertial.roll_rad, inertial.pitch_rad, yaw])) @ np.array(mount_frd_m)
    swing = np.eye(4)
    swing[0, 3], swing[1, 3] = lever[1], -lever[0]
    noise = swing @ noise @ swing.T
    return PoseFix(sensor="external", t_us=sample.t_us, z=np.append(pos - lever, wrap_pi(yaw)), noise=noise)


def tracked_point(
    pos_ned_m: FloatArray, yaw_rad: float, inertial: Inertial, mount_frd_m: tuple[float, float, float]
) -> FloatArray:
    """(3,) NED of the point that the source tracks."""
    point: FloatArray = pos_ned_m + r_ned_from_frd(
        np.array([inertial.roll_rad, inertial.pitch_rad, yaw_rad])
    ) @ np.array(mount_frd_m)
    return point


def _covariance(given: FloatArray) -> FloatArray | None:
    """(4, 4) symmetric with floors on the diagonal; None if it is invalid or without information."""
    p = np.asarray(given, dtype=float)
    if p.shape != (4, 4) or not (abs(p) <= MAX_SIGMA_M**2).all() or p[3, 3] > MAX_SIGMA_RAD**2:
        return None
    p = 0.5 * (p + p.T)
    if float(np.linalg.eigvalsh(p)[0]) < -1e-9:
        return None
    floored: FloatArray = p + np.diag([MIN_SIGMA_M**2] * 3 + [MIN_SIGMA_RAD**2])
    return floored


class ExternalAid(FixAid[ExternalPoseSample]):
    sensor = "external"
    samples = (ExternalPoseSample,)

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle.external_pose.time_offset_s)
        self._mount_frd_m = vehicle.external_pose.position_frd_m
        self._frame: Alignment | None = None
        """Of a source whose frame is not ours; None until it is laid onto the estimate."""
        self._reset_counter: int | None = None

    def first_fix(self, sample: ExternalPoseSample, inertial: Inertial) -> PoseFix | None:
        """See :class:`FixAid`: a source with its own frame does not give the position."""
        self._note_jump(sample)
        in_our_frame = sample.frame is ExternalFrame.NED
        if not in_our_frame and well_formed(sample):
            return None
        return self.counted(fix_from_external(sample, inertial, self._mount_frd_m))

    def fix(self, sample: ExternalPoseSample, node: Node) -> PoseFix | None:
        if not well_formed(sample):
            return self.counted(None)
        self._note_jump(sample)
        inertial = node.moment.inertial
        in_our_frame = sample.frame is ExternalFrame.NED
        if in_our_frame:
            return self.counted(fix_from_external(sample, inertial, self._mount_frd_m))
        if self._frame is None:
            self._frame = self._laid(sample, node)
        return self.counted(fix_from_external(sample, inertial, self._mount_frd_m, self._frame))

    def _laid(self, sample: ExternalPoseSample, node: Node) -> Alignment:
        """The source's frame, so that its pose is the estimate's."""
        inertial, x = node.moment.inertial, node.state.x
        after_s = 1e-6 * (sample.t_us - node.t_us)
        yaw = float(x[YAW]) + after_s * inertial.yaw_rate_rad_s
        return aligned(sample, tracked_point(x[POS] + after_s * x[VEL], yaw, inertial, self._mount_frd_m), yaw)

    def _note_jump(self, sample: ExternalPoseSample) -> None:
        """A new reset counter: the previous alignment is discarded."""
        if self._reset_counter is not None and sample.reset_counter != self._reset_counter:
            self._frame = None
            self.jumped = True
            self.reset(sample.t_us)
        self._reset_counter = sample.reset_counter
