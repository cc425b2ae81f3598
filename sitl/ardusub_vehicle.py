"""A vehicle with ArduSub on board, in the water of a scenario: plant, flight controller, and a tracking system.

What :class:`.sitl.backend.SimulatedVehicle` is for a vehicle of our own drivers, for one that is reached by its flight
controller's MAVLink alone.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from autopilot.core.vehicle import Vehicle
from autopilot.sitl.ardusub import ArduSubEmulator
from autopilot.sitl.plant import Truth
from autopilot.sitl.protocol import PlantContext, create_plant
from autopilot.sitl.scenario_tables import Scenario

POSE_PERIOD_US = 33_333
POSE_SIGMA_M, YAW_SIGMA_RAD = 0.005, 0.008
TRACKER_SYSTEM, TRACKER_COMPONENT = 200, 197
"""MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY."""


class ArduSubVehicle:
    """Time is handed in; the same calls give the same bytes."""

    def __init__(self, scenario: Scenario, vehicle: Vehicle, frame: str, *, seed: int, **more: Any) -> None:
        """``more``: of the emulator."""
        self._vehicle = vehicle
        self._plant = create_plant(scenario.plugins.plant, PlantContext(scenario=scenario, vehicle=vehicle, seed=seed))
        self.controller = ArduSubEmulator(vehicle, frame, seed=seed, **more)
        """The flight controller."""
        self._mav: Any = self.controller.codec(TRACKER_SYSTEM, TRACKER_COMPONENT)
        self._rng = np.random.default_rng((seed, 71))
        self._pose_us = 0

    @property
    def truth(self) -> Truth:
        """The present truth."""
        return self._plant.truth

    def advance(self, t_us: int) -> list[bytes]:
        """Go on to ``t_us`` with the pulses of before; the result is what the flight controller says."""
        self._plant.advance(t_us, self.controller.plant_pulses_us(self._vehicle))
        return self.controller.step(t_us, self._plant.truth)

    def driven(self, t_us: int, servos_us: Sequence[int]) -> Truth:
        """Go on to ``t_us`` with the servo rail of another flight controller, motor by motor; the truth then."""
        self.controller.servos_us = tuple(servos_us[: self.motors])
        self._plant.advance(t_us, self.controller.plant_pulses_us(self._vehicle))
        return self._plant.truth

    @property
    def motors(self) -> int:
        """Of the frame."""
        return len(self.controller.servos_us)

    def pose(self, t_us: int) -> bytes | None:
        """What a tracking system sends of where it is, when that is due (VISION_POSITION_ESTIMATE)."""
        if t_us - self._pose_us < POSE_PERIOD_US:
            return None
        self._pose_us += POSE_PERIOD_US
        truth, noise = self._plant.truth, self._rng.standard_normal(4)
        north, east, down = (truth.pos_ned_m + POSE_SIGMA_M * noise[:3]).tolist()
        yaw = float(truth.rpy_rad[2]) + YAW_SIGMA_RAD * float(noise[3])
        covariance = [0.0] * 21
        for place, sigma in ((0, POSE_SIGMA_M), (6, POSE_SIGMA_M), (11, POSE_SIGMA_M), (20, YAW_SIGMA_RAD)):
            covariance[place] = sigma * sigma
        message = self._mav.vision_position_estimate_encode(0, north, east, down, 0.0, 0.0, yaw, covariance, 0)
        return bytes(message.pack(self._mav))
