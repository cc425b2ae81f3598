"""Records that cross the boundaries of the program: samples in, estimates, goals, commands out.

Frozen dataclasses, time first (``t_us``: microseconds since the service's clock started), SI units, radians. A field's
name ends with its unit and contains its frame (``ned``, ``frd``); its comment gives the shape. A field that may be
absent is None. Sensor samples: :mod:`autopilot.core.samples`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum

import numpy as np

from autopilot.core.clients import EVERYONE, Reach
from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.guard import Fault
from autopilot.core.marks import LoopPart, ServiceThread
from autopilot.core.nondeterminism import Note
from autopilot.core.payload import PayloadState
from autopilot.core.samples import ExternalPoseSample, PictureReport, PlanarFixSample, Sample
from autopilot.core.stills import CameraReport, StillRecord, StoredStill

MAX_THRUSTERS = 8
"""Width of the thruster arrays in logs and outputs."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MavlinkFrame:
    """Raw bytes of one MAVLink frame or datagram on one link."""

    link: int
    """Index of the link it came from or goes to; -1 = all links."""
    data: bytes
    client: int = EVERYONE
    """Client number on the link, one per address or connection; EVERYONE also on a link with one other end."""
    sender: str = ""
    """Name of the sending client for operators, "" for outgoing or unknown."""
    reach: Reach = Reach.NETWORK
    """Whether the sending client is on this machine or in the network."""
    beside: frozenset[int] = frozenset()
    """Clients of the link excluded from a broadcast."""

    def __repr__(self) -> str:
        """For descriptions of faults, which are logged: without the key of a SETUP_SIGNING."""
        shown = "a signing key" if _has_key(self.data) else repr(self.data)
        return f"MavlinkFrame(link={self.link}, client={self.client}, sender={self.sender!r}, data={shown})"


def _has_key(data: bytes) -> bool:
    """Whether a SETUP_SIGNING (message 256 of MAVLink 2) begins somewhere in the data."""
    at = data.find(0xFD)
    while at >= 0:
        if data[at + 7 : at + 10] == b"\x00\x01\x00":
            return True
        at = data.find(0xFD, at + 1)
    return False


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Inputs:
    """Everything that was received since the last tick."""

    t_us: int
    samples: tuple[Sample, ...] = ()
    mavlink_rx: tuple[MavlinkFrame, ...] = ()
    overruns: int = 0
    """Ticks that began late so far (real time only), counted by the runtime."""
    cpu_load: float = 0.0
    """Load of the loop in the last second, 0..1; 0 if not measured (lockstep)."""
    notices: tuple["Event", ...] = ()
    """Messages of the runtime to operators (a broken link, a log that cannot be written)."""
    troubles: tuple["DeviceTrouble", ...] = ()
    """Devices that failed since the last tick."""
    pictures: tuple[PictureReport, ...] = ()
    """Statistics of the images of this tick."""
    log_lost: bool = False
    """The log is incomplete: disk full, gone or too slow."""
    clock_jump_s: float = 0.0
    """Jump of the system clock relative to the monotonic clock since the last tick."""
    frame_counts: Mapping[str, int] | None = None
    """Counts of images by result (``frames.ok`` ...); None without a camera."""
    below: "FlightControllerState | None" = None
    """State of the lower flight controller; None without one."""
    refusals: tuple[str, ...] = ()
    """Reasons of devices against arming, one line each."""
    camera: CameraReport | None = None
    """State of the camera, None = unchanged (or no camera)."""
    stills: tuple[StoredStill, ...] = ()
    """Results of requested stills."""

    # Calls between ticks and recorded answers; for the log, not used by a step.
    between: tuple["Between", ...] = ()
    """Calls since the last tick; their frames come first in the log's ``mavlink_rx``."""
    answers: tuple[Note, ...] = ()
    """Answers from outside during the tick and since the one before."""
    faults: tuple[Fault, ...] = ()
    """Exceptions of drivers; they join the service's in the log."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Between:
    """A call of the service between two ticks, recorded for replay."""

    t_us: int | None
    """Time of frames that were served; None = a HEARTBEAT was made for all links."""
    frames: int = 0
    """Number of frames received then."""


class Authority(Enum):
    """Who commands a vehicle with a lower flight controller."""

    OURS = "ours"
    """It follows our commands, or will when armed."""
    PILOT = "pilot"
    """It is in a pilot's mode: no commands until it is handed back."""
    STOPPED = "stopped"
    """It is disarmed although it was armed for us, or does not arm."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FlightControllerState:
    """Authority, arming and faults of the lower flight controller."""

    t_us: int
    authority: Authority
    acts: bool
    """Whether the thrusters follow the command now."""
    text: str = ""
    """Its mode, or the reason for its disarming."""
    problem: str = ""
    """Deviation of its thrusters from the command, "" if there is none."""
    refusals: tuple[str, ...] = ()
    """Reasons against arming, one line each."""
    pulses_us: tuple[int, ...] = ()
    """What the thrusters get while they do not act for us alone (a pilot's, a second sender's, neutral), in the order
    of the vehicle file; empty = not known."""
    armed: bool | None = None
    """By its heartbeat; None = unknown, or a disarming that is not confirmed yet."""
    rival: bool = False
    """A second source commands the thrusters."""


class DeviceRole(IntEnum):
    SENSORS = 0
    CAMERA = 1
    THRUSTERS = 2
    WATCHDOG = 3
    """The process that stops the thrusters when the service cannot."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DeviceTrouble:
    """A device that failed on this tick; it is tried again on the next."""

    t_us: int
    device: DeviceRole
    text: str
    """Problem and remedy."""


