"""Height over a level floor by a sonar altimeter.

Its beam is wide: the first echo comes from vertically below as long as that is within the beam. Its errors (speed of
sound, objects on the floor) are correlated from echo to echo and do not average out.

A multiple echo has twice the range. With an accurate depth it fails the gate; with a poor depth, when the altimeter is
needed most, it could pass and exclude the correct ones after it. An echo is therefore compared with the preceding
ones.
"""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.core.echoes import LEAST_CONFIDENCE, RecentEchoes
from autopilot.core.samples import AltimeterSample
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.aiding import ScalarAid
from autopilot.estimator.history import Node
from autopilot.estimator.inertial import Inertial, down_of
from autopilot.estimator.measure_range import LEAST_COSINE, FloorRange, unit
from autopilot.estimator.measurement import MAX_SIGMA_M
from autopilot.estimator.states import DOWN

MIN_SIGMA_M, SIGMA_FRACTION = 0.03, 0.02
"""Least standard deviation: what lies on the floor, and the share of the range that a speed of sound is wrong by."""
KNOWN_FRACTION = 0.7
"""While the depth is known better than to this share of an echo's standard deviation by something else, it is left
out: many echoes with one and the same error would make a sure and wrong depth."""
MAX_RANGE_M = 200.0
ECHOES = 5
"""Echoes that must have been heard before one is used: with one in five coming back twice, all of them are multiples
once in three thousand times."""
STEEPEST = 0.5
"""Cosine of the tilt of the beam from which on no echo from below is used."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AltimeterRange(FloorRange):
    """Range of the first echo; the beam is its axis."""

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
    return (
        0.0 < sample.range_m < MAX_RANGE_M and 0.0 <= sample.sigma_m <= MAX_SIGMA_M and 0.0 <= sample.confidence <= 1.0
    )


def _sigma_m(sample: AltimeterSample) -> float:
    return max(sample.sigma_m, math.hypot(MIN_SIGMA_M, SIGMA_FRACTION * sample.range_m))
