"""One pure function per fixed-size message that packs it.

Each function takes the stamp in nanoseconds (the log's epoch plus the service's clock) first and returns CDR bytes.
Topics of variable size (paths, markers, transforms, images, text) are in :mod:`autopilot.log.visuals`.
"""

import math
import struct
from typing import Protocol

import numpy as np

from autopilot.core.frames import FloatArray, quat_from_rpy
from autopilot.core.messages import (
    AID_SENSORS,
    MAX_THRUSTERS,
    AidStatus,
    EnergyPlan,
    Goal,
    Inputs,
    LoopStats,
    MissionProgress,
    ModeState,
    NavCounters,
    NavState,
    NmpcStatus,
    ShadowStatus,
    ThrusterCommand,
    ThrusterHealthState,
)
from autopilot.core.samples import (
    AhrsSample,
    DepthSample,
    ExternalPoseSample,
    ImuSample,
    LaserSample,
    MarkerSighting,
    ObstacleTrack,
    PoseSample,
    PowerSample,
    VelocitySample,
)
from autopilot.log.cdr import ENCAPSULATION
from autopilot.log.schemas import layout


class TruthLike(Protocol):
    """What the log needs of the simulated vehicle: shapes and frames as in ``autopilot_msgs/VehicleState``."""

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


_NED = (4, b"ned\0")
_FRD = (4, b"frd\0")
_CAM = (4, b"cam\0")
_NS = 1_000_000_000

_vehicle_state = layout("autopilot_msgs/VehicleState").packer.pack
_thruster_state = layout("autopilot_msgs/ThrusterState").packer.pack
_contact_state = layout("autopilot_msgs/ContactState").packer.pack
_nav_covariance = layout("autopilot_msgs/NavCovariance").packer.pack
_acting_thrust = layout("autopilot_msgs/ActingThrust").packer.pack
_nav_status = layout("autopilot_msgs/NavStatus").packer.pack
_nav_counters = layout("autopilot_msgs/NavCounters").packer.pack
_shadow_status = layout("autopilot_msgs/ShadowStatus").packer.pack
_depth_raw = layout("autopilot_msgs/DepthRaw").packer.pack
_velocity_raw = layout("autopilot_msgs/VelocityRaw").packer.pack
_external_pose = layout("autopilot_msgs/ExternalPose").packer.pack
_aid_status = layout("autopilot_msgs/AidStatus").packer.pack
_goal = layout("autopilot_msgs/Goal").packer.pack
_nmpc_status = layout("autopilot_msgs/NmpcStatus").packer.pack
_thruster_command = layout("autopilot_msgs/ThrusterCommand").packer.pack
_energy_plan = layout("autopilot_msgs/EnergyPlan").packer.pack
_thruster_health = layout("autopilot_msgs/ThrusterHealth").packer.pack
_mission_progress = layout("autopilot_msgs/MissionProgress").packer.pack
_mode_state = layout("autopilot_msgs/ModeState").packer.pack
_loop_stats = layout("autopilot_msgs/LoopStats").packer.pack
_input_tick = layout("autopilot_msgs/InputTick").packer.pack
_ahrs_raw = layout("autopilot_msgs/AhrsRaw").packer.pack
_imu_raw = layout("autopilot_msgs/ImuRaw").packer.pack
_imu = layout("sensor_msgs/Imu").packer.pack
_pose_fix = layout("autopilot_msgs/PoseFix").packer.pack
_obstacle_track = layout("autopilot_msgs/ObstacleTrack").packer.pack
_laser_raw = layout("autopilot_msgs/LaserRaw").packer.pack
_range = layout("sensor_msgs/Range").packer.pack
_power_raw = layout("autopilot_msgs/PowerRaw").packer.pack
_mavlink_frame = layout("autopilot_msgs/MavlinkFrame").packer.pack
_MARKERS = layout("autopilot_msgs/MarkerSighting")
_HEADER = struct.Struct("<4siII4sH")
_marker_offset = {name: entry[1] for name, entry in (_MARKERS.dtype.fields or {}).items()}

MAX_MARKERS = 64
"""Markers that one logged sighting holds; more are left out."""
MAVLINK_MAX_BYTES = 280
"""Largest MAVLink 2 packet with signature (mavlink.io, Packet Serialization)."""
ALL_LINKS = 255
"""``MavlinkFrame.link`` for a frame that goes to all links."""