# Estimate.


class NavHealth(IntEnum):
    """Validity of the estimate, in ascending order."""

    INVALID = 0
    DEAD_RECKONING = 1
    GOOD = 2


class NavDoubt(Enum):
    """Findings of the monitors against the estimate or its sensors. One bit each in the log, in this order."""

    ACCELEROMETER = "accelerometer"
    """Rejected: inconsistent with thrust and fixes (or the AHRS's tilt is wrong)."""
    GYRO = "gyro"
    """Rejected: inconsistent with compass and fixes."""
    FIXES = "fixes"
    """Inconsistent with the estimate, or an implausible jump."""
    RANGE = "range"
    """Heights by laser and markers disagree."""
    MAP = "map"
    """Markers or sheets are displaced relative to the map."""
    CALIBRATION = "calibration"
    """Residuals show a wrong focal length or late stamps."""
    RESETS = "resets"
    """Repeated resets of the estimate."""
    CAMERA = "camera"
    """Rejected: its fixes are inconsistent with gyro and vehicle model, or have reset the estimate twice."""
    DEPTH = "depth"
    """The pressure sensor's zero is far from the fixes', or it is noisier than it says."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NavState:
    """The navigation state at ``t_us``, of the centre of gravity."""

    t_us: int
    health: NavHealth
    pos_ned_m: FloatArray
    """(3,)"""
    rpy_rad: FloatArray
    """(3,)"""
    vel_frd_m_s: FloatArray
    """(3,) over ground."""
    vel_water_frd_m_s: FloatArray
    """(3,) relative to the water."""
    rate_frd_rad_s: FloatArray
    """(3,)"""
    current_ned_m_s: FloatArray
    """(3,)"""
    variance: FloatArray
    """(12,) of pos_ned, rpy, vel_water_frd, current_ned."""
    reset_count: int = 0
    """Grows by one when position or yaw jump."""
    doubts: frozenset[NavDoubt] = frozenset()
    """Findings against the estimate or its sensors."""

    def in_level_frame(self) -> "NavState":
        """The same motion of a vehicle without roll and pitch, as the 4-DoF model knows it: of one that goes ahead nose
        up, no part of the velocity is heave."""
        roll, pitch, yaw = self.rpy_rad.tolist()
        if not math.isfinite(roll + pitch + sum(self.vel_frd_m_s.tolist()) + sum(self.vel_water_frd_m_s.tolist())):
            return self
        r_level_from_frd = r_ned_from_frd(np.array((roll, pitch, 0.0)))
        return replace(
            self,
            rpy_rad=np.array((0.0, 0.0, yaw)),
            vel_frd_m_s=r_level_from_frd @ self.vel_frd_m_s,
            vel_water_frd_m_s=r_level_from_frd @ self.vel_water_frd_m_s,
        )

    def model4_state(self) -> FloatArray:
        """State (8,) of :mod:`autopilot.core.model4`, of an estimate that is in the level frame."""
        velocity = self.vel_water_frd_m_s.tolist()
        return np.array([*self.pos_ned_m.tolist(), self.rpy_rad.item(2), *velocity, self.rate_frd_rad_s.item(2)])


class AidState(IntEnum):
    """Life cycle of one aiding source."""

    STOPPED = 0
    STARTING = 1
    ACTIVE = 2
    REJECTING = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkerFit:
    """Reprojection residuals of a marker pose."""

    known: int
    """Markers of the picture that were matched with the map."""
    used: int
    """Markers used for the pose; the others were rejected."""
    rms_px: float
    """RMS reprojection error of the used corners."""
    worst_px: float
    """Largest reprojection error."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AidStatus:
    """Result of one measurement update. Unused components are 0."""

    t_us: int
    sensor: str
    """Topic-safe name: markers, laser, heading, model, depth, velocity, external."""
    innovation: FloatArray
    """(3,)"""
    innovation_var: FloatArray
    """(3,)"""
    test_ratio: float
    """Mahalanobis distance squared over its gate; > 1 was rejected."""
    fused: bool
    state: AidState
    age_s: float
    """Now minus time of validity."""
    fit: MarkerFit | None = None
    """Reprojection residuals of a pose from markers."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NavCounters:
    """Counters of the estimator, once per second."""

    t_us: int
    counts: Mapping[str, int]
    """By name: ``ahrs.stuck``, ``markers.fused``, ``resets``, ... (:meth:`.estimator.protocol.Estimator.counters`)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ShadowStatus:
    """Difference between the primary estimator and the redundant one."""

    t_us: int
    pos_difference_ned_m: FloatArray
    """(3,)"""
    yaw_difference_rad: float
    vel_difference_frd_m_s: FloatArray
    """(3,) over ground."""
    ratio: float
    """Largest difference over its bound; above 1 is a disagreement."""
    disagrees: bool
    """The ratio has exceeded 1 for a while."""


