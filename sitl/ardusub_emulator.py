"""Emulated ArduSub flight controller on MAVLink, for tests of the driver.

Behaves as measured with ArduSub 4.7: axes are RC channels, motors sums of them, linear in the pulse; channels are read
at 50 Hz and keep their value without new messages until the pilot failsafe. With a receiver enabled (RC_PROTOCOLS)
each of its frames counts as pilot input while an override is younger than RC_OVERRIDE_TIME. It accepts one ground
station; arming is followed by half a second of neutral and half a second of ramp in heave; a mode change shows in a
heartbeat at once, a disarming first in a text. Modes other than MANUAL also follow the channels: their stabilisation
is left to the hull. No code is shared with the driver.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import Origin
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.ardusub_mixing import NEUTRAL_US, SPAN_US
from autopilot.drivers.ardusub_prearm import PREARM_BIT
from autopilot.sitl.ardusub_extras import COMMANDS, EXTRA_PARAMETERS, ArduSubExtras
from autopilot.sitl.plant import Truth
from autopilot.sitl.sitl_tuning import PLANT
from autopilot.sitl.thruster_models import OFF_US, wrench_of

SYSTEM, COMPONENT = 1, 1
MANUAL, STABILIZE = 19, 0
DEPTH_HOLD, ACRO, SURFACE, POSITION_HOLD = 2, 1, 9, 16
HOLD_DEPTH = (DEPTH_HOLD, SURFACE, POSITION_HOLD)
HELD_HEAVE_US = 150.0
"""What these have at the upright motors themselves: MANUAL begins there."""
SLOW_HEAVE_RAD_S = 2.0 * math.pi * 2.0
"""Low-pass of heave that the modes with depth hold leave behind in MANUAL."""
MODES = {0: "Stabilize", 1: "Acro", 2: "Depth Hold", 9: "Surface", 16: "Position Hold", 19: "Manual"}

FACTORS = {
    "vectored": ("-F+L+Y", "-F-L-Y", "+F+L-Y", "+F-L+Y", "-T+R", "-T-R"),
    "vectored_6dof": ("-F+L+Y", "-F-L-Y", "+F+L-Y", "+F-L+Y", "-T+R-P", "-T-R-P", "-T+R+P", "-T-R+P"),
}
"""Per motor, the axes that it adds up."""
FRAME_NUMBERS = {"vectored": 1, "vectored_6dof": 2}
CHANNEL_OF = {"P": 0, "R": 1, "T": 2, "Y": 3, "F": 4, "L": 5}
CHANNEL_NUMBERS = {"PITCH": 1, "ROLL": 2, "THROTTLE": 3, "YAW": 4, "FORWARD": 5, "LATERAL": 6}
"""RCMAP_..., as it comes."""
PLANE = 4
"""Motors 1 to 4 lie in the plane."""
READ_US = 20_000
"""Channels are read so often."""
PILOT_HEARD_US = 1_000_000
"""So long after a pilot's message it arms with centred roll, pitch and yaw only."""
STILL_US = 510_000
"""Neutral after arming."""
DISARM_SHOWN_US = 400_000
"""A heartbeat that shows a disarming comes up to so much later."""

GROUND_PA, WATER_KG_M3, G = 101_325.0, 998.0, PLANT.gravity_m_s2
ACCEL_NOISE_M_S2, RATE_NOISE_RAD_S = 0.02, 0.002
ACCEL_LAG_S = 0.005
"""Its accelerations are low-passed: how much later they are than its attitude."""
TILT_RAD, YAW_RAD, SLOW_S = 0.005, 0.01, 20.0
"""Slow errors of its attitude."""
PRESSURE_NOISE_PA = 20.0

DEFAULT_RATES_HZ = {
    "HEARTBEAT": 1.0,
    "SYS_STATUS": 2.0,
    "ATTITUDE": 10.0,
    "RAW_IMU": 2.0,
    "SCALED_PRESSURE2": 2.0,
    "SERVO_OUTPUT_RAW": 2.0,
    "BATTERY_STATUS": 3.0,
    "DISTANCE_SENSOR": 3.0,
    "GPS_RAW_INT": 2.0,
}
MESSAGE_IDS = {
    1: "SYS_STATUS",
    30: "ATTITUDE",
    27: "RAW_IMU",
    137: "SCALED_PRESSURE2",
    36: "SERVO_OUTPUT_RAW",
    147: "BATTERY_STATUS",
    132: "DISTANCE_SENSOR",
    24: "GPS_RAW_INT",
}


