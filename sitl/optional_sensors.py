"""Simulated sensors that a scenario may have, and their construction."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.geodesy import Origin, place_from_ned
from autopilot.core.samples import (
    AltimeterSample,
    DepthSample,
    GpsSample,
    HullSample,
    LeakSample,
    ObstacleTrack,
    Sample,
    VelocityLock,
    VelocitySample,
)
from autopilot.core.sensors import SENSOR_ROWS
from autopilot.core.vehicle import AltimeterMount, DepthMount, DvlMount, GpsMount, Vehicle
from autopilot.drivers.base import AlwaysOpen
from autopilot.sitl.contact import MotionSample, MovingPath
from autopilot.sitl.delayed import DelayedSensor, LossySensor, OutageClock
from autopilot.sitl.fault_tables import HullClimate, Leak, SensorFrozen
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import CylinderObstacle, Fault, MovingObstacle, Obstacle
from autopilot.sitl.sensor_tables import (
    AltimeterSensor,
    DepthSensor,
    DvlSensor,
    GpsSensor,
    HullSensor,
    ObstacleSensor,
    Outages,
    Sensors,
)
from autopilot.sitl.simulated_waters import moving_path
from autopilot.sitl.waves import WaveTrain

S = TypeVar("S", bound=Sample)
V = TypeVar("V")
GRAZING_RAD = math.radians(15.0)
"""So far beyond the edge of its beam a smooth floor throws nothing back."""
PERIOD_US = 500_000


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SensedWorld:
    floor_depth_m: float | None = None
    """None = open water."""
    waves: WaveTrain | None = None
    origin: Origin | None = None
    """Of the local frame; None = no sensor needs it."""


class OptionalSensor(LossySensor[S], Generic[S, V]):
    """Samples the truth at its mounting position and delivers after the latency; ``V`` is the type of a reading."""

    name: ClassVar[str]
    """What faults call it."""
    seed: ClassVar[int]
    """Of its random numbers; the next one is that of its gaps."""
    nothing: V
    """What it repeats when it is frozen before its first reading."""

    def __init__(self, table: Any, mount: Any, world: SensedWorld, faults: Iterable[Fault], seed: int) -> None:
        """``table``: of the scenario; ``mount``: of the vehicle file."""
        faults = list(faults)
        super().__init__(table, (mount.rate_hz, mount.latency_s), faults, (seed, self.seed), sensor=self.name)
        self._sensor, self._world = table, world
        self._mount_frd_m = np.array(mount.position_frd_m)
        self._frozen = [f for f in faults if isinstance(f, SensorFrozen) and f.sensor == self.name]
        self._last = self.nothing

    def observe(self, truth: Truth) -> None:
        """Take the sample that is due at ``truth.t_us``."""
        raise NotImplementedError

    def _read(self, t_us: int, value: V) -> V:
        """The reading, or the last one while the sensor is frozen."""
        if not any(fault.holds(t_us) for fault in self._frozen):
            self._last = value
        return self._last


def optional_sensors(
    sensors: Sensors, vehicle: Vehicle, world: SensedWorld, faults: Iterable[Fault], seed: int
) -> list[OptionalSensor[Any, Any]]:
    found = []
    for row in SENSOR_ROWS:
        table = getattr(sensors, row.device) if row.simulated else None
        if table is not None:
            module, _, name = row.simulated.partition(":")
            kind: type[OptionalSensor[Any, Any]] = getattr(import_module(module), name)
            found.append(kind(table, getattr(vehicle, row.table), world, faults, seed))
    return found


class SimDepthSensor(OptionalSensor[DepthSample, float]):
    """Depth with a drifting offset. The pressure of waves over it is taken for depth."""

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


class SimDvl(OptionalSensor[VelocitySample, FloatArray]):
    """Velocity over ground or through the water. In open water the floor is always in reach."""

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


class SimAltimeter(OptionalSensor[AltimeterSample, float]):
    """A sonar altimeter: range to the floor, with noise, multiple echoes, and dropouts."""

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


class SimGps(OptionalSensor[GpsSample, tuple[float, float]]):
    """A satellite receiver: fixes while its antenna is above the water, with errors that change slowly."""

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


class SimHullSensor(AlwaysOpen):
    """Leak probe, barometer, thermometer: constant conditions inside the hull, independent of the truth."""

    def __init__(self, sensor: HullSensor, faults: Iterable[Fault]) -> None:
        self._sensor = sensor
        faults = list(faults)
        self._leaks = [fault for fault in faults if isinstance(fault, Leak)]
        self._climate = [fault for fault in faults if isinstance(fault, HullClimate)]
        self._gaps = OutageClock(Outages(), faults, np.random.default_rng(0), sensor="hull")
        self._samples: list[LeakSample | HullSample] = []
        self.next_us = 0
        """When it samples next."""

    def add(self, fault: Fault) -> bool:
        """A fault that begins while the simulation runs; whether it is one of this sensor."""
        if isinstance(fault, Leak):
            self._leaks.append(fault)
        elif isinstance(fault, HullClimate):
            self._climate.append(fault)
        else:
            return self._gaps.add(fault)
        return True

    def observe(self, truth: Truth) -> None:
        t_us = truth.t_us
        self.next_us += PERIOD_US
        if self._gaps.silent(t_us):
            return
        pressure_pa, temperature_c = self._sensor.pressure_pa, self._sensor.temperature_c
        for fault in self._climate:
            if fault.holds(t_us):
                pressure_pa = pressure_pa if fault.pressure_pa is None else fault.pressure_pa
                temperature_c = temperature_c if fault.temperature_c is None else fault.temperature_c
        self._samples += [
            LeakSample(t_us=t_us, wet=any(leak.holds(t_us) for leak in self._leaks)),
            HullSample(t_us=t_us, pressure_pa=pressure_pa, temperature_c=temperature_c),
        ]

    def poll(self, t_us: int) -> list[LeakSample | HullSample]:
        samples, self._samples = self._samples, []
        return samples


class SimObstacleSensor(DelayedSensor[ObstacleTrack]):
    """An obstacle sensor (e.g. an imaging sonar with tracker): tracks of moving and of unmapped obstacles.

    Obstacles in the fence are not reported. Every report is a track with its own time, with noise on position and
    velocity, and arrives after the latency."""

    def __init__(self, sensor: ObstacleSensor, obstacles: Sequence[Obstacle], seed: int) -> None:
        super().__init__(sensor.rate_hz, sensor.latency_s)
        self._sensor = sensor
        self._rng = np.random.default_rng((seed, 30))
        self._seen: list[tuple[int, MovingPath | MotionSample, float]] = []
        for number, obstacle in enumerate(obstacles, start=1):
            if isinstance(obstacle, MovingObstacle):
                self._seen.append((number, moving_path(obstacle), obstacle.radius_m))
            elif isinstance(obstacle, CylinderObstacle) and obstacle.surprise:
                self._seen.append((number, MotionSample(obstacle.center_m, (0.0, 0.0)), obstacle.radius_m))

    @property
    def blind(self) -> bool:
        """There is nothing in this world that it would ever report."""
        return not self._seen

    def put(self, number: int, north_m: float, east_m: float, radius_m: float) -> None:
        """Move an obstacle away from its mapped position: from now on it is reported."""
        self._seen = [seen for seen in self._seen if seen[0] != number]
        self._seen.append((number, MotionSample((north_m, east_m), (0.0, 0.0)), radius_m))

    def begin(self, t_us: int) -> None:
        """Look from then on: so far there was nothing to be seen."""
        self._count = math.ceil(1e-6 * t_us * self._rate_hz) - 1
        self._taken()

    def observe(self, truth: Truth) -> None:
        self._taken()
        for number, path, radius_m in self._seen:
            motion = path.at(truth.t_us * 1e-6) if isinstance(path, MovingPath) else path
            noise = self._rng.standard_normal(4)
            center, velocity = np.array(motion.center_ned_m), np.array(motion.velocity_ned_m_s)
            if np.hypot(*(truth.pos_ned_m[:2] - center)) - radius_m > self._sensor.range_m:
                continue
            if velocity.any():
                velocity = velocity + self._sensor.sigma_velocity_m_s * noise[2:]
            report = ObstacleTrack(
                t_us=truth.t_us,
                track_id=number,
                pos_ned_m=center + self._sensor.sigma_m * noise[:2],
                vel_ned_m_s=velocity,
                radius_m=radius_m,
            )
            self._send(truth.t_us, 0.0, report)
