"""State of the vehicle: estimate, battery, thrusters, sensors, links.

One object, changed in place. Values that have never been received are NaN, which exceeds no bound.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from statistics import median_low

from autopilot.command.command_tuning import VEHICLE_STATUS
from autopilot.control.thrust.by_hand import PositionlessState
from autopilot.core.echoes import RecentEchoes
from autopilot.core.frames import FloatArray
from autopilot.core.messages import FlightControllerState, Inputs, NavDoubt, NavHealth, NavState
from autopilot.core.samples import (
    AhrsSample,
    DepthSample,
    HullSample,
    LeakSample,
    PilotSample,
    PowerSample,
    Sample,
    VelocitySample,
    possible_depth,
    possible_velocity,
)
from autopilot.mavlink.api import Sticks

NEVER = math.nan


QUIET, IMPLAUSIBLE = "silent or frozen", "implausible"
"""Faults of a sensor without valid data."""
FRESH_US = 1_000_000
"""Age beyond which a range is invalid: the vehicle has moved."""
SLOW_INTERVALS = 2.5
"""The newest range of a slow sonar is valid for so many of its intervals, each taken for ``FRESH_US`` at most: a lost
reading is no loss of the floor."""

READINGS = 5
"""Length of the median filter: rejects fish and multipath echoes. Of an even number the nearer one counts."""

SENSORS = ("altimeter", "laser")
"""Order of preference among sensors with recent data: a sonar's wide beam sees the floor also through silt."""

_NOWHERE = (math.nan, math.nan, math.nan)


@dataclass(slots=True, eq=False)
class _SensorRecord:
    """Status of one sensor that has delivered data."""

    last_us: int
    """Time of its last new data."""
    reading: object = None
    equal: int = 0
    how: str = QUIET
    """Its fault while it has no new data."""
    pushed_n: tuple[float, float] = (0.0, 0.0)
    """Least and most thrust that was commanded since ``reading`` changed."""

    def repeats(self, reading: object) -> bool:
        """Whether this reading is the last one again, to the last digit."""
        again = reading == self.reading
        self.reading, self.equal = reading, self.equal + 1 if again else 0
        return again


@dataclass(slots=True, eq=False)
class _Ranges:
    position_frd_m: tuple[float, float, float] = _NOWHERE
    direction_frd: tuple[float, float, float] = _NOWHERE
    readings: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=READINGS))
    """Time and range, multiples left out."""
    echoes: RecentEchoes = field(default_factory=RecentEchoes)
    record: _SensorRecord = field(default_factory=lambda: _SensorRecord(0))
    held_ned_m: FloatArray | None = None
    """Place of the vehicle when the range was new; None = not known."""

    def frozen(self, pos_ned_m: FloatArray | None) -> bool:
        """Whether it goes on with an old range while the vehicle moves: at rest over a level floor it may."""
        if self.record.equal + 1 < VEHICLE_STATUS.frozen_readings or pos_ned_m is None or self.held_ned_m is None:
            return False
        return math.dist(pos_ned_m, self.held_ned_m) >= VEHICLE_STATUS.frozen_m

    def valid_m(self, t_us: int) -> list[float]:
        """Ranges that count, none = the floor is not seen."""
        fresh = [range_m for then_us, range_m in self.readings if t_us - then_us <= FRESH_US]
        if fresh or len(self.readings) < 2:
            return fresh
        (first_us, _), (newest_us, newest_m) = self.readings[0], self.readings[-1]
        interval_us = min((newest_us - first_us) / (len(self.readings) - 1), FRESH_US)
        return [newest_m] if t_us - newest_us <= SLOW_INTERVALS * interval_us else []


class FloorRanges:
    """Altitude above the floor by the newest ranges of each downward sensor."""

    def __init__(self) -> None:
        self._ranges = {name: _Ranges() for name in SENSORS}

    def mount(
        self, name: str, position_frd_m: tuple[float, float, float], direction_frd: tuple[float, float, float]
    ) -> None:
        """Position and direction (any length) of a sensor in the body frame."""
        x, y, z = direction_frd
        length = math.hypot(x, y, z)
        self._ranges[name] = _Ranges(position_frd_m, (x / length, y / length, z / length))

    def note(self, name: str, t_us: int, range_m: float, pos_ned_m: FloatArray | None = None) -> _SensorRecord | None:
        """One reading of a sensor, along its beam. Its record if it is frozen."""
        ranges = self._ranges[name]
        if not ranges.record.repeats(range_m):
            ranges.record.last_us, ranges.held_ned_m = t_us, pos_ned_m
        if ranges.frozen(pos_ned_m):
            ranges.readings.clear()
            return ranges.record
        # A single one at half the range is a fish above the floor.
        if math.isfinite(range_m) and range_m > 0.0 and ranges.echoes.add(t_us, range_m).at_half < 2:
            ranges.readings.append((t_us, range_m))
        return None

    def height_m(self, t_us: int, rpy_rad: FloatArray | None) -> float | None:
        """Of the vehicle's centre over the floor, None = not known; ``rpy_rad`` (3,), None = level."""
        for name in SENSORS:
            ranges = self._ranges[name]
            valid_m = ranges.valid_m(t_us)
            if valid_m:
                below_m = median_low(valid_m) * _below(rpy_rad, ranges.direction_frd)
                height_m = below_m + _below(rpy_rad, ranges.position_frd_m)
                return height_m if height_m > 0.0 else None
        return None


