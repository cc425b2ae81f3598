"""What was decided: mode, mission, goal, plan and thrust."""

import math

from autopilot.core.messages import (
    MAX_THRUSTERS,
    Drive,
    EnergyPlan,
    Goal,
    MissionProgress,
    ModeState,
    NmpcStatus,
    ThrusterCommand,
    ThrusterHealthState,
)
from autopilot.log.cdr import ENCAPSULATION
from autopilot.log.packing.parts import FRD, NED, NS, UINT16, UINT32, clip, eight
from autopilot.log.schemas import layout

_goal = layout("autopilot_msgs/Goal").packer.pack
_drive = layout("autopilot_msgs/Drive").packer.pack
_nmpc_status = layout("autopilot_msgs/NmpcStatus").packer.pack
_thruster_command = layout("autopilot_msgs/ThrusterCommand").packer.pack
_energy_plan = layout("autopilot_msgs/EnergyPlan").packer.pack
_thruster_health = layout("autopilot_msgs/ThrusterHealth").packer.pack
_mission_progress = layout("autopilot_msgs/MissionProgress").packer.pack
_mode_state = layout("autopilot_msgs/ModeState").packer.pack


def goal(stamp_ns: int, value: Goal) -> bytes:
    """Goal; a free heading is yaw 0 with ``yaw_free`` 1."""
    free = value.yaw_rad is None
    return _goal(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *NED,
        *value.pos_ned_m.tolist(),
        0.0 if value.yaw_rad is None else value.yaw_rad,
        int(free),
        value.speed_m_s,
        value.accept_radius_m,
        value.accept_yaw_rad,
        value.seq,
    )


def drive(stamp_ns: int, value: Drive | None) -> bytes:
    """Drive; what it leaves to the goal is NaN, None is a goal without one."""
    given = value or Drive()
    return _drive(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *NED,
        int(value is not None),
        given.north_m_s,
        given.east_m_s,
        given.turn_rad_s,
        math.nan if given.down_m_s is None else given.down_m_s,
        math.nan if given.yaw_rate_rad_s is None else given.yaw_rate_rad_s,
        given.yaw_trend_rad_s,
    )


def nmpc_status(stamp_ns: int, status: NmpcStatus) -> bytes:
    """NmpcStatus."""
    return _nmpc_status(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *NED,
        int(status.status),
        int(status.fallback),
        clip(status.iterations, UINT16),
        status.solve_s,
        status.cost,
        status.slack_max,
        status.margin_m,
        status.tube_m,
        status.penalty_use,
        status.lift_n,
    )


def energy_plan(stamp_ns: int, plan: EnergyPlan) -> bytes:
    """EnergyPlan."""
    return _energy_plan(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *NED,
        plan.seq,
        plan.eta_s,
        plan.energy_j,
        plan.trajectory_s,
        plan.late,
    )


def thruster_command(stamp_ns: int, command: ThrusterCommand) -> bytes:
    """ThrusterCommand."""
    pwm = (command.pwm_us + (0,) * MAX_THRUSTERS)[:MAX_THRUSTERS]
    return _thruster_command(ENCAPSULATION, *divmod(stamp_ns, NS), *FRD, *eight(command.thrust_n), *pwm)


def thruster_health(stamp_ns: int, state: ThrusterHealthState) -> bytes:
    """ThrusterHealth."""
    return _thruster_health(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *FRD,
        *eight(state.effectiveness),
        *eight(state.estimate),
        *eight(state.sigma),
    )


def mission_progress(stamp_ns: int, progress: MissionProgress) -> bytes:
    """MissionProgress."""
    return _mission_progress(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *NED,
        progress.current_seq,
        progress.reached_seq,
        clip(progress.lap, UINT16),
        int(progress.state),
    )


def mode_state(stamp_ns: int, mode: ModeState) -> bytes:
    """ModeState."""
    return _mode_state(
        ENCAPSULATION,
        *divmod(stamp_ns, NS),
        *FRD,
        int(mode.armed),
        mode.custom_mode & UINT32,
        mode.failsafes & UINT32,
    )
