"""Random world from a seed: workspace, obstacles, current, vehicle, start and mission, as files for the service.

Worlds are not filtered for feasibility: openings may be too narrow, goals may lie in obstacles, currents may be too
strong. The service decides what to do; :mod:`autopilot.campaign.worlds.world_judge` decides whether that was right.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from autopilot.campaign.worlds.distance_map import DistanceMap
from autopilot.campaign.worlds.random_currents import draw_current
from autopilot.campaign.worlds.vehicles import VEHICLES, speed_held_m_s, vehicle_of, vehicle_tables
from autopilot.campaign.worlds.world_shapes import (
    Block,
    Corners,
    Disc,
    Point,
    Solid,
    WorldLayout,
    box,
    clearance_m,
    l_shape,
    solid_clearance_m,
    star,
    wall_pieces,
)
from autopilot.core.vehicle import Vehicle
from autopilot.sitl.current_fields import Current, current_field
from autopilot.sitl.scenario_tables import OriginSection
from autopilot.sitl.toml_text import toml_text

KINDS = ("tank", "pool", "harbour", "open")
_KIND_WEIGHTS = (0.35, 0.3, 0.2, 0.15)
MARGIN_M = 0.03
"""Default of MPC_MARGIN."""
START_CLEARANCE_M = 0.03
"""Clearance at the start beyond the vehicle's margin."""
FLIGHT_S = (15.0, 50.0)
"""Range of mission times: straight legs at cruise speed; detours, turns and delays are added."""
TRIES = 300
START_FRACTION = 0.75
"""Of what the vehicle swims: the water where it begins is slower."""


@dataclass(frozen=True, slots=True, eq=False)
class RandomWorld:
    seed: int
    kind: str
    layout: WorldLayout
    vehicle_number: int
    scenario: dict[str, Any]
    """Tables of the scenario file; mode, vehicle file and duration are set for each flight."""
    plan: dict[str, Any]
    """Tables of the plan in local metres."""

    @property
    def vehicle(self) -> Vehicle:
        return vehicle_of(vehicle_tables(self.vehicle_number))

    @property
    def start_m(self) -> Point:
        """North and east of the start."""
        north, east, _ = self.scenario["vehicle"]["start_m"]
        return (north, east)

    @property
    def waypoints(self) -> list[dict[str, Any]]:
        result: list[dict[str, Any]] = self.plan["waypoint"]
        return result

    @property
    def title(self) -> str:
        """One-line description."""
        shape = f"{self.kind}, {len(self.layout.solids)} solids"
        doors = "".join(f", door {width:.2f} m" for width in self.layout.doors_m)
        current = self.scenario["current"]["kind"]
        return f"{shape}{doors}, {current}, {len(self.waypoints)} waypoints, vehicle {self.vehicle_number}"


def make_world(seed: int) -> RandomWorld:
    rng = np.random.default_rng((seed, 10))
    kind = str(rng.choice(KINDS, p=_KIND_WEIGHTS))
    number = 0 if kind == "tank" and rng.random() < 0.4 else int(rng.integers(VEHICLES))
    vehicle = vehicle_of(vehicle_tables(number))
    params = _params(rng, vehicle, stock=number == 0 and rng.random() < 0.6)
    reach_m = rng.uniform(*FLIGHT_S) * params["SPD_CRUISE"]
    outline = _outline(rng, kind)
    layout = WorldLayout(outline, walls=kind != "open")
    keep = vehicle.radius_m + MARGIN_M
    start = _free_place(rng, layout, keep + 0.3 if outline is None else keep + START_CLEARANCE_M)
    layout = _furnished(rng, layout, start, keep, min(0.6 * reach_m, 25.0))
    low, high = _bounds(layout, start)
    size = (min(high[0] - low[0], 300.0), min(high[1] - low[1], 300.0))
    middle = (0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])) if kind in ("tank", "pool") else start
    current = _current(rng, kind, size, middle, start, params["SPD_PLANAR_MAX"])
    depth = _depths(rng, kind, vehicle)
    params |= {"DEPTH_MIN": depth[0], "DEPTH_MAX": depth[1]}
    waypoints = _waypoints(rng, layout, start, keep, reach_m, params)
    scenario = _scenario(rng, seed, kind, layout, vehicle, params, current, start, waypoints, depth)
    return RandomWorld(seed, kind, layout, number, scenario, _plan(rng, layout, waypoints))


