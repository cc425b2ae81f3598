"""Inputs of a tick beside the estimator's samples: power, obstacles, pictures, device faults."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from autopilot.command.command_tuning import CAMERA_WATCH, COLLISION, ENVIRONMENT
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.control.constraints.obstacles import clearance_m
from autopilot.control.constraints.tracks import Tracks
from autopilot.core import operator_messages as notices
from autopilot.core.camera import CameraModel
from autopilot.core.camera_tilt import tilt_problem
from autopilot.core.echoes import LEAST_CONFIDENCE
from autopilot.core.frames import FloatArray
from autopilot.core.geometry import Fence
from autopilot.core.laser_dot import dot_range
from autopilot.core.messages import DeviceRole, DeviceTrouble, Event, FlightControllerState, Inputs
from autopilot.core.model4 import Model4
from autopilot.core.operator_messages import OperatorText
from autopilot.core.params import ParamSet
from autopilot.core.samples import (
    AhrsSample,
    AltimeterSample,
    CameraTiltSample,
    FrameVerdict,
    ImuSample,
    LaserSample,
    MarkerSighting,
    ObstacleTrack,
    PictureReport,
    PowerSample,
    Sample,
    plausible,
)
from autopilot.core.sensed import Sensed
from autopilot.core.vehicle import BatteryLimits, Vehicle
from autopilot.mavlink.api import BEAM_TRACKS

INERTIAL = (AhrsSample, ImuSample)
"""At every tick: no union, which is slower to ask."""
BATTERY_SAY_EVERY_US = 60_000_000
"""Interval at which a continuing implausible reading is reported again."""

STALE_US = 3_000_000
"""Age beyond which a plausible reading followed by rejected ones only is no longer shown."""
SAY_EVERY_US = 5_000_000
"""Interval at which the same fault is reported again."""

DEVICE_OVER_US = 1_000_000
"""Time without fault after which a device counts as recovered."""

_DEVICE_NAMES = {
    DeviceRole.SENSORS: "Sensors",
    DeviceRole.CAMERA: "Camera",
    DeviceRole.THRUSTERS: "Thrusters",
    DeviceRole.WATCHDOG: "Thruster watchdog",
}
_SAID_ONCE = frozenset({DeviceRole.WATCHDOG})
"""Not reported again while it lasts: it has a failsafe of its own."""
FOGGY, SILENT = "foggy", "silent"
MESSAGES = {
    FrameVerdict.DARK.value: notices.CAMERA_DARK,
    FrameVerdict.BRIGHT.value: notices.CAMERA_BRIGHT,
    FrameVerdict.FLAT.value: notices.CAMERA_FLAT,
    FrameVerdict.TORN.value: notices.CAMERA_TORN,
    FrameVerdict.FROZEN.value: notices.CAMERA_FROZEN,
    FrameVerdict.WRONG_SIZE.value: notices.CAMERA_WRONG_SIZE,
    FrameVerdict.WRONG_TYPE.value: notices.CAMERA_WRONG_TYPE,
    FOGGY: notices.CAMERA_FOGGY,
    SILENT: notices.CAMERA_SILENT,
}
"""Message to the operator for each fault."""


class CameraWatch:
    """Reports changes of the camera's state: black, over-exposed, frozen, torn, foggy or no pictures.

    Unusable pictures are rejected before the vision front end and arrive here as fault names. Dark, bright or foggy
    pictures count only while no marker is detected in them."""

    def __init__(self) -> None:
        self.foggy = 0
        """Pictures that were too foggy for markers."""
        self._trouble: str | None = None
        """Fault reported to the operator, None without one."""
        self._now: str | None = None
        """State of all pictures since ``_since_us``; None = good."""
        self._since_us = 0
        self._count = 0
        self._last_us: int | None = None
        """Time of the last picture,"""
        self._markers_us: int | None = None
        """and the last one with markers."""

    def step(self, t_us: int, pictures: Sequence[PictureReport], samples: Sequence[Sample]) -> list[Event]:
        """Messages to the operator: each fault once, and its end."""
        if any(isinstance(sample, MarkerSighting) and sample.ids for sample in samples):
            self._markers_us = t_us
        for picture in pictures:
            self._last_us = t_us
            self._note(t_us, self._of(t_us, picture))
        silent = self._last_us is not None and t_us - self._last_us >= CAMERA_WATCH.silent_us
        if silent:
            self._note(t_us, SILENT)
        lasting = silent or (self._count >= CAMERA_WATCH.least and t_us - self._since_us >= CAMERA_WATCH.for_us)
        if not lasting or self._now == self._trouble:
            return []
        self._trouble = self._now
        if self._now is None:
            return [notices.CAMERA_WORKS.event(t_us)]
        return [MESSAGES[self._now].event(t_us)]

    def _note(self, t_us: int, trouble: str | None) -> None:
        if trouble != self._now:
            self._now, self._since_us, self._count = trouble, t_us, 0
        self._count += 1

    def _of(self, t_us: int, picture: PictureReport) -> str | None:
        if picture.verdict is not FrameVerdict.OK:
            return str(picture.verdict.value)
        if self._markers_us is not None and t_us - self._markers_us < CAMERA_WATCH.markers_us:
            return None
        if picture.white_fraction > CAMERA_WATCH.clipped_fraction:
            return FrameVerdict.BRIGHT.value
        if picture.black_fraction > CAMERA_WATCH.clipped_fraction:
            return FrameVerdict.DARK.value
        if picture.contrast < CAMERA_WATCH.fog_contrast:
            self.foggy += 1
            return FOGGY
        return None


class DeviceWatch:
    """Device faults and recoveries: each is reported once and counted always."""

    def __init__(self) -> None:
        self._reported_us: dict[DeviceRole, int] = {}
        self._last_us: dict[DeviceRole, int] = {}
        self.counts = dict.fromkeys(DeviceRole, 0)
        """Ticks on which a device could not be used."""
        self.watchdog_problem = ""
        """Fault of the watchdog process on this tick."""

    @property
    def thruster_problem(self) -> str:
        """Why commands do not reach the thrusters, "" while they do."""
        return "thruster output fails" if DeviceRole.THRUSTERS in self._last_us else ""

    def step(self, t_us: int, troubles: Sequence[DeviceTrouble]) -> list[Event]:
        events = []
        self.watchdog_problem = ""
        for trouble in troubles:
            device, name = trouble.device, _DEVICE_NAMES[trouble.device]
            self.counts[device] += 1
            if device is DeviceRole.WATCHDOG:
                self.watchdog_problem = trouble.text
            reported_us = self._last_us.get(device) if device in _SAID_ONCE else self._reported_us.get(device)
            if reported_us is None or t_us - reported_us >= SAY_EVERY_US:
                self._reported_us[device] = t_us
                events.append(notices.DEVICE_FAILED.event(t_us, device=name, reason=trouble.text))
            self._last_us[device] = t_us
        for device, last_us in tuple(self._last_us.items()):
            if t_us - last_us > DEVICE_OVER_US:
                del self._last_us[device]
                events.append(notices.DEVICE_WORKS.event(t_us, device=_DEVICE_NAMES[device]))
        return events


class CollisionDetector:
    """Detects accelerations larger than thrust can cause."""

    def __init__(self, model: Model4) -> None:
        self._per_n = np.array(model.allocation)[:2] / np.array(model.mass_kg)[:2, None]
        """(2, n) acceleration ahead and sideways by each newton of each thruster."""
        self._base: tuple[float, float] | None = None
        self._began_us: int | None = None
        self._peak = 0.0

    def update(self, sample: AhrsSample | ImuSample, thrust_n: FloatArray | None, least_m_s2: float) -> bool:
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
                factor = 0.01 / COLLISION.base_time_s
                self._base = (bx + factor * dx, by + factor * dy)
                return False
            self._began_us, self._peak = sample.t_us, 0.0
        self._peak = max(self._peak, size - self._commanded(thrust_n))
        if size >= 0.5 * least_m_s2 and sample.t_us - self._began_us < COLLISION.jolt_us:
            return False
        ended = size < 0.5 * least_m_s2
        self._began_us = None
        if not ended:
            self._base = (ax, ay)
        return ended and self._peak >= least_m_s2

    def _commanded(self, thrust_n: FloatArray | None) -> float:
        """Twice the acceleration by thrust: it may have reversed within the filter's delay."""
        if thrust_n is None:
            return 0.0
        ax, ay = (self._per_n @ thrust_n).tolist()
        return 2.0 * math.hypot(ax, ay)