def default_parameters(frame: str, directions: Sequence[int]) -> dict[str, float]:
    """Parameters as a laboratory has set them for an autopilot above."""
    motors = {f"MOT_{motor}_DIRECTION": float(sign) for motor, sign in enumerate(directions, 1)}
    channels: dict[str, float] = {}
    for number in range(1, 9):
        channels |= {f"RC{number}_TRIM": 1500.0, f"RC{number}_MIN": 1100.0, f"RC{number}_MAX": 1900.0}
        channels[f"RC{number}_REVERSED"] = channels[f"RC{number}_OPTION"] = 0.0
    channels |= {f"RCMAP_{name}": float(number) for name, number in CHANNEL_NUMBERS.items()}
    channels |= {f"SERVO{motor}_FUNCTION": 32.0 + motor for motor in range(1, len(directions) + 1)}
    return {
        **motors,
        **channels,
        "FRAME_CONFIG": float(FRAME_NUMBERS[frame]),
        "MOT_FV_CPLNG_K": 0.0,
        "MOT_BAT_CURR_MAX": 0.0,
        "MOT_PWM_MIN": 1100.0,
        "MOT_PWM_MAX": 1900.0,
        "MOT_SPOOL_TIME": 0.5,
        "FS_PILOT_INPUT": 1.0,
        "FS_PILOT_TIMEOUT": 0.5,
        "FS_THR_ENABLE": 0.0,
        "RC_PROTOCOLS": 0.0,
        "RC_OVERRIDE_TIME": 3.0,
        "RC_OPTIONS": 32.0,
        "FS_GCS_ENABLE": 2.0,
        "FS_GCS_TIMEOUT": 5.0,
        "ACRO_YAW_P": 3.375,
        "JS_GAIN_DEFAULT": 0.5,
        "MAV_GCS_SYSID": 255.0,
        "BARO1_GND_PRESS": GROUND_PA,
        "BARO2_GND_PRESS": GROUND_PA,
        "BARO_SPEC_GRAV": 1.0,
        **EXTRA_PARAMETERS,
    }


def check_frame(vehicle: Vehicle, frame: str) -> None:
    """ConfigError for a vehicle without a thruster for each of the frame's motors."""
    motors = set(range(1, len(FACTORS[frame]) + 1))
    if not motors <= {thruster.channel for thruster in vehicle.thrusters}:
        raise ConfigError(
            f"vehicle {vehicle.name!r}: ArduSub's frame {frame} has motors 1 to {len(motors)}; use --vehicle bluerov2"
            " with --frame vectored, bluerov2-heavy with vectored_6dof"
        )


