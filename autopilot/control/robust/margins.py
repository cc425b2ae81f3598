"""Active constraint tightening: fixed, tube or Lipschitz (parameter MPC_TIGHTEN), and the refusals that follow from
it.
"""

import math
from dataclasses import replace
from enum import IntEnum

import numpy as np

from autopilot.control.nmpc.grid import TimeGrid, geometric_grid
from autopilot.control.path.reference import unknown_speed_m_s, water_speed_fraction
from autopilot.control.robust.ancillary import Ancillary
from autopilot.control.robust.lipschitz import LipschitzMargins
from autopilot.control.robust.robust_tuning import EVIDENCE, TUBE, WATER_SPEED, YAW_RATE
from autopilot.control.robust.tightening import BackOffs, FixedMargins
from autopilot.control.robust.tube import TubeMargins
from autopilot.control.robust.water_speed import WaterSpeed
from autopilot.core import operator_messages as notices
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.model4 import NX, Model4, forced_acceleration
from autopilot.core.notice_queue import NoticeQueue
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import Vehicle

STEP_LIMIT_S = 0.2
"""A step counts for no more than this."""

AT_REST = NavState(
    t_us=0,
    health=NavHealth.GOOD,
    pos_ned_m=np.zeros(3),
    rpy_rad=np.zeros(3),
    vel_frd_m_s=np.zeros(3),
    vel_water_frd_m_s=np.zeros(3),
    rate_frd_rad_s=np.zeros(3),
    current_ned_m_s=np.zeros(3),
    variance=np.zeros(12),
)
"""The best estimate of a vehicle at rest."""


