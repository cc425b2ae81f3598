"""Interface between the MAVLink server and the vehicle, implemented by :mod:`autopilot.command.commander`."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Protocol

from autopilot.core.arming_reasons import ArmingReason
from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import GeodeticPosition
from autopilot.core.messages import MissionProgress, NavDoubt, NavState, NmpcStatus, RunEnd, ThrusterCommand
from autopilot.core.orbit import OrbitYaw as OrbitYaw
from autopilot.core.params import Saved
from autopilot.core.samples import PowerSample
from autopilot.core.sensed import Sensed
from autopilot.core.stills import CameraReport, StillRecord
from autopilot.mavlink.flight_modes import FlightMode as FlightMode
from autopilot.mavlink.flight_modes import group_of


class CommandResult(IntEnum):
    """MAV_RESULT (common.xml)."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5
    CANCELLED = 6
    COMMAND_LONG_ONLY = 7
    COMMAND_INT_ONLY = 8
    UNSUPPORTED_FRAME = 9
    NOT_IN_CONTROL = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Sticks:
    """A pilot's sticks, -1 to 1, his gain applied."""

    ahead: float = 0.0
    starboard: float = 0.0
    up: float = 0.0
    turn: float = 0.0
    """To starboard."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SetPoint:
    """A client's setpoint, over ground; None = that axis is held."""

    until_us: int
    """Then it is too old to be followed."""
    place_ned_m: tuple[float, float] | None = None
    """North, east."""
    vel_m_s: tuple[float, float] | None = None
    """North, east; ahead, starboard when ``body``."""
    body: bool = False
    depth_m: float | None = None
    down_m_s: float | None = None
    yaw_rad: float | None = None
    yaw_rate_rad_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Circling:
    """A circle to be flown; None = CIRCLE_RADIUS, CIRCLE_SPEED and the vehicle's position."""

    centre: GeodeticPosition | None = None
    """None = where the vehicle is."""
    depth_held: bool = True
    """The centre's altitude does not count."""
    radius_m: float | None = None
    clockwise: bool | None = None
    speed_m_s: float | None = None
    yaw: OrbitYaw = OrbitYaw.TO_CENTRE
    turns: float = 0.0
    """0 = endless."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorTest:
    """Test of one thruster for a moment; exactly one of throttle share and pulse is given."""

    number: int
    """Of the thruster, from 1 in the order of the vehicle file."""
    throttle: float | None = None
    """Of its pulse's span, positive along its direction."""
    pulse_us: float | None = None
    seconds: float = 0.0
    """0 = until the next word is late."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandReply:
    """Result of a command and, for a refusal, the reason in one line."""

    result: CommandResult
    reason: str = ""


ACCEPTED = CommandReply(result=CommandResult.ACCEPTED)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class VehicleView:
    """Data for telemetry, updated once per tick."""

    t_us: int
    armed: bool
    mode: FlightMode
    intended_mode: FlightMode
    """Differs from ``mode`` while a failsafe overrides the operator."""
    nav: NavState | None
    power: PowerSample | None
    command: ThrusterCommand | None
    progress: MissionProgress | None
    target_ned_m: FloatArray | None
    """(3,) where the vehicle is going."""
    origin: GeodeticPosition
    home: GeodeticPosition
    arming_reasons: tuple[ArmingReason, ...] = ()
    """Why arming would be refused now, in any mode; of an armed vehicle, what keeps it from its mission."""
    refusals: tuple[str, ...] = ()
    """Those from devices and disk, as reported to new clients."""
    failsafes: int
    cpu_load: float
    """0..1 of one tick."""
    under_way: bool
    """Armed and sent somewhere since (mission, go-to, return, surface), also when stopped on the way."""
    dropped_rx: int
    """Malformed frames so far."""
    fenced: bool = True
    """Whether a fence is in force."""
    aid_ratio: Mapping[str, float] = field(default_factory=dict)
    """Test ratio of the newest measurement of each aiding sensor, by name; above 1 it was rejected."""
    nav_errors: tuple[int, int, int, int] = (0, 0, 0, 0)
    """AHRS samples refused, fixes not used, other aiding measurements not used, resets of the estimator."""
    nav_doubts: frozenset[NavDoubt] = frozenset()
    """Evidence against the estimate or its sensors."""
    control: NmpcStatus | None = None
    """Of the last control step, None while nothing is controlled."""
    sensed: Sensed = field(default_factory=Sensed)
    """The newest of each sensor."""
    energy_left_j: float | None = None
    """Remaining, None while unknown."""
    ahead: FloatArray | None = None
    """(n, 8) where the controller sees the vehicle go, a state per row (:mod:`autopilot.core.model4`)."""

    @property
    def prearm_reasons(self) -> tuple[str, ...]:
        """Those that count in the operator's mode; empty = ready."""
        group = group_of(self.intended_mode)
        return tuple(reason.text for reason in self.arming_reasons if self.armed or reason.modes & group)


