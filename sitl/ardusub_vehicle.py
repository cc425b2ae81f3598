"""A vehicle with ArduSub in the environment of a scenario: plant, flight controller, and a tracking system.

The counterpart of :class:`.sitl.backend.SimulatedVehicle` for a vehicle that is connected by the MAVLink of its flight
controller only.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from autopilot.core.geodesy import Origin
from autopilot.core.vehicle import Vehicle
from autopilot.sitl.ardusub_emulator import ArduSubEmulator
from autopilot.sitl.payload_devices import SimPayload
from autopilot.sitl.plant import Truth
from autopilot.sitl.protocol import PlantContext, create_plant
from autopilot.sitl.scenario_tables import Scenario
from autopilot.sitl.sitl_tuning import ARDUSUB_VEHICLE


class ArduSubVehicle:
    """Time is handed in; the same calls give the same bytes."""

    def __init__(self, scenario: Scenario, vehicle: Vehicle, frame: str, *, seed: int, **more: Any) -> None:
        """``more``: keyword arguments of the emulator."""
        self._vehicle = vehicle
        self._plant = create_plant(scenario.plugins.plant, PlantContext(scenario=scenario, vehicle=vehicle, seed=seed))
        depth_m = None if scenario.tank is None else scenario.tank.depth_m
        place = scenario.origin
        origin = Origin(lat_deg=place.lat_deg, lon_deg=place.lon_deg, alt_m=place.alt_m)
        self.controller = ArduSubEmulator(vehicle, frame, seed=seed, floor_depth_m=depth_m, origin=origin, **more)
        """The flight controller."""
        self._mav: Any = self.controller.codec(ARDUSUB_VEHICLE.tracker_system, ARDUSUB_VEHICLE.tracker_component)
        tilts = vehicle.tilt is not None and vehicle.tilt.camera_deg is not None
        self._payload = SimPayload(vehicle) if tilts else None
        self._rng = np.random.default_rng((seed, 71))
        self._pose_us = 0

    @property
    def truth(self) -> Truth:
        return self._plant.truth

    @property
    def camera_off_rad(self) -> float:
        """See :attr:`SimPayload.camera_off_rad`."""
        return 0.0 if self._payload is None else self._payload.camera_off_rad

    def advance(self, t_us: int) -> list[bytes]:
        """Advance to ``t_us`` with the previous pulses; returns the flight controller's messages."""
        self._plant.advance(t_us, self.controller.plant_pulses_us(self._vehicle))
        if self._payload is not None:
            self._carry(t_us, self._payload, self.controller.extras.rail(self.controller.servos_us))
        return self.controller.step(t_us, self._plant.truth)

    def driven(self, t_us: int, servos_us: Sequence[int]) -> Truth:
        """Go on to ``t_us`` with the servo rail of another flight controller, motor by motor; the truth then."""
        self.controller.servos_us = tuple(servos_us[: self.motors])
        self._plant.advance(t_us, self.controller.plant_pulses_us(self._vehicle))
        if self._payload is not None:
            self._carry(t_us, self._payload, servos_us)
        return self._plant.truth

    def _carry(self, t_us: int, payload: SimPayload, rail_us: Sequence[int]) -> None:
        """Move the camera as the servo rail says."""
        tilt = self._vehicle.tilt
        pulses_us = dict(enumerate(rail_us, 1))
        payload.set([pulses_us.get(one.channel or 0, 0) if one is tilt else 0 for one in self._vehicle.payload])
        payload.advance(t_us)

    @property
    def motors(self) -> int:
        return len(self.controller.servos_us)

    def pose(self, t_us: int) -> bytes | None:
        """Message of the tracking system (VISION_POSITION_ESTIMATE), when it is due."""
        if t_us - self._pose_us < ARDUSUB_VEHICLE.pose_period_us:
            return None
        self._pose_us += ARDUSUB_VEHICLE.pose_period_us
        truth, noise = self._plant.truth, self._rng.standard_normal(4)
        north, east, down = (truth.pos_ned_m + ARDUSUB_VEHICLE.pose_sigma_m * noise[:3]).tolist()
        yaw = float(truth.rpy_rad[2]) + ARDUSUB_VEHICLE.yaw_sigma_rad * float(noise[3])
        covariance = [0.0] * 21
        for place, sigma in (
            (0, ARDUSUB_VEHICLE.pose_sigma_m),
            (6, ARDUSUB_VEHICLE.pose_sigma_m),
            (11, ARDUSUB_VEHICLE.pose_sigma_m),
            (20, ARDUSUB_VEHICLE.yaw_sigma_rad),
        ):
            covariance[place] = sigma * sigma
        message = self._mav.vision_position_estimate_encode(0, north, east, down, 0.0, 0.0, yaw, covariance, 0)
        return bytes(message.pack(self._mav))
