"""Table of our message types other than samples: topics, message and source.

Schemas, topics and the packer are made of this table and of :data:`autopilot.log.sample_table.SAMPLE_ROWS`.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

from autopilot.core.frames import FloatArray
from autopilot.core.marks import STATS_EVERY_TICKS, ServiceThread
from autopilot.core.messages import (
    MAX_THRUSTERS,
    AidStatus,
    EnergyPlan,
    Goal,
    Inputs,
    LoopStats,
    MarkerFit,
    MissionProgress,
    ModeState,
    NavDoubt,
    NavState,
    NmpcStatus,
    ProcessStats,
    ShadowStatus,
    ThrusterCommand,
    ThrusterHealthState,
)
from autopilot.core.payload import MAX_PAYLOAD, PayloadState
from autopilot.log.packing.parts import UINT16, UINT32, clip, padded
from autopilot.log.packing.record_values import (
    below_values,
    counter_values,
    drive_values,
    frame_values,
    still_values,
)
from autopilot.log.sample_table import MessageRow

_THREADS = ", ".join(thread.name.lower() for thread in ServiceThread)

MAX_NODES = 81
"""Places of a prediction whose tube is logged: those of 80 uniform intervals."""


class TruthLike(Protocol):
    """Ground truth of the simulated vehicle: shapes and frames as in ``autopilot_msgs/VehicleState``."""

    @property
    def pos_ned_m(self) -> FloatArray: ...
    @property
    def rpy_rad(self) -> FloatArray: ...
    @property
    def vel_frd_m_s(self) -> FloatArray: ...
    @property
    def vel_water_frd_m_s(self) -> FloatArray: ...
    @property
    def rate_frd_rad_s(self) -> FloatArray: ...
    @property
    def current_ned_m_s(self) -> FloatArray: ...
    @property
    def thrust_n(self) -> FloatArray:
        """(n,) acting force of each thruster, n <= 8."""
        ...

    @property
    def power_w(self) -> float:
        """Electrical power drawn from the battery: thrusters and everything else."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordRow(MessageRow):
    topics: tuple[str, ...]
    frame: str = "frd"
    values: Callable[[Any], Iterable[Any]] | None = None
    """All fields' values in their order, of what is no object with attributes of their names."""