BEAM_TRACKS = 4 << 28
"""Track numbers from here on are beam returns of a sensor, which also sees the fence's own obstacles."""

UNITS_PER_S = 100_000
"""Signing time counts in 10 us since 2015."""
AHEAD_UNITS = 2 * UNITS_PER_S
"""Maximum lead of the signing time on disk over the latest one used or received. Nothing up to it is accepted
after a restart, which takes about as long."""


@dataclass(frozen=True, slots=True)
class SigningState:
    """Signing state that is kept from run to run."""

    key: bytes | None
    stamp: int
    """Signing time: nothing later has been used or accepted."""

    def __repr__(self) -> str:
        """Leaves out the key."""
        return f"SigningState(key={'set' if self.key else 'none'}, stamp={self.stamp})"


class SigningStore(Protocol):
    """Where the key and the time are kept."""

    @property
    def state(self) -> SigningState:
        """State at the start; with a key, the time on disk is AHEAD_UNITS ahead already."""
        ...

    def keep(self, tick: int, state: SigningState) -> None:
        """Have it written; the n-th call's number is n."""
        ...

    def poll(self, tick: int) -> Saved | None:
        """Result of a write, returned once; None = nothing new."""
        ...


class VehicleCommands(Protocol):
    """Requests that clients make. Every one answers at once and never waits for a solver."""

    def arm(self, force: bool) -> CommandReply:
        """Arm, or refuse with all reasons in one line."""
        ...

    def disarm(self, force: bool) -> CommandReply:
        """Disarm; ``force`` = emergency stop. Never refused; IN_PROGRESS while a flight controller below confirms."""
        ...

    def disarmed(self) -> CommandReply:
        """Result of the last disarming; IN_PROGRESS until it is confirmed."""
        ...

    def set_mode(self, mode: FlightMode) -> CommandReply: ...

    def start_mission(self, first_seq: int | None) -> CommandReply:
        """Enter MISSION at an item (None = the current one). Needs an armed vehicle and a plan."""
        ...

    def pause(self) -> CommandReply:
        """Hold here; the mission progress is kept."""
        ...

    def resume(self) -> CommandReply: ...

    def set_current_item(self, seq: int, *, reset: bool = False) -> CommandReply:
        """``reset``: jumps and laps count from 0 again."""
        ...

    def go_to(self, point: GeodeticPosition | None, yaw_rad: float | None) -> CommandReply:
        """Reposition and hold there (None = here). Checked against the fence."""
        ...

    def set_point(self, point: SetPoint) -> CommandReply:
        """Follow it in GUIDED; in other modes it is kept for a moment, so that GUIDED can be entered."""
        ...

    def refuse_set_point(self, reason: str) -> CommandReply:
        """A set point that is not followed: GUIDED ends."""
        ...

    def orbit(self, circle: Circling) -> CommandReply: ...

    def test_motor(self, test: MotorTest) -> CommandReply:
        """Run one thruster; has to be repeated to keep it running."""
        ...

    def change_depth(self, depth_m: float) -> CommandReply:
        """Another depth where the vehicle is."""
        ...

    def take_off(self, depth_m: float | None, yaw_rad: float | None = None) -> CommandReply:
        """Down to a depth (None = TKOFF_DEPTH) and hold there, with a heading (None = that of then); begins at arming
        when disarmed."""
        ...

    def change_speed(self, speed_m_s: float | None) -> CommandReply:
        """Speed of the current mode or mission, None = the default again."""
        ...

    def set_home(self, point: GeodeticPosition | None) -> CommandReply:
        """Home (None = here)."""
        ...

    def set_origin(self, point: GeodeticPosition) -> CommandReply:
        """Local origin. Refused while armed."""
        ...

    def end_run(self, end: RunEnd) -> CommandReply:
        """Shut down or restart the service, shortly after the answer. Refused while armed."""
        ...


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraIdentity:
    """The camera, which does not change."""

    vehicle: str
    width_px: int
    height_px: int
    r_frd_from_view: FloatArray
    """(3, 3) its own axes (x along the optical axis, y to the right of the picture, z down in it) in the body's."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraState:
    exposing: bool
    """A capture is in progress."""
    interval_s: float | None
    """Time between stills of a running sequence, None without one."""
    distance_m: float | None
    """Way between stills, None without."""
    count: int
    """Stills so far, failed ones included: the next one's number."""
    report: CameraReport | None
    """None before the first word of the camera."""


