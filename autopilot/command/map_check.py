"""Checks that a current map covers the area of the plan, and opens a map at the local origin."""

import itertools
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from autopilot.command.command_tuning import MAP_CHECK
from autopilot.control.current.current_map import CurrentMap
from autopilot.control.current.map_reading import load_current_map
from autopilot.core.errors import ConfigError, PlanError
from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import Origin, ned_from_geodetic
from autopilot.core.geometry import Fence, Polygon, Shape
from autopilot.core.origin_params import params_origin
from autopilot.core.params import ParamSet
from autopilot.core.plan import PlanKind
from autopilot.mission.clearance import Clearance
from autopilot.mission.items import GoTo, Step
from autopilot.mission.mission_tuning import UPSTREAM
from autopilot.mission.plan_files import read_plan
from autopilot.mission.store import Plans
from autopilot.mission.upstream import SlowLeg, slowest_leg


def open_map(path: Path, origin: Origin | None = None, start_utc: str | None = None) -> CurrentMap:
    """Read a map. ``origin``: reference of its coordinates (None = the parameters' defaults). ConfigError names the
    problem.
    """
    place = origin or params_origin(ParamSet())

    def to_local(lat_deg: float, lon_deg: float) -> tuple[float, float]:
        north, east, _ = ned_from_geodetic(place, lat_deg, lon_deg, place.alt_m).tolist()
        return north, east

    return load_current_map(path, to_local, None if start_utc is None else parse_utc(start_utc))


def parse_utc(text: str) -> datetime:
    """Time from text such as 2026-05-01T12:00, UTC by default. ConfigError for invalid text."""
    try:
        time = datetime.fromisoformat(text)
    except ValueError as error:
        raise ConfigError(f"currents_start {text!r} is not a time; write it like 2026-05-01T12:00") from error
    return time if time.tzinfo else time.replace(tzinfo=UTC)


class MapCheck:
    """Checks a map against workspaces, for :class:`autopilot.mission.store.Plans`."""

    def __init__(self, current_map: CurrentMap, origin: Origin) -> None:
        """``origin``: the local origin that the map was read with."""
        self._map = current_map
        self._origin = origin

    def problem(self, fence: Fence, steps: Sequence[Step], origin: Origin) -> str:
        """Why the map does not serve there, "" if it does."""
        current_map, name = self._map, self._map.name
        moved_deg = max(abs(origin.lat_deg - self._origin.lat_deg), abs(origin.lon_deg - self._origin.lon_deg))
        if current_map.nodes.geodetic and moved_deg > MAP_CHECK.same_origin_deg:
            return f"current map {name}: placed about another origin; set ORIGIN_LAT and ORIGIN_LON and start again"
        places = workspace_places(fence, steps)
        outside = np.flatnonzero(current_map.beyond(places))
        if len(outside):
            return f"current map {name}: does not cover {_at(places[outside[0]])}; use a larger map or a smaller fence"
        gaps = self._in_gaps(fence, places)
        if len(gaps):
            return f"current map {name}: fill values at {_at(gaps[0])} in the workspace; exclude it or fill the map"
        return ""

    def warning(self, fence: Fence, steps: Sequence[Step], limit_m_s: float) -> str:
        """Warning for a vehicle with this maximum speed, "" if none."""
        places = workspace_places(fence, steps)
        if not len(places):
            return ""
        fastest = _fastest_m_s(self._map, places, fence)
        name = self._map.name
        if fastest >= limit_m_s:
            return (
                f"Current map {name}: up to {fastest:.2f} m/s, the vehicle swims {limit_m_s:g}: goals may be out of "
                "reach"
            )
        leg = self._slowest_leg(steps, limit_m_s)
        return (
            "" if leg is None or leg.left_m_s >= UPSTREAM.reported_m_s else f"{leg.text(0.0)} (by current map {name})"
        )

    def _slowest_leg(self, steps: Sequence[Step], limit_m_s: float) -> SlowLeg | None:
        """By the map's mean over time, at the depth of the first waypoint."""
        current_map, depths = (
            self._map,
            [s.pos_ned_m[2] for s in steps if isinstance(s, GoTo) and s.pos_ned_m is not None],
        )

        def current_at(places: FloatArray) -> FloatArray:
            pos = np.column_stack([places, np.full(len(places), depths[0])])
            frames = [current_map.velocity(pos, np.full(len(pos), t)) for t in current_map.nodes.time_s]
            mean: FloatArray = np.mean(frames, axis=0)[:, :2]
            return mean

        return slowest_leg(steps, None, 0, limit_m_s, current_at)

    def _in_gaps(self, fence: Fence, places: FloatArray) -> FloatArray:
        """(n, 2) points of the workspace in cells with unknown corners."""
        unknown = self._map.unknown(fence.depth_min_m, fence.depth_max_m)
        if not unknown.any():
            return np.zeros((0, 2))
        found = places[unknown[self._map.cells(places)]]
        if len(found) or not fence.inclusions:
            return found
        # Cells that are finer than the lattice: their middles.
        i, j = np.nonzero(unknown)
        nodes = self._map.nodes
        middles = np.stack(
            (0.5 * (nodes.north_m[i] + nodes.north_m[i + 1]), 0.5 * (nodes.east_m[j] + nodes.east_m[j + 1])), axis=1
        )
        return middles[Clearance.of(fence).near(middles, MAP_CHECK.edge_m)[0] > 0.0]


