"""What was decided: mode, mission, goal, plan and thrust."""

import math

from autopilot.core.messages import (
    EnergyPlan,
    Goal,
    MissionProgress,
    ModeState,
    NmpcStatus,
    ThrusterCommand,
    ThrusterHealthState,
    VelocityGoal,
)
from autopilot.log.cdr import ENCAPSULATION
from autopilot.log.packing.parts import NED, NS, UINT32
from autopilot.log.packing.records import packer_of
from autopilot.log.schemas import layout

_drive = layout("autopilot_msgs/Drive").packer.pack

goal = packer_of(
    Goal,
    "Goal",
    "ned",
    put={
        "yaw_rad": lambda goal: 0.0 if goal.yaw_rad is None else goal.yaw_rad,
        "yaw_free": lambda goal: int(goal.yaw_rad is None),
    },
)
nmpc_status = packer_of(NmpcStatus, "NmpcStatus", "ned")
energy_plan = packer_of(EnergyPlan, "EnergyPlan", "ned")
thruster_command = packer_of(ThrusterCommand, "ThrusterCommand", "frd")
thruster_health = packer_of(ThrusterHealthState, "ThrusterHealth", "frd")
mission_progress = packer_of(MissionProgress, "MissionProgress", "ned")
mode_state = packer_of(
    ModeState,
    "ModeState",
    "frd",
    put={
        "custom_mode": lambda mode: mode.custom_mode & UINT32,
        "failsafes": lambda mode: mode.failsafes & UINT32,
    },
)


def drive(stamp_ns: int, value: VelocityGoal | None) -> bytes:
    """Drive; what it leaves to the goal is NaN, None is a goal without one."""
    given = value or VelocityGoal()
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