_OF_THE_FILTER = (
    "resets",
    "clock.backwards",
    "thrust.malformed",
    "ahrs.good",
    "ahrs.malformed",
    "ahrs.future",
    "ahrs.old",
    "ahrs.stuck",
    "ahrs.blind_steps",
    "ahrs.tilt_disagreements",
)
_OF_AN_AID = ("received", "fused", "rejected", "late", "duplicate", "future", "malformed", "resets")
"""Names of counts, in the order of the fields of NavCounters."""

_UNKNOWN_COVARIANCE = (-1.0,) + (0.0,) * 8
"""sensor_msgs/Imu: element 0 = -1 means that there is no estimate of this quantity's covariance."""
_ZERO9 = (0.0,) * 9
_UINT8, _UINT16, _UINT32 = 0xFF, 0xFFFF, 0xFFFFFFFF


def _clip(value: int, largest: int) -> int:
    return 0 if value < 0 else min(value, largest)


def _eight(values: FloatArray) -> list[float]:
    out: list[float] = values.tolist()
    return out if len(out) == MAX_THRUSTERS else (out + [0.0] * MAX_THRUSTERS)[:MAX_THRUSTERS]


def vehicle_state(stamp_ns: int, state: TruthLike | NavState) -> bytes:
    """VehicleState of the truth or of the estimate."""
    return _vehicle_state(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_NED,
        *state.pos_ned_m.tolist(),
        *state.rpy_rad.tolist(),
        *state.vel_frd_m_s.tolist(),
        *state.vel_water_frd_m_s.tolist(),
        *state.rate_frd_rad_s.tolist(),
        *state.current_ned_m_s.tolist(),
    )


def thruster_state(stamp_ns: int, truth: TruthLike) -> bytes:
    """ThrusterState: acting forces and electrical power."""
    return _thruster_state(ENCAPSULATION, *divmod(stamp_ns, _NS), *_FRD, *_eight(truth.thrust_n), float(truth.power_w))


def contact_state(stamp_ns: int, count: int, penetration_m: float) -> bytes:
    """ContactState: contacts of the simulated hull begun so far, and how deep the deepest of now is."""
    return _contact_state(ENCAPSULATION, *divmod(stamp_ns, _NS), *_NED, _clip(count, _UINT32), penetration_m)


def nav_covariance(stamp_ns: int, nav: NavState) -> bytes:
    """NavCovariance."""
    return _nav_covariance(ENCAPSULATION, *divmod(stamp_ns, _NS), *_NED, *nav.variance.tolist())


def acting_thrust(stamp_ns: int, thrust_n: FloatArray) -> bytes:
    """ActingThrust."""
    return _acting_thrust(ENCAPSULATION, *divmod(stamp_ns, _NS), *_FRD, *_eight(thrust_n))


def nav_status(stamp_ns: int, nav: NavState) -> bytes:
    """NavStatus."""
    return _nav_status(ENCAPSULATION, *divmod(stamp_ns, _NS), *_NED, int(nav.health), _clip(nav.reset_count, _UINT32))


def nav_counters(stamp_ns: int, value: NavCounters) -> bytes:
    """NavCounters; what was not counted is 0."""
    names = [*_OF_THE_FILTER]
    for what in _OF_AN_AID:
        names += [f"{sensor}.{what}" for sensor in AID_SENSORS] + [""] * (8 - len(AID_SENSORS))
    counts = [_clip(value.counts.get(name, 0), _UINT32) for name in names]
    return _nav_counters(ENCAPSULATION, *divmod(stamp_ns, _NS), *_FRD, *counts)


def shadow_status(stamp_ns: int, status: ShadowStatus) -> bytes:
    """ShadowStatus."""
    return _shadow_status(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_NED,
        *status.pos_difference_ned_m.tolist(),
        status.yaw_difference_rad,
        *status.vel_difference_frd_m_s.tolist(),
        status.ratio,
        int(status.disagrees),
    )


def aid_status(stamp_ns: int, aid: AidStatus) -> bytes:
    """AidStatus."""
    return _aid_status(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_NED,
        *aid.innovation.tolist(),
        *aid.innovation_var.tolist(),
        aid.test_ratio,
        int(aid.fused),
        int(aid.state),
        aid.age_s,
    )


