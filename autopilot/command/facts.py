"""What the service is told beside the estimate, as failsafes look at it: the newest of each, plain numbers.

One object, changed in place and only when something comes: a tick on which nothing does costs nothing. What has never
been heard is NaN, which no bound exceeds.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from autopilot.command.command_tuning import FACTS
from autopilot.command.floor_ranges import FloorRanges
from autopilot.control.thrust.by_hand import Felt
from autopilot.core.frames import FloatArray
from autopilot.core.messages import Inputs
from autopilot.core.model4 import Model4
from autopilot.core.samples import (
    AhrsSample,
    DepthSample,
    HullSample,
    ImuSample,
    LeakSample,
    PilotSample,
    PowerSample,
    Sample,
    VelocitySample,
)

NEVER = math.nan


QUIET, IMPLAUSIBLE = "silent or frozen", "implausible"
"""Of a sensor that says nothing that counts."""


@dataclass(slots=True, eq=False)
class _SensorRecord:
    """Of one sensor that has spoken."""

    last_us: int
    """When it last said something new."""
    reading: object = None
    equal: int = 0
    how: str = QUIET
    """What is wrong with it when it has said nothing new."""


@dataclass(slots=True, eq=False)
class VehicleStatus:
    """Newest facts. Times are the service's [us]."""

    gcs_us: float = NEVER
    """Last heartbeat of a ground station or companion."""
    pilot_us: float = NEVER
    """Last input of a pilot."""
    wet_us: float = NEVER
    """When a leak probe was last wet."""
    hull_pa: float = NEVER
    hull_c: float = NEVER
    late_share: float = NEVER
    """Of the ticks of the last second."""
    log_lost: bool = False
    jumped_us: float = NEVER
    """When the clock of day last jumped."""
    collided_us: float = NEVER
    yaw_rad: float = NEVER
    """Of the AHRS, which has an unknown offset."""
    yaw_rate_rad_s: float = 0.0
    ahrs_us: float = NEVER
    """When it last said so."""
    depth_m: float = NEVER
    """Of the pressure sensor."""
    depth_us: float = NEVER
    floor: FloorRanges = field(default_factory=FloorRanges)
    """What looks down."""
    thrust_n: FloatArray | None = None
    """(n,) commanded now."""
    sensors: dict[str, _SensorRecord] = field(default_factory=dict)
    """Those that have spoken and have to go on."""
    _late: int = 0
    _late_us: int = 0

    def note(self, inputs: Inputs) -> None:
        """What comes beside samples."""
        t_us = inputs.t_us
        self.log_lost = inputs.log_lost
        if inputs.clock_jump_s and abs(inputs.clock_jump_s) >= FACTS.jump_s:
            self.jumped_us = t_us
        if t_us - self._late_us >= FACTS.late_every_us:
            since_ticks = (t_us - self._late_us) * 1e-4
            self.late_share = (inputs.overruns - self._late) / since_ticks
            self._late, self._late_us = inputs.overruns, t_us

    def note_ahrs(self, t_us: int, sample: AhrsSample) -> None:
        """The newest attitude."""
        yaw, rate = sample.rpy_rad.item(2), sample.rate_frd_rad_s.item(2)
        if math.isfinite(yaw + rate):
            self.yaw_rad, self.yaw_rate_rad_s, self.ahrs_us = yaw, rate, t_us

    def felt(self, t_us: int) -> Felt:
        """What is known of the vehicle without a position, and not too old."""
        yaw = self.yaw_rad if t_us - self.ahrs_us <= FACTS.felt_us else None
        depth = self.depth_m if t_us - self.depth_us <= FACTS.felt_us else None
        return Felt(yaw_rad=yaw, yaw_rate_rad_s=self.yaw_rate_rad_s, depth_m=depth)

    def note_sample(self, t_us: int, sample: Sample) -> None:
        """One sample that is none of the AHRS: those come with every tick (:class:`Jolts`)."""
        if isinstance(sample, LeakSample):
            self._spoke(t_us, "leak probe")
            if sample.wet:
                self.wet_us = t_us
        elif isinstance(sample, HullSample):
            self._spoke(t_us, "hull sensor")
            if sample.pressure_pa is not None:
                self.hull_pa = sample.pressure_pa
            if sample.temperature_c is not None:
                self.hull_c = sample.temperature_c
        elif isinstance(sample, PilotSample):
            self.pilot_us = t_us
        elif isinstance(sample, DepthSample):
            self._read(t_us, "depth sensor", sample.depth_m)
            if math.isfinite(sample.depth_m):
                self.depth_m, self.depth_us = sample.depth_m, t_us
        elif isinstance(sample, VelocitySample):
            self._read(t_us, "velocity log", sample.vel_frd_m_s.tobytes())
        elif isinstance(sample, PowerSample):
            self._spoke(t_us, "power monitor")

    def silent(self, t_us: int) -> tuple[float, str]:
        """The longest silence [s] of a sensor that has spoken, and whose; NaN when none has."""
        if not self.sensors:
            return NEVER, ""
        name = min(self.sensors, key=self._last_us)
        return 1e-6 * (t_us - self.sensors[name].last_us), name

    def note_implausible(self, t_us: int, name: str) -> None:
        """A sensor says what cannot be: it has spoken, and might as well be silent."""
        self.sensors.setdefault(name, _SensorRecord(t_us)).how = IMPLAUSIBLE

    def how_silent(self, name: str) -> str:
        """What is wrong with a sensor that :meth:`silent` has named."""
        return self.sensors[name].how if name else ""

    def _last_us(self, name: str) -> int:
        return self.sensors[name].last_us

    def _spoke(self, t_us: int, name: str) -> None:
        heard = self.sensors.get(name)
        if heard is None:
            self.sensors[name] = _SensorRecord(t_us)
        else:
            heard.last_us, heard.how = t_us, QUIET

    def _read(self, t_us: int, name: str, reading: object) -> None:
        """A reading that repeats itself to the last digit is as good as none."""
        heard = self.sensors.get(name)
        if heard is None:
            heard = self.sensors[name] = _SensorRecord(t_us)
        heard.equal = heard.equal + 1 if reading == heard.reading else 0
        heard.reading = reading
        if heard.equal < FACTS.frozen_readings:
            heard.last_us = t_us


