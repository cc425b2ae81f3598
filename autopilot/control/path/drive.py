"""Guidance for a commanded velocity: pilot, circle, velocity set points.

The velocity is tracked as far as the workspace is free: the reference path ends a braking distance before a boundary
ahead, and slides along one that it meets at an angle. The optimiser's constraints apply as in every other mode.
"""

import math

import numpy as np

from autopilot.control.nmpc.grid import TimeGrid
from autopilot.control.path.guidance import GuidanceInputs, Reference, Weights
from autopilot.control.path.path_tuning import DRIVE, REFERENCE
from autopilot.control.path.reference import ReferenceRollout, ReferenceTarget, Route, turn_target
from autopilot.core.control_allocator import ControlAllocator
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.core.messages import Severity, VelocityGoal
from autopilot.core.model4 import YAW, Z


class DriveGuidance:
    """See :class:`autopilot.control.path.guidance.Guidance`. It always has a reference: blocked motion is omitted."""

    unreachable = False

    def __init__(self, allocator: ControlAllocator, grid: TimeGrid) -> None:
        self._t_s = grid.t_s
        self._weights = Weights(allocator.model.thrusters)
        self._references = ReferenceRollout(allocator, grid.t_s)
        self.reset()

    def reset(self) -> None:
        self._fresh = True
        self._yaw_target: float | None = None
        self._path = np.zeros((1, 2))

    def take_notices(self) -> list[tuple[Severity, str]]:
        """None: the source of the velocity command has been notified."""
        return []

    def ahead(self, here: FloatArray) -> FloatArray:
        return np.concatenate([here[None], self._path[1:]])

    def reference(self, situation: GuidanceInputs) -> Reference:
        now, fresh, self._fresh = situation, self._fresh, False
        drive = now.goal.drive or VelocityGoal()
        target = self._target(now, drive)
        x, thrust = self._references(now.x0, target, now.nav.current_ned_m_s, now.thrust_limit_n)
        weights = self._weights.update(now.params)
        return Reference(
            x=x, thrust_n=thrust, weight_x=weights.x, weight_u=weights.u, terminal=weights.terminal, fresh=fresh
        )

    def _target(self, now: GuidanceInputs, drive: VelocityGoal) -> ReferenceTarget:
        """Target of the reference: far enough ahead that it does not brake before the horizon's end."""
        params, horizon_s = now.params, float(self._t_s[-1])
        route, cruise_m_s = self._route(now, drive, horizon_s)
        depth_m, heave_m_s = float(now.goal.pos_ned_m[2]), params["SPD_HEAVE_MAX"]
        if drive.down_m_s is not None:
            rate = min(abs(drive.down_m_s), REFERENCE.heave_fraction * heave_m_s)
            heave_m_s = max(rate, 1e-3) / REFERENCE.heave_fraction
            far_m = rate * horizon_s + rate * rate / REFERENCE.heave_deceleration_m_s2
            depth_m = float(now.x0[Z]) + math.copysign(far_m, drive.down_m_s)
        low_m = max(now.fence.depth_min_m, params["DEPTH_MIN"])
        high_m = max(low_m, min(now.fence.depth_max_m, params["DEPTH_MAX"]))
        yaw_rad, yaw_rate = self._heading(now, drive, horizon_s)
        return ReferenceTarget(
            route=route,
            s0_m=0.0,
            depth_m=min(max(depth_m, low_m), high_m),
            yaw_rad=yaw_rad,
            cruise_m_s=cruise_m_s,
            speed_limit_m_s=now.speed_cap_m_s,
            heave_limit_m_s=heave_m_s,
            yaw_rate_limit_rad_s=yaw_rate,
            climb_at_once=drive.down_m_s is not None,
        )

    def _heading(self, now: GuidanceInputs, drive: VelocityGoal, horizon_s: float) -> tuple[float, float]:
        """Heading of the reference's end, and the limit that makes it turn as fast as is asked."""
        here, most = float(now.x0[YAW]), now.params["SPD_YAW_MAX"]
        if drive.yaw_rate_rad_s is None:
            wanted = here if now.goal.yaw_rad is None else now.goal.yaw_rad
            if drive.yaw_trend_rad_s:
                return self._trend(here, wanted, drive.yaw_trend_rad_s, horizon_s, most)
            self._yaw_target = turn_target(here, wanted, self._yaw_target)
            return self._yaw_target, most
        self._yaw_target = None
        rate = min(abs(drive.yaw_rate_rad_s), DRIVE.turn_fraction * most)
        far = rate * horizon_s + rate * rate / REFERENCE.yaw_deceleration_rad_s2
        return here + math.copysign(far, drive.yaw_rate_rad_s), max(rate, 1e-3) / REFERENCE.yaw_rate_fraction

    def _trend(
        self, here: float, wanted: float, trend_rad_s: float, horizon_s: float, most: float
    ) -> tuple[float, float]:
        """Reference of a turning heading: a small error is corrected during the motion, a large one first."""
        self._yaw_target = None
        lack = wrap_pi(wanted - here)
        rate = trend_rad_s + lack / DRIVE.catch_up_s
        if abs(rate) < 1e-3:
            return here, most
        rate = math.copysign(min(abs(rate), DRIVE.turn_fraction * most), rate)
        return here + rate * horizon_s, abs(rate) / REFERENCE.yaw_rate_fraction

    def _route(self, now: GuidanceInputs, drive: VelocityGoal, horizon_s: float) -> tuple[Route, float]:
        """The free path ahead and the speed along it."""
        start, velocity = now.x0[:2].copy(), complex(drive.north_m_s, drive.east_m_s)
        speed = min(abs(velocity), now.speed_cap_m_s, now.goal.speed_m_s)
        if abs(velocity) < DRIVE.slowest_m_s:
            place = np.array(now.goal.pos_ned_m[:2], dtype=float)
            path, speed = (
                (np.stack([start, place]) if now.planner.sees(start, place) else start[None]),
                DRIVE.hold_speed_m_s,
            )
        else:
            path, fraction = self._free_path(now, velocity / abs(velocity), speed, drive.turn_rad_s, horizon_s)
            speed *= fraction
        if len(path) < 2 or float(np.abs(path[-1] - start).max()) < 1e-6:
            out = now.planner.features.push_out(start[None], now.radius_m)
            path = np.concatenate([start[None], start[None] + out])
        self._path = path
        return Route(path), speed

    def _free_path(
        self, now: GuidanceInputs, direction: complex, speed: float, turn_rad_s: float, horizon_s: float
    ) -> tuple[FloatArray, float]:
        """(m, 2) points from here on, and the share of the speed that boundaries leave."""
        length_m = speed * horizon_s + speed * speed / REFERENCE.deceleration_m_s2 + DRIVE.step_m
        count = min(max(math.ceil(length_m / DRIVE.step_m), 2), DRIVE.most_steps)
        step_m, here = length_m / count, complex(now.x0[0], now.x0[1])
        turn = turn_rad_s * step_m / max(speed, DRIVE.slowest_m_s)
        headings = direction * np.exp(1j * turn * (np.arange(count) + 0.5))
        path = np.concatenate(([here], here + step_m * np.cumsum(headings)))
        features, keep_m = now.planner.features, now.radius_m + DRIVE.keep_extra_m
        if features.count == 0:
            return path.view(float).reshape(-1, 2), 1.0
        clearance_m = features.clearance_up_to_m(path.view(float).reshape(-1, 2), 2.0 * keep_m)
        near = np.flatnonzero(clearance_m[1:] < keep_m)
        if not len(near):
            return path.view(float).reshape(-1, 2), 1.0
        points, fractions = path[: int(near[0]) + 1].tolist(), [1.0] * int(near[0])
        for heading in headings[int(near[0]) :].tolist():
            ended, fraction = self._slide(now, points[-1], heading, step_m, keep_m)
            if fraction < DRIVE.least_progress:
                break
            points.append(ended)
            fractions.append(fraction)
        considered = max(1, round(DRIVE.fraction_over_m / step_m))
        first = fractions[:considered] + [0.0] * max(0, considered - len(fractions))
        # A way that ends is braked on by itself; the share is of the part that slides.
        fraction = sum(first) / considered if len(fractions) >= considered else 1.0
        return np.array(points).view(float).reshape(-1, 2), max(fraction, DRIVE.least_progress)

    @staticmethod
    def _slide(
        now: GuidanceInputs, here: complex, heading: complex, step_m: float, keep_m: float
    ) -> tuple[complex, float]:
        """End of a step after projection out of obstacles, and the fraction of it that goes ahead."""
        features = now.planner.features
        wanted = step_m * heading
        place, along = here + wanted, wanted
        for _ in range(DRIVE.pushes):
            out_m = complex(*features.push_out(_point(place), keep_m)[0].tolist())
            if not out_m:
                break
            place += out_m
            away = out_m / abs(out_m)
            into = min((along * away.conjugate()).real, 0.0)
            along -= into * away
        clearance_m = features.clearance_up_to_m(np.concatenate([_point(here), _point(place)]), keep_m)
        if clearance_m[1] < keep_m - DRIVE.too_near_m and clearance_m[1] <= clearance_m[0]:
            return place, 0.0
        return place, min(max((along * heading.conjugate()).real / step_m, 0.0), 1.0)


def _point(place: complex) -> FloatArray:
    return np.array([[place.real, place.imag]])
