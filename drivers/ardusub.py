"""ArduSub as lower flight controller: a source of measurements, and an actuator for our thrust commands.

Its MAVLink delivers attitude, rates and acceleration, pressure, battery and leak probe. Our pulses are sent as
RC_CHANNELS_OVERRIDE in its MANUAL mode, at 50 Hz (:mod:`.drivers.ardusub_mixing`), and its reported servo outputs are
compared with the command. Stopping means 1500 on every channel: without messages the last thrust would remain until
its own failsafe. It keeps its arming, its failsafes and its pilot: we are a ground station to it, whose missing
heartbeat it detects when this process dies, and a change of its mode removes our authority at once
(:mod:`.drivers.ardusub_authority`). Its parameters are read and checked (:mod:`.drivers.ardusub_settings`), never
written.
"""

from collections import deque
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal

import msgspec

from autopilot.core import operator_messages as notices
from autopilot.core.camera_tilt import TiltReports
from autopilot.core.errors import DriverError
from autopilot.core.messages import Authority, FlightControllerState, Severity
from autopilot.core.samples import Sample
from autopilot.core.toml_table import NonNegative, Positive, Table
from autopilot.core.vehicle import Vehicle
from autopilot.drivers.ardusub_authority import AuthorityWatch
from autopilot.drivers.ardusub_leak import LeakWatch
from autopilot.drivers.ardusub_mixing import FRAMES, NEUTRAL, Mixer
from autopilot.drivers.ardusub_payload import Passing
from autopilot.drivers.ardusub_prearm import RUN_CHECKS, SYS_STATUS_ID, PrearmWatch
from autopilot.drivers.ardusub_senders import OutputWatch
from autopilot.drivers.ardusub_settings import ArduSubSettings
from autopilot.drivers.ardusub_telemetry import ArduSubTelemetry
from autopilot.drivers.ardusub_wire import (
    ENOUGH,
    HEARTBEAT_US,
    REST_SENDS,
    SEND_EVERY_US,
    SERVO_HZ,
    SERVO_ID,
    Wire,
)
from autopilot.drivers.base import Closing
from autopilot.drivers.links import open_link, parse_connection

HEARTBEAT = 0
REQUEST_EVERY_US = 500_000
PARAMETERS_PER_REQUEST = 16
READ_AGAIN_US = 30_000_000
"""Parameters act live and may be changed by the pilot: while disarmed they are read anew."""
STALE_US = 500_000
"""Timeout without messages."""
MESSAGE_IDS = {
    "ATTITUDE": 30,
    "RAW_IMU": 27,
    "SCALED_PRESSURE2": 137,
    "SERVO_OUTPUT_RAW": SERVO_ID,
    "DISTANCE_SENSOR": 132,
    "BATTERY_STATUS": 147,
    "GPS_RAW_INT": 24,
}
SLOW_HZ, PRESSURE_HZ, STATUS_HZ = 2.0, 20.0, 1.0
REBOOT_MS = 1000
SURFACE_PA = (50_000, 120_000)
"""From a lake at 5500 m to more than the air has ever had."""
SHOWN_SEVERITY = 4
"""MAV_SEVERITY_WARNING: what it says that is less is for its own ground station."""
MAX_NOTICES = 20
ARMED = "flight controller is armed without us: disarm it first"
NO_PILOT = "lost manual control"
"""It misses our pulses: news only while we mean to send some."""


class ArduSubOptions(Table, frozen=True, kw_only=True):
    """``[devices.flight_controller]`` with ``driver = "ardusub"``."""

    ahrs_most_hz: ClassVar[float] = 50.0
    """It low-passes gyros and accelerations at 20 Hz (INS_GYRO_FILTER, INS_ACCEL_FILTER): more samples tell no more."""
    connect: str
    """Connection string: "udpin:0.0.0.0:14550" for what its companion sends here, or a serial line."""
    frame: Literal["vectored", "vectored_6dof"]
    """Six thrusters (BlueROV2), or eight (Heavy)."""
    system: Annotated[int, msgspec.Meta(ge=1, le=255)] = 1
    """Its MAVLink system id."""
    gcs_system: Annotated[int, msgspec.Meta(ge=1, le=255)] = 255
    """The id of the ground station that it obeys, which we take."""
    surface_pa: Positive | None = None
    """Pressure at the surface; absent = what it has calibrated (BARO2_GND_PRESS)."""
    density_kg_m3: Annotated[float, msgspec.Meta(ge=900.0, le=1100.0)] = 998.0
    """Of the water: 998 fresh, 1025 salt."""
    depth_sigma_m: NonNegative = 0.005

    def __post_init__(self) -> None:
        low, high = SURFACE_PA
        if self.surface_pa is not None and not low <= self.surface_pa <= high:
            raise ValueError(
                f"`surface_pa` = {self.surface_pa:g} Pa; use {low} to {high} Pa (1013.25 hPa are 101325 Pa)"
            )