def _params(rng: np.random.Generator, vehicle: Vehicle, *, stock: bool) -> dict[str, float]:
    """``[params]``: speed limits that the thrusters can hold, acceptance, whether narrow gaps are reported."""
    gaps = {"FENCE_GAP_CHK": float(rng.random() < 0.22)}
    limit = vehicle.drive.limit_n
    if stock:
        return {"SPD_PLANAR_MAX": 0.5, "SPD_CRUISE": 0.35, "SPD_HEAVE_MAX": 0.25, "SPD_YAW_MAX": 1.0, **gaps} | {
            "THR_LIMIT": limit,
            "WP_ACCEPT_RADIUS": 0.3,
        }
    ahead = speed_held_m_s(vehicle, 0, 2.0 * 0.85 * limit)
    down = speed_held_m_s(vehicle, 2, 0.7 * limit - abs(vehicle.model4.buoyancy_excess_n))
    planar = round(min(float(rng.uniform(0.35, 0.8)), 0.8 * ahead), 2)
    return {
        "SPD_PLANAR_MAX": planar,
        "SPD_CRUISE": round(planar * float(rng.uniform(0.5, 0.8)), 2),
        "SPD_HEAVE_MAX": round(min(float(rng.uniform(0.15, 0.35)), 0.7 * down), 2),
        "SPD_YAW_MAX": round(float(rng.uniform(0.6, 1.2)), 2),
        "THR_LIMIT": limit,
        "WP_ACCEPT_RADIUS": round(float(rng.uniform(0.2, 0.5)), 2),
        **gaps,
    }


def _outline(rng: np.random.Generator, kind: str) -> Corners | None:
    if kind == "tank":
        length, width = rng.uniform(3.0, 8.0), rng.uniform(2.6, 6.0)
        if rng.random() < 0.75:
            return box((0.0, 0.0), length, width, 0.0)
        return l_shape(length + 1.0, width + 1.0, (rng.uniform(0.2, 0.5), rng.uniform(0.2, 0.5)))
    if kind == "pool":
        length, width = rng.uniform(8.0, 30.0), rng.uniform(6.0, 18.0)
        sort = rng.random()
        if sort < 0.4:
            return box((0.0, 0.0), length, width, 0.0)
        if sort < 0.65:
            return l_shape(length, width, (rng.uniform(0.2, 0.6), rng.uniform(0.2, 0.6)))
        return star(rng, (0.0, 0.0), 0.5 * length, int(rng.integers(5, 10)), 0.4)
    if kind == "harbour":
        radius = 0.5 * float(np.exp(rng.uniform(math.log(30.0), math.log(300.0))))
        return star(rng, (0.0, 0.0), radius, int(rng.integers(7, 18)), rng.uniform(0.2, 0.6))
    if rng.random() < 0.5:
        return None
    # Open water with an area that the operator drew.
    return star(rng, (0.0, 0.0), rng.uniform(15.0, 60.0), int(rng.integers(4, 9)), 0.3)


def _bounds(layout: WorldLayout, start: Point) -> tuple[Point, Point]:
    corners = np.array(layout.outline_m if layout.outline_m is not None else [start])
    low, high = corners.min(axis=0), corners.max(axis=0)
    if layout.outline_m is None:
        low, high = low - 20.0, high + 20.0
    return (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))