class YawRateExcess:
    """How far the yaw rate runs ahead of its prediction. :meth:`push` with every thrust, :meth:`update` once per
    control step; deterministic.

    Errors of drag, thrust and mass, and thrusters that sit elsewhere than the vehicle file says, act as a moment that
    the prediction does not know. Of all motions yaw answers first: within one lag of the thrusters, before a new
    command acts, 0.2 N m turn the LBV150 faster by 0.1 rad/s. The residual of the yaw equation, r' - (N - D r + Munk
    moment) / m44, shows this moment however it comes about (disturbance observer: Chen et al. 2016). Times the delay of
    a command it is what the yaw rate gains before anything can be done about it: the back-off of the limit, in the
    direction of the turn. With a model that is right there is none."""

    def __init__(self, model: Model4, lag_s: float) -> None:
        """``lag_s``: mean lag of the thrusters."""
        self._model, self._row = model, np.array(model.allocation[3])
        self._lead_s = lag_s + YAW_RATE.step_s
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen."""
        self._last: tuple[int, int, list[float]] | None = None
        self._impulse_nms = self._pushed_s = 0.0
        self._unknown_rad_s2 = 0.0

    def push(self, acting_n: FloatArray, elapsed_s: float) -> None:
        """Thrust (n,) that acts ``elapsed_s`` after the last call."""
        self._impulse_nms += elapsed_s * self._row.dot(acting_n).item()
        self._pushed_s += elapsed_s

    def update(self, nav: NavState) -> None:
        """From the motion since the last call; ``nav`` in the level frame."""
        last, impulse_nms, pushed_s = self._last, self._impulse_nms, self._pushed_s
        u, v, _ = nav.vel_water_frd_m_s.tolist()
        motion = [u, v, 0.0, nav.rate_frd_rad_s.item(2)]
        if nav.health is NavHealth.INVALID or not math.isfinite(sum(motion) + impulse_nms):
            self.reset()
            return
        self._last, self._impulse_nms, self._pushed_s = (nav.t_us, nav.reset_count, motion), 0.0, 0.0
        elapsed_s = 0.0 if last is None else (nav.t_us - last[0]) * 1e-6
        if last is None or last[1] != nav.reset_count or not 0.0 < elapsed_s <= YAW_RATE.longest_s or not pushed_s:
            self._unknown_rad_s2 = 0.0
            return
        between = [0.5 * (before + now) for before, now in zip(last[2], motion, strict=True)]
        predicted = forced_acceleration(self._model, between, (0.0, 0.0, 0.0, impulse_nms / pushed_s), math)[3]
        residual = (motion[3] - last[2][3]) / elapsed_s - predicted
        self._unknown_rad_s2 += (1.0 - math.exp(-elapsed_s / YAW_RATE.follow_s)) * (residual - self._unknown_rad_s2)

    def back_off_rad_s(self, planned_rad_s: float) -> float:
        """Back-off of the limit for a plan that turns like this; 0 where the vehicle turns no faster than predicted."""
        return max(0.0, math.copysign(self._lead_s, planned_rad_s) * self._unknown_rad_s2)


class SpeedEvidence:
    """Adapts the margin of planar speed to the observed overshoot of its limit; updated once per control step.

    The margin is the sum of disturbance bounds and the covariance of the estimate. Mostly the vehicle keeps its speed
    far better, and in a current close to the speed limit the difference decides whether it advances at all. The margin
    is therefore reduced slowly while the vehicle moves at its limit without exceeding it, and restored quickly when it
    exceeds it. Half of the tube and MPC_SPEED_MARGIN are always kept, for errors that are not observable (a wrong
    current estimate)."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self._t_us: int | None = None
        self._reset_count = -1
        self._needed = 1.0
        self._slow_m_s = 0.0
        self.margin_fraction = 1.0
        """Of the margin that is kept."""

    def update(self, nav: NavState, limit_m_s: float, tube_m_s: float, least_m_s: float) -> None:
        """``tube_m_s``: full margin at the end of the prediction; ``least_m_s``: the part that is always kept."""
        speed = math.hypot(float(nav.vel_water_frd_m_s[0]), float(nav.vel_water_frd_m_s[1]))
        good = nav.health is NavHealth.GOOD and math.isfinite(speed) and nav.reset_count == self._reset_count
        if not good or self._t_us is None or tube_m_s <= 0.0 or limit_m_s <= tube_m_s:
            self.reset()
            self._t_us, self._reset_count, self._slow_m_s = nav.t_us, nav.reset_count, speed
            return
        elapsed_s = min(max((nav.t_us - self._t_us) * 1e-6, 0.0), EVIDENCE.longest_s)
        self._t_us = nav.t_us
        self._slow_m_s += (speed - self._slow_m_s) * elapsed_s / EVIDENCE.follow_s
        cap_m_s = limit_m_s - max(self.margin_fraction * tube_m_s, min(tube_m_s, least_m_s))
        seen, time_s = 1.0, EVIDENCE.forget_s
        if speed > EVIDENCE.near_fraction * cap_m_s:
            seen = (EVIDENCE.sigmas * max(abs(speed - self._slow_m_s), speed - cap_m_s) / tube_m_s) ** 2
            time_s = EVIDENCE.quick_s if seen > self._needed else EVIDENCE.slow_s
        self._needed += (min(seen, EVIDENCE.largest_need) - self._needed) * min(1.0, elapsed_s / time_s)
        self._move(math.hypot(*nav.current_ned_m_s[:2].tolist()) / limit_m_s, elapsed_s / tube_m_s)

    def _move(self, current_ratio: float, per_m_s2: float) -> None:
        """Move the margin towards the required one, as far as the current demands it."""
        needed = min(1.0, max(EVIDENCE.least_fraction, math.sqrt(self._needed)))
        demand = min(
            max(
                (current_ratio - EVIDENCE.strong_ratio) / (EVIDENCE.strongest_ratio - EVIDENCE.strong_ratio),
                0.0,
            ),
            1.0,
        )
        step = 1.0 - demand * (1.0 - needed) - self.margin_fraction
        self.margin_fraction += min(max(step, -EVIDENCE.shrink_m_s2 * per_m_s2), EVIDENCE.grow_m_s2 * per_m_s2)


class Tighten(IntEnum):
    """Values of MPC_TIGHTEN."""

    FIXED = 0
    TUBE = 1
    LIPSCHITZ = 2


