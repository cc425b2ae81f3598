"""Conversion of ArduSub's telemetry to our samples."""

import math
from collections import deque
from typing import Any, NamedTuple

import numpy as np

from autopilot.core.device_clock import DeviceClock
from autopilot.core.frames import FloatArray
from autopilot.core.samples import AhrsSample, AltimeterSample, DepthSample, GpsSample, PowerSample, Sample
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.base import G_M_S2

FRESH_IMU_US = 50_000
"""An acceleration older than this beside an attitude: the sample is left out."""
ACCEL_LAG_S = 0.005
"""Its filtered accelerations are so much older than its attitude beyond what the stamps say: measured against the
truth of its simulation (4.8.0-dev)."""
CLOCK_SPAN_US = (1 << 32) * 1000
"""time_boot_ms begins anew after 50 days."""
AGAIN_US = 500_000
"""It sends its last pressure again when it has no new one (10 Hz, sent 20 times a second): a reading, to the last bit
the one before, is passed on only after so long."""
PA_HPA = 100.0
DOWNWARD = 25
"""MAV_SENSOR_ROTATION_PITCH_270."""
LEAST_QUALITY = 70
"""Per cent (RNGFND_SQ_MIN of ArduSub)."""
FIX_3D, UNKNOWN_EPH = 3, 65535
"""GPS_FIX_TYPE_3D_FIX; GPS_RAW_INT.eph without a value."""
RANGE_ERROR_M = 3.0
"""Error of one satellite's range (standard positioning service): times the dilution of precision it is the position's,
where the receiver gives no h_acc."""
RANGE_SIGMA_M, RANGE_FRACTION = 0.01, 0.005
"""Of a range: it is told in centimetres, a Ping Sonar resolves half a per cent."""
EVERY_US, FIRST_EVERY_US = 500_000, 100_000
"""Between requests, and until there are enough."""
ENOUGH = 5
KEPT_US = 15_000_000
"""Quartzes drift by no more than 7 ms meanwhile."""
ANSWER_US = 2_000_000
"""A later answer does not count."""
PENDING = 32
SLACK_US = 20_000.0
"""Beyond half a round trip: two polls, rounding. What differs by more is another setting of the clock."""
DIRECT_US = 10_000.0
"""Latency of a cable, loop time included, which is part of the vehicle file's ``latency_s``."""


class _RoundTrip(NamedTuple):
    t_us: int
    took_us: int
    ahead_us: float
    """Our time minus the device's."""


class LinkLatency:
    """Latency of a flight controller's link, by TIMESYNC (https://mavlink.io/en/services/timesync.html).

    Arrivals alone do not show a constant latency: it looks like another setting of the device's clock. A round trip
    does: the clock's reading in the answer is taken half of it before the answer comes, wherever its latency lies
    within."""

    def __init__(self, span_us: int) -> None:
        """``span_us``: the counter in the device's measurements begins anew after this."""
        self._span_us = span_us
        self._asked: deque[int] = deque(maxlen=PENDING)
        self._trips: deque[_RoundTrip] = deque()

    def due(self, t_us: int) -> bool:
        """Whether to send a request now, whose ts1 is this time [ns]."""
        every_us = EVERY_US if len(self._trips) >= ENOUGH else FIRST_EVERY_US
        if self._asked and t_us - self._asked[-1] < every_us:
            return False
        self._asked.append(t_us)
        return True

    def take(self, t_us: int, tc1_ns: int, ts1_ns: int) -> None:
        """A TIMESYNC of the flight controller: an answer to one of ours, or something else."""
        asked_us = ts1_ns // 1000
        if tc1_ns <= 0 or asked_us not in self._asked or not 0 <= t_us - asked_us <= ANSWER_US:
            return
        trip = _RoundTrip(t_us, t_us - asked_us, 0.5 * (asked_us + t_us) - 1e-3 * tc1_ns)
        best = self._best
        if best is not None and abs(best.ahead_us - trip.ahead_us) > 0.5 * (best.took_us + trip.took_us) + SLACK_US:
            self._trips.clear()
        self._trips.append(trip)
        while t_us - self._trips[0].t_us > KEPT_US:
            self._trips.popleft()

    @property
    def _best(self) -> _RoundTrip | None:
        return min(self._trips, key=lambda trip: trip.took_us) if self._trips else None

    @property
    def longest_us(self) -> int:
        """The longest of the last round trips."""
        return max((trip.took_us for trip in self._trips), default=0)

    def beyond_us(self, ahead_us: float) -> float:
        """Latency beyond that of a cable [us] that is part of a difference of clocks by arrivals (our time minus the
        device's). 0 while it is not known.
        """
        best = self._best
        if best is None:
            return 0.0
        half = 0.5 * self._span_us
        latency_us = (ahead_us - best.ahead_us + half) % self._span_us - half
        # Not of its last answer's clock (a restart): with the next one it is known again.
        if not -0.5 * best.took_us - SLACK_US <= latency_us <= ANSWER_US:
            return 0.0
        return max(0.0, latency_us - DIRECT_US)


