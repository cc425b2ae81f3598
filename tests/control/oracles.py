"""What functions of the compiled library mean, in numpy: slow, and NaN wherever an input is none."""

import math
from itertools import pairwise
from typing import Any

import numpy as np

from autopilot.control.bounds import SLOWEST_CAP_M_S
from autopilot.control.current.current_learning import FlowFit
from autopilot.control.current.currents import correction_fraction
from autopilot.control.energy.energy_tuning import TRACK
from autopilot.control.energy.trajectory import Trajectory
from autopilot.control.nmpc.grid import TimeGrid
from autopilot.control.path.path_tuning import REFERENCE
from autopilot.control.path.reference import ReferenceTarget, unknown_speed_m_s
from autopilot.control.robust.ancillary import Ancillary
from autopilot.control.robust.disturbance import DisturbanceBound, EstimateSpread, channel_variances
from autopilot.control.robust.inner import plan_error
from autopilot.control.robust.robust_tuning import TUBE
from autopilot.control.robust.tightening import BackOffs, FixedMargins
from autopilot.control.robust.tube import SPEED_SHARE, TubeMargins, TubeTable
from autopilot.core.frames import FloatArray, unwrap_near
from autopilot.core.messages import NavState
from autopilot.core.model4 import NX, YAW, U, Z
from autopilot.core.params import ParamSet


def bounds(
    radius_m: float, off: BackOffs, now: Any, wished: Any, plan_n: FloatArray, change: float
) -> dict[str, FloatArray]:
    """The arrays of ``ProgramBounds``."""
    params, fence, depth_m = now.params, now.fence, now.x0[Z]
    shallow, deep = max(fence.depth_min_m, params["DEPTH_MIN"]), min(fence.depth_max_m, params["DEPTH_MAX"])
    left = now.thrust_limit_n - np.minimum(off.thrust_n, TUBE.largest_thrust_fraction * now.thrust_limit_n)
    weight = wished.weight_u + change
    wanted = np.minimum(np.maximum(wished.thrust_n, -left), left)
    limits = (
        np.maximum(params["SPD_PLANAR_MAX"] - off.planar_speed_m_s, SLOWEST_CAP_M_S),
        np.maximum(params["SPD_HEAVE_MAX"] - off.heave_m_s, 0.0),
        np.maximum(params["SPD_YAW_MAX"] - off.yaw_rate_rad_s, 0.0),
        np.minimum(depth_m, shallow + off.depth_m),
        np.maximum(depth_m, deep - off.depth_m),
    )
    return {
        "limits": np.stack(limits, axis=1),
        "thrust_n": left,
        "keep_m": radius_m + off.clearance_m,
        "tube_m": np.concatenate([off.clearance_m[:1], off.clearance_m, off.clearance_m[-1:]]),
        "held_ref_n": (wished.weight_u * wanted + change * plan_n) / weight,
        "held_weight": weight,
    }


def least_clearance_m(path: FloatArray, normals: FloatArray, offsets: FloatArray) -> float:
    """How much room a path (m, 2) has beyond its half-planes."""
    return float((normals[..., 0] * path[:, :1] + normals[..., 1] * path[:, 1:] - offsets).min())


def _largest(rows: FloatArray) -> FloatArray:
    """Largest eigenvalue of symmetric 2 x 2 matrices, given as xx, xy, yy (m, 3)."""
    xx, xy, yy = rows.T
    result: FloatArray = 0.5 * (xx + yy) + np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    return result


def variances_along(table: TubeTable, surge_m_s: FloatArray, variances: FloatArray) -> FloatArray:
    """(nodes, STATES_OUT + thrusters) of a tube's table for planned surge (nodes,) and variances (GROUPS,)."""
    mixed = table.variance @ variances
    place = np.minimum(np.maximum((surge_m_s - table.first_m_s) / table.step_m_s, 0.0), len(mixed) - 1.0)
    low, nodes = np.minimum(np.nan_to_num(place).astype(np.intp), len(mixed) - 2), np.arange(len(place))
    result: FloatArray = mixed[low, nodes] + (place - low)[:, None] * (mixed[low + 1, nodes] - mixed[low, nodes])
    return result