class BatteryWatch:
    """The newest reading that this battery can have, and messages about rejected ones."""

    def __init__(self, limits: BatteryLimits) -> None:
        self._limits = limits
        self._good_us = 0
        self._refused_us: int | None = None
        """Time of the newest reading, if it was rejected."""
        self._reported_us: int | None = None
        self._events: list[Event] = []
        self.power: PowerSample | None = None
        self.refused = 0
        """Readings that no battery has, or that this one cannot have."""

    @property
    def shown(self) -> PowerSample | None:
        refused_us = self._refused_us
        return None if refused_us is not None and refused_us - self._good_us >= STALE_US else self.power

    def note(self, t_us: int, sample: PowerSample) -> bool:
        """Check a reading; whether it is plausible."""
        limits = self._limits
        if not plausible(sample):
            self._refuse(t_us, notices.BATTERY_IMPLAUSIBLE())
        elif not limits.can_be(sample.voltage_v):
            found = notices.BATTERY_VOLTAGE_IMPLAUSIBLE(
                voltage_v=sample.voltage_v, low_v=limits.min_v, high_v=limits.max_v
            )
            self._refuse(t_us, found)
        else:
            self.power, self._good_us, self._refused_us = sample, t_us, None
            return True
        return False

    def _refuse(self, t_us: int, text: OperatorText) -> None:
        self.refused += 1
        self._refused_us = t_us
        if self._reported_us is None or t_us - self._reported_us >= BATTERY_SAY_EVERY_US:
            self._reported_us = t_us
            self._events.append(text.event(t_us))

    def take_events(self) -> list[Event]:
        """Lines for the operator since the last call."""
        events, self._events = self._events, []
        return events