class Jolts:
    """Finds jolts in the accelerometer: a push that comes and goes, larger than thrust can make."""

    def __init__(self, model: Model4) -> None:
        self._per_n = np.array(model.allocation)[:2] / np.array(model.mass_kg)[:2, None]
        """(2, n) acceleration ahead and sideways by each newton of each thruster."""
        self._base: tuple[float, float] | None = None
        self._began_us: int | None = None
        self._peak = 0.0

    def look(self, sample: AhrsSample | ImuSample, thrust_n: FloatArray | None, least_m_s2: float) -> bool:
        """Whether a jolt of at least that size has just ended."""
        ax, ay, _ = sample.accel_frd_m_s2.tolist()
        if self._base is None:
            self._base = (ax, ay)
            return False
        bx, by = self._base
        dx, dy = ax - bx, ay - by
        size = math.sqrt(dx * dx + dy * dy)
        if not size < 1e6:  # no reading
            return False
        if self._began_us is None:
            if size < least_m_s2:
                share = 0.01 / FACTS.base_time_s
                self._base = (bx + share * dx, by + share * dy)
                return False
            self._began_us, self._peak = sample.t_us, 0.0
        self._peak = max(self._peak, size - self._commanded(thrust_n))
        if size >= 0.5 * least_m_s2 and sample.t_us - self._began_us < FACTS.jolt_us:
            return False
        ended = size < 0.5 * least_m_s2
        self._began_us = None
        if not ended:
            self._base = (ax, ay)
        return ended and self._peak >= least_m_s2

    def _commanded(self, thrust_n: FloatArray | None) -> float:
        """Twice what thrust accelerates by: it may have been the opposite a moment ago."""
        if thrust_n is None:
            return 0.0
        ax, ay = (self._per_n @ thrust_n).tolist()
        return 2.0 * math.hypot(ax, ay)