FIELDS = f"""
VehicleState
float64[3] pos_ned_m  # place
float64[3] rpy_rad  # roll, pitch, yaw
float64[3] vel_frd_m_s  # over ground
float64[3] vel_water_frd_m_s  # relative to the water
float64[3] rate_frd_rad_s  # turn rates p, q, r
float64[3] current_ned_m_s  # of the water

ThrusterState
float64[8] thrust_n  # acting force, unused = 0
float64 power_w  # electrical, drawn from the battery: thrusters and everything else

ContactState
uint32 count  # contacts begun so far
float64 penetration_m  # deepest now, 0 = none

NavCovariance
float64[12] variance  # of pos_ned, rpy, vel_water_frd, current_ned

ActingThrust
float64[8] thrust_n  # that the estimator was told, unused = 0

NavStatus
uint8 health  # 0 invalid, 1 dead reckoning, 2 good
uint32 reset_count  # jumps of the estimate so far
uint32 doubts  # 1 accelerometer, 2 gyro, 4 fixes, 8 range, 16 map, 32 calibration, 64 resets, 128 camera, 256 depth

NavCounters
uint32 resets  # of the filter
uint32 clock_backwards  # times that the clock went back
uint32 thrust_malformed  # thrusts that are not finite
uint32 ahrs_good  # samples taken
uint32 ahrs_malformed  # not finite or out of range
uint32 ahrs_future  # stamped later than now
uint32 ahrs_old  # stamped before one that was taken
uint32 ahrs_stuck  # repeating themselves
uint32 ahrs_blind_steps  # of the filter without an AHRS sample
uint32 ahrs_tilt_disagreements  # tilts that left what gyros and accelerometers say
uint32[16] received  # by sensor: heading model markers external velocity depth laser altimeter gps
uint32[16] fused  # 1 = it went into the estimate
uint32[16] rejected  # measurements that failed their test
uint32[16] late  # measurements older than the filter goes back
uint32[16] duplicate  # measurements that came twice
uint32[16] future  # measurements stamped later than now
uint32[16] malformed  # measurements that are not finite or out of range
uint32[16] aid_resets  # resets of the estimate by this sensor
uint32[16] frames  # ok wrong_size wrong_type dark bright flat torn frozen dropped failed late foggy tilted
uint32 markers_unknown  # markers that the map does not have
uint32 markers_misfit  # markers left out because they did not fit
uint32 markers_leaning  # fixes refused because they leaned
uint32 shadow_disagreements  # times that the estimators parted
uint32 doubt_accel  # times that the accelerometer was doubted
uint32 doubt_gyro  # times that the gyros were doubted
uint32 doubt_compass_jumps  # of the heading source
uint32 doubt_jumps  # of the estimate
uint32[4] devices  # ticks on which it failed: 0 sensors, 1 camera, 2 thrusters, 3 their watchdog
uint32 power_malformed  # readings of the battery that were refused: not finite, or none that it can have
uint32 faults  # inside the service
uint32 other  # counted, and not one of these
uint32 ahrs_field_disturbances  # how often the magnetometer ceased to be believed

ShadowStatus
float64[3] pos_difference_ned_m  # flown minus shadow
float64 yaw_difference_rad  # flown minus shadow
float64[3] vel_difference_frd_m_s  # flown minus shadow
float64 ratio  # largest difference over its bound
uint8 disagrees  # 1 = beyond the bounds for long enough

AidStatus
float64[3] innovation  # measurement minus prediction, unused = 0
float64[3] innovation_var  # its variance by the filter, unused = 0
float64 test_ratio  # squared innovation over its gate, above 1 = rejected
uint8 fused  # 1 = it went into the estimate
uint8 state  # 0 stopped, 1 starting, 2 active, 3 rejecting
float64 age_s  # of the measurement when it was used

MarkerFit
uint16 known  # markers of the picture that were matched with the map
uint16 used  # of these the pose stands on; the others did not fit
float64 rms_px  # of the distances of all corners used from where map, camera and pose have them
float64 worst_px  # the largest of them

Goal
float64[3] pos_ned_m  # place
float64 yaw_rad  # heading from north
uint8 yaw_free  # 1 = any heading will do
float64 speed_m_s  # to be flown in the water
float64 accept_radius_m  # inside it the place is reached
float64 accept_yaw_rad  # and within it the heading
int32 seq  # mission item, -1 none

Drive
uint8 active  # 0 = the goal is a place, and nothing below counts
float64 north_m_s  # over ground; both 0 = the goal's place is held
float64 east_m_s  # the same
float64 turn_rad_s  # the direction of that velocity turns so fast
float64 down_m_s  # NaN = the goal's depth
float64 yaw_rate_rad_s  # NaN = the goal's heading
float64 yaw_trend_rad_s  # so fast the goal's heading itself turns

NmpcStatus
uint8 status  # 0 ok, 1 idle, 2 not finite, 3 residual, 4 exception
uint8 fallback  # 0 none, 1 shifted plan, 2 station keeping, 3 neutral
uint16 iterations  # quadratic programs solved in this step
float64 solve_s  # CPU time of the whole control step
float64 cost  # of the program solved; only differences mean something
float64 slack_max  # largest violation of a soft limit in the prediction
float64 margin_m  # smallest tightened clearance in the prediction
float64 tube_m  # largest distance kept from boundaries beyond the body
float64 penalty_use  # largest multiplier of a soft limit over its penalty
float64 lift_n  # learned vertical force beyond the vehicle file's buoyancy, positive pushes up
float64 speed_margin_m_s  # of the planar speed; negative where drag is higher than believed
float64 drag_excess  # logarithm of drag over thrust, relative to the vehicle file
float64 drag_excess_sigma  # its standard deviation

Tube
float32[{MAX_NODES}] radius_m  # horizontal, about each place of /ctl/horizon

ThrusterCommand
float64[8] thrust_n  # force of each thruster, unused = 0
uint16[8] pwm_us  # pulse lengths, unused = 0

ThrusterHealth
float64[8] effectiveness  # 0..1, what bounds and allocation go by, unused = 0
float64[8] estimate  # from the motion
float64[8] sigma  # its standard deviation

EnergyPlan
int32 seq  # mission item that it leads to, -1 none
float64 eta_s  # to the goal's region
float64 energy_j  # to the goal's region, hotel power included
float64 trajectory_s  # planned so far
uint32 late  # plans that came late

MissionProgress
int32 current_seq  # mission item that is flown, -1 none
int32 reached_seq  # -1 none
uint16 lap  # laps that are complete
uint8 state  # MISSION_STATE

ModeState
uint8 armed  # 1 = thrusters may turn
uint32 custom_mode  # as in HEARTBEAT; names are in run.json
uint32 failsafes  # bits: docs/failsafes.md

ParameterChange
uint8[16] name  # ASCII, padded with zeros
float64 value  # the new one

LoopStats
float64 tick_s  # longest tick of the last second
float64 cpu_s  # CPU seconds of the last second
uint32 overruns  # ticks that began late, so far
uint32 dropped_log  # messages lost so far
uint32 dropped_frames  # pictures that detection did not follow
uint8 late_part  # what most of the slowest tick of the second went into: 0 wait, 1 device, 2 vision, 3 receive
float64[12] part_s  # its wall time: as late_part, 4 estimate, 5 mavlink, 6 decide, 7 control
float64[12] part_cpu_s  # its CPU time: as part_s, 8 allocate, 9 write, 10 send, 11 record
float32[{STATS_EVERY_TICKS}] ticks_s  # wall time of each tick of the last second
float32[{STATS_EVERY_TICKS}] ticks_cpu_s  # CPU time of the same

ProcessStats
uint64 rss  # bytes of memory that are resident, 0 = the system does not say
uint32 log_queue  # messages that wait for the writer of the log
uint64 log_queue_bytes  # what they take
uint16 threads  # of the process
float64 collect_s  # longest pause of the garbage collector in the last second
float64[{len(ServiceThread)}] thread_cpu_s  # CPU seconds of the last second: {_THREADS}

InputTick
uint16 samples  # inputs that follow in the file and belong to this tick
uint16 frames  # MAVLink datagrams of this tick
uint32 overruns  # ticks that began late, so far
float64 cpu_load  # 0..1, 0 = not measured

PayloadOutputs
uint16[16] pulse_us  # of [[payload]] in the order of the vehicle file, unused = 0

PayloadTruth
float64[16] share  # where each really is: 0 dark, off, closed; 1 bright, on, open; unused = 0

Still  # time of the exposure, as that of its picture in /payload/image
uint32 index  # number of the still in this run
int32 seq  # mission item that asked for it, -1 = a client
uint8 stored  # 0 = there is no picture: see /rosout
uint8 pose_known  # 0 = there was no estimate then, and the pose is not meant
float64[3] pos_ned_m  # of the vehicle at the exposure, as estimated
float64[3] rpy_rad  # roll, pitch, yaw
float64[6] variance  # of both
uint16 width_px  # of the picture
uint16 height_px  # of the picture
uint32 size  # bytes
float64 delay_s  # from the exposure until it was stored

Below
uint8 authority  # 0 ours, 1 the pilot's, 2 stopped
uint8 acts  # whether thrusters do what they are commanded
uint8 thrusters  # so many of pulses_us are known
uint16[8] pulses_us  # what the thrusters get while they do not act for us
uint8[64] text  # its mode, or why it has stopped; UTF-8, zeros behind it
uint8[128] problem  # how its thrusters do something else than what they are commanded, the same
uint8[512] refusals  # why it would not fly for us, the same; lines end with a newline
uint8 armed  # by its heartbeat: 0 no, 1 yes, 2 not known
uint8 rival  # 1 = somebody else commands the thrusters beside us

MavlinkFrame
uint8[280] data  # the packet, padded with zeros
uint16 length  # bytes of the packet
uint8 link  # 255 = all links
uint16 client  # of the link: one number per address or connection, 0 = everyone
"""
"""Name and fields of every type, behind its header, as ``ros2msg``."""