class ArduSub(Closing):
    """A :class:`autopilot.drivers.protocols.FlightController`."""

    Options = ArduSubOptions

    def __init__(self, vehicle: Vehicle, options: ArduSubOptions) -> None:
        """ConfigError for a vehicle, or a connection string, that is none for it."""
        parse_connection(options.connect)
        self._vehicle = vehicle
        self._options = options
        frame = FRAMES[options.frame]
        self._mixer = Mixer(vehicle, frame)
        self._rates_hz = {
            "ATTITUDE": min(vehicle.ahrs.rate_hz, options.ahrs_most_hz),
            "RAW_IMU": min(vehicle.ahrs.rate_hz, options.ahrs_most_hz),
            "SCALED_PRESSURE2": PRESSURE_HZ,
            "SERVO_OUTPUT_RAW": SERVO_HZ,
            "DISTANCE_SENSOR": vehicle.altimeter.rate_hz,
            "BATTERY_STATUS": SLOW_HZ,
            "GPS_RAW_INT": vehicle.gps.rate_hz,
        }
        self._wire: Wire | None = None
        self._telemetry = self._new_telemetry()
        self._leak = LeakWatch()
        self._watch = AuthorityWatch()
        self._prearm = PrearmWatch()
        self._payload = Passing(vehicle)
        self.settings = ArduSubSettings(frame.number, frame.motors, options.gcs_system, self._payload.parameters())
        """Its parameters."""
        self._tilt = TiltReports(vehicle)
        self._timeout_us = round(1e6 * min(thruster.drive.command_timeout_s for thruster in vehicle.thrusters))
        self._notices: list[tuple[Severity, str]] = []
        self._boot_ms = 0
        self._now_us = 0
        self._last_received_us: int | None = None
        self._received_count = dict.fromkeys(self._rates_hz, 0)
        """How often each has come since it was last counted."""
        self._beat_us = self._last_request_us = self._read_us = -(1 << 62)
        self._again: deque[str] = deque()
        """Parameters that are to be read anew."""
        self._command_us: int | None = None
        self._sent_us = 0
        self._standing_down = False
        self._rest = 0
        """Remaining repetitions of 1500."""
        self._senders = OutputWatch()
        self._seen: tuple[int, tuple[int, ...]] | None = None
        """What is at the servo rail, and when that was reported."""

    def _new_telemetry(self) -> ArduSubTelemetry:
        options = self._options
        return ArduSubTelemetry(
            self._vehicle,
            density_kg_m3=options.density_kg_m3,
            depth_sigma_m=options.depth_sigma_m,
            ground_pa=options.surface_pa,
        )

    @property
    def mismatch_count(self) -> int:
        """Servo output reports that differ from the command."""
        return self._senders.mismatch_count

    @property
    def bad_frames(self) -> int:
        """Frames that were damaged, or unknown."""
        return 0 if self._wire is None else self._wire.bad_frames

    @property
    def bad_samples(self) -> int:
        """Messages with values that are not finite."""
        return self._telemetry.bad_samples

    def open(self) -> None:
        if self._wire is None:
            wire = Wire(open_link(self._options.connect), system=self._options.system, ours=self._options.gcs_system)
            self._telemetry = self._new_telemetry()
            self._watch.lose_sight()
            self._prearm = PrearmWatch()
            self._last_received_us, self._received_count = None, dict.fromkeys(self._rates_hz, 0)
            self._beat_us = self._last_request_us = self._read_us = -(1 << 62)
            self.settings.forget()
            self._wire = wire

    def close(self) -> None:
        """1500 on every channel, disarm if armed by us; then close the link.

        A silent flight controller is not sent a disarm command: buffered on the link, it would act after its return.
        """
        wire, self._wire = self._wire, None
        if wire is None:
            return
        if self._watch.accepts_commands or self._rest:
            for _ in range(REST_SENDS):
                wire.override(NEUTRAL)
            if self._watch.wanted and self._watch.armed and not self._silent(self._now_us):
                wire.arm(armed=False)
        self._command_us, self._rest = None, 0
        wire.close()

    # Measurements

    def poll(self, t_us: int) -> list[Sample]:
        """Received samples; also sends requests and periodic messages."""
        wire = self._open_wire()
        self._now_us = t_us
        samples: list[Sample] = []
        for message in wire.receive(t_us):
            samples += self._receive(t_us, message)
        samples += self._leak.samples(t_us, silent=self._silent(t_us))
        if t_us - self._beat_us >= HEARTBEAT_US:
            self._beat_us = t_us
            wire.heartbeat()
        if self._last_received_us is not None and self._telemetry.latency.due(t_us):
            wire.request_time(t_us)
        self._request_arming(wire, t_us)
        if self._last_received_us is not None and t_us - self._last_request_us >= REQUEST_EVERY_US:
            passed_s = 1e-6 * min(t_us - self._last_request_us, 10 * REQUEST_EVERY_US)
            self._last_request_us = t_us
            self._request_missing(wire, t_us, passed_s)
        return samples

    def _request_arming(self, wire: Wire, t_us: int) -> None:
        armed = self._watch.due(t_us)
        if armed is not None:
            wire.arm(armed=armed)
        if self._watch.beat_due(t_us):
            wire.request_message(HEARTBEAT)

    def advice(self) -> tuple[tuple[str, str], ...]:
        """Settings with which it flies, and others that would be better."""
        rivals = () if self._wire is None else sorted(self._wire.rivals)
        found = tuple(
            (
                f"ground station {self._options.gcs_system}/{component} speaks to it, too: it obeys both",
                "keep its joystick off, or give it another system id",
            )
            for component in rivals
        )
        return (*self.settings.advice(), *self._payload.advice(self.settings.values), *found)

    def take_notices(self) -> Sequence[tuple[Severity, str]]:
        """Its messages to our operators."""
        clock = [(severity, f"FC: {text}") for severity, text in self._telemetry.clock.take_notices()]
        notices, self._notices = self._notices + clock, []
        return notices

    def unwired(self) -> dict[str, str]:
        """None: it has an output for everything, and reports errors on command."""
        return {}

    def set_payload(self, t_us: int, pulses_us: Sequence[int]) -> None:
        """Command the payload, whatever the authority over the thrusters."""
        self._payload.want(pulses_us)
        command = self._payload.due(t_us) if self._wire is not None and not self._silent(t_us) else None
        if command is not None:
            self._open_wire().order(int(command[0]), *command[1:])

    def _note_payload(self, text: str) -> None:
        if text and len(self._notices) < MAX_NOTICES:
            self._notices.append(notices.PAYLOAD_REFUSED(text=text))

    def _open_wire(self) -> Wire:
        if self._wire is None:
            raise DriverError("flight controller is closed; open it first")
        return self._wire

    def _receive(self, t_us: int, message: Any) -> list[Sample]:
        kind = message.get_type()
        if self._silent(t_us):
            self._request_mode()
        self._last_received_us = t_us
        self._leak.hear(t_us, message.text if kind == "STATUSTEXT" else "")
        if kind == "ATTITUDE":
            if message.time_boot_ms < self._boot_ms - REBOOT_MS:  # rebooted: its parameters may be others
                self.settings.forget()
                self._prearm = PrearmWatch()
                self._payload.forget()
            self._boot_ms = message.time_boot_ms
        if kind == "TIMESYNC":
            self._telemetry.latency.take(t_us, message.tc1, message.ts1)
            return []
        if kind in self._received_count:
            self._received_count[kind] += 1
        if kind == "PARAM_VALUE":
            if self.settings.take(message.param_id, float(message.param_value)):
                self._telemetry.parameters = self.settings.values
                self._mixer.take(self.settings.values)
            return []
        if kind == "SERVO_OUTPUT_RAW":
            return [] if message.port else self._compare(t_us, message)
        if kind == "COMMAND_ACK":
            self._note_payload(self._payload.acknowledge(message))
        self._prearm.take(t_us, message)
        commanding, found = self._watch.accepts_commands, self._watch.found_armed
        self._watch.take(t_us, message)
        if self._watch.found_armed and not found:
            self._notices.append(notices.FOUND_ARMED())
        if commanding and not self._watch.accepts_commands:
            self._let_go()
        if kind == "STATUSTEXT" and message.severity <= SHOWN_SEVERITY:
            self._pass_on(message)
        return self._telemetry.take(t_us, message)

    def _request_mode(self) -> None:
        """After a silence: request its mode, which may have changed; heartbeats come only once a second."""
        self._watch.lose_sight()
        if self._wire is not None:
            self._wire.request_message(HEARTBEAT)

    def _pass_on(self, message: Any) -> None:
        text = message.text.strip()
        expected = not self._watch.wanted and text.lower().startswith(NO_PILOT)
        if not expected and len(self._notices) < MAX_NOTICES:
            self._notices.append((Severity(message.severity), f"FC: {text}"))

    def _request_missing(self, wire: Wire, t_us: int, passed_s: float) -> None:
        """For messages that do not come as often as they should, and for parameters."""
        for kind, rate_hz in self._rates_hz.items():
            if self._received_count[kind] < int(ENOUGH * rate_hz * passed_s):
                wire.interval(MESSAGE_IDS[kind], rate_hz)
            self._received_count[kind] = 0
        if not self._watch.wanted and self._prearm.due(t_us):
            wire.interval(SYS_STATUS_ID, STATUS_HZ)
            wire.order(RUN_CHECKS, 0.0, 0.0)
        if self._read_us < 0:
            self._read_us = t_us
        if t_us - self._read_us > READ_AGAIN_US and not self._watch.wanted:
            self._read_us = t_us
            self._again = deque(self.settings.names)
        missing = self.settings.missing()[:PARAMETERS_PER_REQUEST]
        for name in missing:
            self.settings.note_request(name)
            wire.read_parameter(name)
        for _ in range(min(PARAMETERS_PER_REQUEST - len(missing), len(self._again))):
            wire.read_parameter(self._again.popleft())

    # Who has it

    def command(self, t_us: int, *, armed: bool) -> None:
        watch = self._watch
        if watch.wanted and not armed:
            self._let_go()
        if watch.wanted is not armed:
            self._senders.begin()
        watch.want(t_us, armed=armed)

    def hand_back(self, t_us: int) -> None:
        """Neutral, then silence: it stays armed, subject to its pilot failsafe, until our next arming."""
        if self._watch.accepts_commands:
            self._let_go()
        self._watch.hand_back()

    def stop(self, t_us: int) -> None:
        """Neutral, and disarmed by force until its heartbeat confirms it, whoever armed it."""
        if self._watch.accepts_commands:
            self._let_go()
        self._watch.stop(t_us)

    def stand_down(self, t_us: int) -> bool:
        """Shutdown: disarm if armed by us; True when complete."""
        watch = self._watch
        if self._wire is None or not (watch.ours_to_stop or self._standing_down):
            return True
        if self.armed(t_us) is False and not self._standing_down:
            return True
        self._standing_down = True
        self.stop(t_us)
        self._rest_of(t_us)
        self.poll(t_us)
        return self.armed(t_us) is False

    def armed(self, t_us: int) -> bool | None:
        """By its heartbeat, None = unknown."""
        return None if self._silent(t_us) else self._watch.is_armed(t_us)

    def below(self, t_us: int) -> FlightControllerState:
        watch = self._watch
        return FlightControllerState(
            t_us=t_us,
            authority=watch.authority,
            acts=watch.acts(t_us) and not self._silent(t_us),
            text=watch.text,
            problem=self._senders.problem,
            refusals=self._refusals(t_us),
            pulses_us=self._pulses_us(t_us),
            armed=self.armed(t_us),
            rival=self._senders.rival and watch.wanted and watch.authority is Authority.OURS,
        )

    def _pulses_us(self, t_us: int) -> tuple[int, ...]:
        """Reported thruster pulses from any source [us]; () without a recent report."""
        if self._seen is None or t_us - self._seen[0] > STALE_US:
            return ()
        return self._mixer.pulses_us(self._seen[1])

    def _refusals(self, t_us: int) -> tuple[str, ...]:
        if self._silent(t_us) or not self._watch.known:
            return (self._silence_reason,)
        pilot = self._watch.authority is Authority.PILOT
        mode = (f"pilot has it in {self._watch.text}: switch it to MANUAL",) if pilot else ()
        return (*mode, *self._armed_refusal(), *self.settings.problems(), *self._prearm.refusals(t_us))

    def _armed_refusal(self) -> tuple[str, ...]:
        watch = self._watch
        return (ARMED,) if watch.armed and not (watch.wanted or watch.handed_back) else ()

    @property
    def other_systems(self) -> tuple[int, ...]:
        """Flight controllers on its link that are not ours."""
        return () if self._wire is None else tuple(sorted(self._wire.other_systems))

    @property
    def _silence_reason(self) -> str:
        """Reason for missing data."""
        others = self.other_systems
        if self._last_received_us is not None or not others:
            return "flight controller is silent: check cable and link"
        listed = ", ".join(map(str, others))
        found = f"system {listed} is heard, {self._options.system} expected"
        return f"flight controller: {found}: set `system` = {others[0]} in [devices]"

    def _silent(self, t_us: int) -> bool:
        return self._last_received_us is None or t_us - self._last_received_us > STALE_US

    def _let_go(self) -> None:
        """Nothing of ours is left standing in its channels."""
        self._command_us = None
        self._senders.forget()
        self._rest = REST_SENDS
        self._send_rest()

    # Thrust

    def write(self, t_us: int, pwm_us: Sequence[int]) -> None:
        """Pulses per thruster. DriverError without data from it; nothing is sent without authority.

        After a silence 1500 is sent first: its pilot may have taken over unnoticed.
        """
        wire = self._open_wire()
        if self._watch.wanted and self._watch.authority is not Authority.PILOT and self._silent(t_us):
            if self._command_us is not None:
                self._let_go()
            self._rest_of(t_us)
            raise DriverError("flight controller is silent: check cable and link")
        if not self._watch.accepts_commands:
            self._rest_of(t_us)
            return
        self._command_us = t_us
        if t_us - self._sent_us < SEND_EVERY_US:
            return
        self._sent_us = t_us
        if not self._watch.armed:  # it arms with neutral channels only
            wire.override(NEUTRAL)
            return
        mixed = self._mixer.mix(pwm_us, self._telemetry.supply_v)
        wire.override(mixed.channels_us)
        self._senders.sent(t_us, mixed.servos_us)

    def check(self, t_us: int) -> bool:
        """1500 when the last command is too old; True while it is."""
        if self._command_us is None or t_us - self._command_us > self._timeout_us:
            if self._command_us is not None:
                self._let_go()
            self._rest_of(t_us)
            return True
        return False

    def neutral(self) -> None:
        self._let_go()

    def _rest_of(self, t_us: int) -> None:
        if self._rest and t_us - self._sent_us >= SEND_EVERY_US:
            self._sent_us = t_us
            self._send_rest()

    def _send_rest(self) -> None:
        """A pilot who has it is disturbed by no more than one."""
        if self._wire is not None and self._rest:
            self._wire.override(NEUTRAL)
            self._rest = 0 if self._watch.pilots else self._rest - 1

    def _compare(self, t_us: int, message: Any) -> list[Sample]:
        """Compare the reported outputs with the command; the camera's tilt is one of them."""
        found = tuple(getattr(message, f"servo{motor}_raw") for motor in range(1, self._mixer.motors + 1))
        self._seen = (t_us, found)
        if self._watch.acts(t_us):
            self._senders.check(
                t_us,
                message.time_usec,
                found,
                slow_heave=self._mixer.heave_signs if self._watch.slow_heave else None,
                round_trip_us=self._telemetry.latency.longest_us,
            )
        else:
            self._senders.skip(found)
        tilt = self._vehicle.tilt
        pulse_us = 0 if tilt is None else getattr(message, f"servo{tilt.channel}_raw", 0)
        return [*self._tilt.of(t_us, pulse_us)]