def _free_place(rng: np.random.Generator, layout: WorldLayout, need_m: float) -> Point:
    """A point with that clearance, else the best one sampled."""
    low, high = _bounds(layout, (0.0, 0.0))
    best, most = (0.0, 0.0), -math.inf
    for _ in range(TRIES):
        place = (round(rng.uniform(low[0], high[0]), 2), round(rng.uniform(low[1], high[1]), 2))
        have = clearance_m(layout, place)
        if have >= need_m:
            return place
        if have > most:
            best, most = place, have
    return best


def _furnished(rng: np.random.Generator, layout: WorldLayout, start: Point, keep: float, reach_m: float) -> WorldLayout:
    """Inner walls and obstacles, none of them where the vehicle begins."""
    solids: list[Solid] = []
    widths: list[float] = []
    low, high = _bounds(layout, start)
    reach = min(reach_m, 0.5 * max(high[0] - low[0], high[1] - low[1]))

    def add(solid: Solid) -> bool:
        if solid_clearance_m(solid, start) < keep + START_CLEARANCE_M:
            return False
        solids.append(solid)
        return True

    for _ in range(int(rng.choice(3, p=[0.5, 0.38, 0.12]))):
        walls, doors = _wall(rng, layout, start, keep, reach)
        if all(solid_clearance_m(wall, start) >= keep + START_CLEARANCE_M for wall in walls):
            solids += walls
            widths += doors if walls else []
    area = (min(high[0] - low[0], 2.0 * reach)) * (min(high[1] - low[1], 2.0 * reach))
    most = min(12, int(area / 1.5))
    size = float(np.clip(reach / 6.0, 0.7, 3.0))
    for _ in range(int(rng.integers(0, most + 1)) if rng.random() < 0.85 else 0):
        for _ in range(10):
            place = (
                round(float(np.clip(start[0] + rng.uniform(-reach, reach), low[0], high[0])), 2),
                round(float(np.clip(start[1] + rng.uniform(-reach, reach), low[1], high[1])), 2),
            )
            if add(_obstacle(rng, place, size)):
                break
    return WorldLayout(layout.outline_m, tuple(solids), walls=layout.walls, doors_m=tuple(widths))


def _obstacle(rng: np.random.Generator, place: Point, size: float) -> Solid:
    sort = rng.random()
    if sort < 0.45:
        return Disc(place, round(float(rng.uniform(0.06, 0.4)) * size, 2))
    if sort < 0.7:
        sides = rng.uniform(0.15, 1.0, 2) * size
        return Block(box(place, float(sides[0]), float(sides[1]), rng.uniform(0.0, math.pi)))
    roughness = float(rng.choice([0.1, 0.6]))
    return Block(star(rng, place, float(rng.uniform(0.2, 0.7)) * size, int(rng.integers(3, 9)), roughness))


def _wall(
    rng: np.random.Generator, layout: WorldLayout, start: Point, keep: float, reach: float
) -> tuple[list[Solid], list[float]]:
    """An inner wall at some distance from the start, with no opening, one or two, from impassable to wide."""
    away = rng.uniform(-math.pi, math.pi)
    distance = rng.uniform(keep + 0.2, max(keep + 0.4, 0.7 * reach))
    foot = (start[0] + distance * math.cos(away), start[1] + distance * math.sin(away))
    if layout.outline_m is not None and clearance_m(WorldLayout(layout.outline_m), foot) < keep:
        return [], []
    count = int(rng.choice([0, 1, 2], p=[0.06, 0.7, 0.24]))
    tight = [2.0 * keep * rng.uniform(0.75, 1.15) for _ in range(count)]
    wide = [float(rng.uniform(0.9, 3.0)) for _ in range(count)]
    widths = [round(float(t if rng.random() < 0.55 else w), 2) for t, w in zip(tight, wide, strict=True)]
    doors = [(float(rng.uniform(0.1, 0.9)), width) for width in widths]
    direction = away + 0.5 * math.pi + rng.uniform(-0.6, 0.6)
    thickness = round(float(rng.uniform(0.1, 0.4)), 2)
    solids: list[Solid] = []
    for a, b in wall_pieces(layout.outline_m, foot, direction, rng.uniform(4.0, 16.0), doors):
        middle = (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]))
        solids.append(Block(box(middle, math.dist(a, b), thickness, direction)))
    return solids, widths


