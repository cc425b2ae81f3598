"""Reachable goals of a random world and lower bounds of their times, computed independently of the service.

Every goal is *sure* (must be reached: a path with slightly more clearance than the vehicle keeps, and a current
that leaves a quarter of its speed), *impossible* (no path at all, or a current faster than the vehicle), or in
between, where reaching it and reporting why not are both right.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from autopilot.campaign.worlds.distance_map import NO_PATH, DistanceMap, Flow, still
from autopilot.campaign.worlds.random_currents import flow_of
from autopilot.campaign.worlds.random_world import MARGIN_M, RandomWorld, current_table
from autopilot.campaign.worlds.vehicles import speed_held_m_s
from autopilot.campaign.worlds.world_shapes import Point

SURE_FRACTION = 0.75
"""Of what the vehicle swims; a goal that needs more of it may be declined."""
ROUNDING_M = 0.015
"""Fence and waypoints are rounded to 1e-7 degrees on the wire."""
BOUND_FACTOR = 1.6
"""Time allowed for a leg, relative to the time-optimal path at the requested speed."""
BOUND_ENERGY = 1.8
"""Additional factor when the vehicle chooses its speed."""
BOUND_PER_GOAL_S = 14.0
START_S = 15.0
LONGEST_LEG_S = 240.0
"""A leg that may take longer than this may be declined, and is not waited for."""
TELLING_S = 90.0
"""Time allowed for reporting an unreachable goal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """One goal of the mission and the path to it."""

    seq: int
    """Mission item."""
    sure: bool
    straight: bool
    """Sure along the shortest path too, which is the one of the quadratic mode."""
    possible: bool
    ground: bool
    """A path over ground surely exists, whatever the current."""
    no_ground: bool
    """There is surely no path over ground."""
    water_m_s: float
    """Fastest water at the goal."""
    length_m: float
    bound_s: float
    """For this leg alone, in the quadratic mode."""

    def must(self, mode: int) -> bool:
        """Whether it has to be reached in a mode (MPC_COST)."""
        return self.sure if mode else self.straight


@dataclass(frozen=True, slots=True, kw_only=True)
class Prospect:
    """Requirements on a vehicle in a world."""

    legs: tuple[Leg, ...]
    swims_m_s: float
    """Maximum speed through the water: its limit, or that of its thrusters."""
    keep_m: float

    def bound_s(self, mode: int) -> float:
        """Longest flight that is waited for."""
        factor = BOUND_ENERGY if mode else 1.0
        return START_S + factor * sum(leg.bound_s for leg in self.legs)

    def sure_after(self, seq: int, mode: int) -> bool:
        """Whether the goal after item ``seq`` has to be reached in that mode; False at the end."""
        return next((leg.must(mode) for leg in self.legs if leg.seq > seq), False)


def item_seqs(world: RandomWorld) -> list[int]:
    """Mission item of every waypoint: changes of speed are items of their own."""
    found, seq = [], 0
    for waypoint in world.waypoints:
        seq += "speed_m_s" in waypoint
        found.append(seq)
        seq += 1
    return found


def swims_m_s(world: RandomWorld) -> float:
    """Fastest through the water: the limit, or less with these thrusters and the drag that the plant has."""
    params, mismatch = world.scenario["params"], world.scenario["vehicle"]["mismatch"]
    force = 2.0 * params["THR_LIMIT"] * min(1.0, mismatch.get("thrust", 1.0)) / max(1.0, mismatch.get("drag", 1.0))
    return min(float(params["SPD_PLANAR_MAX"]), speed_held_m_s(world.vehicle, 0, 0.85 * force))


def prospect(world: RandomWorld) -> Prospect:
    """Prospects of all goals in mission order, including the return path if the mission ends with it."""
    keep, swims = world.vehicle.radius_m + MARGIN_M, swims_m_s(world)
    flow = flow_of(current_table(world.scenario["current"]))
    places = [(float(w["x_m"]), float(w["y_m"])) for w in world.waypoints]
    chart = DistanceMap(world.layout, [world.start_m, *places])
    judge = _Judge(world, chart, flow, keep, swims)
    legs, here, speed = [], world.start_m, float(world.scenario["params"]["SPD_CRUISE"])
    depth = float(world.scenario["vehicle"]["start_m"][2])
    for seq, waypoint, place in zip(item_seqs(world), world.waypoints, places, strict=True):
        speed = float(waypoint.get("speed_m_s", speed))
        extra = float(waypoint.get("hold_s", 0.0)) + (TURN_S if "yaw_rad" in waypoint else 0.0)
        extra += abs(waypoint["depth_m"] - depth) / (0.5 * world.scenario["params"]["SPD_HEAVE_MAX"])
        accept = float(waypoint.get("accept_m", world.scenario["params"]["WP_ACCEPT_RADIUS"]))
        legs.append(judge.leg(seq, here, place, accept, min(speed, swims), extra, yaw=waypoint.get("yaw_rad")))
        here, depth = place, waypoint["depth_m"]
    after = legs[-1].seq + 1
    if world.plan["end"]["action"] == "return":
        accept = float(world.scenario["params"]["WP_ACCEPT_RADIUS"])
        legs.append(judge.leg(after, here, world.start_m, accept, min(speed, swims), 0.0, yaw=None))
    elif world.plan["end"]["action"] == "surface":
        legs.append(judge.up(after, legs[-1], depth))
    return Prospect(legs=tuple(legs), swims_m_s=swims, keep_m=keep)