def goal(stamp_ns: int, value: Goal) -> bytes:
    """Goal; a free heading is yaw 0 with ``yaw_free`` 1."""
    free = value.yaw_rad is None
    return _goal(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_NED,
        *value.pos_ned_m.tolist(),
        0.0 if value.yaw_rad is None else value.yaw_rad,
        int(free),
        value.speed_m_s,
        value.accept_radius_m,
        value.accept_yaw_rad,
        value.seq,
    )


def nmpc_status(stamp_ns: int, status: NmpcStatus) -> bytes:
    """NmpcStatus."""
    return _nmpc_status(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_NED,
        int(status.status),
        int(status.fallback),
        _clip(status.iterations, _UINT16),
        status.solve_s,
        status.cost,
        status.slack_max,
        status.margin_m,
        status.tube_m,
        status.penalty_use,
    )


def thruster_command(stamp_ns: int, command: ThrusterCommand) -> bytes:
    """ThrusterCommand."""
    pwm = (command.pwm_us + (0,) * MAX_THRUSTERS)[:MAX_THRUSTERS]
    return _thruster_command(ENCAPSULATION, *divmod(stamp_ns, _NS), *_FRD, *_eight(command.thrust_n), *pwm)


def thruster_health(stamp_ns: int, state: ThrusterHealthState) -> bytes:
    """ThrusterHealth."""
    return _thruster_health(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_FRD,
        *_eight(state.effectiveness),
        *_eight(state.estimate),
        *_eight(state.sigma),
    )


def energy_plan(stamp_ns: int, plan: EnergyPlan) -> bytes:
    """EnergyPlan."""
    return _energy_plan(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_NED,
        plan.seq,
        plan.eta_s,
        plan.energy_j,
        plan.trajectory_s,
        plan.late,
    )


def mission_progress(stamp_ns: int, progress: MissionProgress) -> bytes:
    """MissionProgress."""
    return _mission_progress(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_NED,
        progress.current_seq,
        progress.reached_seq,
        _clip(progress.lap, _UINT16),
        int(progress.state),
    )


def mode_state(stamp_ns: int, mode: ModeState) -> bytes:
    """ModeState."""
    return _mode_state(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_FRD,
        int(mode.armed),
        mode.custom_mode & _UINT32,
        mode.failsafes & _UINT32,
    )


def loop_stats(stamp_ns: int, stats: LoopStats) -> bytes:
    """LoopStats."""
    return _loop_stats(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_FRD,
        stats.tick_s,
        stats.cpu_s,
        _clip(stats.overruns, _UINT32),
        _clip(stats.dropped_log, _UINT32),
    )


def input_tick(stamp_ns: int, inputs: Inputs) -> bytes:
    """InputTick: opens the group of messages that one call of ``step`` took in."""
    return _input_tick(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_FRD,
        _clip(len(inputs.samples), _UINT16),
        _clip(len(inputs.mavlink_rx), _UINT16),
        _clip(inputs.overruns, _UINT32),
        inputs.cpu_load,
    )


def ahrs_raw(stamp_ns: int, sample: AhrsSample) -> bytes:
    """AhrsRaw: exactly what the estimator got."""
    return _ahrs_raw(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_FRD,
        *sample.rpy_rad.tolist(),
        *sample.rate_frd_rad_s.tolist(),
        *sample.accel_frd_m_s2.tolist(),
    )


def imu_raw(stamp_ns: int, sample: ImuSample) -> bytes:
    """ImuRaw; without a magnetometer's reading zeros with ``mag_known`` 0."""
    return _imu_raw(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_FRD,
        *sample.rate_frd_rad_s.tolist(),
        *sample.accel_frd_m_s2.tolist(),
        int(sample.mag_frd is not None),
        *((0.0, 0.0, 0.0) if sample.mag_frd is None else sample.mag_frd.tolist()),
    )


def imu(stamp_ns: int, sample: AhrsSample) -> bytes:
    """sensor_msgs/Imu of the same sample, for viewers. Axes stay NED and FRD."""
    w, x, y, z = quat_from_rpy(sample.rpy_rad).tolist()
    return _imu(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_FRD,
        x,
        y,
        z,
        w,
        *_ZERO9,
        *sample.rate_frd_rad_s.tolist(),
        *_ZERO9,
        *sample.accel_frd_m_s2.tolist(),
        *_ZERO9,
    )


