"""Depth by pressure: depth of the sensor plus an offset, which is a filter state."""

from dataclasses import dataclass

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import AidStatus, MarkerFit
from autopilot.core.samples import DepthSample, possible_depth
from autopilot.core.vehicle import Vehicle
from autopilot.estimator.aiding import ScalarAid
from autopilot.estimator.estimator_tuning import DEPTH, EVIDENCE
from autopilot.estimator.filter_core import Innovation
from autopilot.estimator.inertial import down_of
from autopilot.estimator.measurement import MAX_SIGMA_M, Measurement, Moment
from autopilot.estimator.states import DEPTH_OFFSET, DOWN, NX, VEL_DOWN, one

MIN_SIGMA_M = 0.003
"""Floor of the noise: waves, and the pressure of the flow round the hull (v^2/2g is 6 mm at 0.35 m/s)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Depth(Measurement):
    """z = (1,) depth that the sensor shows [m]."""

    mount_frd_m: tuple[float, float, float]
    """Where the sensor sits."""

    def predicted(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """Depth of the centre of gravity, plus how far below it the sensor is, plus offset."""
        return np.array(
            [x[DOWN] + after_s * x[VEL_DOWN] + down_of(moment.inertial, self.mount_frd_m) + x[DEPTH_OFFSET]]
        )

    def jacobian(self, x: FloatArray, moment: Moment, after_s: float) -> FloatArray:
        """d/d depth, heave speed and offset."""
        jac = np.zeros((1, NX))
        jac[0, DOWN] = jac[0, DEPTH_OFFSET] = 1.0
        jac[0, VEL_DOWN] = after_s
        return jac


def depth_from_sample(sample: DepthSample, mount_frd_m: tuple[float, float, float]) -> Depth | None:
    """The measurement of a pressure sensor's sample; None if it is malformed."""
    if not (possible_depth(sample.depth_m) and 0.0 <= sample.sigma_m <= MAX_SIGMA_M):
        return None
    return Depth(
        sensor="depth",
        t_us=sample.t_us,
        z=np.array([sample.depth_m]),
        noise=np.array([[max(sample.sigma_m, MIN_SIGMA_M) ** 2]]),
        mount_frd_m=mount_frd_m,
    )


class DepthAid(ScalarAid[DepthSample]):
    sensor = "depth"
    samples = (DepthSample,)
    own = one(DEPTH_OFFSET)

    def __init__(self, vehicle: Vehicle, floor_depth_m: float | None) -> None:
        super().__init__(vehicle.depth_sensor.time_offset_s)
        self._mount_frd_m = vehicle.depth_sensor.position_frd_m
        self._ratio = 0.0

    def judged(
        self, t_us: int, now_us: int, innovation: Innovation, fused: bool, fit: MarkerFit | None = None
    ) -> AidStatus:
        self._ratio += DEPTH.ratio_gain * (min(innovation.test_ratio, EVIDENCE.ratio_most) - self._ratio)
        return super().judged(t_us, now_us, innovation, fused, fit)

    def disagrees(self, x: FloatArray) -> bool:
        """Whether its zero is far from the fixes' surface, or it is noisier than its samples say."""
        return abs(x.item(DEPTH_OFFSET)) > DEPTH.offset_m or self._ratio > EVIDENCE.ratio_denies

    def measured(self, sample: DepthSample) -> Depth | None:
        return self.counted(depth_from_sample(sample, self._mount_frd_m))