class ArduSubEmulator:
    """Bytes in, bytes and servo pulses out. Time is handed in."""

    def __init__(
        self,
        vehicle: Vehicle,
        frame: str,
        *,
        seed: int = 0,
        directions: Sequence[int] | None = None,
        parameters: dict[str, float] | None = None,
        floor_depth_m: float | None = None,
        origin: Origin | None = None,
    ) -> None:
        """``directions``: MOT_n_DIRECTION as this vehicle needs them, 1 for all by default."""
        from pymavlink.dialects.v20 import ardupilotmega

        check_frame(vehicle, frame)
        self._dialect: Any = ardupilotmega
        self._mav: Any = ardupilotmega.MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPONENT)
        self._readers: dict[int, Any] = {}
        self._rows = [_row(text) for text in FACTORS[frame]]
        self._scales = frame != "vectored"
        signs = [1] * len(self._rows) if directions is None else list(directions)
        self._wiring = self._wired(vehicle, signs)
        self._pressure_frd_m = np.array(vehicle.depth_sensor.position_frd_m)
        self.parameters = {**default_parameters(frame, signs), **(parameters or {})}
        """Live: what is written here or by PARAM_SET acts at once."""
        self.mode = MANUAL
        self.armed = False
        self.wet = False
        """The leak probe."""
        self.objection = ""
        """What its own pre-arm checks find, "" = nothing."""
        self.servos_us = (NEUTRAL_US,) * len(self._rows)
        """What is at the servo rail now."""
        self.extras = ArduSubExtras(self._mav, self.parameters, seed, floor_depth_m, origin)
        """Outputs beside the motors, and sensors that are sold separately."""
        self._shown_armed = False
        self._show_us = 0
        self._channels = [NEUTRAL_US] * 8
        """As they are held."""
        self._read = [0.0] * 6
        """As they were read last, us off neutral."""
        self._read_us = -READ_US
        self._slow_heave = False
        self._heave, self._heave_us = 0.0, 0
        """Filtered, us off neutral, and when."""
        self._armed_us = 0
        self._input_us: int | None = None
        self._override_us: int | None = None
        """Of the newest override or joystick."""
        self._gcs_us: int | None = None
        self._failed = self._gcs_lost = False
        self._leak_us = -20_000_000
        self._gain = self.parameters["JS_GAIN_DEFAULT"]
        self._rates_hz = dict(DEFAULT_RATES_HZ)
        self._sent_us = dict.fromkeys(self._rates_hz, -(1 << 62))
        self._out: list[bytes] = []
        self._rng = np.random.default_rng((seed, 70))
        self._accel: tuple[int, FloatArray] | None = None
        """When its low-pass was last asked, and what it had."""
        first = self._rng.standard_normal(3)
        self._slow = np.array([TILT_RAD, TILT_RAD, YAW_RAD]) * first
        self._slow_us = 0
        self.pressure_hz = 10.0
        """So often its pressure sensor is read; between two readings the last is sent again."""
        self._pressure_hpa, self._pressure_us = 0.0, -(1 << 62)
        self.mute = False
        """Says nothing and hears nothing: a cable that is off."""

    def codec(self, system: int, component: int) -> Any:
        """Somebody else of the same dialect."""
        return self._dialect.MAVLink(None, srcSystem=system, srcComponent=component)

    # The vehicle's side

    def plant_pulses_us(self, vehicle: Vehicle) -> tuple[int, ...]:
        """Pulses per channel as the plant has them: along ``direction_frd`` above neutral."""
        pulses = [NEUTRAL_US] * max(thruster.channel for thruster in vehicle.thrusters)
        for motor, (servo, wired) in enumerate(zip(self.servos_us, self._wiring, strict=True)):
            pulses[motor] = OFF_US if servo == OFF_US else NEUTRAL_US + wired * (servo - NEUTRAL_US)
        return tuple(pulses)

    def _wired(self, vehicle: Vehicle, directions: Sequence[int]) -> list[int]:
        """1 where a longer servo pulse is a longer pulse of the plant: directions are as its pilot has set them."""
        wrench = np.array(wrench_of(vehicle))
        by_motor = {thruster.channel: index for index, thruster in enumerate(vehicle.thrusters)}
        wired = []
        for motor, (row, direction) in enumerate(zip(self._rows, directions, strict=True), 1):
            force = wrench[:3, by_motor[motor]]
            commanded = np.array([row[CHANNEL_OF["F"]], row[CHANNEL_OF["L"]], -row[CHANNEL_OF["T"]]])
            turned = -1 if vehicle.thrusters[by_motor[motor]].reversed else 1
            wired.append(int(math.copysign(1.0, float(force @ commanded))) * direction * turned)
        return wired

    # The wire's side

    def receive(self, t_us: int, data: bytes, link: int = 0) -> None:
        if self.mute:
            return
        reader = self._readers.get(link)
        if reader is None:
            reader = self._readers[link] = self._dialect.MAVLink(None)
            reader.robust_parsing = True
        for message in reader.parse_buffer(data) or ():
            self._take(t_us, message)

    def step(self, t_us: int, truth: Truth) -> list[bytes]:
        """Advance to ``t_us``: servo outputs, and messages to all links."""
        self._watch(t_us)
        if t_us - self._read_us >= READ_US:
            self._read_us = t_us
            self._read = [float(min(max(us, 1100), 1900) - NEUTRAL_US) for us in self._channels[:6]]
        self._filter_heave(t_us)
        self.servos_us = self._mixed(t_us)
        for name, rate_hz in self._rates_hz.items():
            if rate_hz > 0.0 and t_us - self._sent_us[name] >= 1e6 / rate_hz - 1000.0:
                self._sent_us[name] = t_us
                self._stream(name, t_us, truth)
        out, self._out = self._out, []
        return [] if self.mute else out

    def _filter_heave(self, t_us: int) -> None:
        """Unfiltered, except for the filter that depth hold leaves active until a disarming or another mode."""
        if not self.armed or self.mode in (STABILIZE, ACRO):
            self._slow_heave = False
        elif self.mode in HOLD_DEPTH:
            self._slow_heave = True
        commanded, passed_s = self._read[CHANNEL_OF["T"]], 1e-6 * (t_us - self._heave_us)
        gain = 1.0 - math.exp(-SLOW_HEAVE_RAD_S * passed_s) if self._slow_heave else 1.0
        self._heave, self._heave_us = self._heave + gain * (commanded - self._heave), t_us

    def _mixed(self, t_us: int) -> tuple[int, ...]:
        still = not self.armed or t_us - self._armed_us < STILL_US
        if still:
            return (NEUTRAL_US,) * len(self._rows)
        axes = np.array(self._read)
        axes[CHANNEL_OF["T"]] = self._heave
        grown = (t_us - self._armed_us - STILL_US) / (1e6 * max(self.parameters["MOT_SPOOL_TIME"], 0.01))
        axes[CHANNEL_OF["T"]] *= min(1.0, grown)
        axes[CHANNEL_OF["Y"]] *= self.parameters["ACRO_YAW_P"] / 3.375
        sums = np.array(self._rows) @ axes
        if self._scales:
            for group in (slice(0, PLANE), slice(PLANE, None)):
                sums[group] /= max(1.0, float(np.abs(sums[group]).max()) / SPAN_US)
        else:
            heave = abs(axes[CHANNEL_OF["T"]]) / SPAN_US
            cut = 1.0 - self.parameters["MOT_FV_CPLNG_K"] * heave
            if cut < 1.0:  # forward gives way to heave on the two motors that would work against it
                forward = axes[CHANNEL_OF["F"]]
                for motor in (0, 1) if axes[CHANNEL_OF["T"]] > 0.0 else (2, 3):
                    sums[motor] -= self._rows[motor][CHANNEL_OF["F"]] * forward * (1.0 - cut)
            sums = np.clip(sums, -SPAN_US, SPAN_US)
        pulses = []
        for motor, amount in enumerate(sums.tolist(), 1):
            sign = -1.0 if self.parameters[f"MOT_{motor}_DIRECTION"] < 0.0 else 1.0
            pulses.append(int(NEUTRAL_US + sign * amount))
        return tuple(pulses)

    def _watch(self, t_us: int) -> None:
        values = self.parameters
        self._read_receiver(t_us)
        if self.armed and self._input_us is not None:
            late = t_us - self._input_us > 1e6 * values["FS_PILOT_TIMEOUT"]
            if late and not self._failed and values["FS_PILOT_INPUT"] >= 1.0:
                self._failed = True
                self._channels[:6] = [NEUTRAL_US] * 6
                self._read_us = -READ_US
                self._text(2, "Lost manual control")
                if values["FS_PILOT_INPUT"] >= 2.0:
                    self._disarm(t_us)
        if self._gcs_us is not None and values["FS_GCS_ENABLE"] >= 1.0:
            lost = t_us - self._gcs_us > 1e6 * values["FS_GCS_TIMEOUT"]
            if lost and not self._gcs_lost:
                self._text(4, "MYGCS: 255, heartbeat lost")
                if values["FS_GCS_ENABLE"] >= 2.0 and self.armed:
                    self._disarm(t_us)
            self._gcs_lost = lost
        if self._shown_armed != self.armed and t_us >= self._show_us:
            self._shown_armed = self.armed
        if self.wet and t_us - self._leak_us >= 20_000_000:
            self._leak_us = t_us
            self._text(4, "Leak Detected")

    @property
    def _overridable(self) -> bool:
        """RC_OVERRIDE_TIME 0 and bit 1 of RC_OPTIONS switch overrides off, a joystick's as well."""
        return self.parameters["RC_OVERRIDE_TIME"] != 0.0 and not round(self.parameters["RC_OPTIONS"]) & 2

    def _read_receiver(self, t_us: int) -> None:
        """A radio receiver with centred sticks, where one is enabled."""
        if self._override_us is None or round(self.parameters["RC_PROTOCOLS"]) == 0:
            return
        lasts_s = self.parameters["RC_OVERRIDE_TIME"]
        if lasts_s >= 0.0 and t_us - self._override_us >= 1e6 * lasts_s:
            self._channels[:6] = [NEUTRAL_US] * 6
        if self._input_us is not None:
            self._input_us, self._failed = t_us, False

    def _arm(self, t_us: int) -> None:
        if not self.armed:
            self.armed, self._armed_us, self._shown_armed, self._input_us = True, t_us, True, None
            self._text(6, "Arming motors")

    def _not_neutral(self, t_us: int) -> str:
        """What keeps it from arming in the channels of a pilot who is heard."""
        if self._input_us is None or t_us - self._input_us > PILOT_HEARD_US:
            return ""
        moved = [name for name in ("ROLL", "PITCH", "YAW") if self._channels[CHANNEL_NUMBERS[name] - 1] != NEUTRAL_US]
        return f"{moved[0].capitalize()} (RC{CHANNEL_NUMBERS[moved[0]]}) is not neutral" if moved else ""

    def _disarm(self, t_us: int) -> None:
        if self.armed:
            self.armed, self._show_us = False, t_us + DISARM_SHOWN_US
            self._text(6, "Disarming motors")

    def _set_mode(self, mode: int) -> bool:
        if mode not in MODES:
            self._text(4, f"No such mode {mode}")
            return False
        if mode == MANUAL and self.mode in HOLD_DEPTH and self.armed:
            self._heave = HELD_HEAVE_US
        self.mode = mode
        if mode == MANUAL:
            self._read = [0.0] * 6
        self._sent_us["HEARTBEAT"] = -(1 << 62)
        return True

    def _take(self, t_us: int, message: Any) -> None:
        kind, source = message.get_type(), message.get_srcSystem()
        obeyed = source == round(self.parameters["MAV_GCS_SYSID"])
        if obeyed and kind in ("HEARTBEAT", "RC_CHANNELS_OVERRIDE", "MANUAL_CONTROL"):
            self._gcs_us = t_us
        match kind:
            case "RC_CHANNELS_OVERRIDE" if obeyed and message.target_system == SYSTEM:
                self._input_us, self._failed = t_us, False
                if not self._overridable:
                    return
                for channel in range(8):
                    value = getattr(message, f"chan{channel + 1}_raw")
                    if value not in (0, 65535):
                        self._channels[channel] = value
                self._override_us = t_us
            case "MANUAL_CONTROL" if obeyed and message.target == SYSTEM and self._overridable:
                self._pilot(t_us, message)
            case "COMMAND_LONG":
                self._command(t_us, message, source)
            case "TIMESYNC" if message.tc1 == 0:
                self._send(self._mav.timesync_encode(1000 * t_us, message.ts1))
            case "PARAM_REQUEST_READ":
                self._send_parameter(message.param_id)
            case "PARAM_SET" if message.param_id in self.parameters:
                self.parameters[message.param_id] = float(message.param_value)
                self._send_parameter(message.param_id)
            case _:
                return

    def _pilot(self, t_us: int, message: Any) -> None:
        """A joystick: gain and truncation to whole microseconds."""
        gain = self._gain
        for name, amount in (
            ("F", 0.4 * gain * message.x),
            ("L", 0.4 * gain * message.y),
            ("Y", 0.4 * gain * message.r),
        ):
            self._channels[CHANNEL_OF[name]] = int(NEUTRAL_US + amount)
        self._channels[CHANNEL_OF["T"]] = int(NEUTRAL_US + 0.8 * gain * (message.z - 500))
        self._channels[0] = self._channels[1] = NEUTRAL_US
        self._input_us, self._failed = t_us, False
        self._override_us = t_us

    def _command(self, t_us: int, message: Any, source: int) -> None:
        """Anybody may arm, disarm and change the mode."""
        result = 3
        objection = self.objection or self._not_neutral(t_us) if message.command == 400 else ""
        if message.param1 > 0.5 and objection:
            result = 4
            self._text(2, f"Arm: {objection}")
        elif message.command == 400:
            result = 0
            (self._arm if message.param1 > 0.5 else self._disarm)(t_us)
        elif message.command == 401:
            result = 0
            if self.objection:
                self._text(2, f"PreArm: {self.objection}")
        elif message.command == 176:
            result = 0 if self._set_mode(int(message.param2)) else 4
        elif message.command == 511 and int(message.param1) in MESSAGE_IDS:
            name = MESSAGE_IDS[int(message.param1)]
            self._rates_hz[name] = 1e6 / message.param2 if message.param2 > 0.0 else 0.0
            result = 0
        elif message.command == 511:
            result = 2
        elif message.command == 512:
            result = 0 if message.param1 == 0.0 else 4
            if result == 0:
                self._sent_us["HEARTBEAT"] = -(1 << 62)
        elif message.command in COMMANDS:
            result, text = self.extras.order(message)
            if text:
                self._text(6, text)
        self._send(self._mav.command_ack_encode(message.command, result, 0, 0, source, message.get_srcComponent()))

    def _send_parameter(self, name: str) -> None:
        if name in self.parameters:
            count = len(self.parameters)
            self._send(self._mav.param_value_encode(name.encode(), self.parameters[name], 9, count, 65535))

    def _text(self, severity: int, text: str) -> None:
        self._send(self._mav.statustext_encode(severity, text.encode()))

    def _send(self, message: Any) -> None:
        self._out.append(bytes(message.pack(self._mav)))

    def _filtered(self, t_us: int, truth: Truth) -> FloatArray:
        """(3,) acceleration behind its low-pass."""
        last = self._accel
        passed_s = 0.0 if last is None else 1e-6 * (t_us - last[0])
        before = truth.accel_frd_m_s2 if last is None else last[1]
        now: FloatArray = before + passed_s / (passed_s + ACCEL_LAG_S) * (truth.accel_frd_m_s2 - before)
        self._accel = t_us, now
        return now

    def _stream(self, name: str, t_us: int, truth: Truth) -> None:
        mav, ms = self._mav, t_us // 1000
        match name:
            case "HEARTBEAT":
                flags = 1 | 64 | (128 if self._shown_armed else 0)
                self._send(mav.heartbeat_encode(12, 3, flags, self.mode, 4 if self._shown_armed else 3))
            case "SYS_STATUS":
                healthy = 0 if self.objection else PREARM_BIT
                known = (PREARM_BIT, PREARM_BIT, healthy)
                self._send(mav.sys_status_encode(*known, 100, round(1e3 * truth.voltage_v), 0, -1, 0, 0, 0, 0, 0, 0))
            case "ATTITUDE":
                rpy = (truth.rpy_rad + self._slow_errors(t_us)).tolist()
                rate = (truth.rate_frd_rad_s + RATE_NOISE_RAD_S * self._rng.standard_normal(3)).tolist()
                yaw = math.remainder(rpy[2], 2.0 * math.pi)
                self._send(mav.attitude_encode(ms, rpy[0], rpy[1], yaw, *rate))
            case "RAW_IMU":
                accel = self._filtered(t_us, truth) + ACCEL_NOISE_M_S2 * self._rng.standard_normal(3)
                mg = [round(1e3 * part / G) for part in accel.tolist()]
                turn = [round(1e3 * part) for part in truth.rate_frd_rad_s.tolist()]
                self._send(mav.raw_imu_encode(t_us, *mg, *turn, 0, 0, 0))
            case "SCALED_PRESSURE2":
                if t_us - self._pressure_us >= 1e6 / self.pressure_hz - 1000.0:
                    depth_m = truth.depth_of(self._pressure_frd_m)
                    noise = PRESSURE_NOISE_PA * float(self._rng.standard_normal())
                    self._pressure_hpa = 0.01 * (GROUND_PA + WATER_KG_M3 * G * depth_m + noise)
                    self._pressure_us = t_us
                self._send(mav.scaled_pressure2_encode(ms, self._pressure_hpa, 0.0, 2000))
            case "SERVO_OUTPUT_RAW":
                servos = self.extras.rail(self.servos_us)
                self._send(mav.servo_output_raw_encode(t_us & 0xFFFFFFFF, 0, *servos[:8], *servos[8:]))
            case "GPS_RAW_INT" | "DISTANCE_SENSOR":
                found = self.extras.gps(t_us, truth) if name == "GPS_RAW_INT" else self.extras.range(ms, truth)
                if found is not None:
                    self._send(found)
            case _:
                cells = [round(1e3 * truth.voltage_v), *([65535] * 9)]
                used = round(truth.energy_used_j / 100.0)
                left = round(100.0 * truth.energy_remaining)
                self._send(
                    mav.battery_status_encode(0, 0, 1, 32767, cells, round(100.0 * truth.current_a), -1, used, left)
                )

    def _slow_errors(self, t_us: int) -> np.ndarray[Any, np.dtype[np.float64]]:
        keep = math.exp(-1e-6 * (t_us - self._slow_us) / SLOW_S)
        self._slow_us = t_us
        fresh = np.array([TILT_RAD, TILT_RAD, YAW_RAD]) * math.sqrt(1.0 - keep * keep)
        self._slow = keep * self._slow + fresh * self._rng.standard_normal(3)
        return self._slow


def _row(text: str) -> list[int]:
    """``-F+L+Y`` as factors of the channels 1 to 6."""
    row = [0] * len(CHANNEL_OF)
    for sign, axis in _terms(text):
        row[CHANNEL_OF[axis]] = sign
    return row


def _terms(text: str) -> Iterator[tuple[int, str]]:
    letters: Iterable[str] = iter(text)
    for sign, axis in zip(letters, letters, strict=False):
        yield (1 if sign == "+" else -1), axis
