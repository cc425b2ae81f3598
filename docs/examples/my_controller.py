"""My own controller: along the planner's way at a set speed, by the model's forces."""

import numpy as np

from autopilot.control.path.planner import Planner
from autopilot.control.protocol import Controller, ControllerContext, simple_output
from autopilot.core.frames import wrap_pi


class Follower(Controller):
    """Follows a point that runs ahead of the vehicle on the free way to the goal."""

    def __init__(self, given: ControllerContext) -> None:
        self.model, self.radius_m = given.model, given.vehicle.radius_m
        self.thrust_of_force = np.linalg.pinv(np.array(given.model.allocation))  # (N, 4)
        self.reset()

    def reset(self) -> None:
        self.way, self.end, self.fence, self.integral = None, None, None, np.zeros(4)

    def step(self, t_us, nav, goal, fence, params, thruster_limit_n, tracks, *, delay_s):
        here, end = nav.pos_ned_m, goal.pos_ned_m
        if fence is not self.fence or (end != self.end).any():
            self.end, self.fence, self.integral = end, fence, np.zeros(4)
            self.way = Planner(fence, self.radius_m + 0.1).path(here[:2], end[:2])
        if self.way is None:  # no way: drift, and say that there was no answer
            return simple_output(t_us, nav, np.zeros(len(thruster_limit_n)), solved=False)
        ahead = point_ahead(self.way, here[:2], 0.4)
        wish = 0.6 * np.array([*(ahead - here[:2]), end[2] - here[2]])  # m/s over ground, world frame
        wish[:2] *= min(1.0, min(goal.speed_m_s, 0.25) / max(np.hypot(*wish[:2]), 1e-9))
        yaw = nav.rpy_rad[2]
        turn = 0.0 if goal.yaw_rad is None else np.clip(wrap_pi(goal.yaw_rad - yaw), -0.6, 0.6)
        c, s = np.cos(yaw), np.sin(yaw)
        through = wish - nav.current_ned_m_s  # what the water carries along need not be driven
        want = np.array([c * through[0] + s * through[1], c * through[1] - s * through[0], through[2], turn])
        error = want - np.array([*nav.vel_water_frd_m_s, nav.rate_frd_rad_s[2]])
        self.integral = np.clip(self.integral + 0.05 * 0.3 * error, -0.2, 0.2)
        drag = np.array(self.model.linear_drag) * want + np.array(self.model.quadratic_drag) * np.abs(want) * want
        force = drag + np.array(self.model.mass_kg) * (1.5 * error + self.integral)
        force[2] += self.model.buoyancy_excess_n
        thrust_n = np.clip(self.thrust_of_force @ force, -thruster_limit_n, thruster_limit_n)
        return simple_output(t_us, nav, thrust_n, route_ned_m=self.way)


def point_ahead(way, here, distance_m):
    """The point of a polyline (m, 2) that lies so far beyond the one nearest to ``here``."""
    begin, step = way[:-1], np.diff(way, axis=0)
    share = np.clip(((here - begin) * step).sum(1) / np.maximum((step * step).sum(1), 1e-12), 0.0, 1.0)
    k = int(np.hypot(*(begin + share[:, None] * step - here).T).argmin())
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*step.T))))
    at = min(along[k] + share[k] * np.hypot(*step[k]) + distance_m, along[-1])
    return np.array([np.interp(at, along, way[:, axis]) for axis in (0, 1)])
