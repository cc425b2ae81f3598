"""ArduSub as the flight controller below us: it measures, and its motors do what our thrust asks for.

Its MAVLink is attitude, rates and acceleration, pressure, battery and leak probe. Our pulses go down as
RC_CHANNELS_OVERRIDE in its MANUAL mode, fifty times a second (:mod:`drivers.ardusub_mixing`), and what comes out at its
servo rail is compared with what was meant. Stopping means 1500 on every channel: to say nothing would leave the last
thrust standing until its own failsafe. It keeps its arming, its failsafes and its pilot: we are a ground station to it,
whose heartbeat it misses when this process dies, and a change of its mode takes the vehicle from us at once
(:mod:`drivers.ardusub_authority`). Its parameters are read and checked (:mod:`drivers.ardusub_settings`), and never
written.
"""

from collections import deque
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import msgspec

from autopilot.core.errors import DriverError
from autopilot.core.messages import Authority, Below, Severity
from autopilot.core.samples import Sample
from autopilot.core.toml_table import NonNegative, Positive, Table
from autopilot.core.vehicle import Vehicle
from drivers.ardusub_authority import AuthorityWatch
from drivers.ardusub_mixing import FRAMES, NEUTRAL, PLANE_MOTORS, Mixer
from drivers.ardusub_payload import Passing
from drivers.ardusub_settings import Settings
from drivers.ardusub_telemetry import Telemetry
from drivers.ardusub_wire import Wire
from drivers.base import Closing
from drivers.links import open_link

SEND_EVERY_US = 20_000
"""It reads its channels at 50 Hz."""
HEARTBEAT = 0
HEARTBEAT_US = 1_000_000
ASK_EVERY_US = 500_000
PARAMETERS_PER_ASK = 8
READ_AGAIN_US = 30_000_000
"""Parameters act live and may be changed by the pilot: while disarmed they are read anew."""
STALE_US = 500_000
"""Nothing heard for so long: it is silent."""
REST_SENDS = 3
"""How often 1500 is sent after the last command."""

SERVO_RATE_HZ, SLOW_HZ, PRESSURE_HZ = 50.0, 2.0, 20.0
REBOOT_MS = 1000
ENOUGH = 0.7
"""Share of a rate below which it is asked for anew."""
SERVO_WITHIN_US = 450_000
"""What comes out belongs to one of the commands of so long before: 20 ms to act, the way back, and a late loop."""
SERVO_TOLERANCE_US = 4
SERVO_WRONG_US = 300_000
SERVO_WRONG_SHARE, SERVO_RIGHT_SHARE = 0.2, 0.05
"""Other pulses than ours for so long, in so many of the reports, are somebody else's: a joystick speaks 20 to 50 times
a second, and the last of two senders wins. From so few on they are ours again."""
SERVO_MEMORY, SERVO_MOST_SHARE = 20, 0.3
"""Reports that the share is of, and what more of them do not raise it beyond."""

SHOWN_SEVERITY = 4
"""MAV_SEVERITY_WARNING: what it says that is less is for its own ground station."""
MAX_NOTICES = 20
NO_PILOT = "lost manual control"
"""It misses our pulses: news only while we mean to send some."""


class ArduSubOptions(Table, frozen=True, kw_only=True):
    """``[devices.flight_controller]`` with ``driver = "ardusub"``."""

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


