"""Horizontal position by a satellite receiver, while the vehicle is at the surface.

Its errors (ionosphere, reflections off the water) change over minutes: a hundred fixes are no better than one. A fix is
therefore used once a second at most, and only while the position is less well known than by a share of its own
standard deviation; in between it is compared, and keeps the estimate alive as long as it agrees.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.samples import DepthSample, PlanarFixSample
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.aiding import ScalarAid
from autopilot.estimator.history import Node
from autopilot.estimator.inertial import Inertial, down_of
from autopilot.estimator.measure_pose import MAX_DISTANCE_M, PoseFix
from autopilot.estimator.measurement import CHI2_999, MAX_SIGMA_M, Measurement, Moment
from autopilot.estimator.states import DOWN, EAST, GYRO_BIAS, NORTH, NX, VEL_EAST, VEL_NORTH, YAW

MIN_SIGMA_M = 0.02
"""Of a receiver with phase corrections; others say metres."""
KNOWN_FRACTION = 0.7
"""Share of a fix's standard deviation that the position's own has to exceed for it to be used."""
USE_EVERY_US = 1_000_000
SURFACED_M = 0.3
"""Depth of the centre of gravity above which an antenna on top can be out of the water. Beyond, a receiver that still
gives fixes extrapolates them."""
START_COUNT, START_US = 5, 3_000_000
"""Fixes within so long that must agree with each other before the estimate begins at one of them."""
START_YAW_SIGMA_RAD = 0.1
"""Of the AHRS's heading, which is all there is: compass, steel nearby, declination."""
START_DEPTH_SIGMA_M, START_OFFSET_SIGMA_M = 0.15, 0.03
"""Of the depth, and of the pressure sensor's zero: it is set at the surface, and nothing else tells the depth."""
START_SPEED_M_S = 1.0
"""A vehicle that is carried or drifts while it starts."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlanarFix(Measurement):
    """z = (2,) north, east of the antenna [m]."""

    mount_frd_m: tuple[float, float, float]

    def predicted(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """Position of the centre of gravity plus the lever arm."""
        north, east = _lever(moment.inertial, _yaw(x, moment, after_s), self.mount_frd_m)
        return np.array(
            [x[NORTH] + after_s * x[VEL_NORTH] + north, x[EAST] + after_s * x[VEL_EAST] + east],
        )

    def jacobian(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """d/d position, velocity and heading."""
        north, east = _lever(moment.inertial, _yaw(x, moment, after_s), self.mount_frd_m)
        jac = np.zeros((2, NX))
        jac[0, NORTH] = jac[1, EAST] = 1.0
        jac[0, VEL_NORTH] = jac[1, VEL_EAST] = after_s
        jac[0, YAW], jac[1, YAW] = -east, north
        return jac


def _yaw(x: FloatArray, moment: Moment, after_s: float) -> float:
    return x.item(YAW) + after_s * (moment.inertial.yaw_rate_rad_s - x.item(GYRO_BIAS))


def _lever(inertial: Inertial, yaw_rad: float, mount_frd_m: tuple[float, float, float]) -> tuple[float, float]:
    """North and east of the antenna from the centre of gravity."""
    rotation = r_ned_from_frd(np.array([inertial.roll_rad, inertial.pitch_rad, yaw_rad]))
    north, east, _ = (rotation @ np.array(mount_frd_m)).tolist()
    return north, east


class GpsAid(ScalarAid[PlanarFixSample]):
    sensor = "gps"
    samples = (PlanarFixSample,)
    own = slice(NORTH, EAST + 1)

    def __init__(self, vehicle: Vehicle, floor_depth_m: float | None) -> None:
        super().__init__(vehicle.gps.time_offset_s)
        self._mount_frd_m = vehicle.gps.position_frd_m
        self._depth_mount_frd_m = vehicle.depth_sensor.position_frd_m
        self._used_us = -USE_EVERY_US
        self._depth: DepthSample | None = None
        self._first: deque[PlanarFixSample] = deque(maxlen=START_COUNT)
        self.agreed_us: int | None = None
        """Time of the newest fix that agrees with the estimate, used or not; None before the first."""

    def measured(self, sample: PlanarFixSample) -> PlanarFix | None:
        return self.counted(self._made(sample))

    def _made(self, sample: PlanarFixSample) -> PlanarFix | None:
        place = np.asarray(sample.pos_ned_m, dtype=float)
        # Comparisons with NaN are false, so a NaN anywhere is malformed as well.
        if place.shape != (2,) or not (abs(place) <= MAX_DISTANCE_M).all() or not 0.0 <= sample.sigma_m <= MAX_SIGMA_M:
            return None
        noise = np.eye(2) * max(sample.sigma_m, MIN_SIGMA_M) ** 2
        return PlanarFix(sensor=self.sensor, t_us=sample.t_us, z=place, noise=noise, mount_frd_m=self._mount_frd_m)

    def wanted(self, sample: PlanarFixSample, node: Node) -> bool:
        """See :class:`ScalarAid`; malformed samples are accepted here, to be counted."""
        fix = self._made(sample)
        if fix is None:
            return True
        if node.state.x.item(DOWN) > SURFACED_M:
            return False
        p = node.state.p if node.state.p.ndim == 1 else node.state.p.diagonal()
        known_m2, fix_m2 = max(p.item(NORTH), p.item(EAST)), fix.noise.item(0)
        y = fix.z - fix.predicted(node.state.x, node.moment, 1e-6 * (sample.t_us - node.t_us))
        if float(y @ y) <= CHI2_999[2] * (known_m2 + fix_m2):
            self.agreed_us = sample.t_us
        if known_m2 <= KNOWN_FRACTION**2 * fix_m2 or sample.t_us - self._used_us < USE_EVERY_US:
            return False
        self._used_us = sample.t_us
        return True

    def reopened(self, measurement: Measurement, *, fixed: bool) -> slice | None:
        """See :class:`ScalarAid`: markers and poses know better."""
        return None if fixed else self.own

    # Before there is an estimate

    def note_depth(self, sample: DepthSample) -> None:
        """Depth of the sensor, before there is an estimate."""
        if math.isfinite(sample.depth_m):
            self._depth = sample

    def first_fix(self, sample: PlanarFixSample, inertial: Inertial) -> PoseFix | None:
        """The pose to begin at: fixes that agree, the AHRS's heading, the depth of the pressure sensor; None while
        there is none.
        """
        fix = self._made(sample)
        depth_m = 0.0
        if self._depth is not None:
            depth_m = self._depth.depth_m - down_of(inertial, self._depth_mount_frd_m)
        if fix is None or depth_m > SURFACED_M:
            return None
        self._first.append(sample)
        oldest = self._first[0]
        if len(self._first) < START_COUNT or sample.t_us - oldest.t_us > START_US:
            return None
        if not all(self._agree(sample, other) for other in self._first):
            return None
        north, east = _lever(inertial, inertial.ahrs_yaw_rad, self._mount_frd_m)
        planar_m2 = fix.noise.item(0)
        return PoseFix(
            sensor=self.sensor,
            t_us=sample.t_us,
            z=np.array([fix.z[0] - north, fix.z[1] - east, max(depth_m, 0.0), inertial.ahrs_yaw_rad]),
            noise=np.diag([planar_m2, planar_m2, START_DEPTH_SIGMA_M**2, START_YAW_SIGMA_RAD**2]),
        )

    @staticmethod
    def _agree(one: PlanarFixSample, other: PlanarFixSample) -> bool:
        apart_m = math.dist(one.pos_ned_m, other.pos_ned_m)
        spread_m = math.sqrt(CHI2_999[2]) * math.hypot(one.sigma_m, other.sigma_m)
        return apart_m <= spread_m + START_SPEED_M_S * 1e-6 * abs(one.t_us - other.t_us)
