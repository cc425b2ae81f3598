"""A simulated pressure sensor: depth at its mounting position, with a drifting offset."""

import math
from collections.abc import Iterable

from autopilot.core.frames import r_ned_from_frd
from autopilot.core.samples import DepthSample
from autopilot.core.vehicle import DepthMount
from autopilot.sitl.optional_sensors import OptionalSensor, SensedWorld
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Fault
from autopilot.sitl.sensor_tables import DepthSensor


class SimDepthSensor(OptionalSensor[DepthSample, float]):
    """The pressure of waves over it is taken for depth."""

    name, seed, nothing = "depth", 40, 0.0

    def __init__(
        self, table: DepthSensor, mount: DepthMount, world: SensedWorld, faults: Iterable[Fault], seed: int
    ) -> None:
        super().__init__(table, mount, world, faults, seed)
        self._offset_m = table.bias_m * float(self._rng.standard_normal())
        self._walk_m = table.drift_m_rts / math.sqrt(self._rate_hz)

    def observe(self, truth: Truth) -> None:
        self._taken()
        noise, chance = self._rng.standard_normal(3).tolist(), self._rng.random(3).tolist()
        self._offset_m += self._walk_m * noise[0]
        if self._lost(truth.t_us, chance[0]):
            return
        depth_m = truth.depth_of(self._mount_frd_m) + self._offset_m + self._sensor.sigma_m * noise[1]
        if self._world.waves is not None:
            place = truth.pos_ned_m + r_ned_from_frd(truth.rpy_rad) @ self._mount_frd_m
            depth_m += self._world.waves.pressed_m(place.tolist(), truth.t_us * 1e-6)
        if chance[1] < self._sensor.outlier_probability:
            depth_m += self._sensor.outlier_m * (2.0 * chance[2] - 1.0)
        depth_m = self._read(truth.t_us, depth_m)
        sample = DepthSample(t_us=truth.t_us, depth_m=depth_m, sigma_m=self._sensor.sigma_m)
        self._send(truth.t_us, noise[2], sample)
