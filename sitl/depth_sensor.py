"""A simulated pressure sensor: depth where it sits, with an offset that wanders."""

import math
from collections.abc import Iterable

import numpy as np

from autopilot.core.frames import r_ned_from_frd
from autopilot.core.samples import DepthSample
from autopilot.core.vehicle import DepthMount
from autopilot.sitl.delayed import LossySensor
from autopilot.sitl.fault_tables import SensorFrozen
from autopilot.sitl.optional_sensors import SensedWorld
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Fault
from autopilot.sitl.sensor_tables import DepthSensor
from autopilot.sitl.waves import WaveTrain


class SimDepthSensor(LossySensor[DepthSample]):
    """Takes samples of the truth and delivers them after their latency."""

    def __init__(
        self,
        sensor: DepthSensor,
        mount: DepthMount,
        faults: Iterable[Fault],
        seed: int,
        waves: WaveTrain | None = None,
    ) -> None:
        """``waves``: over it; their pressure is taken for depth."""
        faults = list(faults)
        super().__init__(sensor, (mount.rate_hz, mount.latency_s), faults, (seed, 40), sensor="depth")
        self._waves = waves
        self._sensor = sensor
        self._mount_frd_m = np.array(mount.position_frd_m)
        self._frozen = [f for f in faults if isinstance(f, SensorFrozen) and f.sensor == "depth"]
        self._last_m = 0.0
        self._offset_m = sensor.bias_m * float(self._rng.standard_normal())
        self._walk_m = sensor.drift_m_rts / math.sqrt(self._rate_hz)

    @classmethod
    def of(
        cls, table: DepthSensor, mount: DepthMount, world: SensedWorld, faults: Iterable[Fault], seed: int
    ) -> "SimDepthSensor":
        return cls(table, mount, faults, seed, world.waves)

    def observe(self, truth: Truth) -> None:
        self._taken()
        noise, chance = self._rng.standard_normal(3).tolist(), self._rng.random(3).tolist()
        self._offset_m += self._walk_m * noise[0]
        if self._lost(truth.t_us, chance[0]):
            return
        turned = r_ned_from_frd(truth.rpy_rad)
        below_m = float(turned[2] @ self._mount_frd_m)
        depth_m = float(truth.pos_ned_m[2]) + below_m + self._offset_m + self._sensor.sigma_m * noise[1]
        if self._waves is not None:
            place = truth.pos_ned_m + turned @ self._mount_frd_m
            depth_m += self._waves.pressed_m(place.tolist(), truth.t_us * 1e-6)
        if chance[1] < self._sensor.outlier_probability:
            depth_m += self._sensor.outlier_m * (2.0 * chance[2] - 1.0)
        if any(fault.holds(truth.t_us) for fault in self._frozen):
            depth_m = self._last_m
        self._last_m = depth_m
        sample = DepthSample(t_us=truth.t_us, depth_m=depth_m, sigma_m=self._sensor.sigma_m)
        self._send(truth.t_us, noise[2], sample)
