"""Judges a flight in a random world: refusals against reachability, goals and bounds on the ground truth."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np

from autopilot.campaign.worlds.random_world import RandomWorld
from autopilot.campaign.worlds.reachability import Leg, Prospect, item_seqs
from autopilot.campaign.worlds.world_results import WorldOutcome, WorldResult
from autopilot.campaign.worlds.world_shapes import clearance_m
from autopilot.core.frames import wrap_pi
from autopilot.log.smoothness import measure
from autopilot.sitl.plant import Truth

if TYPE_CHECKING:
    from autopilot.campaign.worlds.world_flight import WorldWatch

SEEN_M = 0.05
"""Tolerance beyond the acceptance radius: the estimate is not the truth."""
SEEN_RAD = 0.06
NEAR_M = 0.03
"""Corners of a fence are rounded on the wire."""
DEPTH_M = 0.05
CLEARANCE_M = 0.01
SPEED_M_S = 0.02
HEAVE_M_S = 0.015
YAW_RATE_RAD_S = 0.05
THRUST_N = 1e-6
MOST_REPORTED = 16
_WATER = re.compile(r"current|upstream|water|out of reach", re.IGNORECASE)
_GROUND = re.compile(r"no free (way|path)", re.IGNORECASE)
_HOPELESS = re.compile(r"out of reach|no free (way|path)", re.IGNORECASE)


def is_hopeless(text: str) -> bool:
    """Whether the text reports that current or geometry make the goal unreachable."""
    return bool(_HOPELESS.search(text))


def judge_refusal(world: RandomWorld, chances: Prospect, reason: str) -> WorldResult:
    """Whether the reason of a refusal before the flight is right."""
    right, why = _refusal(world, chances, reason)
    outcome = WorldOutcome.REFUSED if right else WorldOutcome.MISREFUSED
    return WorldResult(
        room=0,
        mode=0,
        seed=world.seed,
        outcome=outcome,
        what=_short(reason) if right else f"{_short(reason)} ({why})",
        goals=len(chances.legs),
    )


def _short(reason: str) -> str:
    """The reason without the file's name."""
    return re.sub(r"^.*?\.toml: (cannot be flown: )?", "", reason).split("; mend the plan")[0]


def _refusal(world: RandomWorld, chances: Prospect, reason: str) -> tuple[bool, str]:
    """Whether a refusal is right, and if not why not."""
    found = re.search(r"no free path from .* to item (\d+)", reason)
    if found:
        leg = _leg(chances, int(found[1]))
        return (leg is not None and not leg.ground), "there is a way on the chart"
    if "no room for the vehicle" in reason:
        return not any(leg.ground for leg in chances.legs), "there is room"
    found = re.search(r"item (\d+)\b.*\b(inside|outside|from)\b", reason)
    if found and "fence item" in reason:
        waypoint = _waypoint(world, int(found[1]))
        if waypoint is None:
            return False, "there is no such item"
        have = clearance_m(world.layout, (waypoint["x_m"], waypoint["y_m"]))
        return have < chances.keep_m + NEAR_M, f"it has {have:.2f} m"
    found = re.search(r"item (\d+)", reason)
    waypoint = None if found is None else _waypoint(world, int(found[1]), before=True)
    params = world.scenario["params"]
    if waypoint is not None and "DEPTH_M" in reason:
        inside = params["DEPTH_MIN"] <= waypoint["depth_m"] <= params["DEPTH_MAX"]
        return not inside, "its depth is in the band"
    if waypoint is not None and "SPD_PLANAR_MAX" in reason and "speed_m_s" in waypoint:
        return waypoint["speed_m_s"] > params["SPD_PLANAR_MAX"], "its speed is allowed"
    if _WATER.search(reason):
        legs = chances.legs if found is None else [leg for leg in chances.legs if leg.seq == int(found[1])]
        return any(not leg.sure for leg in legs), "the water leaves a quarter of the speed"
    return False, "the judge does not know this reason"


def _waypoint(world: RandomWorld, seq: int, *, before: bool = False) -> dict[str, float] | None:
    """The waypoint of a mission item; ``before``: its change of speed counts as it."""
    for number, waypoint in zip(item_seqs(world), world.waypoints, strict=True):
        if number == seq or (before and "speed_m_s" in waypoint and number == seq + 1):
            return waypoint
    return None


def _leg(chances: Prospect, seq: int) -> Leg | None:
    return next((leg for leg in chances.legs if leg.seq == seq), None)


def judge_flight(world: RandomWorld, chances: Prospect, mode: int, watch: WorldWatch, end: Truth) -> WorldResult:
    visited = _visits(world, watch)
    goals = len(world.waypoints)
    done = visited == goals and watch.completed
    swept = _swept(chances, watch)
    outcome, what = _outcome(world, chances, mode, watch, visited, done=done, swept=swept)
    track = watch.rows
    steps = np.diff(track[:, 1:3], axis=0)
    return WorldResult(
        room=0,
        mode=mode,
        seed=world.seed,
        outcome=outcome,
        what=what,
        goals=goals,
        visited=visited,
        bound_s=round(chances.bound_s(mode), 1),
        simulated_s=round(end.t_us * 1e-6, 2),
        length_m=round(float(np.sum(np.hypot(steps[:, 0], steps[:, 1]))), 2),
        energy_j=round(float(np.sum(watch.column("power_w")) * 0.01), 1),
        contacts=0 if swept else end.contact_count,
        failsafes=[] if swept else [f"{name} at {watch.first_failsafe_s:.1f} s" for name in watch.failsafe_names],
        alarms=[text for _, _, text in watch.reported if text.startswith("Thruster ")],
        fallbacks=watch.fallbacks,
        steps=watch.steps,
        broken={} if swept else _broken(world, watch),
        smoothness=measure(watch.commands(world.scenario["params"]["THR_LIMIT"])),
        first_fallback_s=watch.first_fallback_s,
        events=[f"{t_s:.1f} s {text}" for t_s, _, text in watch.reported][:MOST_REPORTED],
    )