class ArduSub(Closing):
    """A :class:`drivers.protocols.FlightController`."""

    Options = ArduSubOptions

    def __init__(self, vehicle: Vehicle, options: ArduSubOptions) -> None:
        self._vehicle = vehicle
        self._options = options
        frame = FRAMES[options.frame]
        self._mixer = Mixer(vehicle, frame)
        self._rates_hz = {
            "ATTITUDE": vehicle.ahrs.rate_hz,
            "RAW_IMU": vehicle.ahrs.rate_hz,
            "SCALED_PRESSURE2": PRESSURE_HZ,
            "SERVO_OUTPUT_RAW": SERVO_RATE_HZ,
            "BATTERY_STATUS": SLOW_HZ,
        }
        self._ids = {"ATTITUDE": 30, "RAW_IMU": 27, "SCALED_PRESSURE2": 137, "SERVO_OUTPUT_RAW": 36}
        self._ids["BATTERY_STATUS"] = 147
        self._wire: Wire | None = None
        self._telemetry = self._new_telemetry()
        self._watch = AuthorityWatch()
        self.settings = Settings(frame.number, frame.motors, options.gcs_system)
        """Its parameters."""
        self._payload = Passing(vehicle)
        self._timeout_us = round(1e6 * min(thruster.drive.command_timeout_s for thruster in vehicle.thrusters))
        self._notices: list[tuple[Severity, str]] = []
        self._boot_ms = 0
        self._now_us = 0
        self._heard_us: int | None = None
        self._heard_of = dict.fromkeys(self._rates_hz, 0)
        """How often each has come since it was last looked at."""
        self._beat_us = self._asked_us = self._read_us = -(1 << 62)
        self._command_us: int | None = None
        self._sent_us = 0
        self._rest = 0
        """So often 1500 has still to be sent."""
        self._meant: deque[tuple[int, tuple[int, ...]]] = deque()
        self._seen: tuple[int, tuple[int, ...]] | None = None
        """What is at the servo rail, and when that was told."""
        self._wrong_share = 0.0
        """Of the last reports of the servo rail."""
        self._wrong_us: int | None = None
        """Since when there are some."""
        self.problem = ""
        """What comes out though it was not meant, "" while all is well."""
        self.saturated_count = 0
        """Commands that did not fit its channels."""
        self.mismatch_count = 0
        """Reports of the servo rail that show something else than what was meant."""

    def _new_telemetry(self) -> Telemetry:
        options = self._options
        return Telemetry(
            self._vehicle,
            density_kg_m3=options.density_kg_m3,
            depth_sigma_m=options.depth_sigma_m,
            ground_pa=options.surface_pa,
        )

    @property
    def bad_frames(self) -> int:
        """Frames that were damaged, or unknown."""
        return 0 if self._wire is None else self._wire.bad_frames

    @property
    def bad_samples(self) -> int:
        """Messages whose numbers are none."""
        return self._telemetry.bad_samples

    def open(self) -> None:
        """Open the link; whether anybody is there shows later."""
        if self._wire is None:
            wire = Wire(open_link(self._options.connect), system=self._options.system, ours=self._options.gcs_system)
            self._telemetry = self._new_telemetry()
            self._watch.lose_sight()
            self._heard_us, self._heard_of = None, dict.fromkeys(self._rates_hz, 0)
            self._beat_us = self._asked_us = self._read_us = -(1 << 62)
            self.settings.forget()
            self._wire = wire

    def close(self) -> None:
        """1500 on every channel, disarmed if it is ours; then let go of the link.

        One that is silent is not told to disarm: what lies in a buffer on the way would stop it when it is back."""
        wire, self._wire = self._wire, None
        if wire is None:
            return
        if self._watch.takes_commands or self._rest:
            for _ in range(REST_SENDS):
                wire.override(NEUTRAL)
            if self._watch.wanted and self._watch.armed and not self._silent(self._now_us):
                wire.arm(armed=False)
        self._command_us, self._rest = None, 0
        wire.close()

    # What it measures

    def poll(self, t_us: int) -> list[Sample]:
        """What has arrived; and what has to be asked for or told regularly."""
        wire = self._open_wire()
        self._now_us = t_us
        samples: list[Sample] = []
        for message in wire.receive(t_us):
            samples += self._hear(t_us, message)
        if self._heard_us is not None:
            samples += self._telemetry.leak(t_us)
        if t_us - self._beat_us >= HEARTBEAT_US:
            self._beat_us = t_us
            wire.heartbeat()
        asked = self._watch.due(t_us)
        if asked is not None:
            wire.arm(armed=asked)
        if self._heard_us is not None and t_us - self._asked_us >= ASK_EVERY_US:
            passed_s = 1e-6 * min(t_us - self._asked_us, 10 * ASK_EVERY_US)
            self._asked_us = t_us
            self._ask(wire, t_us, passed_s)
        return samples

    def advice(self) -> tuple[tuple[str, str], ...]:
        """Settings with which it flies, and others that would be better."""
        return self.settings.advice()

    def take_notices(self) -> Sequence[tuple[Severity, str]]:
        """What it says that our operators should know."""
        notices, self._notices = self._notices, []
        return notices

    def unwired(self) -> dict[str, str]:
        """It has an output for everything; what it does not allow it says when it is asked."""
        return {}

    def set_payload(self, t_us: int, pulses_us: Sequence[int]) -> None:
        """What the vehicle carries, whoever has the thrusters."""
        self._payload.want(pulses_us)
        command = self._payload.due(t_us) if self._wire is not None and not self._silent(t_us) else None
        if command is not None:
            self._open_wire().order(*command)

    def _note_payload(self, text: str) -> None:
        if text and len(self._notices) < MAX_NOTICES:
            self._notices.append((Severity.WARNING, text))

    def _open_wire(self) -> Wire:
        if self._wire is None:
            raise DriverError("flight controller is closed; open it first")
        return self._wire

    def _hear(self, t_us: int, message: Any) -> list[Sample]:
        kind = message.get_type()
        if self._silent(t_us):
            self._ask_who_has_it()
        self._heard_us = t_us
        if kind == "ATTITUDE":
            if message.time_boot_ms < self._boot_ms - REBOOT_MS:  # rebooted: its parameters may be others
                self.settings.forget()
                self._payload.forget()
            self._boot_ms = message.time_boot_ms
        if kind in self._heard_of:
            self._heard_of[kind] += 1
        if kind == "PARAM_VALUE":
            if self.settings.take(message.param_id, float(message.param_value)):
                self._telemetry.parameters = self.settings.values
                self._mixer.take(self.settings.values)
            return []
        if kind == "SERVO_OUTPUT_RAW":
            self._compare(t_us, message)
            return []
        if kind == "COMMAND_ACK":
            self._note_payload(self._payload.acknowledge(message))
        commanding = self._watch.takes_commands
        self._watch.take(t_us, message)
        if commanding and not self._watch.takes_commands:
            self._let_go()
        if kind == "STATUSTEXT" and message.severity <= SHOWN_SEVERITY:
            self._pass_on(message)
        return self._telemetry.take(t_us, message)

    def _ask_who_has_it(self) -> None:
        """After a silence: what it has told of its mode may be over, and heartbeats come once a second."""
        self._watch.lose_sight()
        if self._wire is not None:
            self._wire.ask_for(HEARTBEAT)

    def _pass_on(self, message: Any) -> None:
        text = message.text.strip()
        expected = not self._watch.wanted and text.lower().startswith(NO_PILOT)
        if not expected and len(self._notices) < MAX_NOTICES:
            self._notices.append((Severity(message.severity), f"FC: {text}"))

    def _ask(self, wire: Wire, t_us: int, passed_s: float) -> None:
        """For messages that do not come as often as they should, and for parameters."""
        for kind, rate_hz in self._rates_hz.items():
            if self._heard_of[kind] < int(ENOUGH * rate_hz * passed_s):
                wire.interval(self._ids[kind], rate_hz)
            self._heard_of[kind] = 0
        if self._read_us < 0:
            self._read_us = t_us
        if t_us - self._read_us > READ_AGAIN_US and not self._watch.wanted:
            self._read_us = t_us
            for name in self.settings.names:
                wire.read_parameter(name)
        for name in self.settings.missing()[:PARAMETERS_PER_ASK]:
            self.settings.ask(name)
            wire.read_parameter(name)

    # Who has it

    def command(self, t_us: int, *, armed: bool) -> None:
        """Whether our thrust is meant to act."""
        watch = self._watch
        if watch.wanted and not armed:
            self._let_go()
        elif armed and not watch.wanted:
            self._count_as_right()
        watch.want(t_us, armed=armed)

    def hand_back(self, t_us: int) -> None:
        """Neutral, then silence: it stays armed, and its pilot's failsafe says what becomes of it. A new arming of ours
        takes it anew."""
        if self._watch.takes_commands:
            self._let_go()
        self._watch.hand_back()

    def below(self, t_us: int) -> Below:
        """Who has the vehicle now."""
        watch = self._watch
        return Below(
            t_us=t_us,
            authority=watch.authority,
            acts=watch.acts(t_us) and not self._silent(t_us),
            text=watch.text,
            problem=self.problem,
            refusals=self._refusals(t_us),
            pulses_us=self._pulses_us(t_us),
        )

    def _pulses_us(self, t_us: int) -> tuple[int, ...]:
        """What the thrusters get, whoever it is from; () when it has not been told of late."""
        if self._seen is None or t_us - self._seen[0] > STALE_US:
            return ()
        return self._mixer.pulses_us(self._seen[1])

    def _refusals(self, t_us: int) -> tuple[str, ...]:
        if self._silent(t_us) or not self._watch.known:
            return ("flight controller is silent: check cable and link",)
        pilot = self._watch.authority is Authority.PILOT
        mode = (f"pilot has it in {self._watch.text}: switch it to MANUAL",) if pilot else ()
        return (*mode, *self.settings.problems())

    def _silent(self, t_us: int) -> bool:
        return self._heard_us is None or t_us - self._heard_us > STALE_US

    def _let_go(self) -> None:
        """Nothing of ours is left standing in its channels."""
        self._command_us = None
        self._meant.clear()
        self.problem = ""
        self._rest = REST_SENDS
        self._send_rest()

    # Thrust

    def write(self, t_us: int, pwm_us: Sequence[int]) -> None:
        """Pulses per thruster. DriverError while nothing is heard from it; nothing goes down while it is not ours.

        Nor while it is silent, but 1500 at first: its pilot may have taken it without our hearing of it."""
        wire = self._open_wire()
        if self._watch.wanted and self._watch.authority is not Authority.PILOT and self._silent(t_us):
            if self._command_us is not None:
                self._let_go()
            self._rest_of(t_us)
            raise DriverError("flight controller is silent: check cable and link")
        if not self._watch.takes_commands:
            self._rest_of(t_us)
            return
        self._command_us = t_us
        if t_us - self._sent_us < SEND_EVERY_US:
            return
        self._sent_us = t_us
        mixed = self._mixer.mix(pwm_us, self._telemetry.supply_v)
        self.saturated_count += mixed.saturated
        wire.override(mixed.channels_us)
        self._meant.append((t_us, mixed.servos_us))

    def check(self, t_us: int) -> bool:
        """1500 when the last command is too old; True while it is."""
        if self._command_us is None or t_us - self._command_us > self._timeout_us:
            if self._command_us is not None:
                self._let_go()
            self._rest_of(t_us)
            return True
        return False

    def neutral(self) -> None:
        """Stop all thrusters now."""
        self._let_go()

    def _rest_of(self, t_us: int) -> None:
        if self._rest and t_us - self._sent_us >= SEND_EVERY_US:
            self._sent_us = t_us
            self._send_rest()

    def _send_rest(self) -> None:
        """A pilot who has it is disturbed by no more than one."""
        if self._wire is not None and self._rest:
            self._wire.override(NEUTRAL)
            self._rest = 0 if self._watch.authority is Authority.PILOT else self._rest - 1

    def _compare(self, t_us: int, message: Any) -> None:
        """What comes out, with what was meant."""
        found = tuple(getattr(message, f"servo{motor}_raw") for motor in range(1, self._mixer.motors + 1))
        self._seen = (t_us, found)
        while self._meant and t_us - self._meant[0][0] > SERVO_WITHIN_US and len(self._meant) > 1:
            self._meant.popleft()
        if not self._watch.acts(t_us) or not self._meant:
            self._count_as_right()
            return
        wrong = not self._is_meant(found)
        self.mismatch_count += wrong
        share = self._wrong_share + (wrong - self._wrong_share) / SERVO_MEMORY
        self._wrong_share = min(share, SERVO_MOST_SHARE)
        if not wrong and share < SERVO_RIGHT_SHARE:
            self._wrong_us, self.problem = None, ""
            return
        if self._wrong_us is None:
            self._wrong_us = t_us
        if wrong and share > SERVO_WRONG_SHARE and t_us - self._wrong_us > SERVO_WRONG_US:
            meant = self._meant[-1][1]
            worst = max(range(len(meant)), key=lambda motor: abs(found[motor] - meant[motor]))
            self.problem = f"motor {worst + 1} gets {found[worst]} us instead of {meant[worst]}: joystick off?"

    def _count_as_right(self) -> None:
        self._wrong_share, self._wrong_us = 0.0, None

    def _is_meant(self, found: tuple[int, ...]) -> bool:
        """Whether it is one of the last commands; with slow heave, upright motors lie between those of longer."""
        if not self._watch.slow_heave:
            return any(_alike(found, meant) for _, meant in reversed(self._meant))
        upright = zip(*(meant[PLANE_MOTORS:] for _, meant in self._meant), strict=True)
        between = all(
            min(meant) - SERVO_TOLERANCE_US <= pulse <= max(meant) + SERVO_TOLERANCE_US
            for pulse, meant in zip(found[PLANE_MOTORS:], upright, strict=True)
        )
        return between and any(_alike(found[:PLANE_MOTORS], meant[:PLANE_MOTORS]) for _, meant in reversed(self._meant))


def _alike(found: Sequence[int], meant: Sequence[int]) -> bool:
    return all(abs(one - other) <= SERVO_TOLERANCE_US for one, other in zip(found, meant, strict=True))
