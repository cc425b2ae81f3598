"""A simulated Doppler velocity log: velocity at its mounting position, over ground or through the water."""

from collections.abc import Iterable

import numpy as np

from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.samples import VelocityLock, VelocitySample
from autopilot.core.vehicle import DvlMount
from autopilot.sitl.optional_sensors import OptionalSensor, SensedWorld
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Fault
from autopilot.sitl.sensor_tables import DvlSensor


class SimDvl(OptionalSensor[VelocitySample, FloatArray]):
    """In open water the floor is always in reach."""

    name, seed, nothing = "dvl", 50, np.zeros(3)

    def __init__(
        self, table: DvlSensor, mount: DvlMount, world: SensedWorld, faults: Iterable[Fault], seed: int
    ) -> None:
        super().__init__(table, mount, world, faults, seed)
        self._bias_m_s = table.bias_m_s * self._rng.standard_normal(3)
        self._r_dvl_from_frd = r_ned_from_frd(np.array([0.0, 0.0, table.heading_error_rad])).T
        self._scale = 1.0 + table.scale_error * float(self._rng.standard_normal())

    def observe(self, truth: Truth) -> None:
        self._taken()
        noise, chance = self._rng.standard_normal(4), self._rng.random(5)
        if self._lost(truth.t_us, float(chance[0])):
            return
        bottom = self._sensor.lock == "bottom"
        if bottom and not self._in_reach(truth):
            return
        vel = truth.vel_frd_m_s if bottom else truth.vel_water_frd_m_s
        vel = vel + np.cross(truth.rate_frd_rad_s, self._mount_frd_m)
        vel = self._scale * (self._r_dvl_from_frd @ vel) + self._bias_m_s + self._sensor.sigma_m_s * noise[:3]
        if chance[1] < self._sensor.outlier_probability:
            vel = vel + self._sensor.outlier_m_s * (2.0 * chance[2:5] - 1.0)
        sample = VelocitySample(
            t_us=truth.t_us,
            vel_frd_m_s=self._read(truth.t_us, vel),
            sigma_m_s=np.full(3, self._sensor.sigma_m_s),
            lock=VelocityLock.BOTTOM if bottom else VelocityLock.WATER,
        )
        self._send(truth.t_us, float(noise[3]), sample)

    def _in_reach(self, truth: Truth) -> bool:
        if self._world.floor_depth_m is None:
            return True
        depth_m = float(truth.pos_ned_m[2] + r_ned_from_frd(truth.rpy_rad)[2] @ self._mount_frd_m)
        return bool(
            self._sensor.least_altitude_m <= self._world.floor_depth_m - depth_m <= self._sensor.most_altitude_m
        )