RECORD_ROWS = (
    RecordRow(of=NavState, type="VehicleState", topics=("/sim/truth", "/nav/state"), frame="ned"),
    RecordRow(type="ThrusterState", topics=("/sim/thrusters",), put={"power_w": lambda truth: float(truth.power_w)}),
    RecordRow(
        type="ContactState",
        topics=("/sim/contact",),
        frame="ned",
        put={"count": lambda contact: clip(contact[0], UINT32), "penetration_m": lambda contact: contact[1]},
    ),
    RecordRow(of=NavState, type="NavCovariance", topics=("/nav/covariance",), frame="ned"),
    RecordRow(type="ActingThrust", topics=("/nav/thrust",), values=lambda thrust_n: padded(thrust_n, MAX_THRUSTERS)),
    RecordRow(
        of=NavState,
        type="NavStatus",
        topics=("/nav/status",),
        frame="ned",
        put={"doubts": lambda nav: sum(1 << bit for bit, doubt in enumerate(NavDoubt) if doubt in nav.doubts)},
    ),
    RecordRow(type="NavCounters", topics=("/nav/counters",), values=counter_values),
    RecordRow(of=ShadowStatus, type="ShadowStatus", topics=("/nav/shadow",), frame="ned"),
    RecordRow(of=AidStatus, type="AidStatus", topics=(), frame="ned"),
    RecordRow(of=MarkerFit, type="MarkerFit", topics=("/nav/fit",)),
    RecordRow(
        of=Goal,
        type="Goal",
        topics=("/ctl/goal",),
        frame="ned",
        put={
            "yaw_rad": lambda goal: 0.0 if goal.yaw_rad is None else goal.yaw_rad,
            "yaw_free": lambda goal: int(goal.yaw_rad is None),
        },
    ),
    RecordRow(type="Drive", topics=("/ctl/drive",), frame="ned", values=drive_values),
    RecordRow(of=NmpcStatus, type="NmpcStatus", topics=("/ctl/nmpc",), frame="ned"),
    RecordRow(
        type="Tube",
        topics=("/ctl/tube",),
        frame="ned",
        put={"radius_m": lambda control: padded(control.tube_m, MAX_NODES)},
    ),
    RecordRow(of=ThrusterCommand, type="ThrusterCommand", topics=("/out/thrusters",)),
    RecordRow(of=ThrusterHealthState, type="ThrusterHealth", topics=("/ctl/thrusters",)),
    RecordRow(of=EnergyPlan, type="EnergyPlan", topics=("/ctl/plan",), frame="ned"),
    RecordRow(of=MissionProgress, type="MissionProgress", topics=("/mission/progress",), frame="ned"),
    RecordRow(
        of=ModeState,
        type="ModeState",
        topics=("/sys/mode",),
        put={"custom_mode": lambda mode: mode.custom_mode & UINT32, "failsafes": lambda mode: mode.failsafes & UINT32},
    ),
    RecordRow(
        type="ParameterChange",
        topics=("/sys/parameters",),
        values=lambda change: (change[0].encode("ascii", "replace"), change[1]),
    ),
    RecordRow(
        of=LoopStats,
        type="LoopStats",
        topics=("/sys/loop",),
        put={
            "ticks_s": lambda stats: padded(stats.ticks_s, STATS_EVERY_TICKS),
            "ticks_cpu_s": lambda stats: padded(stats.ticks_cpu_s, STATS_EVERY_TICKS),
        },
    ),
    RecordRow(
        of=ProcessStats, type="ProcessStats", topics=("/sys/process",), put={"rss": lambda stats: stats.rss_bytes}
    ),
    RecordRow(
        of=Inputs,
        type="InputTick",
        topics=("/in/tick",),
        put={
            "samples": lambda inputs: clip(len(inputs.samples), UINT16),
            "frames": lambda inputs: clip(len(inputs.mavlink_rx), UINT16),
        },
    ),
    RecordRow(
        of=PayloadState,
        type="PayloadOutputs",
        topics=("/payload/outputs",),
        put={"pulse_us": lambda state: padded(state.pulses_us, MAX_PAYLOAD)},
    ),
    RecordRow(type="PayloadTruth", topics=("/sim/payload",), values=lambda levels: padded(levels, MAX_PAYLOAD)),
    RecordRow(type="Still", topics=("/payload/still",), frame="ned", values=still_values),
    RecordRow(type="Below", topics=("/in/below",), values=below_values),
    RecordRow(type="MavlinkFrame", topics=("/in/mavlink", "/out/mavlink"), values=frame_values),
)
