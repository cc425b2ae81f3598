"""My own estimator: the vehicle's model carries the position on, every fix pulls it back."""

import numpy as np

from autopilot.core.frames import r_ned_from_frd, wrap_pi
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.model4 import body_acceleration
from autopilot.core.samples import AhrsSample, PoseSample
from autopilot.estimator.protocol import Estimator, EstimatorContext

PULL_1_S = (8.0, 6.0, 2.0)
"""How fast fixes correct position, velocity through the water, and current."""
FRESH_US, LOST_US = 500_000, 10_000_000


class Observer(Estimator):
    """Needs an AHRS and poses (``--sensors pose``, or an external positioning system)."""

    ahrs_us = None  # time of the last good AHRS sample: the service asks for it

    def __init__(self, given: EstimatorContext) -> None:
        self.model = given.model
        self.ahrs, self.pos, self.fix_us, self.last_us, self.yaw_offset = None, None, 0, 0, 0.0
        self.water, self.current, self.over_ground = np.zeros(3), np.zeros(3), np.zeros(3)

    def step(self, t_us, samples, thrust_n):
        dt_s, self.last_us = (t_us - self.last_us) * 1e-6, t_us
        for sample in samples:
            if isinstance(sample, AhrsSample) and np.isfinite([*sample.rpy_rad, *sample.rate_frd_rad_s]).all():
                self.ahrs, self.ahrs_us = sample, t_us
        if self.ahrs is None:
            return None
        rpy = self.ahrs.rpy_rad + np.array([0.0, 0.0, self.yaw_offset])
        turned = r_ned_from_frd(rpy)
        nu = (*self.water, self.ahrs.rate_frd_rad_s[2])
        self.water = self.water + dt_s * np.array(body_acceleration(self.model, nu, thrust_n, np)[:3])
        self.over_ground = turned @ self.water + self.current
        if self.pos is not None:
            self.pos = self.pos + dt_s * self.over_ground
        for sample in samples:
            if isinstance(sample, PoseSample) and np.isfinite([*sample.pos_ned_m, sample.yaw_rad]).all():
                self.correct(t_us, sample, rpy[2], turned)
        if self.pos is None:
            return None
        age_us = t_us - self.fix_us
        health = NavHealth.GOOD if age_us < FRESH_US else NavHealth.DEAD_RECKONING
        return NavState(
            t_us=t_us,
            health=NavHealth.INVALID if age_us > LOST_US else health,
            pos_ned_m=self.pos,
            rpy_rad=np.array([*rpy[:2], wrap_pi(rpy[2])]),
            vel_frd_m_s=turned.T @ self.over_ground,
            vel_water_frd_m_s=self.water,
            rate_frd_rad_s=self.ahrs.rate_frd_rad_s,
            current_ned_m_s=self.current,
            variance=np.repeat([1e-4, 1e-4, 4e-4, 4e-4], 3) * (1.0 + age_us * 1e-6) ** 2,
        )

    def correct(self, t_us, fix, yaw, turned):
        """A fix says where the vehicle was; the way since then is taken off what is believed now."""
        if self.pos is None:
            self.pos, self.yaw_offset = fix.pos_ned_m.copy(), self.yaw_offset + wrap_pi(fix.yaw_rad - yaw)
        since_s, apart_s = (t_us - fix.t_us) * 1e-6, min((fix.t_us - self.fix_us) * 1e-6, 0.1)
        if apart_s <= 0.0:  # an old one, or the same again
            return
        self.fix_us = fix.t_us
        off = fix.pos_ned_m - (self.pos - since_s * self.over_ground)
        position, water, current = (min(1.0, apart_s * pull) for pull in PULL_1_S)
        self.pos = self.pos + position * off
        self.water = self.water + water * turned.T @ off
        self.current = self.current + current * np.array([off[0], off[1], 0.0])
        self.yaw_offset += position * wrap_pi(fix.yaw_rad - yaw + since_s * self.ahrs.rate_frd_rad_s[2])