# Decide.


@dataclass(frozen=True, slots=True, kw_only=True)
class VelocityGoal:
    """A velocity over ground to be tracked instead of a position (pilot, circle, velocity set points)."""

    north_m_s: float = 0.0
    east_m_s: float = 0.0
    """Both 0: the goal's position is held."""
    turn_rad_s: float = 0.0
    """Rate of turn of the velocity's direction, positive to starboard."""
    down_m_s: float | None = None
    """None = the goal's depth."""
    yaw_rate_rad_s: float | None = None
    """None = the goal's heading."""
    yaw_trend_rad_s: float = 0.0
    """Rate of the goal's heading."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Goal:
    """Terminal region of the vehicle and the speed towards it."""

    pos_ned_m: FloatArray
    """(3,)"""
    yaw_rad: float | None
    """None = free heading."""
    speed_m_s: float
    """Cruise speed over ground that the operator asks for."""
    accept_radius_m: float
    accept_yaw_rad: float
    seq: int
    """Mission item, -1 when the goal is not of a mission."""
    speed_asked: bool = False
    """True = commanded by mission or command; False = an upper bound."""
    following: "Goal | None" = None
    """Next goal without a stop here, None = it stays."""
    drive: VelocityGoal | None = None
    """Velocity to be tracked, None = go to the position."""
    facing_ned_m: FloatArray | None = None
    """(2,) point that the heading is directed at, None = ``yaw_rad``."""


class ProgressState(IntEnum):
    """MISSION_STATE (common.xml)."""

    UNKNOWN = 0
    NO_MISSION = 1
    NOT_STARTED = 2
    ACTIVE = 3
    PAUSED = 4
    COMPLETE = 5


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MissionProgress:
    t_us: int
    current_seq: int
    reached_seq: int
    """-1 none."""
    lap: int
    """Number of passes of the first DO_JUMP (or the first positional item), from 0."""
    state: ProgressState


# Control.


class SolveStatus(IntEnum):
    OK = 0
    IDLE = 1
    """Not asked to solve (disarmed)."""
    NOT_FINITE = 2
    RESIDUAL = 3
    """The result does not satisfy the predicted dynamics."""
    EXCEPTION = 4


class Fallback(IntEnum):
    """Source of the thrust command; NONE = the optimiser."""

    NONE = 0
    SHIFTED_PLAN = 1
    STATION_KEEPING = 2
    NEUTRAL = 3


FALLBACK_TEXT = "Controller: no solution"
"""Prefix of operator messages about a fallback."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class NmpcStatus:
    """Diagnostics of the controller, one per NMPC step."""

    t_us: int
    status: SolveStatus
    fallback: Fallback
    iterations: int
    solve_s: float
    """Measured CPU time: differs from run to run."""
    cost: float
    slack_max: float
    margin_m: float
    """Smallest tightened clearance to fence and obstacles in the prediction."""
    tube_m: float = 0.0
    """Largest distance that the prediction keeps from boundaries beyond the body: the tube, at least MPC_MARGIN."""
    penalty_use: float = 0.0
    """Largest multiplier of a soft limit over the slope of its penalty: at 1 the penalty is no longer exact."""
    lift_n: float = 0.0
    """Estimated vertical force beyond the vehicle file's buoyancy, positive up."""
    speed_margin_m_s: float = 0.0
    """Back-off of the planar speed limit at the end of the prediction; negative where drag is higher than believed."""
    drag_excess: float = 0.0
    drag_excess_sigma: float = 0.0
    """Logarithm of the true ratio of drag to thrust over the vehicle file's, and its standard deviation."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class UnsolvedProgram:
    """A QP that the solver failed to solve, with all data needed to solve it again."""

    t_us: int
    solver: str
    status: SolveStatus
    arrays: Mapping[str, FloatArray]
    """See :mod:`autopilot.control.nmpc.unsolved`."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EnergyPlan:
    """A minimum-energy trajectory that has just become active."""

    seq: int
    """Mission item that it leads to, -1 when the goal is not of a mission."""
    eta_s: float
    """To the goal's region."""
    energy_j: float
    """To the goal's region, hotel power included."""
    trajectory_s: float
    """Duration of the planned part: less than ``eta_s`` if the goal is far away."""
    late: int
    """Plans so far that were late."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ControlOutput:
    """Result of one controller step: thrust, prediction and diagnostics."""

    thrust_n: FloatArray
    """(n,) in the order of the vehicle file."""
    status: NmpcStatus
    horizon_ned_m: FloatArray
    """(n, 3) predicted positions, first row = now."""
    route_ned_m: FloatArray
    """(m, 2) the free path that the reference follows, first row = now, last = goal."""
    nominal: FloatArray = field(default_factory=lambda: np.zeros((0, 8)))
    """(n, 8) predicted states (:mod:`autopilot.core.model4`) of the undisturbed vehicle."""
    nominal_t_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(n,) times of ``nominal`` after ``status.t_us``: the plan begins one thruster lag ahead."""
    tube_m: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(n,) horizontal radius of the tube about ``horizon_ned_m``, by which the constraints are tightened."""
    plan: EnergyPlan | None = None
    """On the step on which one came into force."""
    restarted: bool = False
    """The plan was restarted (another route, a jump of the estimate): earlier predictions are void."""
    unsolved: tuple[UnsolvedProgram, ...] = ()
    """The first programs of this step that were not solved."""


# Out.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ThrusterCommand:
    """Thrust and pulses, in the order of the vehicle file."""

    t_us: int
    thrust_n: FloatArray
    """(8,) unused = 0."""
    pwm_us: tuple[int, ...]
    """(8,) unused = 0; neutral when disarmed."""
    armed: bool = False
    """Whether thrusters may turn: a flight controller below us is armed and disarmed with it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ThrusterHealthState:
    """Effectiveness of each thruster, 1 = nominal thrust of the vehicle file."""

    t_us: int
    effectiveness: FloatArray
    """(n,) used by bounds and allocation: the smaller of declared and detected."""
    estimate: FloatArray
    """(n,) the running estimate, including errors of mass and drag."""
    sigma: FloatArray
    """(n,) standard deviation of the estimate."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModeState:
    """Arming, flight mode and active failsafes."""

    t_us: int
    armed: bool
    custom_mode: int
    failsafes: int
    """Bits of :class:`Failsafe`."""


class Failsafe(IntEnum):
    """Bit positions of ModeState.failsafes; their conditions: :mod:`autopilot.command.failsafe_table`."""

    NAV_LOST = 0
    SOLVER = 1
    BATTERY = 2
    AHRS_STALE = 3
    THRUSTER = 4
    LATENCY = 5
    NAV_CHECK = 6
    FAULT = 7
    GCS = 8
    PILOT = 9
    DEAD_RECKONING = 10
    SENSOR = 11
    DOUBT = 12
    BATTERY_CRITICAL = 13
    ENERGY = 14
    LEAK = 15
    PRESSURE = 16
    TEMPERATURE = 17
    CAGE_SOFT = 18
    CAGE_HARD = 19
    TILT = 20
    COLLISION = 21
    STUCK = 22
    TETHER = 23
    LOOP = 24
    LOG = 25
    CLOCK = 26
    ASCENT = 27
    WATCHDOG = 28
    CAMERA = 29
    SENDER = 30


class RunEnd(Enum):
    """End of a run of the service by command."""

    STOP = "stop"
    AGAIN = "again"
    """And another one begins."""


class Severity(IntEnum):
    """MAV_SEVERITY (common.xml)."""

    EMERGENCY = 0
    ALERT = 1
    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6
    DEBUG = 7


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Event:
    """A line for the operator and for the log. ``severity`` is a :class:`Severity`."""

    t_us: int
    severity: int
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessStats:
    """Resources of the process, once per second."""

    rss_bytes: int
    """Resident memory; 0 = unknown."""
    log_queue: int
    """Messages that wait for the writer of the log,"""
    log_queue_bytes: int
    """and what they take."""
    threads: int
    collect_s: float
    """Longest pause of the garbage collector in the last second."""
    thread_cpu_s: tuple[float, ...] = (0.0,) * len(ServiceThread)
    """CPU time of the last second by :class:`ServiceThread`; all 0 where the system does not tell threads apart."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LoopStats:
    """Timing of the control loop, once per second."""

    t_us: int
    tick_s: float
    """Longest tick of the last second."""
    cpu_s: float
    """CPU seconds of the last second."""
    overruns: int
    dropped_log: int
    dropped_frames: int = 0
    """Pictures that detection did not follow, so far."""
    part_s: tuple[float, ...] = (0.0,) * len(LoopPart)
    """Wall time of the slowest tick of the last second by :class:`LoopPart`."""
    part_cpu_s: tuple[float, ...] = (0.0,) * len(LoopPart)
    """CPU time of the same."""
    ticks_s: tuple[float, ...] = ()
    """Wall time of each tick of the last second, without its late beginning."""
    ticks_cpu_s: tuple[float, ...] = ()
    """CPU time of the same."""
    process: ProcessStats | None = None

    @property
    def late_part(self) -> LoopPart:
        """The part with the largest share of the slowest tick."""
        return LoopPart(max(range(len(self.part_s)), key=self.part_s.__getitem__))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EstimatorInputs:
    """Inputs of the estimator in one tick beside ``Inputs.samples``, for replay."""

    thrust_n: FloatArray
    """(n,) thrust assumed to act since the last tick, in the order of the vehicle file."""
    samples: tuple[ExternalPoseSample | PlanarFixSample, ...] = ()
    """Poses that came over MAVLink, and GPS fixes in the local frame."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Outputs:
    """All results of one tick: commands and records for the log."""

    t_us: int
    command: ThrusterCommand
    nav: NavState | None
    """None until the estimator is initialised."""
    mode: ModeState
    mavlink_tx: tuple[MavlinkFrame, ...] = ()
    aids: tuple[AidStatus, ...] = ()
    estimated_from: EstimatorInputs | None = None
    goal: Goal | None = None
    control: ControlOutput | None = None
    """Set on the ticks on which the controller ran."""
    progress: MissionProgress | None = None
    counters: NavCounters | None = None
    """Counters of the estimator, once per second."""
    shadow: ShadowStatus | None = None
    """None without a redundant estimator."""
    thrusters: ThrusterHealthState | None = None
    """Twice per second and when a thruster's health changes."""
    drop_weight: bool = False
    """A failsafe wants the drop weight off."""
    hand_back: bool = False
    """A failsafe has handed the thrusters back to the lower flight controller; ``command`` is neutral."""
    disarm_flight_controller: bool = False
    """The flight controller below is to be disarmed, until its heartbeat shows it."""
    payload: PayloadState | None = None
    """Commanded state of gripper, lights, relays; None without payload."""
    shots: tuple[int, ...] = ()
    """Numbers of the stills that are to be taken from now on."""
    stills: tuple[StillRecord, ...] = ()
    """Stills that have been stored, with where the vehicle was."""
    run_end: RunEnd | None = None
    """An operator wants this run to end now."""
    events: tuple[Event, ...] = field(default=())
    parameters: Mapping[str, float] = field(default_factory=dict)
    """That were changed since the last tick."""
    faults: tuple[Fault, ...] = ()
    """Exceptions inside the service on this tick."""
