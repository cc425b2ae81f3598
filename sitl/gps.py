"""A simulated satellite receiver: fixes while its antenna is above the water, with errors that change slowly."""

import math
from collections.abc import Iterable

from autopilot.core.frames import r_ned_from_frd
from autopilot.core.geodesy import Origin, place_from_ned
from autopilot.core.samples import GpsSample
from autopilot.core.vehicle import GpsMount
from autopilot.sitl.optional_sensors import OptionalSensor, SensedWorld
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Fault
from autopilot.sitl.sensor_tables import GpsSensor


class SimGps(OptionalSensor[GpsSample, tuple[float, float]]):
    name, seed, nothing = "gps", 80, (0.0, 0.0)

    def __init__(
        self, table: GpsSensor, mount: GpsMount, world: SensedWorld, faults: Iterable[Fault], seed: int
    ) -> None:
        super().__init__(table, mount, world, faults, seed)
        self._origin = world.origin or Origin(lat_deg=0.0, lon_deg=0.0)
        self._slow_m = table.sigma_m * self._rng.standard_normal(2)
        self._keep = math.exp(-1.0 / (self._rate_hz * table.error_time_s))
        self._dry_us: int | None = -round(1e6 * table.acquire_s)
        """Since when the antenna has been above the water, None = it is not."""

    def observe(self, truth: Truth) -> None:
        self._taken()
        noise, chance = self._rng.standard_normal(5), self._rng.random(1).item()
        fresh_m = self._sensor.sigma_m * math.sqrt(1.0 - self._keep * self._keep)
        self._slow_m = self._keep * self._slow_m + fresh_m * noise[:2]
        antenna_ned_m = truth.pos_ned_m + r_ned_from_frd(truth.rpy_rad) @ self._mount_frd_m
        if antenna_ned_m[2] > 0.0:
            self._dry_us = None
            return
        self._dry_us = truth.t_us if self._dry_us is None else self._dry_us
        acquired = truth.t_us - self._dry_us >= 1e6 * self._sensor.acquire_s
        if self._lost(truth.t_us, chance) or not acquired:
            return
        seen = antenna_ned_m[:2] + self._slow_m + self._sensor.noise_m * noise[2:4]
        north_m, east_m = self._read(truth.t_us, (float(seen[0]), float(seen[1])))
        place = place_from_ned(self._origin, north_m, east_m, float(antenna_ned_m[2]))
        if place is not None:
            sigma_m = math.hypot(self._sensor.sigma_m, self._sensor.noise_m)
            sample = GpsSample(
                t_us=truth.t_us, lat_deg=place.lat_deg, lon_deg=place.lon_deg, alt_m=place.alt_m, sigma_m=sigma_m
            )
            self._send(truth.t_us, float(noise[4]), sample)