def _current(
    rng: np.random.Generator, kind: str, size: Point, middle: Point, start: Point, limit_m_s: float
) -> dict[str, Any]:
    """A current in which the vehicle can hold position at the start."""
    for _ in range(20):
        table = draw_current(rng, kind, size, middle, limit_m_s)
        there = current_field(current_table(table)).velocity((*start, 1.0), 0.0)
        if math.hypot(there[0], there[1]) <= START_FRACTION * limit_m_s or (kind == "open" and rng.random() < 0.3):
            return table
    return {"kind": "none"}


def current_table(table: dict[str, Any]) -> Current:
    """``[current]`` as the scenario reads it."""
    result: Current = msgspec.convert(table, Current)
    return result


def _depths(rng: np.random.Generator, kind: str, vehicle: Vehicle) -> tuple[float, float, float]:
    """Least and greatest depth of the vehicle, and of the floor."""
    floor = {"tank": (1.3, 2.5), "pool": (1.5, 5.0), "harbour": (3.0, 15.0), "open": (12.0, 60.0)}[kind]
    half = vehicle.hull_half_height_m
    depth = round(max(float(rng.uniform(*floor)), 2.0 * half + 0.9), 2)
    greatest = round(depth - half - rng.uniform(0.12, 0.4), 2)
    return round(rng.uniform(0.05, 0.2), 2), greatest, depth


def _waypoints(
    rng: np.random.Generator,
    layout: WorldLayout,
    start: Point,
    keep: float,
    reach_m: float,
    params: dict[str, float],
) -> list[dict[str, Any]]:
    """Two to six positions; most missions stay in reachable space, some are drawn without that check."""
    count = int(rng.choice([2, 3, 4, 5, 6], p=[0.3, 0.3, 0.2, 0.1, 0.1]))
    chart = DistanceMap(layout, [start])
    regions = chart.regions(keep + chart.pixel_m)
    home = chart.regions_near(regions, start, 0.3) if rng.random() < 0.6 else None
    careless = rng.random() < 0.1
    places: list[dict[str, Any]] = []
    here, depth = start, None
    for _ in range(count):
        near_wall = rng.random() < 0.2
        there = _next_place(rng, layout, here, reach_m / count, keep if not careless else -1.0, chart, regions, home)
        if near_wall and not careless:
            there = _towards_wall(rng, layout, there, keep)
        depth = _depth(rng, params, depth, math.dist(here, there))
        places.append(_dressed(rng, there, depth, params))
        here = there
    return places


def _next_place(
    rng: np.random.Generator,
    layout: WorldLayout,
    here: Point,
    leg_m: float,
    need_m: float,
    chart: DistanceMap,
    regions: Any,
    home: set[int] | None,
) -> Point:
    for attempt in range(TRIES):
        length = max(0.8, leg_m * rng.uniform(0.4, 1.5) * (1.0 - attempt / (TRIES + 50)))
        angle = rng.uniform(-math.pi, math.pi)
        there = (round(here[0] + length * math.cos(angle), 2), round(here[1] + length * math.sin(angle), 2))
        if clearance_m(layout, there) < need_m:
            continue
        if home is None or chart.regions_near(regions, there, 0.1) & home:
            return there
    return here


def _towards_wall(rng: np.random.Generator, layout: WorldLayout, place: Point, keep: float) -> Point:
    """Nearer to a boundary, as near as the vehicle keeps."""
    angle = rng.uniform(-math.pi, math.pi)
    for _ in range(40):
        further = (round(place[0] + 0.1 * math.cos(angle), 2), round(place[1] + 0.1 * math.sin(angle), 2))
        if clearance_m(layout, further) < keep + 0.01:
            return place
        if math.isinf(clearance_m(layout, further)):
            return place
        place = further
    return place