def _visits(world: RandomWorld, watch: WorldWatch) -> int:
    """Number of waypoints that the plant reached in order."""
    rows, params = watch.rows, world.scenario["params"]
    at, visited = 0, 0
    for waypoint in world.waypoints:
        place = np.array((waypoint["x_m"], waypoint["y_m"], waypoint["depth_m"]))
        accept = waypoint.get("accept_m", params["WP_ACCEPT_RADIUS"]) + SEEN_M
        near = np.sqrt(np.sum((rows[at:, 1:4] - place) ** 2, axis=1)) <= accept
        if "yaw_rad" in waypoint:
            off = np.abs(np.angle(np.exp(1j * (rows[at:, 6] - waypoint["yaw_rad"]))))
            near &= off <= ACCEPT_YAW_RAD + SEEN_RAD
        if not near.any():
            break
        at += int(np.argmax(near))
        visited += 1
    return visited


ACCEPT_YAW_RAD = 0.15
"""Default of WP_ACCEPT_YAW."""


def _swept(chances: Prospect, watch: WorldWatch) -> bool:
    """The water was faster than the vehicle where it was."""
    current_m_s = np.hypot(watch.column("c_n"), watch.column("c_e"))
    return bool((current_m_s > 0.97 * chances.swims_m_s).any())


def _outcome(
    world: RandomWorld, chances: Prospect, mode: int, watch: WorldWatch, visited: int, *, done: bool, swept: bool
) -> tuple[WorldOutcome, str]:
    if done:
        return WorldOutcome.REACHED, ""
    stuck = chances.legs[min(visited, len(chances.legs) - 1)]
    ground = [text for _, _, text in watch.reported if _GROUND.search(text)]
    texts = [text for _, _, text in watch.reported if _WATER.search(text) or _GROUND.search(text)]
    texts = [text for text in texts if _names(text, stuck.seq)]
    about = f"item {stuck.seq} ({visited} of {len(world.waypoints)} visited, {_away(world, watch, visited)})"
    if ground and visited and not stuck.ground:
        return WorldOutcome.NOT_REACHED, f"accepted though there is no way, and told on it: {about}"
    if not stuck.must(mode) or swept:
        if texts:
            return WorldOutcome.TOLD, f"{texts[-1]} at {about}"
        if not stuck.possible or swept:
            return WorldOutcome.NOT_REACHED, f"cannot be reached and nothing was said: {about}"
        return WorldOutcome.NOT_REACHED, f"hardly to be reached and nothing was said: {about}"
    if watch.completed:
        return WorldOutcome.NOT_REACHED, f"says complete without having been there: {about}"
    last = f", said: {watch.reported[-1][2]}" if watch.reported else ""
    return WorldOutcome.NOT_REACHED, f"{about} in {chances.bound_s(mode):.0f} s{last}"


def _names(text: str, seq: int) -> bool:
    """Whether a text names the item, or no item by number."""
    found = re.search(r"\bitem (\d+)", text, re.IGNORECASE)
    return found is None or int(found[1]) == seq


def _away(world: RandomWorld, watch: WorldWatch, visited: int) -> str:
    row = watch.rows[-1]
    if visited >= len(world.waypoints):
        return "mission not complete"
    waypoint = world.waypoints[visited]
    distance = math.hypot(row[1] - waypoint["x_m"], row[2] - waypoint["y_m"])
    deep = row[3] - waypoint["depth_m"]
    turn = f", {abs(wrap_pi(row[6] - waypoint['yaw_rad'])):.2f} rad off" if "yaw_rad" in waypoint else ""
    return f"{distance:.2f} m away, {deep:+.2f} m deep{turn}"


def _broken(world: RandomWorld, watch: WorldWatch) -> dict[str, float]:
    """Bounds that were broken by more than their tolerance."""
    params, vehicle = world.scenario["params"], world.vehicle
    rows = watch.rows[watch.mission.holds(watch.column("t_s"))]
    flown = watch.track.between(watch.mission)
    found: dict[str, float] = {}

    def hold(name: str, beyond: float, tolerance: float) -> None:
        if not beyond <= tolerance:
            found[name] = round(beyond, 4)

    every = watch.rows[::5]
    least = min(clearance_m(world.layout, (float(row[1]), float(row[2]))) for row in every)
    hold("clearance", vehicle.radius_m - least, CLEARANCE_M)
    hold("planar speed", float(np.max(flown.planar_speed_m_s)) - params["SPD_PLANAR_MAX"], SPEED_M_S)
    hold("heave", float(np.max(np.abs(flown.vel_level_m_s[:, 2]))) - params["SPD_HEAVE_MAX"], HEAVE_M_S)
    hold("yaw rate", float(np.max(np.abs(rows[:, 15]))) - params["SPD_YAW_MAX"], YAW_RATE_RAD_S)
    hold("thrust", float(np.max(rows[:, 19])) - params["THR_LIMIT"], THRUST_N)
    hold("depth", float(np.max(rows[:, 3])) - params["DEPTH_MAX"], DEPTH_M)
    if world.plan["end"]["action"] != "surface":
        hold("depth above", params["DEPTH_MIN"] - float(np.min(rows[:, 3])), DEPTH_M)
    return found
