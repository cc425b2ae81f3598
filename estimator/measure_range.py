"""Range from a sensor to a level floor, as lasers and sonars measure it."""

import math
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from autopilot.core.echoes import LEAST_CONFIDENCE, RecentEchoes
from autopilot.core.frames import FloatArray
from autopilot.core.samples import AltimeterSample, LaserSample, MarkerSighting
from autopilot.core.vehicle import Laser, Vehicle
from autopilot.estimator.aiding import ScalarAid
from autopilot.estimator.history import Node
from autopilot.estimator.inertial import Inertial, down_of
from autopilot.estimator.measurement import MAX_SIGMA_M, Measurement, Moment
from autopilot.estimator.pictures import Pictures
from autopilot.estimator.states import DOWN, LASER_BIAS, NX, VEL_DOWN, one

LEAST_COSINE = 0.2
"""Of a tilt: beyond it a range says nothing of the height."""
ALTIMETER_MIN_SIGMA_M, SIGMA_FRACTION = 0.03, 0.02
"""Least standard deviation: what lies on the floor, and the share of the range that a speed of sound is wrong by."""
KNOWN_FRACTION = 0.7
"""While the depth is known better than to this share of an echo's standard deviation by something else, it is left
out: many echoes with one and the same error would make a sure and wrong depth."""
ALTIMETER_MAX_RANGE_M = 200.0
ECHOES = 5
"""Echoes that must have been heard before one is used: with one in five coming back twice, all of them are multiples
once in three thousand times."""
STEEPEST = 0.5
"""Cosine of the tilt of the beam from which on no echo from below is used."""
LASER_MIN_SIGMA_M = 0.005
"""Floor of the range noise: waves of the floor, calibration."""

LASER_MAX_RANGE_M = 50.0

NO_LASER = Laser(position_frd_m=(0.0, 0.0, 0.0))
"""Stands for the laser of a vehicle that has none: no sample of it will come."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FloorRange(Measurement):
    """z = (1,) range [m]."""

    floor_depth_m: float
    mount_frd_m: tuple[float, float, float]
    """Where the beam starts."""
    beam_frd: tuple[float, float, float]
    """Where it goes, of length 1."""

    @abstractmethod
    def cosine(self, inertial: Inertial) -> float:
        """Cosine of the angle between the beam and the vertical."""
        ...

    def predicted(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """(floor - depth of the sensor) / cosine."""
        below = down_of(moment.inertial, self.mount_frd_m)
        height_m = self.floor_depth_m - x.item(DOWN) - after_s * x.item(VEL_DOWN) - below
        return np.array([height_m / self.cosine(moment.inertial)])

    def jacobian(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """d/d depth and heave speed."""
        cosine = self.cosine(moment.inertial)
        jac = np.zeros((1, NX))
        jac[0, DOWN] = -1.0 / cosine
        jac[0, VEL_DOWN] = -after_s / cosine
        return jac


def unit(direction: tuple[float, float, float]) -> tuple[float, float, float]:
    """The direction with length 1."""
    x, y, z = direction
    length = math.sqrt(x * x + y * y + z * z)
    return (x / length, y / length, z / length)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AltimeterRange(FloorRange):
    """Range of the first echo; the beam is its axis.

    Its beam is wide: the first echo comes from vertically below as long as that is within the beam. Its errors (speed
    of sound, objects on the floor) are correlated from echo to echo and do not average out.

    A multiple echo has twice the range. With an accurate depth it fails the gate; with a poor depth, when the altimeter
    is needed most, it could pass and exclude the correct ones after it. An echo is therefore compared with the
    preceding ones."""

    half_beam_rad: float

    def cosine(self, inertial: Inertial) -> float:
        """Cosine of the angle between the beam's edge and the vertical."""
        off_rad = math.acos(max(-1.0, min(1.0, down_of(inertial, self.beam_frd)))) - self.half_beam_rad
        return max(math.cos(max(0.0, off_rad)), LEAST_COSINE)


class AltimeterAid(ScalarAid[AltimeterSample]):
    """Sonar altimeter: used where the floor's depth is known and no better height is available."""

    sensor = "altimeter"
    samples = (AltimeterSample,)

    def __init__(self, vehicle: Vehicle, floor_depth_m: float | None) -> None:
        mount = vehicle.altimeter
        super().__init__(mount.time_offset_s)
        self._floor_depth_m = floor_depth_m
        self._mount_frd_m = mount.position_frd_m
        self._beam_frd = unit(mount.direction_frd)
        self._half_beam_rad = 0.5 * mount.beam_width_rad
        self._echoes = RecentEchoes()

    def wanted(self, sample: AltimeterSample, node: Node) -> bool:
        """See :class:`ScalarAid`; malformed samples are accepted here, to be counted."""
        if not _sane(sample):
            return True
        p = node.state.p
        depth_variance = p.item(DOWN) if p.ndim == 1 else p.item(DOWN, DOWN)
        floor_known = self._floor_depth_m is not None
        sure_enough = sample.confidence >= LEAST_CONFIDENCE
        points_down = down_of(node.moment.inertial, self._beam_frd) > STEEPEST
        depth_unsure = depth_variance > (KNOWN_FRACTION * _sigma_m(sample)) ** 2
        once = self._came_back_once(sample) if sure_enough else False
        return floor_known and sure_enough and once and points_down and depth_unsure

    def _came_back_once(self, sample: AltimeterSample) -> bool:
        """Whether it is a first echo by comparison with the preceding ones, to which it is added."""
        before, at_half = self._echoes.add(sample.t_us, sample.range_m)
        return before >= ECHOES and not at_half

    def measured(self, sample: AltimeterSample) -> AltimeterRange | None:
        if self._floor_depth_m is None or not _sane(sample):
            return self.counted(None)
        return AltimeterRange(
            sensor="altimeter",
            t_us=sample.t_us,
            z=np.array([sample.range_m]),
            noise=np.array([[_sigma_m(sample) ** 2]]),
            floor_depth_m=self._floor_depth_m,
            mount_frd_m=self._mount_frd_m,
            beam_frd=self._beam_frd,
            half_beam_rad=self._half_beam_rad,
        )


def _sane(sample: AltimeterSample) -> bool:
    """Whether a sample is plausible for an altimeter; comparisons with NaN are false."""
    noise, sure = 0.0 <= sample.sigma_m <= MAX_SIGMA_M, 0.0 <= sample.confidence <= 1.0
    return 0.0 < sample.range_m < ALTIMETER_MAX_RANGE_M and noise and sure


def _sigma_m(sample: AltimeterSample) -> float:
    return max(sample.sigma_m, math.hypot(ALTIMETER_MIN_SIGMA_M, SIGMA_FRACTION * sample.range_m))


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
    if not 0.0 < sample.range_m < LASER_MAX_RANGE_M or not 0.0 <= sample.sigma_m <= MAX_SIGMA_M:
        return None
    return LaserRange(
        sensor="laser",
        t_us=sample.t_us,
        z=np.array([sample.range_m]),
        noise=np.array([[max(sample.sigma_m, LASER_MIN_SIGMA_M) ** 2]]),
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