class Margins(NoticeQueue):
    """Chooses among the three at every step."""

    def __init__(self, model: Model4, grid: TimeGrid, lag_s: float = 0.0) -> None:
        """``lag_s``: mean lag of the thrusters."""
        super().__init__()
        self.ancillary = Ancillary(model)
        fixed = FixedMargins(grid, model.thrusters)
        self.tube = TubeMargins(model, grid, self.ancillary, fixed)
        self.lipschitz = LipschitzMargins(model, grid, fixed)
        self.evidence = SpeedEvidence()
        """Reset by the controller at a restart."""
        self.water_speed = WaterSpeed(model)
        """The same."""
        self.yaw_rate = YawRateExcess(model, lag_s)
        """The same."""
        self.speed_margin_m_s: float | None = None
        """Back-off of the planar speed limit where drag and thrust have been told apart from the current; negative if
        the true speed is lower than the estimated one. None = the tube's."""
        self._margin_us: int | None = None
        self._fixed = fixed
        self._reported = False
        self._goal_margin: tuple[ParamSet, int, float] | None = None
        self._rest = np.zeros((grid.n + 1, NX))
        self._idle = np.zeros((grid.n, model.thrusters))

    def back_offs(self, nav: NavState, x: FloatArray, thrust_n: FloatArray, params: ParamSet) -> BackOffs:
        mode = Tighten(int(params["MPC_TIGHTEN"]))
        if mode is Tighten.TUBE:
            self._reported = False
            # The fixed margin stays: an error of the estimated speed through the water is not observable here.
            return self.tube.back_offs(nav, x, thrust_n, params, self.evidence.margin_fraction)
        if mode is Tighten.LIPSCHITZ:
            if not self._reported:
                self._reported = True
                self._notices.append(notices.LIPSCHITZ(text=self.lipschitz.report(nav, params).text))
            return self.lipschitz.back_offs(nav, x, thrust_n, params)
        self._reported = False
        return self._fixed.back_offs(nav, x, thrust_n, params)

    def update(self, nav: NavState, params: ParamSet) -> None:
        """Once per control step, before :meth:`back_offs`: update the evidence for the speed margins."""
        self.water_speed.update(nav)
        if Tighten(int(params["MPC_TIGHTEN"])) is Tighten.TUBE:
            self.yaw_rate.update(nav)
            tube_m_s = self.tube.rest_speed_m_s(nav, params)
            self.evidence.update(nav, params["SPD_PLANAR_MAX"], tube_m_s, unknown_speed_m_s(params))
            unknown_m_s = max(self.evidence.margin_fraction * tube_m_s, unknown_speed_m_s(params))
            self._move_speed_margin(nav.t_us, unknown_m_s, params["SPD_PLANAR_MAX"])
        else:
            self.evidence.reset()
            self.yaw_rate.reset()
            self.speed_margin_m_s = None

    def _move_speed_margin(self, t_us: int, unknown_m_s: float, limit_m_s: float) -> None:
        """Move the planar speed margin towards what is known of the true speed, or back to ``unknown_m_s``."""
        elapsed_s = 0.0 if self._margin_us is None else min(max((t_us - self._margin_us) * 1e-6, 0.0), STEP_LIMIT_S)
        self._margin_us, tuning = t_us, WATER_SPEED
        bound, likely = self.water_speed.bound, self.water_speed.likely
        target_m_s = unknown_m_s
        if bound is not None and likely is not None:
            left_m_s = limit_m_s - min(tuning.floor_m_s, limit_m_s)
            # Little knowledge is no reason to go slower than without any.
            target_m_s = min(limit_m_s - left_m_s / bound, max(unknown_m_s, limit_m_s - left_m_s / likely))
            target_m_s = min(target_m_s, TUBE.largest_fraction * limit_m_s)
        if self.speed_margin_m_s is None:
            if bound is None:
                return
            self.speed_margin_m_s = unknown_m_s
        change_m_s = target_m_s - self.speed_margin_m_s
        step_m_s = min(max(change_m_s, -tuning.shrink_m_s2 * elapsed_s), tuning.grow_m_s2 * elapsed_s)
        self.speed_margin_m_s += step_m_s
        if bound is None and step_m_s == change_m_s:
            self.speed_margin_m_s = None

    def restart(self) -> None:
        """Discard what has been learned, for a restart of the controller."""
        self.evidence.reset()
        self.water_speed.reset()
        self.yaw_rate.reset()
        self.speed_margin_m_s = self._margin_us = None

    def settled(self, nav: NavState, params: ParamSet) -> BackOffs:
        """Back-offs by the parameters alone, for a vehicle at rest with the best estimate: checks of positions must
        not depend on the present accuracy of the estimate.
        """
        return self.back_offs(replace(nav, variance=np.zeros_like(nav.variance)), self._rest, self._idle, params)

    def clearance_m(self, params: ParamSet) -> float:
        """The fixed margin plus the planner's: it must not change with the estimate, or routes would change all the
        time.
        """
        return params["MPC_MARGIN"]

    def planar_speed_m_s(self, nav: NavState, params: ParamSet) -> float:
        """Largest speed through the water for guidance: a fraction of the limit minus the back-off at the end of the
        prediction.
        """
        back_off = self.back_offs(nav, self._rest, self._idle, params).planar_speed_m_s
        cap_m_s = max(0.0, params["SPD_PLANAR_MAX"] - float(back_off[-1]))
        return cap_m_s * water_speed_fraction(math.hypot(*nav.current_ned_m_s[:2].tolist()), cap_m_s)

    def goal_margin_m(self, params: ParamSet) -> float:
        """Clearance beyond the body radius [m] that is kept where the vehicle stays, by the parameters alone."""
        seen = params, params.revision
        if self._goal_margin is None or self._goal_margin[:2] != seen:
            node = 0 if Tighten(int(params["MPC_TIGHTEN"])) is Tighten.LIPSCHITZ else -1
            self._goal_margin = *seen, float(self.settled(AT_REST, params).clearance_m[node])
        return self._goal_margin[2]

    def refusals(self, nav: NavState, fence_half_m: float, params: ParamSet) -> tuple[str, ...]:
        """Why the vehicle must not be armed: limits of which the margins leave nothing at node 1.

        ``fence_half_m``: largest clearance beyond the body radius anywhere (inf = open water).
        """
        # A vehicle that lies still cannot know the current yet, and the estimate gets better once it moves. That there
        # is a position at all is asked for elsewhere.
        margins = self.settled(nav, params)
        kind = Tighten(int(params["MPC_TIGHTEN"]))
        mode = kind.name.lower()
        # Tube margins settle and are cut at a share of the limit: one that has been cut is one that does not fit.
        node, fraction = (-1, TUBE.largest_fraction) if kind is Tighten.TUBE else (0, 1.0)
        reasons = [
            f"{name} limit {params[limit]:g} {unit} leaves too little beside the {mode} margin {margin[node]:.2f}: "
            f"smaller MPC_W_* or higher {limit}"
            for name, limit, unit, margin in (
                ("planar speed", "SPD_PLANAR_MAX", "m/s", margins.planar_speed_m_s),
                ("heave", "SPD_HEAVE_MAX", "m/s", margins.heave_m_s),
                ("yaw rate", "SPD_YAW_MAX", "rad/s", margins.yaw_rate_rad_s),
            )
            if float(margin[node]) >= fraction * params[limit]
        ]
        band, depth = params["DEPTH_MAX"] - params["DEPTH_MIN"], float(margins.depth_m[node])
        if band > 0.0 and fraction * band <= 2.0 * depth:
            reasons.append(f"depth band {band:.2f} m leaves too little beside the {mode} margin {depth:.2f} m")
        near = float(margins.clearance_m[0])
        if fence_half_m < near and math.isfinite(fence_half_m):
            reasons.append(f"the fence leaves nothing of the {mode} margin {near:.2f} m: widen it")
        if mode == "lipschitz":
            report = self.lipschitz.report(nav, params)
            if report.empty_node is not None and report.empty_node <= 1:
                reasons.append(f"{report.text}: set MPC_TIGHTEN 1 or smaller MPC_W_*")
        return tuple(reasons)


def goal_margin_m(vehicle: Vehicle, params: ParamSet) -> float:
    """:meth:`Margins.goal_margin_m` of the shipped controller, for checks without a flight."""
    return Margins(vehicle.to_model(), geometric_grid()).goal_margin_m(params)