def marker_sighting(stamp_ns: int, sighting: MarkerSighting) -> bytes:
    """MarkerSighting: the first MAX_MARKERS markers."""
    count = min(len(sighting.ids), MAX_MARKERS)
    message = bytearray(_MARKERS.packer.size)
    _HEADER.pack_into(message, 0, ENCAPSULATION, *divmod(stamp_ns, _NS), *_CAM, count)
    struct.pack_into(f"<{count}H", message, _marker_offset["ids"], *sighting.ids[:count])
    corners = np.ascontiguousarray(sighting.corners_px[:count], dtype="<f4").tobytes()
    message[_marker_offset["corners_px"] : _marker_offset["corners_px"] + len(corners)] = corners
    if sighting.laser_px is not None:
        message[_marker_offset["laser_found"]] = 1
        struct.pack_into("<2d", message, _marker_offset["laser_px"], *sighting.laser_px.tolist())
    struct.pack_into("<I", message, _marker_offset["decode_us"], _clip(sighting.decode_us, _UINT32))
    return bytes(message)


def pose_fix(stamp_ns: int, sample: PoseSample) -> bytes:
    """PoseFix."""
    return _pose_fix(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_NED,
        *sample.pos_ned_m.tolist(),
        sample.yaw_rad,
        *sample.sigma_pos_m.tolist(),
        sample.sigma_yaw_rad,
    )


def laser_raw(stamp_ns: int, sample: LaserSample) -> bytes:
    """LaserRaw: exactly what the estimator got."""
    return _laser_raw(ENCAPSULATION, *divmod(stamp_ns, _NS), *_FRD, sample.range_m, sample.sigma_m)


def laser_range(stamp_ns: int, sample: LaserSample) -> bytes:
    """sensor_msgs/Range of the same sample, for viewers."""
    variance = sample.sigma_m * sample.sigma_m
    return _range(ENCAPSULATION, *divmod(stamp_ns, _NS), *_FRD, 1, 0.0, 0.0, math.inf, sample.range_m, variance)


def depth_raw(stamp_ns: int, sample: DepthSample) -> bytes:
    """DepthRaw."""
    return _depth_raw(ENCAPSULATION, *divmod(stamp_ns, _NS), *_FRD, sample.depth_m, sample.sigma_m)


def velocity_raw(stamp_ns: int, sample: VelocitySample) -> bytes:
    """VelocityRaw."""
    return _velocity_raw(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_FRD,
        *sample.vel_frd_m_s.tolist(),
        *sample.sigma_m_s.tolist(),
        int(sample.lock),
    )


def external_pose(stamp_ns: int, sample: ExternalPoseSample) -> bytes:
    """ExternalPose; an unknown covariance is zeros with ``covariance_known`` 0."""
    known = sample.covariance is not None
    return _external_pose(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_NED,
        *sample.pos_m.tolist(),
        sample.yaw_rad,
        int(known),
        *([0.0] * 16 if sample.covariance is None else sample.covariance.ravel().tolist()),
        int(sample.frame),
        _clip(sample.reset_counter, _UINT32),
    )


def obstacle_track(stamp_ns: int, track: ObstacleTrack) -> bytes:
    """ObstacleTrack."""
    return _obstacle_track(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_NED,
        *track.pos_ned_m.tolist(),
        *track.vel_ned_m_s.tolist(),
        track.radius_m,
        _clip(track.track_id, _UINT32),
    )


def power_raw(stamp_ns: int, sample: PowerSample) -> bytes:
    """PowerRaw."""
    return _power_raw(
        ENCAPSULATION,
        *divmod(stamp_ns, _NS),
        *_FRD,
        sample.voltage_v,
        sample.current_a,
        sample.energy_used_j,
        sample.remaining,
    )


def mavlink_frame(stamp_ns: int, data: bytes, link: int) -> bytes:
    """MavlinkFrame of at most MAVLINK_MAX_BYTES bytes; link -1 = all links."""
    number = link if 0 <= link < ALL_LINKS else ALL_LINKS
    return _mavlink_frame(ENCAPSULATION, *divmod(stamp_ns, _NS), *_FRD, data, len(data), number)
