"""What an emulated ArduSub has beside its motors: lights, relays, the camera's tilt, sonar altimeter and GPS."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from autopilot.core.geodesy import Origin, place_from_ned
from autopilot.sitl.plant import Truth

SERVOS, RELAYS = 16, 2
SET_RELAY, SET_SERVO, MOUNT_CONTROL = 181, 183, 205
COMMANDS = (SET_RELAY, SET_SERVO, MOUNT_CONTROL)
"""MAV_CMD that :meth:`ArduSubExtras.order` answers."""
ACCEPTED, DENIED, FAILED = 0, 2, 4
"""MAV_RESULT."""
FREE_FUNCTIONS = (0, 1, *range(51, 67))
"""SERVOn_FUNCTION that DO_SET_SERVO moves: disabled, manual, RCIN1 to RCIN16."""
MOUNT_PITCH = 7
"""SERVOn_FUNCTION of the camera's tilt."""
BY_ANGLE = 2.0
"""MAV_MOUNT_MODE_MAVLINK_TARGETING."""
MAX_RANGE_M, RANGE_NOISE_M = 50.0, 0.02
"""Of a sonar altimeter as range finder 1."""
GPS_UP_M, GPS_SIGMA_M, GPS_HZ = 0.15, 1.5, 5.0
"""Of its receiver: height of the antenna over the centre of gravity, error of each axis, drawn once, and rate."""

EXTRA_PARAMETERS = {
    # Lights at outputs 13 and 14, the camera's tilt at 16, as on a vehicle that is sold with a Navigator.
    **{f"SERVO{n}_FUNCTION": 0.0 for n in range(9, SERVOS + 1)},
    "SERVO13_FUNCTION": 59.0,
    "SERVO14_FUNCTION": 60.0,
    "SERVO16_FUNCTION": float(MOUNT_PITCH),
    "SERVO16_MIN": 1100.0,
    "SERVO16_MAX": 1900.0,
    "RNGFND1_TYPE": 0.0,  # sold separately; 10 = by MAVLink
    "GPS1_TYPE": 0.0,  # sold separately; 1 = found by itself
    "MNT1_TYPE": 1.0,
    "MNT1_PITCH_MIN": -45.0,
    "MNT1_PITCH_MAX": 45.0,
}


class ArduSubExtras:
    def __init__(
        self, mav: Any, parameters: dict[str, float], seed: int, floor_depth_m: float | None, origin: Origin | None
    ) -> None:
        """``mav``: its encoder; ``parameters``: live."""
        self._mav, self._parameters = mav, parameters
        self._floor_depth_m, self._origin = floor_depth_m, origin
        self._rng = np.random.default_rng((seed, 72))
        self._gps_off_m = GPS_SIGMA_M * self._rng.standard_normal(2)
        self.spare_us: dict[int, int] = {}
        """Pulses that were asked for by command, by output."""
        self.relays: dict[int, bool] = {}
        self.tilt_deg = 0.0
        """Target of mount 1, by command or by its pilot; upwards positive."""

    def order(self, message: Any) -> tuple[int, str]:
        """COMMAND_LONG of :data:`COMMANDS`: MAV_RESULT, and what is said, "" = nothing."""
        number = int(message.param1)
        if message.command == MOUNT_CONTROL:
            if message.param7 != BY_ANGLE:
                return DENIED, ""
            self.tilt_deg = message.param1
        elif message.command == SET_SERVO:
            if round(self._parameters.get(f"SERVO{number}_FUNCTION", -1.0)) not in FREE_FUNCTIONS:
                return FAILED, f"ServoRelayEvent: Channel {number} is already in use"
            self.spare_us[number] = int(message.param2)
        elif 0 <= message.param1 < RELAYS:
            self.relays[number] = message.param2 > 0.5
        else:
            return FAILED, ""
        return ACCEPTED, ""

    def rail(self, motors_us: Sequence[int]) -> list[int]:
        """Pulses of all outputs, 0 = off."""
        rail = [*motors_us, *([0] * (SERVOS - len(motors_us)))]
        for number, pulse_us in self.spare_us.items():
            rail[number - 1] = pulse_us
        values = self._parameters
        low_deg, high_deg = values["MNT1_PITCH_MIN"], values["MNT1_PITCH_MAX"]
        level = (min(max(self.tilt_deg, low_deg), high_deg) - low_deg) / (high_deg - low_deg)
        for number in range(1, SERVOS + 1):
            if round(values.get(f"SERVO{number}_FUNCTION", 0.0)) == MOUNT_PITCH:
                low_us, high_us = values[f"SERVO{number}_MIN"], values[f"SERVO{number}_MAX"]
                rail[number - 1] = round(low_us + level * (high_us - low_us))
        return rail

    def gps(self, t_us: int, truth: Truth) -> Any | None:
        """GPS_RAW_INT of a receiver whose antenna is on top; under water there is no fix, without one no receiver."""
        if self._origin is None or self._parameters["GPS1_TYPE"] == 0.0:
            return None
        north, east, down = truth.pos_ned_m.tolist()
        off_n, off_e = self._gps_off_m.tolist()
        dry = down < GPS_UP_M
        place = place_from_ned(self._origin, north + off_n, east + off_e, down - GPS_UP_M) if dry else None
        lat, lon, alt = (0.0, 0.0, 0.0) if place is None else (place.lat_deg, place.lon_deg, place.alt_m)
        read_us = t_us - t_us % round(1e6 / GPS_HZ)
        where = (round(1e7 * lat), round(1e7 * lon), round(1e3 * alt))
        accuracy = {"h_acc": round(1e3 * GPS_SIGMA_M)} if dry else {}
        return self._mav.gps_raw_int_encode(read_us, 3 if dry else 1, *where, 90, 65535, 0, 65535, 12, **accuracy)

    def range(self, ms: int, truth: Truth) -> Any | None:
        """DISTANCE_SENSOR to the floor, straight down: its beam is wide."""
        if self._floor_depth_m is None or self._parameters["RNGFND1_TYPE"] == 0.0:
            return None
        range_m = self._floor_depth_m - float(truth.pos_ned_m[2]) + RANGE_NOISE_M * float(self._rng.standard_normal())
        range_cm = round(100.0 * min(max(range_m, 0.0), MAX_RANGE_M))
        return self._mav.distance_sensor_encode(ms, 30, round(100.0 * MAX_RANGE_M), range_cm, 2, 0, 25, 0)
