"""Range along the laser beam to the floor, corrected for tilt."""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.samples import LaserSample, MarkerSighting
from autopilot.core.vehicle import Laser, Vehicle
from autopilot.estimator.aiding import ScalarAid
from autopilot.estimator.inertial import Inertial, down_of
from autopilot.estimator.measure_range import LEAST_COSINE, FloorRange, unit
from autopilot.estimator.measurement import MAX_SIGMA_M, Moment
from autopilot.estimator.pictures import Pictures
from autopilot.estimator.states import LASER_BIAS, one

MIN_SIGMA_M = 0.005
"""Floor of the range noise: waves of the floor, calibration."""

MAX_RANGE_M = 50.0

NO_LASER = Laser(position_frd_m=(0.0, 0.0, 0.0))
"""Stands for the laser of a vehicle that has none: no sample of it will come."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LaserRange(FloorRange):
    """Range along the beam, plus a bias that is a state of its own."""

    beam_frd: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def cosine(self, inertial: Inertial) -> float:
        """Between the beam and the vertical."""
        return max(down_of(inertial, self.beam_frd), LEAST_COSINE)

    def predicted(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        # Not super(): a dataclass with slots is another class than the one that its methods were written in.
        return FloorRange.predicted(self, x, moment, after_s) + x.item(LASER_BIAS)

    def jacobian(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """d/d depth, heave speed and bias."""
        jac = FloorRange.jacobian(self, x, moment, after_s)
        jac[0, LASER_BIAS] = 1.0
        return jac


def range_from_sample(
    sample: LaserSample,
    floor_depth_m: float,
    mount_frd_m: tuple[float, float, float],
    beam_frd: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> LaserRange | None:
    """The measurement of a range sensor's sample; None if it is malformed."""
    if not (math.isfinite(sample.range_m) and math.isfinite(sample.sigma_m)):
        return None
    if not 0.0 < sample.range_m < MAX_RANGE_M or not 0.0 <= sample.sigma_m <= MAX_SIGMA_M:
        return None
    return LaserRange(
        sensor="laser",
        t_us=sample.t_us,
        z=np.array([sample.range_m]),
        noise=np.array([[max(sample.sigma_m, MIN_SIGMA_M) ** 2]]),
        floor_depth_m=floor_depth_m,
        mount_frd_m=mount_frd_m,
        beam_frd=beam_frd,
    )


class LaserAid(ScalarAid[LaserSample | MarkerSighting]):
    """A laser whose dot is seen by the camera: ranges as they come, or of the dot in a picture."""

    sensor = "laser"
    samples = (LaserSample, MarkerSighting)
    own = one(LASER_BIAS)
    of_pictures = True

    def __init__(self, vehicle: Vehicle, pictures: Pictures, floor_depth_m: float | None) -> None:
        """``floor_depth_m``: depth of the floor [m]; None = unknown, ranges are not used."""
        super().__init__()
        self._pictures, self._floor_depth_m = pictures, floor_depth_m
        self.sigma_m = 0.0
        """Standard deviation of the newest range, its calibration included."""
        laser = vehicle.laser or NO_LASER
        self._mount_frd_m = laser.position_frd_m
        self._beam_frd = unit(laser.direction_frd)

    @property
    def offset_us(self) -> int:
        return self._pictures.offset_us

    def measured(self, sample: LaserSample | MarkerSighting) -> LaserRange | None:
        shown = self._of_picture(sample) if isinstance(sample, MarkerSighting) else sample
        floor_m = self._floor_depth_m
        if shown is None or floor_m is None:
            return None
        found = self.counted(range_from_sample(shown, floor_m, self._mount_frd_m, self._beam_frd))
        if found is not None:
            self.sigma_m = math.sqrt(found.noise.item())
        return found

    def _of_picture(self, sighting: MarkerSighting) -> LaserSample | None:
        """The range by the dot in a picture, None = it shows none."""
        solver = self._pictures.solver
        dot = solver.laser_range(sighting) if solver is not None and solver.well_formed(sighting) else None
        if dot is None:
            return None
        self.counts["received"] += 1
        sample = LaserSample(t_us=sighting.t_us, range_m=dot[0], sigma_m=dot[1])
        self._pictures.note_made(sample)
        return sample
