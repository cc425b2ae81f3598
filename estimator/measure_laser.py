"""Range along the laser beam to the floor, corrected for tilt."""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.samples import LaserSample, MarkerSighting
from autopilot.core.vehicle import Laser, Vehicle
from autopilot.estimator.aiding import ScalarAid
from autopilot.estimator.inertial import Inertial, down_of
from autopilot.estimator.measurement import Measurement, Moment
from autopilot.estimator.pictures import Pictures
from autopilot.estimator.states import DOWN, LASER_BIAS, NX, VEL_DOWN, one

MIN_SIGMA_M = 0.005
"""Floor of the range noise: waves of the floor, calibration."""

MAX_RANGE_M = 50.0
MAX_SIGMA_M = 10.0

NO_LASER = Laser(position_frd_m=(0.0, 0.0, 0.0))
"""Stands for the laser of a vehicle that has none: no sample of it will come."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LaserRange(Measurement):
    """z = (1,) range from the laser to a level floor [m]."""

    floor_depth_m: float
    mount_frd_m: tuple[float, float, float]
    """Where the beam starts."""
    beam_frd: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Where it goes, of length 1."""

    def _cosine(self, inertial: Inertial) -> float:
        """Between the beam and the vertical."""
        return max(down_of(inertial, self.beam_frd), 0.2)

    def predicted(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """(floor - depth of the laser) / cosine of the tilt, plus bias."""
        below, cosine = down_of(moment.inertial, self.mount_frd_m), self._cosine(moment.inertial)
        down, speed, bias = x.item(DOWN), x.item(VEL_DOWN), x.item(LASER_BIAS)
        return np.array([(self.floor_depth_m - down - after_s * speed - below) / cosine + bias])

    def jacobian(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """d/d depth, heave speed and bias."""
        cosine = self._cosine(moment.inertial)
        jac = np.zeros((1, NX))
        jac[0, DOWN] = -1.0 / cosine
        jac[0, VEL_DOWN] = -after_s / cosine
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
        """``floor_depth_m``: None = it is not known what the beam meets, ranges are not used."""
        super().__init__()
        self._pictures, self._floor_depth_m = pictures, floor_depth_m
        laser = vehicle.laser or NO_LASER
        self._mount_frd_m = laser.position_frd_m
        bx, by, bz = laser.direction_frd
        length = math.sqrt(bx * bx + by * by + bz * bz)
        self._beam_frd = (bx / length, by / length, bz / length)

    @property
    def offset_us(self) -> int:
        """See :class:`Aid`."""
        return self._pictures.offset_us

    def measured(self, sample: LaserSample | MarkerSighting) -> LaserRange | None:
        """See :class:`ScalarAid`."""
        shown = self._of_picture(sample) if isinstance(sample, MarkerSighting) else sample
        floor_m = self._floor_depth_m
        if shown is None or floor_m is None:
            return None
        return self.counted(range_from_sample(shown, floor_m, self._mount_frd_m, self._beam_frd))

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