class Environment:
    def __init__(self, vehicle: Vehicle, params: ParamSet) -> None:
        self._params = params
        self._collisions = CollisionDetector(vehicle.to_model())
        self.power_watch = BatteryWatch(vehicle.battery.limits)
        self._events: list[Event] = []
        self.devices = DeviceWatch()
        self.camera = CameraWatch()
        self.tracks = Tracks()
        """Obstacles beside the fence."""
        self.below: FlightControllerState | None = None
        """The flight controller below us."""
        self.refusals: tuple[str, ...] = ()
        """Devices' reasons against arming."""
        self.status = VehicleStatus()
        self._t_us = 0
        self._reported_over = False
        """That the vehicle would be deep inside of an obstacle."""
        self.sensed = Sensed()
        """The newest of each sensor."""
        self.status.floor.mount("altimeter", vehicle.altimeter.position_frd_m, vehicle.altimeter.direction_frd)
        self._tilt = vehicle.tilt
        if vehicle.laser is not None:
            self.status.floor.mount("laser", vehicle.laser.position_frd_m, vehicle.laser.direction_frd)
        with_laser = vehicle.camera is not None and vehicle.laser is not None
        self._camera = CameraModel.of(vehicle.eye, vehicle.laser) if with_laser else None

    @property
    def power(self) -> PowerSample | None:
        """Latest plausible battery reading."""
        return self.power_watch.power

    @property
    def supply_v(self) -> float | None:
        """Measured voltage, None before the first reading."""
        return None if self.power is None else self.power.voltage_v

    def note(self, inputs: Inputs) -> None:
        self._t_us = inputs.t_us
        self._events += self.devices.step(inputs.t_us, inputs.troubles)
        self._events += self.camera.step(inputs.t_us, inputs.pictures, inputs.samples)
        self.below, self.refusals = inputs.below, inputs.refusals
        status = self.status
        status.note(inputs)
        for sample in inputs.samples:
            if isinstance(sample, INERTIAL):
                self._feel(inputs.t_us, sample)
                continue
            if isinstance(sample, PowerSample):
                self._note_power(inputs.t_us, sample)
                continue
            self._show(inputs.t_us, sample)
            if isinstance(sample, ObstacleTrack):
                self.tracks.note(inputs.t_us, sample)
            else:
                status.note_sample(inputs.t_us, sample)

    def _note_power(self, t_us: int, sample: PowerSample) -> None:
        """One battery reading; an implausible one counts as missing."""
        weight = self._power_weight(sample.t_us)
        if not self.power_watch.note(t_us, sample):
            self.status.note_implausible(t_us, "power monitor")
            return
        self.status.note_sample(t_us, sample)
        power_w, before_w = sample.voltage_v * sample.current_a, self.sensed.power_w
        self.sensed.power_w = power_w if before_w is None else before_w + weight * (power_w - before_w)

    def _feel(self, t_us: int, sample: AhrsSample | ImuSample) -> None:
        status, sensed = self.status, self.sensed
        sensed.inertial = sample
        sensed.vibration.note(sample.accel_frd_m_s2)
        if isinstance(sample, AhrsSample):
            status.note_ahrs(t_us, sample)
        if self._collisions.update(sample, status.thrust_n, self._params["FS_COLL_ACC"]):
            status.collided_us = t_us

    def note_others(self, t_us: int, tracks: Sequence[ObstacleTrack], removed: Sequence[int], fence: Fence) -> None:
        """Take reported obstacles, without beam returns from the fence itself."""
        for number in removed:
            self.tracks.forget(number)
        beams = [track for track in tracks if track.track_id >= BEAM_TRACKS]
        free_m = clearance_m(fence, np.array([track.pos_ned_m for track in beams])) if beams else ()
        known = {track.track_id for track, clear_m in zip(beams, free_m, strict=True) if clear_m < ENVIRONMENT.known_m}
        for track in tracks:
            if track.track_id not in known:
                self.tracks.note(t_us, track)

    def _show(self, t_us: int, sample: Sample) -> None:
        """Keep the latest values for display; AHRS and IMU are handled in :meth:`_feel`."""
        sensed = self.sensed
        if isinstance(sample, LaserSample):
            self._show_laser(t_us, sample)
        elif isinstance(sample, AltimeterSample):
            sensed.newest[AltimeterSample] = sample
            if sample.confidence >= LEAST_CONFIDENCE:
                self.status.note_range(t_us, "altimeter", sample.range_m)
        elif not isinstance(sample, MarkerSighting):
            sensed.newest[type(sample)] = sample
        elif sample.laser_px is not None and self._camera is not None and self.tilt_problem is None:
            shown = sensed.of(LaserSample)
            if shown is None or t_us - shown.t_us >= ENVIRONMENT.range_us:
                found = dot_range(self._camera, sample.laser_px)
                if found is not None:
                    self._show_laser(t_us, LaserSample(t_us=sample.t_us, range_m=found[0], sigma_m=found[1]))

    @property
    def tilt_problem(self) -> OperatorText | None:
        """Why the camera's pictures are not used, None while they are."""
        return tilt_problem(self._tilt, self.sensed.of(CameraTiltSample), self._t_us)

    def _show_laser(self, t_us: int, sample: LaserSample) -> None:
        self.sensed.newest[LaserSample] = sample
        self.status.note_range(t_us, "laser", sample.range_m)

    def _power_weight(self, t_us: int) -> float:
        """Share that a new sample has of the mean power."""
        passed_s = 1e-6 * (t_us - (t_us if self.power is None else self.power.t_us))
        return min(max(passed_s / ENVIRONMENT.power_s, 0.0), 1.0)

    @property
    def thruster_problem(self) -> str:
        """Why commands do not become thrust, "" while they do."""
        below = self.below
        return self.devices.thruster_problem or ("" if below is None else below.problem)

    @property
    def acts(self) -> bool:
        """Whether thrusters follow their commands, according to their device."""
        below = self.below
        return not self.thruster_problem and self.alone and (below is None or below.acts)

    @property
    def alone(self) -> bool:
        """Whether no other controller commands the thrusters."""
        return self.below is None or not self.below.rival

    def take_events(self) -> list[Event]:
        """Lines for the operator since the last call."""
        over_m = self.tracks.over_m
        if over_m is not None and not self._reported_over:
            self._events.append(notices.IN_OBSTACLE.event(self._t_us, size_m=over_m))
        self._reported_over = over_m is not None
        events, self._events = self._events + self.power_watch.take_events(), []
        return events

    def pictures(self, frames: Mapping[str, int] | None) -> dict[str, int]:
        """Counts of the pictures, those that were too foggy among them; empty without a camera."""
        return {} if frames is None else {**frames, "frames.foggy": self.camera.foggy}

    def counts(self) -> dict[str, int]:
        """Ticks without a device and readings of the battery that were refused, for the log."""
        troubles = {f"devices.{role.name.lower()}": count for role, count in self.devices.counts.items() if count}
        refused = self.power_watch.refused
        return {**troubles, "power.malformed": refused} if refused else troubles
