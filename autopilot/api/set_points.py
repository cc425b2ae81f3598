"""A client in the process that arms the vehicle and sends it where a program wants it to go."""

import math
from collections.abc import Sequence

from autopilot.sitl.operator import ARM, Order, ScriptedOperator

OFFBOARD: Order = (176, (1.0, 6.0))
"""MAV_CMD_DO_SET_MODE, PX4's main mode 6: follow set points (mode GUIDED)."""

PERIOD_US = 100_000
"""Set points are repeated: without them mode GUIDED ends after OFFB_TIMEOUT."""

IGNORED = 0b1001_1111_1000
"""POSITION_TARGET_TYPEMASK: position and yaw count; velocities, accelerations and yaw rate do not."""
NO_YAW = 1 << 10

LOCAL_NED = 1
"""MAV_FRAME"""


class SetPointClient(ScriptedOperator):
    """Sends its goal as SET_POSITION_TARGET_LOCAL_NED while it has one."""

    def __init__(self, *, arms: bool) -> None:
        """``arms``: else another client does."""
        super().__init__(1, orders=(ARM,) if arms else ())
        self._goal: tuple[float, float, float, float] | None = None
        self._sent_goal_us = -PERIOD_US
        self._asked = False

    def go_to(self, goal: tuple[float, float, float, float], *, guided: bool) -> None:
        """North, east, depth [m], yaw [rad] (NaN = free), from the next tick on. ``guided``: the mode is GUIDED."""
        self._asked = guided  # a refused set point or a failsafe has ended it, or it has not begun
        if goal != self._goal:
            self._goal, self._sent_goal_us = goal, -PERIOD_US

    def step(self, t_us: int, received: Sequence[bytes]) -> list[bytes]:
        if self._goal is None:
            return super().step(t_us, received)
        out: list[bytes] = []
        if t_us - self._sent_goal_us >= PERIOD_US:
            self._sent_goal_us = t_us
            north_m, east_m, depth_m, yaw_rad = self._goal
            free = math.isnan(yaw_rad)
            place = (north_m, east_m, depth_m, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 if free else yaw_rad, 0.0)
            mask = IGNORED | (NO_YAW if free else 0)
            target = self._mav.set_position_target_local_ned_encode(0, self.target_system, 1, LOCAL_NED, mask, *place)
            out.append(self._pack(target))
        if not self._asked and self.started:
            self._asked = True
            self._todo.append(OFFBOARD)
        return out + super().step(t_us, received)
