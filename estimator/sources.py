"""Where aiding measurements come from: every sensor's samples, its mounting and clock, and its book-keeping."""

import math
from collections import deque
from dataclasses import replace
from typing import TypeVar

import numpy as np

from autopilot.core.samples import (
    DepthSample,
    ExternalFrame,
    ExternalPoseSample,
    LaserSample,
    MarkerSighting,
    PoseSample,
    VelocitySample,
)
from autopilot.core.vehicle import Laser, Vehicle
from autopilot.estimator.aiding import Aid
from autopilot.estimator.history import Node
from autopilot.estimator.inertial import Inertial
from autopilot.estimator.intake import AidingSample
from autopilot.estimator.markers_pose import MarkerSolver
from autopilot.estimator.measure_depth import depth_from_sample
from autopilot.estimator.measure_external import Alignment, aligned, fix_from_external, tracked_point, well_formed
from autopilot.estimator.measure_laser import range_from_sample
from autopilot.estimator.measure_pose import PoseFix, fix_from_sample
from autopilot.estimator.measure_velocity import velocity_from_sample
from autopilot.estimator.measurement import Measurement
from autopilot.estimator.states import DEPTH_OFFSET, HEADING_OFFSET, LASER_BIAS, POS, VEL, YAW

OF_PICTURES = PoseSample | MarkerSighting | LaserSample
"""Kinds of samples that have a picture's stamp."""
LOST_AFTER = 3
"""Sightings in a row that do not fit the predicted pose before the whole floor is searched."""


NO_LASER = Laser(position_frd_m=(0.0, 0.0, 0.0))
"""Stands for the laser of a vehicle that has none: no sample of it will come."""

T = TypeVar("T")


def _one(index: int) -> slice:
    return slice(index, index + 1)


