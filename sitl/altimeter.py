"""A simulated sonar altimeter: range to the floor, with noise, multiple echoes, and dropouts."""

import math
from collections.abc import Iterable

import numpy as np

from autopilot.core.frames import r_ned_from_frd
from autopilot.core.samples import AltimeterSample
from autopilot.core.vehicle import AltimeterMount
from autopilot.sitl.optional_sensors import OptionalSensor, SensedWorld
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Fault
from autopilot.sitl.sensor_tables import AltimeterSensor

GRAZING_RAD = math.radians(15.0)
"""So far beyond the edge of its beam a smooth floor throws nothing back."""


class SimAltimeter(OptionalSensor[AltimeterSample, float]):
    name, seed, nothing = "altimeter", 60, 0.0

    def __init__(
        self, table: AltimeterSensor, mount: AltimeterMount, world: SensedWorld, faults: Iterable[Fault], seed: int
    ) -> None:
        super().__init__(table, mount, world, faults, seed)
        beam = np.array(mount.direction_frd)
        self._beam_frd = beam / np.linalg.norm(beam)
        self._half_beam_rad = 0.5 * mount.beam_width_rad
        self._scale = 1.0 + table.scale_error * float(self._rng.standard_normal())

    def observe(self, truth: Truth) -> None:
        self._taken()
        noise, chance = self._rng.standard_normal(2).tolist(), self._rng.random(3).tolist()
        range_m = self._echo_m(truth)
        if self._lost(truth.t_us, chance[0]) or range_m is None:
            return
        sigma_m = math.hypot(self._sensor.sigma_m, self._sensor.sigma_share * range_m)
        range_m = self._scale * range_m + sigma_m * noise[0]
        if chance[1] < self._sensor.multiple_probability:
            range_m *= 2.0
        range_m = self._read(truth.t_us, range_m)
        if self._sensor.least_range_m <= range_m <= self._sensor.most_range_m:
            confidence = max(0.0, 1.0 - 0.3 * chance[2])
            sample = AltimeterSample(t_us=truth.t_us, range_m=range_m, sigma_m=sigma_m, confidence=confidence)
            self._send(truth.t_us, noise[1], sample)

    def _echo_m(self, truth: Truth) -> float | None:
        """Range to the nearest point of the floor within the beam, None = no echo."""
        if self._world.floor_depth_m is None:
            return None
        r = r_ned_from_frd(truth.rpy_rad)
        height_m = self._world.floor_depth_m - float(truth.pos_ned_m[2] + r[2] @ self._mount_frd_m)
        off_rad = math.acos(max(-1.0, min(1.0, float(r[2] @ self._beam_frd)))) - self._half_beam_rad
        if height_m <= 0.0 or off_rad > GRAZING_RAD:
            return None
        return height_m / math.cos(max(0.0, off_rad))
