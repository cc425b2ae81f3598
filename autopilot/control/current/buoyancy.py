"""Estimator of the constant vertical disturbance: wrong buoyancy, payload, hanging tether.

No other part compensates it: a horizontal force is estimated as current, the vertical current is taken as zero, and
the optimiser, which starts every plan at the estimate, has no integral action. The vertical force beyond thrust, drag
and the vehicle file's buoyancy is estimated here and added to the model's buoyancy, for offset-free tracking
(Pannocchia and Rawlings 2003: constant disturbance model).

The estimate is a low-pass of the residual of the heave equation, m33 w' - (thrust - drag). Its gain is large at first
and small later, so that waves are not compensated. The vertical velocity comes from the navigation filter (depth
sensor, fixes, accelerometers), which does not use the buoyancy.
"""

import math

import numpy as np

from autopilot.control.current.current_tuning import BUOYANCY_ESTIMATOR
from autopilot.core import operator_messages as notices
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.model4 import ABS_SMOOTHING_M2_S2, Model4
from autopilot.core.notice_queue import NoticeQueue


class BuoyancyEstimator(NoticeQueue):
    """Excess buoyancy beyond the vehicle file. One instance per vehicle; called once per control step."""

    def __init__(self, model: Model4, half_height_m: float) -> None:
        super().__init__()
        self._mass_kg, self._file_n = model.mass_kg[2], model.buoyancy_excess_n
        self._drag = model.linear_drag[2], model.quadratic_drag[2]
        self._row = np.array(model.allocation[2])
        self._size = np.abs(self._row)
        self._submerged_m = BUOYANCY_ESTIMATOR.submerged * half_height_m
        self.reset()

    def reset(self) -> None:
        """Discard the estimate: the vehicle may have been trimmed."""
        self.lift_n = 0.0
        """[N] beyond the vehicle file, positive pushes up."""
        self._learned_s = self._beyond_s = self._push_n = 0.0
        self._reported = ""
        self.forget()

    def forget(self) -> None:
        """Discard the last sample: the next one does not continue it."""
        self._last: tuple[float, float, int] | None = None
        self._impulse_ns = self._elapsed_s = 0.0

    @property
    def excess_n(self) -> float:
        """Buoyancy minus weight [N] as it has proved to be."""
        return self._file_n + self.lift_n

    def push(self, acting_n: FloatArray, elapsed_s: float) -> None:
        """Thrust (n,) that acts ``elapsed_s`` after the last call."""
        before_n, self._push_n = self._push_n, self._row.dot(acting_n).item()
        self._impulse_ns += 0.5 * elapsed_s * (before_n + self._push_n)
        self._elapsed_s += elapsed_s

    def update(self, nav: NavState, low_m: float, high_m: float, limit_n: FloatArray) -> None:
        """Update from the response to the thrust since the last call. ``low_m``, ``high_m``: depth band [m];
        ``limit_n`` (n,): thrust limits [N].
        """
        seen = _down(nav.vel_frd_m_s, nav.rpy_rad), _down(nav.vel_water_frd_m_s, nav.rpy_rad), nav.reset_count
        last, impulse_ns, elapsed_s = self._last, self._impulse_ns, self._elapsed_s
        self._last, self._impulse_ns, self._elapsed_s = seen, 0.0, 0.0
        most_n = self._size.dot(limit_n).item()
        usable = nav.health is not NavHealth.INVALID and 0.0 < elapsed_s <= BUOYANCY_ESTIMATOR.longest_s
        if last is None or last[2] != nav.reset_count or not usable:
            return
        rate = 0.5 * (seen[1] + last[1])
        linear, square = self._drag
        drag_n = (linear + square * math.sqrt(rate * rate + ABS_SMOOTHING_M2_S2)) * rate
        # Residual of the heave equation, positive upwards.
        left_ns = impulse_ns - elapsed_s * (drag_n + self.excess_n) - self._mass_kg * (seen[0] - last[0])
        rate_1_s = max(1.0 / (self._learned_s + BUOYANCY_ESTIMATOR.first_s), 1.0 / BUOYANCY_ESTIMATOR.follow_s)
        change_n = rate_1_s * left_ns
        depth_m = float(nav.pos_ned_m[2])
        if not math.isfinite(change_n + depth_m):
            return
        # Beyond the band something may hold the vehicle: at the floor no lift is learned, at the surface no weight.
        held = change_n > 0.0 if depth_m >= high_m else change_n < 0.0 and depth_m <= max(low_m, self._submerged_m)
        if not held:
            self._learned_s += elapsed_s
            self.lift_n = min(max(self.lift_n + change_n, -most_n - self._file_n), most_n - self._file_n)
        self._tell(most_n, elapsed_s)

    def _tell(self, most_n: float, elapsed_s: float) -> None:
        """Once per flight, and again if it becomes too much."""
        too_much = abs(self.excess_n) > BUOYANCY_ESTIMATOR.most_fraction * most_n
        much = (
            self._learned_s > BUOYANCY_ESTIMATOR.reported_after_s
            and abs(self.lift_n) > BUOYANCY_ESTIMATOR.reported_fraction * most_n
        )
        self._beyond_s = self._beyond_s + elapsed_s if too_much or much else 0.0
        if self._beyond_s < BUOYANCY_ESTIMATOR.stands_s:
            return
        if too_much:
            found = notices.BUOYANCY_BEYOND_THRUST(trim="light" if self.excess_n > 0.0 else "heavy")
        else:
            direction = "Lighter" if self.lift_n > 0.0 else "Heavier"
            found = notices.BUOYANCY_OFF(way=direction, force_n=abs(self.lift_n))
        kind = found.text.split()[0]
        if kind not in (self._reported, "" if self._reported != "Too" else kind):
            self._reported = kind
            self._notices.append(found)


def _down(velocity_frd_m_s: FloatArray, rpy_rad: FloatArray) -> float:
    """NED down component of a velocity (3,) FRD at these Euler angles (3,)."""
    u, v, w = velocity_frd_m_s.tolist()
    roll, pitch, _ = rpy_rad.tolist()
    down: float = math.cos(pitch) * (math.sin(roll) * v + math.cos(roll) * w) - math.sin(pitch) * u
    return down