class ArduSubTelemetry:
    """Messages in, samples out. Stamps are those of its clock, moved to ours."""

    def __init__(
        self, vehicle: Vehicle, *, density_kg_m3: float, depth_sigma_m: float, ground_pa: float | None
    ) -> None:
        """``ground_pa``: pressure at the surface, None = its own."""
        self._vehicle = vehicle
        self._density = density_kg_m3
        self._depth_sigma_m = depth_sigma_m
        self._given_ground_pa = ground_pa
        self.clock = DeviceClock(CLOCK_SPAN_US)
        """Its own, on ours."""
        self.latency = LinkLatency(CLOCK_SPAN_US)
        """Of the way that its messages take."""
        self._accel: tuple[int, int, list[float]] | None = None
        """The last one: arrival and its own time [us], and what was measured [m/s^2]."""
        self._pressure: tuple[int, float] = (-AGAIN_US, math.nan)
        """The last one that was passed on."""
        self._gps_us: int | None = None
        """Receiver's time of the last fix that was passed on."""
        self.supply_v: float | None = None
        self.parameters: dict[str, float] = {}
        """Its own, as far as they are known."""
        self.bad_samples = 0
        """Messages whose numbers are none."""

    def take(self, t_us: int, message: Any) -> list[Sample]:
        """The samples that a message makes."""
        match message.get_type():
            case "RAW_IMU":
                accel = [message.xacc, message.yacc, message.zacc]
                self._accel = (t_us, int(message.time_usec), [1e-3 * G_M_S2 * part for part in accel])
            case "ATTITUDE":
                return self._attitude(t_us, message)
            case "SCALED_PRESSURE2":
                return self._depth(t_us, message)
            case "DISTANCE_SENSOR" if message.orientation == DOWNWARD:
                return self._altimeter(t_us, message)
            case "GPS_RAW_INT" if message.fix_type >= FIX_3D:
                return self._gps(t_us, message)
            case "BATTERY_STATUS" if message.id == 0:
                return self._power(t_us, message)
            case _:
                return []
        return []

    def _taken_us(self, arrived_us: int, latency_s: float) -> int:
        """When a measurement was made that arrives then, over a link that may be slower than a cable."""
        return arrived_us - round(1e6 * latency_s + self.latency.beyond_us(self.clock.offset_us))

    def _attitude(self, t_us: int, message: Any) -> list[Sample]:
        if self._accel is None or t_us - self._accel[0] > FRESH_IMU_US:
            return []
        numbers = [message.roll, message.pitch, message.yaw, message.rollspeed, message.pitchspeed, message.yawspeed]
        if not all(math.isfinite(number) for number in numbers):
            self.bad_samples += 1
            return []
        stamped_us = self.clock.stamp(t_us, int(message.time_boot_ms) * 1000)
        if stamped_us is None:
            self.bad_samples += 1
            return []
        return [
            AhrsSample(
                t_us=self._taken_us(stamped_us, self._vehicle.ahrs.latency_s),
                rpy_rad=np.array(numbers[:3]),
                rate_frd_rad_s=np.array(numbers[3:]),
                accel_frd_m_s2=self._turned(int(message.time_boot_ms) * 1000, numbers[3:], *self._accel[1:]),
            )
        ]

    def _turned(self, device_us: int, rate_frd_rad_s: list[float], of_us: int, accel: list[float]) -> FloatArray:
        """(3,) an acceleration of before in the axes of the body at ``device_us``: by a lag of 20 ms and half a radian
        per second gravity would be off by 0.1 m/s^2."""
        apart_us = (device_us - of_us + CLOCK_SPAN_US // 2) % CLOCK_SPAN_US - CLOCK_SPAN_US // 2
        lag_s = ACCEL_LAG_S + 1e-6 * min(max(apart_us, 0), FRESH_IMU_US)
        (p, q, r), (x, y, z) = rate_frd_rad_s, accel
        return np.array((x - lag_s * (q * z - r * y), y - lag_s * (r * x - p * z), z - lag_s * (p * y - q * x)))

    def _depth(self, t_us: int, message: Any) -> list[Sample]:
        """Depth by the sensor outside of the hull."""
        given_pa = self._given_ground_pa
        ground_pa = self.parameters.get("BARO2_GND_PRESS") if given_pa is None else given_pa
        if ground_pa is None or ground_pa <= 0.0 or not math.isfinite(message.press_abs):
            return []
        if message.press_abs == self._pressure[1] and t_us - self._pressure[0] < AGAIN_US:
            return []
        self._pressure = (t_us, message.press_abs)
        depth_m = (PA_HPA * message.press_abs - ground_pa) / (self._density * G_M_S2)
        taken_us = self._taken_us(t_us, self._vehicle.depth_sensor.latency_s)
        return [DepthSample(t_us=taken_us, depth_m=depth_m, sigma_m=self._depth_sigma_m)]

    def _altimeter(self, t_us: int, message: Any) -> list[Sample]:
        """Sample of its range finder; none at or beyond its limits; a quality of 0 means unknown."""
        range_cm, quality = message.current_distance, getattr(message, "signal_quality", 0)
        if not message.min_distance < range_cm < message.max_distance or not 0 <= quality <= 100:
            return []
        if quality and quality < LEAST_QUALITY:
            return []
        taken_us = self._taken_us(t_us, self._vehicle.altimeter.latency_s)
        range_m = 0.01 * range_cm
        sigma_m = math.hypot(RANGE_SIGMA_M, RANGE_FRACTION * range_m)
        confidence = 0.01 * quality if quality else 1.0
        return [AltimeterSample(t_us=taken_us, range_m=range_m, sigma_m=sigma_m, confidence=confidence)]

    def _gps(self, t_us: int, message: Any) -> list[Sample]:
        """Fix of its receiver; none of unknown accuracy, and none that it has sent before."""
        sigma_m = 1e-3 * getattr(message, "h_acc", 0)
        if sigma_m == 0.0 and message.eph != UNKNOWN_EPH:
            sigma_m = RANGE_ERROR_M * 0.01 * message.eph
        if sigma_m == 0.0 or message.time_usec == self._gps_us:
            return []
        self._gps_us = message.time_usec
        return [
            GpsSample(
                t_us=t_us - round(1e6 * self._vehicle.gps.latency_s),
                lat_deg=1e-7 * message.lat,
                lon_deg=1e-7 * message.lon,
                alt_m=1e-3 * message.alt,
                sigma_m=sigma_m,
            )
        ]

    def _power(self, t_us: int, message: Any) -> list[Sample]:
        cells = [cell for cell in message.voltages if cell != 65535]
        if not cells:
            return []
        voltage_v = 1e-3 * sum(cells)
        current_a = max(0.0, 1e-2 * message.current_battery)
        used_j = 100.0 * message.energy_consumed if message.energy_consumed >= 0 else 0.0
        if used_j == 0.0 and message.current_consumed > 0:
            used_j = 3.6 * message.current_consumed * voltage_v
        if self._vehicle.battery.limits.can_be(voltage_v):
            self.supply_v = voltage_v
        if message.battery_remaining >= 0:
            remaining = 0.01 * message.battery_remaining
        else:
            remaining = min(1.0, max(0.0, 1.0 - used_j / self._vehicle.battery.capacity_j))
        return [
            PowerSample(t_us=t_us, voltage_v=voltage_v, current_a=current_a, energy_used_j=used_j, remaining=remaining)
        ]