def _depth(rng: np.random.Generator, params: dict[str, float], before: float | None, leg_m: float) -> float:
    """A depth in the band that the leg leaves time for; once in a while one that is not in it."""
    low, high = params["DEPTH_MIN"] + 0.05, params["DEPTH_MAX"] - 0.05
    if before is None:
        return round(float(rng.uniform(low, min(high, low + 1.5))), 2)
    if rng.random() < 0.004:
        return round(high + float(rng.uniform(0.3, 2.0)), 2)
    most = 0.5 * params["SPD_HEAVE_MAX"] * leg_m / params["SPD_CRUISE"] + 0.1
    return round(float(np.clip(before + rng.uniform(-most, most), low, high)), 2)


def _dressed(rng: np.random.Generator, place: Point, depth_m: float, params: dict[str, float]) -> dict[str, Any]:
    """A waypoint with or without heading, delay, acceptance and speed of its own."""
    table: dict[str, Any] = {"x_m": place[0], "y_m": place[1], "depth_m": depth_m}
    if rng.random() < 0.35:
        table["yaw_rad"] = round(float(rng.uniform(-math.pi, math.pi)), 2)
    if rng.random() < 0.25:
        table["hold_s"] = round(float(rng.uniform(0.5, 5.0)), 1)
    if rng.random() < 0.25:
        table["accept_m"] = round(float(rng.uniform(0.15, 0.5)), 2)
    if rng.random() < 0.2:
        table["speed_m_s"] = round(params["SPD_PLANAR_MAX"] * float(rng.uniform(0.35, 0.9)), 2)
    elif rng.random() < 0.004:
        table["speed_m_s"] = round(params["SPD_PLANAR_MAX"] * 1.3, 2)
    return table


def _scenario(
    rng: np.random.Generator,
    seed: int,
    kind: str,
    layout: WorldLayout,
    vehicle: Vehicle,
    params: dict[str, float],
    current: dict[str, Any],
    start: Point,
    waypoints: list[dict[str, Any]],
    depth: tuple[float, float, float],
) -> dict[str, Any]:
    low, high = params["DEPTH_MIN"] + 0.1, params["DEPTH_MAX"] - 0.1
    # As near to the first waypoint's depth as a vehicle is let into the water.
    start_depth = round(float(np.clip(waypoints[0]["depth_m"] + rng.uniform(-0.5, 0.5), low, max(low, high))), 2)
    camera = kind == "tank" and depth[2] <= 2.0 and rng.random() < 0.08
    sensors: dict[str, Any] = {"position": "camera" if camera else "pose"}
    if rng.random() < 0.3:
        sensors["depth"] = {}
    if rng.random() < 0.2:
        sensors["dvl"] = {}
    source = str(rng.choice(["estimate", "map", "uniform"], p=[0.68, 0.18, 0.14]))
    tables: dict[str, Any] = {
        "scenario": {"name": f"room-{seed}", "description": f"room {seed}: {kind}", "seed": seed},
        "obstacle": [_solid_table(solid) for solid in layout.solids],
        "current": current,
        "vehicle": {
            "start_m": [*start, start_depth],
            "start_yaw_rad": round(float(rng.uniform(-math.pi, math.pi)), 2),
            "held": bool(rng.random() < 0.75),
            "mismatch": _mismatch(rng),
        },
        "sensors": sensors,
        "controller": {"currents": source},
        "params": dict(params),
        "accept": _accept(vehicle, params),
    }
    if layout.walls and layout.outline_m is not None:
        tables["tank"] = {"polygon_m": [list(corner) for corner in layout.outline_m], "depth_m": depth[2]}
    return tables