class Sources:
    """All aiding sensors of a vehicle."""

    def __init__(self, vehicle: Vehicle, solver: MarkerSolver | None, floor_depth_m: float | None) -> None:
        self._solver = solver
        self._floor_depth_m = floor_depth_m
        laser = vehicle.laser or NO_LASER
        self._laser_frd_m = laser.position_frd_m
        bx, by, bz = laser.direction_frd
        length = math.sqrt(bx * bx + by * by + bz * bz)
        self._beam_frd = (bx / length, by / length, bz / length)
        self._depth_frd_m = vehicle.depth_sensor.position_frd_m
        self._dvl_frd_m = vehicle.dvl.position_frd_m
        self._external_frd_m = vehicle.external_pose.position_frd_m
        self.markers, self.external = Aid("markers"), Aid("external")
        self.laser, self.depth = Aid("laser", _one(LASER_BIAS)), Aid("depth", _one(DEPTH_OFFSET))
        self.heading, self.velocity = Aid("heading", _one(HEADING_OFFSET)), Aid("velocity", VEL)
        self.model = Aid("model")
        self.aid_of: dict[type, Aid] = {
            PoseSample: self.markers,
            MarkerSighting: self.markers,
            LaserSample: self.laser,
            DepthSample: self.depth,
            VelocitySample: self.velocity,
            ExternalPoseSample: self.external,
        }
        """Kind of sample -> whose it is."""
        camera_us = 0 if vehicle.camera is None else round(1e6 * vehicle.camera.time_offset_s)
        self._offset_us: dict[type, int] = {
            PoseSample: camera_us,
            MarkerSighting: camera_us,
            LaserSample: camera_us,
            DepthSample: round(1e6 * vehicle.depth_sensor.time_offset_s),
            VelocitySample: round(1e6 * vehicle.dvl.time_offset_s),
            ExternalPoseSample: round(1e6 * vehicle.external_pose.time_offset_s),
        }
        self._camera_us = camera_us
        self.late_us = 0
        """What else has been found to be taken off the stamps of pictures."""
        self._made: deque[PoseSample | LaserSample] = deque(maxlen=64)
        self._unfit_in_row = 0
        self._frame: Alignment | None = None
        self._reset_counter: int | None = None
        self.external_jumped = False
        """The external source has said that its pose has jumped, and none of its poses has been used since."""

    @property
    def aids(self) -> tuple[Aid, ...]:
        """All of them."""
        return self.markers, self.laser, self.heading, self.model, self.depth, self.velocity, self.external

    @property
    def newest_fix_us(self) -> int | None:
        """Time of validity of the newest fix that has been used, None before the first."""
        markers_us, external_us = self.markers.last_fused_us, self.external.last_fused_us
        if markers_us is None or external_us is None:
            return external_us if markers_us is None else markers_us
        return max(markers_us, external_us)

    def on_our_clock(self, sample: AidingSample) -> AidingSample:
        """The sample with its sensor's time offset taken off."""
        offset_us = self._offset_us[type(sample)]
        if self.late_us and isinstance(sample, OF_PICTURES):
            offset_us -= self.late_us
        return replace(sample, t_us=sample.t_us + offset_us) if offset_us else sample

    def believe_focal(self, share: float) -> None:
        """From now on take the camera's focal length for too long by that share."""
        if self._solver is not None:
            self._solver.believe_focal(share)

    def take_made(self) -> tuple[PoseSample | LaserSample, ...]:
        """What was made of pictures since the last call, stamped as the pictures were."""
        if not self._made:
            return ()
        made = tuple(self._made)
        self._made.clear()
        return made

    def first_fix(self, sample: AidingSample, inertial: Inertial) -> PoseFix | None:
        """A pose from a sample while nothing is known; None if this sample gives none."""
        if isinstance(sample, PoseSample):
            return self._counted(fix_from_sample(sample, "markers"), self.markers)
        if isinstance(sample, ExternalPoseSample):
            self._note_jump(sample)
            if sample.frame is not ExternalFrame.NED and well_formed(sample):
                return None
            return self._counted(fix_from_external(sample, inertial, self._external_frd_m), self.external)
        if isinstance(sample, MarkerSighting) and self._solver is not None:
            if not self._solver.well_formed(sample):
                return self._counted(None, self.markers)
            return self._kept(self._solver.locate(sample, inertial.roll_rad, inertial.pitch_rad))
        return None

    def fix(self, sample: AidingSample, node: Node) -> tuple[PoseFix | None, Aid]:
        """A pose from a sample that belongs to ``node``, and whose it is."""
        if isinstance(sample, ExternalPoseSample):
            return self._counted(self._external_fix(sample, node), self.external), self.external
        if isinstance(sample, PoseSample):
            return self._counted(fix_from_sample(sample, "markers"), self.markers), self.markers
        if isinstance(sample, MarkerSighting) and self._solver is not None:
            if not self._solver.well_formed(sample):
                return self._counted(None, self.markers), self.markers
            return self._kept(self._solve(node, sample, self._solver)), self.markers
        return None, self.markers

    def scalars(self, sample: AidingSample) -> tuple[Measurement | None, Aid]:
        """Range, depth or velocity from a sample, and whose it is."""
        if isinstance(sample, DepthSample):
            return self._counted(depth_from_sample(sample, self._depth_frd_m), self.depth), self.depth
        if isinstance(sample, VelocitySample):
            return self._counted(velocity_from_sample(sample, self._dvl_frd_m), self.velocity), self.velocity
        if isinstance(sample, MarkerSighting):
            if self._solver is None or not self._solver.well_formed(sample):
                return None, self.laser
            dot = self._solver.laser_range(sample)
            if dot is None:
                return None, self.laser
            self.laser.counts["received"] += 1
            sample = LaserSample(t_us=sample.t_us, range_m=dot[0], sigma_m=dot[1])
            self._made.append(replace(sample, t_us=sample.t_us - self._camera_us + self.late_us))
        if not isinstance(sample, LaserSample) or self._floor_depth_m is None:
            return None, self.laser
        laser = range_from_sample(sample, self._floor_depth_m, self._laser_frd_m, self._beam_frd)
        return self._counted(laser, self.laser), self.laser

    def solver_counts(self) -> dict[str, int]:
        """What was odd about markers, as ``markers.what``."""
        return {} if self._solver is None else {f"markers.{what}": n for what, n in self._solver.counts.items()}

    def _solve(self, node: Node, sighting: MarkerSighting, solver: MarkerSolver) -> PoseFix | None:
        """Fix by the predicted pose; after some that do not fit, by a search over the whole floor."""
        if not sighting.ids:
            return None
        inertial, x = node.moment.inertial, node.state.x
        after_s = 1e-6 * (sighting.t_us - node.t_us)
        rpy = np.array([inertial.roll_rad, inertial.pitch_rad, x[YAW] + after_s * inertial.yaw_rate_rad_s])
        sheets = () if node.state.sheets is None else (node.state.sheets,)
        fix = solver.track(sighting, x[POS] + after_s * x[VEL], rpy, *sheets)
        self._unfit_in_row = 0 if fix is not None and self.markers.rejected_in_row == 0 else self._unfit_in_row + 1
        if self._unfit_in_row > LOST_AFTER:
            fix = solver.locate(sighting, inertial.roll_rad, inertial.pitch_rad, *sheets) or fix
        if fix is None:
            self.markers.counts["rejected"] += 1
        return fix

    def _kept(self, fix: PoseFix | None) -> PoseFix | None:
        """Remember a pose from a picture for :meth:`take_made`."""
        if fix is not None:
            sigma = np.sqrt(fix.noise.diagonal())
            self._made.append(
                PoseSample(
                    t_us=fix.t_us - self._camera_us + self.late_us,
                    pos_ned_m=fix.z[:3],
                    yaw_rad=float(fix.z[3]),
                    sigma_pos_m=sigma[:3],
                    sigma_yaw_rad=float(sigma[3]),
                )
            )
        return fix

    def _external_fix(self, sample: ExternalPoseSample, node: Node) -> PoseFix | None:
        if not well_formed(sample):
            return None
        self._note_jump(sample)
        inertial, x = node.moment.inertial, node.state.x
        if sample.frame is ExternalFrame.NED:
            return fix_from_external(sample, inertial, self._external_frd_m)
        if self._frame is None:
            after_s = 1e-6 * (sample.t_us - node.t_us)
            yaw = float(x[YAW]) + after_s * inertial.yaw_rate_rad_s
            point = tracked_point(x[POS] + after_s * x[VEL], yaw, inertial, self._external_frd_m)
            self._frame = aligned(sample, point, yaw)
        return fix_from_external(sample, inertial, self._external_frd_m, self._frame)

    def _note_jump(self, sample: ExternalPoseSample) -> None:
        """A new reset counter: what the source said before does not hold any more."""
        if self._reset_counter is not None and sample.reset_counter != self._reset_counter:
            self._frame = None
            self.external_jumped = True
            self.external.reset(sample.t_us)
        self._reset_counter = sample.reset_counter

    def _counted(self, measurement: T | None, aid: Aid) -> T | None:
        if measurement is None:
            aid.counts["malformed"] += 1
        return measurement
