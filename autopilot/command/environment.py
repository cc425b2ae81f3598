"""Inputs of a tick beside the estimator's samples: power, obstacles, pictures, device faults."""

from collections.abc import Mapping, Sequence

import numpy as np

from autopilot.command.battery_watch import BatteryWatch
from autopilot.command.camera_watch import CameraWatch
from autopilot.command.collision import CollisionDetector
from autopilot.command.command_tuning import ENVIRONMENT
from autopilot.command.device_watch import DeviceWatch
from autopilot.command.vehicle_status import VehicleStatus
from autopilot.control.constraints.obstacles import clearance_m
from autopilot.control.constraints.tracks import Tracks
from autopilot.core import operator_messages as notices
from autopilot.core.camera import CameraModel
from autopilot.core.camera_tilt import tilt_problem
from autopilot.core.echoes import LEAST_CONFIDENCE
from autopilot.core.geometry import Fence
from autopilot.core.laser_dot import dot_range
from autopilot.core.messages import Event, FlightControllerState, Inputs
from autopilot.core.operator_messages import OperatorText
from autopilot.core.params import ParamSet
from autopilot.core.samples import (
    AhrsSample,
    AltimeterSample,
    CameraTiltSample,
    ImuSample,
    LaserSample,
    MarkerSighting,
    ObstacleTrack,
    PowerSample,
    Sample,
)
from autopilot.core.sensed import Sensed
from autopilot.core.vehicle import Vehicle
from autopilot.mavlink.api import BEAM_TRACKS

INERTIAL = (AhrsSample, ImuSample)
"""At every tick: no union, which is slower to ask."""


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
                self.status.floor.note("altimeter", t_us, sample.range_m)
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
        self.status.floor.note("laser", t_us, sample.range_m)

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
