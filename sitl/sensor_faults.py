"""Effects of the faults of :mod:`autopilot.sitl.fault_tables` on readings, poses and images."""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.sitl.fault_tables import (
    AhrsAttitude,
    ImuClip,
    ImuOffset,
    ImuScale,
    ImuStuck,
    LensFault,
    MarkersMoved,
    Mounting,
)
from autopilot.sitl.plant import Truth
from autopilot.sitl.scenario_tables import Fault

AXES = {"x": 0, "y": 1, "z": 2}
SENSORS = {"gyro": 0, "accel": 3}
"""Where a sensor's three values stand among the six."""


class ImuFaults:
    """Faults of gyros, accelerometers and attitude, in the order of the scenario file."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        faults = list(faults)
        self._inertial = [f for f in faults if isinstance(f, ImuOffset | ImuScale | ImuStuck | ImuClip)]
        self._attitude = [f for f in faults if isinstance(f, AhrsAttitude)]
        self._stuck: dict[int, float] = {}

    def with_inertial(self, t_us: int, six: list[float]) -> list[float]:
        """Faulty gyro and accelerometer readings from the true ones."""
        for index, fault in enumerate(self._inertial):
            if not fault.holds(t_us):
                self._stuck.pop(index, None)
                continue
            first = SENSORS[fault.sensor]
            for axis in range(3):
                place = first + axis
                if isinstance(fault, ImuOffset):
                    six[place] += fault.offset[axis]
                elif isinstance(fault, ImuScale):
                    six[place] *= fault.factor[axis]
                elif isinstance(fault, ImuClip):
                    six[place] = min(max(six[place], -fault.limit), fault.limit)
                elif axis == AXES[fault.axis]:
                    six[place] = self._stuck.setdefault(index, six[place])
        return six

    def attitude_rad(self, t_us: int) -> tuple[float, float, float]:
        """Added to roll, pitch, yaw."""
        if not self._attitude:
            return 0.0, 0.0, 0.0
        active = [fault for fault in self._attitude if fault.holds(t_us)]
        return sum(f.roll_rad for f in active), sum(f.pitch_rad for f in active), sum(f.yaw_rad for f in active)


class OpticalFaults:
    """Faults of lens, mounting and markers."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self._faults = [fault for fault in faults if isinstance(fault, LensFault | Mounting | MarkersMoved)]
        self._tilt: Mounting | None = None

    def tilt(self, off_rad: float) -> None:
        """Tilt the camera upwards from where it was calibrated; it turns about itself, by whole degrees."""
        degrees = round(math.degrees(off_rad))
        self._tilt = Mounting(at_s=0.0, rpy_rad=(0.0, math.radians(degrees), 0.0)) if degrees else None

    def camera_at(self, t_us: int) -> tuple[LensFault | Mounting, ...]:
        """Faults of the camera itself that hold then."""
        own = tuple(f for f in self._faults if isinstance(f, LensFault | Mounting) and f.holds(t_us))
        return own if self._tilt is None else (*own, self._tilt)

    def seen(self, truth: Truth) -> Truth:
        """Apparent pose of the vehicle if the displaced markers were at their mapped positions."""
        for fault in self._faults:
            if isinstance(fault, MarkersMoved) and fault.holds(truth.t_us):
                c, s = math.cos(fault.yaw_rad), math.sin(fault.yaw_rad)
                north, east, down = (truth.pos_ned_m - np.array(fault.offset_m)).tolist()
                truth = replace(
                    truth,
                    pos_ned_m=np.array([c * north + s * east, c * east - s * north, down]),
                    rpy_rad=truth.rpy_rad - np.array([0.0, 0.0, fault.yaw_rad]),
                )
        return truth

    def pose(self, truth: Truth, camera_frd_m: FloatArray, floor_depth_m: float | None) -> tuple[FloatArray, float]:
        """Position (3,) and heading that pictures would give, without noise."""
        if not self._faults and self._tilt is None:
            return truth.pos_ned_m, float(truth.rpy_rad[2])
        truth = self.seen(truth)
        position, yaw = truth.pos_ned_m, float(truth.rpy_rad[2])
        for fault in self.camera_at(truth.t_us):
            r = r_ned_from_frd(truth.rpy_rad)
            if isinstance(fault, LensFault):
                if floor_depth_m is not None:
                    height_m = floor_depth_m - float(position[2] + r[2] @ camera_frd_m)
                    position = position + np.array([0.0, 0.0, height_m * (1.0 - 1.0 / fault.focal_factor)])
                continue
            # The camera's pose is measured correctly; the vehicle's follows by the assumed mounting.
            lens = camera_frd_m + np.array(fault.position_m)
            assumed = r @ r_ned_from_frd(np.array(fault.rpy_rad))
            position = position + r @ lens - assumed @ camera_frd_m
            yaw = math.atan2(assumed[1, 0], assumed[0, 0])
        return position, yaw