def tube_back_offs(
    tube: TubeMargins, grid: TimeGrid, nav: NavState, x: FloatArray, params: ParamSet, speed_fraction: float
) -> BackOffs:
    """Of the variances in the tube's table, mixed and read off at the planned surge."""
    spread = EstimateSpread.of(nav)
    rows = variances_along(tube.table, x[:, U], np.array(channel_variances(DisturbanceBound.of(params), spread)))
    inner, least = rows[1:-1], FixedMargins(grid, rows.shape[1] - TUBE.states_out).values(params)
    band_m, most, speed = params["DEPTH_MAX"] - params["DEPTH_MIN"], TUBE.largest_fraction, SPEED_SHARE**2

    def kept(sigmas: float, variance: FloatArray, most: float, least: float) -> FloatArray:
        result: FloatArray = np.maximum(np.minimum(sigmas * np.sqrt(variance), most), least)
        return result

    sigmas = TUBE.band_sigmas
    planar_limit_m_s, heave_limit_m_s = most * params["SPD_PLANAR_MAX"], most * params["SPD_HEAVE_MAX"]
    planar_variance, heave_variance = speed * spread.planar_m2_s2, speed * spread.heave_m2_s2
    planar = kept(sigmas, _largest(inner[:, 5:8]) + planar_variance, planar_limit_m_s, least.planar_speed_m_s)
    disc = _largest(inner[:, :3]) + spread.position_m2
    return BackOffs(
        clearance_m=kept(TUBE.disc_sigmas, disc, TUBE.largest_clearance_m, least.clearance_m),
        depth_m=kept(sigmas, inner[:, 3] + spread.depth_m2, 0.5 * most * band_m, 0.0),
        planar_speed_m_s=np.maximum(speed_fraction * planar, np.minimum(planar, unknown_speed_m_s(params))),
        heave_m_s=kept(sigmas, inner[:, 8] + heave_variance, heave_limit_m_s, least.heave_m_s),
        yaw_rate_rad_s=kept(sigmas, inner[:, 9], most * params["SPD_YAW_MAX"], least.yaw_rate_rad_s),
        thrust_n=sigmas * np.sqrt(rows[:-1, TUBE.states_out :]),
    )


def inner_thrust(
    ancillary: Ancillary,
    grid: TimeGrid,
    plan: tuple[FloatArray, FloatArray, FloatArray],
    after_s: float,
    x: FloatArray,
    current: FloatArray,
    limit_n: FloatArray,
) -> FloatArray:
    """Of a plan (states, thrust, current): its thrust and the feedback of the error."""
    states, thrust_n, planned_current = plan
    time = min(max(after_s, 0.0), float(grid.t_s[-1]))
    k = max(int(np.searchsorted(grid.t_s, time)) - 1, 0)
    z = states[k] + (time - grid.t_s[k]) / grid.dt_s[k] * (states[k + 1] - states[k])
    gain = ancillary.gain(float((states[0] if k < 2 else z)[U]))
    thrust = thrust_n[k] + gain @ plan_error(x, z, current, planned_current)
    result: FloatArray = np.minimum(np.maximum(thrust, -limit_n), limit_n)
    return result


def rows_at(trajectory: Trajectory, t_s: FloatArray) -> FloatArray:
    """States and impulse of a trajectory (m, 8 + n)."""
    impulse = np.cumsum(trajectory.thrust_n * np.diff(trajectory.t_s)[:, None], axis=0)
    rows = np.hstack([trajectory.x, np.vstack([np.zeros(impulse.shape[1]), impulse])])
    return np.stack([np.interp(t_s, trajectory.t_s, column) for column in rows.T], axis=1)


def nearest_on_trajectory(trajectory: Trajectory, x0: FloatArray, around_s: float) -> tuple[float, float]:
    """Time of the point nearest to a state, heading counted, and how far its place is."""
    window = np.linspace(max(0.0, around_s - TRACK.window_s), around_s + TRACK.window_s, TRACK.search_points)
    places = rows_at(trajectory, window)
    turn = places[:, YAW] - unwrap_near(float(x0[YAW]), float(places[0, YAW]))
    gap = ((places[:, :2] - x0[:2]) ** 2).sum(axis=1)
    nearest = int((gap + (TRACK.yaw_lever_m * turn) ** 2).argmin())
    return float(window[nearest]), math.sqrt(float(gap[nearest]))


def flow(fit: FlowFit, places: FloatArray) -> FloatArray:
    """(m, 2) at places (m, 2): the curl of a streamfunction with a Gaussian kernel at every cell."""
    dx, dy = ((places[:, None, i] - fit.places_ned_m[None, :, i]) / fit.length_m for i in (0, 1))
    bell, (north, east) = np.exp(-0.5 * (dx * dx + dy * dy)), fit.pull
    by_north = (bell * (1.0 - dy * dy)) @ north + (bell * dx * dy) @ east
    by_east = (bell * (1.0 - dx * dx)) @ east + (bell * dx * dy) @ north
    return fit.mean_m_s + np.stack([by_north, by_east], axis=1)