class CameraOrders(Protocol):
    """Requests to the camera, answered at once (:mod:`autopilot.command.photographer`); the pictures follow."""

    identity: CameraIdentity

    @property
    def state(self) -> CameraState: ...

    def shoot(self, count: int | None, interval_s: float) -> CommandReply:
        """A number of stills (None = until stopped) at an interval. Replaces a running sequence."""
        ...

    def stop(self) -> CommandReply:
        """End the sequence, by time or by distance."""
        ...

    def shoot_every(self, distance_m: float, *, now: bool) -> CommandReply:
        """A still after every distance [m] from the last one; 0 ends the sequence. ``now``: the first at once."""
        ...

    def record(self, index: int) -> StillRecord | None:
        """A still of this run by its number."""
        ...

    def take_records(self) -> tuple[StillRecord, ...]:
        """Stills stored since the last call."""
        ...


class EquipmentOrders(Protocol):
    """Requests to payload outputs (:mod:`autopilot.command.equipment`). Every order answers at once."""

    @property
    def thruster_channels(self) -> tuple[int, ...]:
        """Output of each thruster, in the order of the vehicle file."""
        ...

    def pulses_us(self) -> Mapping[int, int]:
        """Channel -> pulse [us] of the payload outputs, as of the last tick."""
        ...

    def light_levels(self) -> tuple[float, ...]:
        """How bright the lights are that can be used, 0 to 1, in the order of the vehicle file."""
        ...

    def set_servo(self, channel: int, pulse_us: float) -> CommandReply: ...

    def repeat_servo(self, channel: int, pulse_us: float, count: int, cycle_s: float) -> CommandReply:
        """Move to a pulse and back, repeatedly."""
        ...

    def set_relay(self, number: int, *, on: bool) -> CommandReply: ...

    def toggle_relay(self, number: int) -> CommandReply: ...

    def repeat_relay(self, number: int, count: int, cycle_s: float) -> CommandReply:
        """Toggle a relay and back, repeatedly."""
        ...

    def grip(self, number: int, *, close: bool) -> CommandReply: ...

    def refuse_actuator(self, number: int) -> str:
        """Why an actuator cannot be moved, "" when it can."""
        ...

    def set_actuators(self, values: Mapping[int, float]) -> CommandReply:
        """Number -> -1 to 1. All or none."""
        ...

    def refuse_tilt(self, angle_rad: float | None = None) -> str:
        """Why the camera cannot be tilted, or not to an angle; "" when it can."""
        ...

    @property
    def tilt_rad(self) -> float | None:
        """Angle of the camera's tilt, upwards positive; None without one, and while nobody knows it."""
        ...

    @property
    def tilt_range_rad(self) -> tuple[float, float] | None:
        """Ends of the tilt, lower and upper; None without one."""
        ...

    def tilt(self, angle_rad: float) -> CommandReply:
        """Tilt the camera to an angle against the body, upwards positive."""
        ...

    def tilt_by(self, step_rad: float | None) -> CommandReply:
        """Tilt the camera up or down by a step; None = to its start, its middle as a rule."""
        ...

    def lights(self, change: float | None) -> CommandReply:
        """Change the brightness of all lights by a share; None = toggle."""
        ...