def _solid_table(solid: Solid) -> dict[str, Any]:
    if isinstance(solid, Disc):
        return {"kind": "cylinder", "center_m": list(solid.center_m), "radius_m": solid.radius_m}
    return {"kind": "prism", "polygon_m": [list(corner) for corner in solid.corners_m]}


def _mismatch(rng: np.random.Generator) -> dict[str, float]:
    """Deviation of the simulated vehicle from its file; a third have none."""
    if rng.random() < 0.33:
        return {}
    wide = {"surge_mass": 0.15, "sway_mass": 0.15, "drag": 0.2, "thrust": 0.08, "buoyancy": 0.005, "lag": 0.3}
    return {key: round(float(rng.uniform(1.0 - half, 1.0 + half)), 3) for key, half in wide.items()}


def _accept(vehicle: Vehicle, params: dict[str, float]) -> dict[str, float]:
    """``[accept]``, so that a log of it can be checked as any other."""
    return {
        "cylinder_clearance_m": round(0.16 + vehicle.radius_m, 3),
        "wall_clearance_m": vehicle.radius_m,
        "depth_min_m": 0.0,
        "depth_max_m": params["DEPTH_MAX"],
        "planar_speed_m_s": round(params["SPD_PLANAR_MAX"] + 0.02, 3),
        "heave_m_s": round(params["SPD_HEAVE_MAX"] + 0.01, 3),
        "yaw_rate_rad_s": round(params["SPD_YAW_MAX"] + 0.05, 3),
        "thrust_n": params["THR_LIMIT"],
    }


def _plan(rng: np.random.Generator, layout: WorldLayout, waypoints: list[dict[str, Any]]) -> dict[str, Any]:
    home = OriginSection()
    polygons = [] if layout.outline_m is None else [_polygon(layout.outline_m, inclusion=True)]
    polygons += [_polygon(solid.corners_m, inclusion=False) for solid in layout.solids if isinstance(solid, Block)]
    circles = [
        {"x_m": solid.center_m[0], "y_m": solid.center_m[1], "radius_m": solid.radius_m}
        for solid in layout.solids
        if isinstance(solid, Disc)
    ]
    end = str(rng.choice(["hold", "return", "surface"], p=[0.86, 0.08, 0.06]))
    return {
        "origin": {"lat_deg": home.lat_deg, "lon_deg": home.lon_deg, "alt_m": home.alt_m},
        "waypoint": waypoints,
        "end": {"action": end},
        "fence": {"polygon": polygons, "circle": circles},
    }


def _polygon(corners: Corners, *, inclusion: bool) -> dict[str, Any]:
    return {"points_m": [list(corner) for corner in corners], "inclusion": inclusion}


def files_of(world: RandomWorld, *, mode: int, duration_s: float) -> dict[str, bytes]:
    """Scenario, vehicle and plan as files of one folder, for a mode (MPC_COST)."""
    scenario = dict(world.scenario)
    scenario["scenario"] = {**scenario["scenario"], "plan": PLAN_FILE, "duration_s": round(duration_s, 1)}
    scenario["vehicle"] = {**scenario["vehicle"], "model": "lbv150" if not world.vehicle_number else VEHICLE_FILE}
    scenario["params"] = {**scenario["params"], "MPC_COST": mode}
    files = {SCENARIO_FILE: toml_text(scenario).encode(), PLAN_FILE: toml_text(world.plan).encode()}
    if world.vehicle_number:
        files[VEHICLE_FILE] = toml_text(vehicle_tables(world.vehicle_number)).encode()
    return files


SCENARIO_FILE, PLAN_FILE, VEHICLE_FILE = "scenario.toml", "plan.toml", "vehicle.toml"


def write_files(world: RandomWorld, folder: Path, *, mode: int, duration_s: float) -> None:
    """Write scenario, plan and vehicle of a world into an existing folder, for ``autopilot sitl``."""
    for name, data in files_of(world, mode=mode, duration_s=duration_s).items():
        (folder / name).write_bytes(data)