def currents(
    fit: FlowFit, nav: NavState, places: FloatArray, t_s: FloatArray, scale_m: float, trust: float
) -> FloatArray:
    """(m, 3) the flow as far as it is trusted, corrected by what the estimate says it lacks here."""
    estimate = nav.current_ned_m_s
    lack = estimate[:2] - flow(fit, nav.pos_ned_m[None, :2])
    fraction = correction_fraction(nav, places, t_s, scale_m)[:, None]
    planar = estimate[:2] + trust * (flow(fit, places[:, :2]) - estimate[:2] + fraction * lack)
    return np.column_stack([planar, np.full(len(places), estimate[2])])


def nearest_on_route(points: FloatArray, p: FloatArray, hint: float, window_m: float) -> tuple[float, float]:
    """Arc length and distance of the nearest point of a route (m, 2) within a window."""
    best_s, best, s = 0.0, math.inf, 0.0
    for a, b in pairwise(points):
        length = math.dist(a, b)
        tangent = (b - a) / max(length, 1e-9)
        low, high = np.maximum(0.0, hint - window_m - s), np.minimum(length, hint + window_m - s)
        if low <= high:
            along = min(max(float((p - a) @ tangent), low), high)
            off = math.dist(p, a + along * tangent)
            best_s, best = (s + along, off) if off < best else (best_s, best)
        s += length
    return best_s, best


def ground_speed_m_s(cruise_m_s: float, tangent: FloatArray, current: FloatArray, limit_m_s: float) -> float:
    """Along a tangent (2,), as fast as is asked or the limit through the water allows."""
    along, rules = float(tangent @ current), REFERENCE
    span = rules.fast_current_fraction - rules.slow_current_fraction
    fast = np.clip((-along / np.maximum(limit_m_s, 1e-6) - rules.slow_current_fraction) / span, 0.0, 1.0)
    water = limit_m_s * (
        rules.water_speed_fraction + fast * (rules.upstream_speed_fraction - rules.water_speed_fraction)
    )
    radicand = along * along - float(current @ current) + water * water
    reachable = 0.0 if radicand <= 0.0 else along + np.sqrt(radicand)
    return float(np.maximum(np.minimum(cruise_m_s, reachable), rules.slowest_m_s))


def references(t_s: FloatArray, x0: FloatArray, target: ReferenceTarget, current: FloatArray) -> FloatArray:
    """(m, 8) states along a route."""
    points, rules = target.route.points, REFERENCE
    legs = np.abs(np.diff(points @ np.array([1.0, 1.0j])))
    s, tangents = np.append(0.0, np.cumsum(legs)), np.diff(points, axis=0) / np.maximum(legs, 1e-9)[:, None]

    def leg(at_m: FloatArray | float) -> Any:
        return np.minimum(s[1:].searchsorted(at_m, side="right"), len(legs) - 1)

    rest = np.maximum(s[-1] - target.s0_m, 0.0)
    ahead = tangents[leg(target.s0_m + np.minimum(rules.corner_ahead_m, 0.5 * rest))]
    speed = ground_speed_m_s(target.cruise_m_s, ahead, current[:2], target.speed_limit_m_s)
    dz, turn = float(target.depth_m - x0[Z]), float(target.yaw_rad - x0[YAW])
    climb = rules.heave_fraction * target.heave_limit_m_s
    if not target.climb_at_once:
        needed = abs(dz) / np.maximum(rest / speed, rules.min_depth_time_s)
        climb = np.minimum(np.maximum(needed, rules.slowest_m_s), climb)
    travel, rate = [], []
    for distance, wanted, deceleration in (
        (rest, speed, rules.deceleration_m_s2),
        (abs(dz), climb, rules.heave_deceleration_m_s2),
        (abs(turn), rules.yaw_rate_fraction * target.yaw_rate_limit_rad_s, rules.yaw_deceleration_rad_s2),
    ):
        start = np.minimum(wanted, math.sqrt(2.0 * deceleration * distance))
        until = (distance / start - 0.5 * start / deceleration if start != 0.0 else 0.0) - t_s
        now = np.minimum(np.maximum(until * deceleration + start, 0.0), start)
        travel.append(distance - now * now / (2.0 * deceleration) - np.maximum(until, 0.0) * start)
        rate.append(now)
    at_m, down, sense = target.s0_m + travel[0], math.copysign(1.0, dz), math.copysign(1.0, turn)
    yaw = x0[YAW] + sense * travel[2]
    north, east = (tangents[leg(at_m)] * rate[0][:, None] - current[:2]).T
    c, sine = np.cos(yaw), np.sin(yaw)
    place = [np.interp(at_m, s, points[:, i]) for i in (0, 1)]
    moves = [c * north + sine * east, c * east - sine * north, down * rate[1] - current[2], sense * rate[2]]
    states = np.stack([*place, x0[Z] + down * travel[1], yaw, *moves], axis=1)
    assert states.shape == (len(t_s), NX)
    return states