def _below(rpy_rad: FloatArray | None, frd: tuple[float, float, float]) -> float:
    """The part of a vector that points down."""
    forward, right, down = frd
    if rpy_rad is None:
        return down
    roll, pitch, _ = rpy_rad.tolist()
    sideways = right * math.sin(roll) + down * math.cos(roll)
    return float(sideways * math.cos(pitch) - forward * math.sin(pitch))


@dataclass(slots=True, eq=False, kw_only=True)
class VehicleStatus:
    """Read by modes, failsafes and arming; times in service time [us].

    The first fields are set once per tick, just before the commander's step, so that a request between two ticks
    sees those of the last one. The others are set by the samples as they arrive.
    """

    t_us: int = 0
    """Of the tick."""
    nav: NavState | None = None
    power: PowerSample | None = None
    """The newest reading of the battery that is plausible."""
    ahrs_age_s: float | None = None
    """Since the last good sample (a frozen device sends none), None before the first."""
    fixed: bool = False
    """A fix has agreed with the estimate of late."""
    solver_failures: int = 0
    """NMPC steps in a row without a solution."""
    unreachable: bool = False
    """The controller finds no path to its goal."""
    shortfall: str = ""
    """What is missing to reach it in the present current, "" = nothing."""
    path_left_m: float | None = None
    """Length of the path to the goal as the controller flies it, None without one."""
    nav_doubts: frozenset[NavDoubt] = frozenset()
    """Evidence against the estimate or its sensors."""
    camera_problem: str = ""
    """Why pictures are not used although they come."""
    nav_disagrees: bool = False
    """The shadow estimator has been somewhere else for a while."""
    thruster_effectiveness: tuple[float, ...] = ()
    """Effectiveness of each thruster, in the order of the vehicle file; empty = not known."""
    thrusters_doubtful: tuple[tuple[str, ...], ...] = ()
    """Groups of redundant thrusters, one of which is weak: their loss is shared out equally."""
    thruster_problem: str = ""
    """Axes that the remaining thrusters cannot drive."""
    watchdog_problem: str = ""
    """Fault of the watchdog process."""
    thrusters_unseen: tuple[str, ...] = ()
    """Thrusters used too little for a loss of half their thrust to be noticed."""
    command_delay_s: float = 0.0
    """Command latency; 0 until it is certain."""
    fault: str = ""
    """Internal faults of the last seconds."""
    below: FlightControllerState | None = None
    """The flight controller, None without one."""
    refusals: tuple[str, ...] = ()
    """Reasons of devices against arming."""
    sticks: Sticks | None = None
    """Of the pilot, None = no pilot."""

    gcs_us: float = NEVER
    """Last heartbeat of a ground station or companion."""
    pilot_us: float = NEVER
    """Last input of a pilot."""
    wet_us: float = NEVER
    """When a leak probe was last wet."""
    hull_pa: float = NEVER
    hull_c: float = NEVER
    late_fraction: float = NEVER
    """Of the ticks of the last second."""
    log_lost: bool = False
    jumped_us: float = NEVER
    """When the clock of day last jumped."""
    collided_us: float = NEVER
    yaw_rad: float = NEVER
    """Of the AHRS, which has an unknown offset."""
    yaw_rate_rad_s: float = 0.0
    ahrs_us: float = NEVER
    """Time of its last report."""
    depth_m: float = NEVER
    """Of the pressure sensor."""
    depth_us: float = NEVER
    floor: FloorRanges = field(default_factory=FloorRanges)
    """Downward range sensors."""
    thrust_n: FloatArray | None = None
    """(n,) commanded now."""
    sensors: dict[str, _SensorRecord] = field(default_factory=dict)
    """Those that have been received and have to go on."""
    _late: int = 0
    _late_us: int = 0

    @property
    def estimate(self) -> NavState | None:
        """The estimate, None if it is missing or lost."""
        return None if self.nav is None or self.nav.health is NavHealth.INVALID else self.nav

    def note(self, inputs: Inputs) -> None:
        t_us = inputs.t_us
        self.log_lost = inputs.log_lost
        if inputs.clock_jump_s and abs(inputs.clock_jump_s) >= VEHICLE_STATUS.jump_s:
            self.jumped_us = t_us
        if t_us - self._late_us >= VEHICLE_STATUS.late_every_us:
            since_ticks = (t_us - self._late_us) * 1e-4
            self.late_fraction = (inputs.overruns - self._late) / since_ticks
            self._late, self._late_us = inputs.overruns, t_us

    def note_ahrs(self, t_us: int, sample: AhrsSample) -> None:
        yaw, rate = sample.rpy_rad.item(2), sample.rate_frd_rad_s.item(2)
        if math.isfinite(yaw + rate):
            self.yaw_rad, self.yaw_rate_rad_s, self.ahrs_us = yaw, rate, t_us

    def measured(self, t_us: int) -> PositionlessState:
        """Attitude and depth that are known without a position, if not too old."""
        yaw = self.yaw_rad if t_us - self.ahrs_us <= VEHICLE_STATUS.fresh_us else None
        depth = self.depth_m if t_us - self.depth_us <= VEHICLE_STATUS.fresh_us else None
        return PositionlessState(yaw_rad=yaw, yaw_rate_rad_s=self.yaw_rate_rad_s, depth_m=depth)

    def note_range(self, t_us: int, name: str, range_m: float) -> None:
        """One range to the floor. A sensor that sees none is no fault: it counts as one only while it is frozen."""
        frozen = self.floor.note(name, t_us, range_m, None if self.nav is None else self.nav.pos_ned_m)
        if frozen is None:
            self.sensors.pop(name, None)
        else:
            self.sensors[name] = frozen

    def note_sample(self, t_us: int, sample: Sample) -> None:
        """One sample other than AHRS, which arrives at every tick."""
        if isinstance(sample, LeakSample):
            self._spoke(t_us, "leak probe")
            if sample.wet:
                self.wet_us = t_us
        elif isinstance(sample, HullSample):
            self._note_hull(t_us, sample)
        elif isinstance(sample, PilotSample):
            self.pilot_us = t_us
        elif isinstance(sample, DepthSample):
            if possible_depth(sample.depth_m):
                self._read(t_us, "depth sensor", sample.depth_m)
                self.depth_m, self.depth_us = sample.depth_m, t_us
            else:
                self.note_implausible(t_us, "depth sensor")
        elif isinstance(sample, VelocitySample):
            if possible_velocity(sample.vel_frd_m_s):
                self._read(t_us, "velocity log", sample.vel_frd_m_s.tobytes())
            else:
                self.note_implausible(t_us, "velocity log")
        elif isinstance(sample, PowerSample):
            self._note_power(t_us, sample)

    def _note_power(self, t_us: int, sample: PowerSample) -> None:
        """A monitor at rest repeats itself; one that measures a current does not while the thrust changes."""
        record = self.sensors.setdefault("power monitor", _SensorRecord(t_us))
        held = record.reading
        same = (
            isinstance(held, PowerSample)
            and sample.current_a != 0.0
            and abs(sample.voltage_v - held.voltage_v) <= VEHICLE_STATUS.frozen_v
            and abs(sample.current_a - held.current_a) <= VEHICLE_STATUS.frozen_a
        )
        pushed_n = 0.0 if self.thrust_n is None else float(abs(self.thrust_n).sum())
        low_n, high_n = record.pushed_n if same else (pushed_n, pushed_n)
        record.pushed_n = low_n, high_n = min(low_n, pushed_n), max(high_n, pushed_n)
        record.reading, record.equal = (held, record.equal + 1) if same else (sample, 0)
        if record.equal < VEHICLE_STATUS.frozen_readings or high_n - low_n < VEHICLE_STATUS.frozen_thrust_n:
            record.last_us, record.how = t_us, QUIET

    def _note_hull(self, t_us: int, sample: HullSample) -> None:
        """Each of its values counts alone; one that is not finite is a fault of the sensor."""
        given = [value for value in (sample.pressure_pa, sample.temperature_c) if value is not None]
        if all(map(math.isfinite, given)):
            self._spoke(t_us, "hull sensor")
        else:
            self.note_implausible(t_us, "hull sensor")
        if sample.pressure_pa is not None and math.isfinite(sample.pressure_pa):
            self.hull_pa = sample.pressure_pa
        if sample.temperature_c is not None and math.isfinite(sample.temperature_c):
            self.hull_c = sample.temperature_c

    def silent(self, t_us: int) -> tuple[float, str]:
        """Longest time without data [s] over the sensors that have delivered any, and which; NaN without any."""
        if not self.sensors:
            return NEVER, ""
        name = min(self.sensors, key=self._last_us)
        return 1e-6 * (t_us - self.sensors[name].last_us), name

    def note_implausible(self, t_us: int, name: str) -> None:
        """An implausible value: the sensor is alive, but counts as silent."""
        self.sensors.setdefault(name, _SensorRecord(t_us)).how = IMPLAUSIBLE

    def how_silent(self, name: str) -> str:
        """Fault of the sensor that :meth:`silent` returned."""
        return self.sensors[name].how if name else ""

    def _last_us(self, name: str) -> int:
        return self.sensors[name].last_us

    def _spoke(self, t_us: int, name: str) -> None:
        record = self.sensors.get(name)
        if record is None:
            self.sensors[name] = _SensorRecord(t_us)
        else:
            record.last_us, record.how = t_us, QUIET

    def _read(self, t_us: int, name: str, reading: object) -> None:
        """A reading that repeats itself to the last digit is as good as none."""
        record = self.sensors.get(name)
        if record is None:
            record = self.sensors[name] = _SensorRecord(t_us)
        record.repeats(reading)
        if record.equal < VEHICLE_STATUS.frozen_readings:
            record.last_us, record.how = t_us, QUIET
