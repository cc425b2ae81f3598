"""Height over a level floor by a sonar altimeter.

Its beam is wide: the first echo comes from the floor straight below as long as that lies within the beam. Its errors
(speed of sound, what lies on the floor) are the same from echo to echo, so that averaging does not take them away.
"""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.core.samples import AltimeterSample
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.aiding import ScalarAid
from autopilot.estimator.history import Node
from autopilot.estimator.inertial import Inertial, down_of
from autopilot.estimator.measure_range import LEAST_COSINE, FloorRange, unit
from autopilot.estimator.states import DOWN

MIN_SIGMA_M, SIGMA_SHARE = 0.03, 0.02
"""Least standard deviation: what lies on the floor, and the share of the range that a speed of sound is wrong by."""
KNOWN_SHARE = 0.7
"""While the depth is known better than to this share of an echo's standard deviation by something else, it is left
out: many echoes with one and the same error would make a sure and wrong depth."""
MAX_RANGE_M, MAX_SIGMA_M = 200.0, 10.0
LEAST_CONFIDENCE = 0.5
STEEPEST = 0.5
"""Cosine of the tilt of the beam from which on no echo from below is used."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AltimeterRange(FloorRange):
    """Range of the first echo; the beam is its axis."""

    half_beam_rad: float

    def cosine(self, inertial: Inertial) -> float:
        """Of what the beam's edge is off the vertical."""
        off_rad = math.acos(max(-1.0, min(1.0, down_of(inertial, self.beam_frd)))) - self.half_beam_rad
        return max(math.cos(max(0.0, off_rad)), LEAST_COSINE)


class AltimeterAid(ScalarAid[AltimeterSample]):
    """Sonar altimeter: used where the floor's depth is known and nothing knows the height better."""

    sensor = "altimeter"
    samples = (AltimeterSample,)

    def __init__(self, vehicle: Vehicle, floor_depth_m: float | None) -> None:
        mount = vehicle.altimeter
        super().__init__(mount.time_offset_s)
        self._floor_depth_m = floor_depth_m
        self._mount_frd_m = mount.position_frd_m
        self._beam_frd = unit(mount.direction_frd)
        self._half_beam_rad = 0.5 * mount.beam_width_rad

    def wanted(self, sample: AltimeterSample, node: Node) -> bool:
        """See :class:`ScalarAid`."""
        p = node.state.p
        depth_variance = p.item(DOWN) if p.ndim == 1 else p.item(DOWN, DOWN)
        floor_known = self._floor_depth_m is not None
        sure_enough = sample.confidence >= LEAST_CONFIDENCE
        looks_down = down_of(node.moment.inertial, self._beam_frd) > STEEPEST
        depth_in_doubt = depth_variance > (KNOWN_SHARE * _sigma_m(sample)) ** 2
        return floor_known and sure_enough and looks_down and depth_in_doubt

    def measured(self, sample: AltimeterSample) -> AltimeterRange | None:
        """See :class:`ScalarAid`."""
        numbers = (sample.range_m, sample.sigma_m, sample.confidence)
        sane = all(map(math.isfinite, numbers)) and 0.0 < sample.range_m < MAX_RANGE_M
        if self._floor_depth_m is None or not (sane and 0.0 <= sample.sigma_m <= MAX_SIGMA_M):
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


def _sigma_m(sample: AltimeterSample) -> float:
    return max(sample.sigma_m, math.hypot(MIN_SIGMA_M, SIGMA_SHARE * sample.range_m))
