"""Control without a solution of the optimiser: station keeping by cascaded P loops on the model, and its notices to
the operator.
"""

import math

import numpy as np

from autopilot.control.robust.robust_tuning import FALLBACK
from autopilot.core import model4
from autopilot.core import operator_messages as notices
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import Fallback
from autopilot.core.model4 import YAW, R, U, X, Y, Z
from autopilot.core.notice_queue import NoticeQueue

TOLD = {
    Fallback.SHIFTED_PLAN: notices.FALLBACK_SHIFTED_PLAN,
    Fallback.STATION_KEEPING: notices.FALLBACK_HOLDING,
}


class FallbackWatch(NoticeQueue):
    """Reports when the thrusters are not commanded by the optimiser, and when they are again."""

    def __init__(self) -> None:
        super().__init__()
        self._reported: set[Fallback] = set()
        self._solved = 0

    def reset(self) -> None:
        """A new flight: the next fallback is news."""
        self._reported.clear()
        self._solved = 0

    def watch(self, fallback: Fallback) -> None:
        row = TOLD.get(fallback)
        if row is not None:
            self._solved = 0
            if fallback not in self._reported:
                self._reported.add(fallback)
                self._notices.append(row())
        elif fallback is Fallback.NONE and self._reported:
            self._solved += 1
            if self._solved >= FALLBACK.over_steps:
                self.reset()
                self._notices.append(notices.FALLBACK_OVER())


class FiniteWatch(NoticeQueue):
    """Counts steps and ticks without thrust because the estimate or its prediction is not finite."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0
        """Since the last one that was reported as over."""
        self._finite_steps = 0

    def watch(self, finite: bool) -> None:
        if not finite:
            self._finite_steps = 0
            self.count += 1
            if self.count == 1:
                self._notices.append(notices.CONTROL_NOT_FINITE())
        elif self.count:
            self._finite_steps += 1
            if self._finite_steps >= FALLBACK.over_steps:
                self._notices.append(notices.CONTROL_FINITE(count=self.count))
                self.count = 0


def station_keeping_thrust(
    allocator: ControlAllocator,
    x: FloatArray,
    target: FloatArray,
    current_ned_m_s: FloatArray,
    limit_n: FloatArray,
) -> FloatArray:
    """Thrust (n,) [N] within ``limit_n`` (n,) that holds position, depth and heading of ``target`` (8,) in a current.

    Position error -> velocity over ground -> velocity through the water -> drag feed-forward plus velocity feedback.
    """
    model = allocator.model
    dx, dy = float(target[X] - x[X]), float(target[Y] - x[Y])
    distance = math.hypot(dx, dy)
    speed = min(FALLBACK.position_gain_1_s * distance, FALLBACK.speed_limit_m_s)
    scale = speed / distance if distance > 1e-9 else 0.0
    north, east = scale * dx - current_ned_m_s[0], scale * dy - current_ned_m_s[1]
    shrink = min(1.0, FALLBACK.water_speed_limit_m_s / max(math.hypot(north, east), 1e-9))
    c, s = math.cos(x[YAW]), math.sin(x[YAW])
    climb = max(
        -FALLBACK.heave_limit_m_s, min(FALLBACK.heave_limit_m_s, FALLBACK.position_gain_1_s * float(target[Z] - x[Z]))
    )
    turn = FALLBACK.yaw_gain_1_s * wrap_pi(float(target[YAW] - x[YAW]))
    wanted = np.array(
        [
            shrink * (c * north + s * east),
            shrink * (c * east - s * north),
            climb - current_ned_m_s[2],
            max(-FALLBACK.yaw_rate_limit_rad_s, min(FALLBACK.yaw_rate_limit_rad_s, turn)),
        ]
    )
    nu = [float(v) for v in x[U : R + 1]]
    drift = model4.body_acceleration(model, [float(v) for v in wanted], (0.0,) * model.thrusters, math)
    force = np.array(
        [
            m * (FALLBACK.velocity_gain_1_s * (w - v) - a)
            for m, w, v, a in zip(model.mass_kg, wanted, nu, drift, strict=True)
        ]
    )
    return allocator.thrust_n(force, limit_n)
