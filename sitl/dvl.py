"""A simulated Doppler velocity log: velocity of the place where it sits, over ground or through the water."""

from collections.abc import Iterable

import numpy as np

from autopilot.core.frames import r_ned_from_frd
from autopilot.core.samples import VelocityLock, VelocitySample
from autopilot.core.vehicle import DvlMount
from autopilot.sitl.delayed import LossySensor
from autopilot.sitl.fault_tables import SensorFrozen
from autopilot.sitl.optional_sensors import SensedWorld
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Fault
from autopilot.sitl.sensor_tables import DvlSensor


class SimDvl(LossySensor[VelocitySample]):
    """Takes samples of the truth and delivers them after their latency."""

    def __init__(
        self, sensor: DvlSensor, mount: DvlMount, floor_depth_m: float | None, faults: Iterable[Fault], seed: int
    ) -> None:
        """``floor_depth_m`` None: the floor is always in reach."""
        faults = list(faults)
        super().__init__(sensor, (mount.rate_hz, mount.latency_s), faults, (seed, 50), sensor="dvl")
        self._frozen = [f for f in faults if isinstance(f, SensorFrozen) and f.sensor == "dvl"]
        self._last_m_s = np.zeros(3)
        self._sensor = sensor
        self._mount_frd_m = np.array(mount.position_frd_m)
        self._floor_depth_m = floor_depth_m
        self._bias_m_s = sensor.bias_m_s * self._rng.standard_normal(3)
        self._scale = 1.0 + sensor.scale_error * float(self._rng.standard_normal())

    @classmethod
    def of(cls, table: DvlSensor, mount: DvlMount, world: SensedWorld, faults: Iterable[Fault], seed: int) -> "SimDvl":
        return cls(table, mount, world.floor_depth_m, faults, seed)

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
        vel = self._scale * vel + self._bias_m_s + self._sensor.sigma_m_s * noise[:3]
        if chance[1] < self._sensor.outlier_probability:
            vel = vel + self._sensor.outlier_m_s * (2.0 * chance[2:5] - 1.0)
        if any(fault.holds(truth.t_us) for fault in self._frozen):
            vel = self._last_m_s
        self._last_m_s = vel
        sample = VelocitySample(
            t_us=truth.t_us,
            vel_frd_m_s=vel,
            sigma_m_s=np.full(3, self._sensor.sigma_m_s),
            lock=VelocityLock.BOTTOM if bottom else VelocityLock.WATER,
        )
        self._send(truth.t_us, float(noise[3]), sample)

    def _in_reach(self, truth: Truth) -> bool:
        if self._floor_depth_m is None:
            return True
        depth_m = float(truth.pos_ned_m[2] + r_ned_from_frd(truth.rpy_rad)[2] @ self._mount_frd_m)
        return self._sensor.least_altitude_m <= self._floor_depth_m - depth_m <= self._sensor.most_altitude_m