def workspace_places(fence: Fence, steps: Sequence[Step]) -> FloatArray:
    """(n, 2) sample points of the workspace: a grid within the fence, or the legs of the mission in open water."""
    goals = [s.pos_ned_m[:2] for s in steps if isinstance(s, GoTo) and s.pos_ned_m is not None]
    legs = [np.linspace(a, b, MAP_CHECK.lattice) for a, b in itertools.pairwise(goals)]
    places = np.vstack([np.zeros((0, 2)), *(g[None] for g in goals), *legs])
    if not fence.inclusions:
        return places
    corners = np.vstack([_corners(shape) for shape in fence.inclusions])
    axes = [np.linspace(corners[:, k].min(), corners[:, k].max(), MAP_CHECK.lattice) for k in range(2)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    candidates = np.vstack((places, corners, lattice))
    return candidates[Clearance.of(fence).near(candidates, MAP_CHECK.edge_m)[0] >= -1e-9]


def describe_map(current_map: CurrentMap) -> list[tuple[str, object]]:
    """Rows of a table that describes a map."""
    nodes = current_map.nodes
    current = nodes.current_ned_m_s
    known = np.isfinite(current).all(axis=-1)
    speed = np.hypot(current[..., 0], current[..., 1])[known]

    def extent(axis: FloatArray, unit: str) -> str:
        return f"{axis[0]:g} to {axis[-1]:g} {unit}, {len(axis)} nodes"

    return [
        ("north", extent(nodes.north_m, "m")),
        ("east", extent(nodes.east_m, "m")),
        ("depth", extent(nodes.depth_m, "m")),
        ("time", extent(nodes.time_s, "s")),
        ("from latitude and longitude", nodes.geodetic),
        ("fastest, m/s", round(float(speed.max()), 4) if len(speed) else 0.0),
        ("rms speed, m/s", round(float(np.sqrt(np.mean(speed**2))), 4) if len(speed) else 0.0),
        ("nodes without a value, %", round(100.0 * float(1.0 - known.mean()), 2)),
        ("SHA-256", nodes.digest),
    ]


def _corners(shape: Shape) -> FloatArray:
    """(n, 2) points on the boundary of a shape."""
    if isinstance(shape, Polygon):
        return np.asarray(shape.vertices_ned_m, dtype=float)
    angle = np.linspace(0.0, 2.0 * np.pi, MAP_CHECK.circle_places, endpoint=False)
    return shape.center_ned_m + shape.radius_m * np.stack((np.cos(angle), np.sin(angle)), axis=1)


def plan_findings(current_map: CurrentMap, path: Path, origin: Origin | None) -> tuple[str, str]:
    """Problem and warning of a map with the plan in a file, "" for none. PlanError if the plan itself is wrong."""
    params = ParamSet()
    where = origin or params_origin(params)
    plans = Plans(params, 0.0, where)
    plan = read_plan(path)
    for kind, items in ((PlanKind.FENCE, plan.fence), (PlanKind.MISSION, plan.mission)):
        rejection = plans.replace(kind, items) if items else None
        if rejection is not None:
            raise PlanError(f"{path}: {kind.name.lower()}: {rejection.reason}")
    check = MapCheck(current_map, where)
    fence, steps = plans.fence(), plans.steps()
    return check.problem(fence, steps, where), check.warning(fence, steps, params["SPD_PLANAR_MAX"])


def _at(place: FloatArray) -> str:
    return f"north {place[0]:.1f}, east {place[1]:.1f} m"


def _fastest_m_s(current_map: CurrentMap, places: FloatArray, fence: Fence) -> float:
    """Largest horizontal speed over all frames and levels at points (n, 2)."""
    nodes, fastest = current_map.nodes, 0.0
    thinned = places[:: max(1, len(places) // 1000)]
    levels = [d for d in nodes.depth_m if fence.depth_min_m <= d <= fence.depth_max_m] or nodes.depth_m[:1]
    for time_s in nodes.time_s:
        for depth_m in levels:
            pos = np.column_stack((thinned, np.full(len(thinned), depth_m)))
            flow = current_map.velocity(pos, np.full(len(thinned), time_s))
            fastest = max(fastest, float(np.hypot(flow[:, 0], flow[:, 1]).max()))
    return fastest