TURN_S = 8.0
"""For a heading of its own."""


class _Judge:
    def __init__(self, world: RandomWorld, chart: DistanceMap, flow: Flow, keep: float, swims: float) -> None:
        self._world, self._chart, self._flow, self._swims, self._keep = world, chart, flow, swims, keep
        slack = 1.5 * chart.pixel_m + ROUNDING_M
        places = [world.start_m, *((float(w["x_m"]), float(w["y_m"])) for w in world.waypoints)]
        self._strict, self._loose = chart.paths(keep + slack, places), chart.paths(keep - slack, places)
        self._regions = chart.regions(keep + slack), chart.regions(keep - slack)

    def leg(
        self, seq: int, here: Point, there: Point, accept_m: float, speed: float, extra_s: float, *, yaw: float | None
    ) -> Leg:
        """Prospect of the leg from one position to the next."""
        near = max(0.9 * accept_m, 0.1)
        strict, loose = (
            bool(self._chart.regions_near(regions, here, 0.35) & self._chart.regions_near(regions, there, reach))
            for regions, reach in zip(self._regions, (near, accept_m + 0.3), strict=True)
        )
        current_m_s = self._current_m_s(there)
        sure_m_s = SURE_FRACTION * self._swims
        path = NO_PATH
        if strict:
            speeds = {"water_m_s": sure_m_s, "ground_m_s": speed}
            path = self._strict.quickest(here, there, near, self._flow, **speeds, worst=True)
        holdable = current_m_s <= sure_m_s and (yaw is None or self._holds(there, yaw))
        possible = loose and (math.isfinite(path.time_s) or self._perhaps(here, there, accept_m + 0.3))
        straight = self._strict.shortest(here, there, near, self._flow, water_m_s=sure_m_s, ground_m_s=speed)
        bound = BOUND_FACTOR * path.time_s + BOUND_PER_GOAL_S + extra_s
        sure = strict and holdable and bound < LONGEST_LEG_S
        if not sure:
            bound = TELLING_S + min(math.dist(here, there) / max(0.5 * speed, 0.05), LONGEST_LEG_S)
        return Leg(
            seq=seq,
            sure=sure,
            straight=sure and BOUND_FACTOR * straight.time_s + BOUND_PER_GOAL_S + extra_s < LONGEST_LEG_S,
            possible=possible,
            ground=strict,
            no_ground=not loose,
            water_m_s=current_m_s,
            length_m=path.length_m,
            bound_s=bound,
        )

    def _perhaps(self, here: Point, there: Point, reach: float) -> bool:
        """Whether the vehicle could get there in the most favourable current; a path beyond the search area counts
        too.
        """

        def found(swims: float, flow: Flow) -> bool:
            path = self._loose.quickest(here, there, reach, flow, water_m_s=swims, ground_m_s=swims, worst=False)
            return math.isfinite(path.time_s)

        return found(1.02 * self._swims, self._flow) or not found(self._swims, still)

    def up(self, seq: int, before: Leg, depth_m: float) -> Leg:
        """The ascent at the end: as sure as the goal before it."""
        bound = 20.0 + depth_m / (0.4 * self._world.scenario["params"]["SPD_HEAVE_MAX"])
        return replace(before, seq=seq, length_m=0.0, bound_s=bound)

    def _current_m_s(self, place: Point) -> float:
        flow = self._flow(np.array([place]))[:, 0]
        return float(np.hypot(flow[:, 0], flow[:, 1]).max())

    def _holds(self, place: Point, yaw: float) -> bool:
        """Whether the thrusters can hold that position and heading with a margin."""
        model, params = self._world.vehicle.model4, self._world.scenario["params"]
        for north, east in self._flow(np.array([place]))[:, 0]:
            ahead = north * math.cos(yaw) + east * math.sin(yaw)
            aside = east * math.cos(yaw) - north * math.sin(yaw)
            for axis, speed, thrusters in ((0, ahead, 2.0), (1, aside, 1.0)):
                drag = model.linear_drag[axis] * abs(speed) + model.quadratic_drag[axis] * speed**2
                if drag > 0.6 * thrusters * params["THR_LIMIT"]:
                    return False
        return True
