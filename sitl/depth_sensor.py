"""A simulated pressure sensor: depth where it sits, with an offset that wanders."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from autopilot.core.frames import r_ned_from_frd
from autopilot.core.samples import DepthSample
from autopilot.core.vehicle import DepthMount
from autopilot.drivers.base import AlwaysOpen
from autopilot.sitl.delayed import DelayedSamples
from autopilot.sitl.fault_tables import SensorFrozen
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario import DepthSensor, Fault
from autopilot.sitl.waves import WaveTrain


class SimDepthSensor(AlwaysOpen):
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
        self._waves = waves
        self._sensor = sensor
        self._mount_frd_m = np.array(mount.position_frd_m)
        self._rng = np.random.default_rng((seed, 40))
        rate_hz = sensor.rate_hz or mount.rate_hz
        self._line: DelayedSamples[DepthSample] = DelayedSamples(
            rate_hz=rate_hz,
            latency_s=mount.latency_s if sensor.latency_s is None else sensor.latency_s,
            jitter_s=sensor.latency_jitter_s,
            drop_probability=sensor.drop_probability,
            outages=sensor.outages,
            faults=faults,
            sensor="depth",
            rng=np.random.default_rng((seed, 41)),
        )
        self._frozen = [f for f in faults if isinstance(f, SensorFrozen) and f.sensor == "depth"]
        self._last_m = 0.0
        self._offset_m = sensor.bias_m * float(self._rng.standard_normal())
        self._walk_m = sensor.drift_m_rts / math.sqrt(rate_hz)

    @property
    def next_us(self) -> int:
        """When the next sample is taken."""
        return self._line.next_us

    def add(self, fault: Fault) -> bool:
        """A fault that begins while the simulation runs; whether it is one of this sensor."""
        return self._line.add(fault)

    def observe(self, truth: Truth) -> None:
        """Take the sample that is due at ``truth.t_us``."""
        self._line.advance()
        noise, chance = self._rng.standard_normal(3).tolist(), self._rng.random(3).tolist()
        self._offset_m += self._walk_m * noise[0]
        if self._line.lost(truth.t_us, chance[0]):
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
        self._line.send(truth.t_us, noise[2], sample)

    def poll(self, t_us: int) -> Sequence[DepthSample]:
        """What has arrived up to ``t_us``."""
        return self._line.poll(t_us)
