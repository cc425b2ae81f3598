"""Contact of the hull with walls, floor and obstacles: a penalty force, and the largest penetration.

The hull is a vertical cylinder about the centre of gravity (radius and half height in the vehicle file), which
encloses the real box at every heading: a reported contact may have been a miss by centimetres, a miss is certain.
Forces are normal and act at the centre of gravity: no friction, no moment. The surface is not solid: the hull loses
buoyancy as it emerges (:mod:`.sitl.rigid_body`), and the emerged height is recorded with the contacts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, NamedTuple, TypeAlias

from autopilot.core.shapes import is_inside
from autopilot.core.toml_table import Vec2, Vec3
from autopilot.sitl.sitl_tuning import CONTACT

Ends: TypeAlias = Literal["bounce", "loop", "stop"]


class MotionSample(NamedTuple):
    """Position and velocity at one time."""

    center_ned_m: Vec2
    velocity_ned_m_s: Vec2


class MovingPath:
    """Constant speed along a polyline."""

    def __init__(self, path_m: Sequence[Vec2], speed_m_s: float, ends: Ends, start_s: float = 0.0) -> None:
        """``path_m``: two points or more, consecutive ones different. At its end the motion reverses, continues to the
        first point (``loop``) or stops. Until ``start_s`` it is at rest at the first point.
        """
        points = [*path_m, path_m[0]] if ends == "loop" else list(path_m)
        self._legs: list[tuple[float, Vec2, Vec2]] = []
        length = 0.0
        for (ax, ay), (bx, by) in pairwise(points):
            leg = math.hypot(bx - ax, by - ay)
            self._legs.append((length, (ax, ay), ((bx - ax) / leg, (by - ay) / leg)))
            length += leg
        self._length_m, self._end = length, points[-1]
        self._ends, self._start_s = ends, start_s
        self.speed_m_s = speed_m_s

    def at(self, t_s: float) -> MotionSample:
        """Position and velocity at a time."""
        travelled, speed = self.speed_m_s * (t_s - self._start_s), self.speed_m_s
        if travelled < 0.0:
            return MotionSample(self._legs[0][1], (0.0, 0.0))
        if self._ends == "stop" and travelled >= self._length_m:
            return MotionSample(self._end, (0.0, 0.0))
        if self._ends == "loop":
            travelled %= self._length_m
        elif self._ends == "bounce":
            travelled %= 2.0 * self._length_m
            if travelled > self._length_m:
                travelled, speed = 2.0 * self._length_m - travelled, -speed
        begin, (ax, ay), (dx, dy) = next(leg for leg in reversed(self._legs) if leg[0] <= travelled)
        along = travelled - begin
        return MotionSample((ax + along * dx, ay + along * dy), (speed * dx, speed * dy))


@dataclass(frozen=True, slots=True, kw_only=True)
class Cylinder:
    """A vertical cylinder through the whole depth."""

    name: str
    center_ned_m: Vec2
    radius_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere:
    name: str
    center_ned_m: Vec3
    radius_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Prism:
    """A vertical prism through the whole depth."""

    name: str
    polygon_ned_m: tuple[Vec2, ...]
    """Corners, simple, not closed, any winding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MovingCylinder:
    """A vertical cylinder through the whole depth that moves, and that nothing stops."""

    name: str
    path: MovingPath
    radius_m: float


Solid: TypeAlias = Cylinder | Sphere | Prism | MovingCylinder


@dataclass(frozen=True, slots=True, kw_only=True)
class Touch:
    what: str
    """wall, floor or the obstacle's name."""
    depth_m: float
    normal_ned: Vec3
    """Unit vector out of the thing that is touched."""
    speed_m_s: float = 0.0
    """How fast the thing itself moves along the normal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactRecord:
    """One contact, from first touch to the last."""

    t_us: int
    what: str
    max_depth_m: float


def _feet(polygon: Sequence[Vec2], x: float, y: float) -> list[tuple[float, float]]:
    """Nearest point of every wall; a corner shared by two walls appears once."""
    feet = []
    ax, ay = polygon[-1]
    for bx, by in polygon:
        ex, ey = bx - ax, by - ay
        s = ((x - ax) * ex + (y - ay) * ey) / (ex * ex + ey * ey)
        if s > 0.0:
            s = min(s, 1.0)
            feet.append((ax + s * ex, ay + s * ey))
        ax, ay = bx, by
    return feet


class SolidGeometry:
    """Everything solid round a hull of given size."""

    def __init__(
        self,
        *,
        polygon_ned_m: Sequence[Vec2] | None,
        floor_m: float | None,
        solids: Sequence[Solid],
        hull_radius_m: float,
        hull_half_height_m: float,
    ) -> None:
        self._polygon = tuple(polygon_ned_m) if polygon_ned_m is not None else None
        self._floor_m = floor_m
        self._solids = tuple(solids)
        self._t_s = 0.0
        self.fastest_m_s = self._fastest()
        """Speed of the fastest thing that moves."""
        self._radius = hull_radius_m
        self._half_height = hull_half_height_m

    @property
    def solids(self) -> tuple[Cylinder | Sphere | Prism, ...]:
        """Everything solid but walls and floor, where it is now; in the order in which it was given."""
        return tuple(self._now(solid) for solid in self._solids)

    def put(self, number: int, north_m: float, east_m: float) -> None:
        """The solid of that number (from 1) stands there from now on, also if it moved."""
        solids = list(self._solids)
        solids[number - 1] = moved_to(self._now(solids[number - 1]), north_m, east_m)
        self._solids = tuple(solids)
        self.fastest_m_s = self._fastest()

    def _fastest(self) -> float:
        return max((s.path.speed_m_s for s in self._solids if isinstance(s, MovingCylinder)), default=0.0)

    def _now(self, solid: Solid) -> Cylinder | Sphere | Prism:
        if not isinstance(solid, MovingCylinder):
            return solid
        return Cylinder(name=solid.name, center_ned_m=solid.path.at(self._t_s).center_ned_m, radius_m=solid.radius_m)

    def move_to(self, t_s: float) -> None:
        """Everything that moves is where it is at that time."""
        self._t_s = t_s

    def touches(self, pos_ned_m: Sequence[float], margin_m: float = 0.0) -> list[Touch]:
        """Contacts of a hull at a position (3,), and solids closer than ``margin_m`` (depth < 0 then)."""
        x, y, z = pos_ned_m
        found = []
        if self._polygon is not None:
            for fx, fy in _feet(self._polygon, x, y):
                gap = math.hypot(x - fx, y - fy)
                if gap - self._radius < margin_m and gap > 0.0:
                    normal = ((x - fx) / gap, (y - fy) / gap, 0.0)
                    found.append(Touch(what="wall", depth_m=self._radius - gap, normal_ned=normal))
        if self._floor_m is not None and self._floor_m - z - self._half_height < margin_m:
            depth = z + self._half_height - self._floor_m
            found.append(Touch(what="floor", depth_m=depth, normal_ned=(0.0, 0.0, -1.0)))
        for solid in self._solids:
            if isinstance(solid, MovingCylinder):
                (cx, cy), (u, v) = solid.path.at(self._t_s)
                where: Cylinder | Sphere | Prism = Cylinder(
                    name=solid.name, center_ned_m=(cx, cy), radius_m=solid.radius_m
                )
            else:
                where, u, v = solid, 0.0, 0.0
            gap, normal = self._gap(where, x, y, z)
            if gap < margin_m:
                speed = normal[0] * u + normal[1] * v
                found.append(Touch(what=solid.name, depth_m=-gap, normal_ned=normal, speed_m_s=speed))
        return found

    def clearance_m(self, pos_ned_m: Sequence[float]) -> float:
        """Smallest distance of a hull at a position (3,) from anything solid, negative inside; inf if all is open."""
        gaps = [-touch.depth_m for touch in self.touches(pos_ned_m, math.inf)]
        return min(gaps, default=math.inf)

    def _gap(self, solid: Cylinder | Sphere | Prism, x: float, y: float, z: float) -> tuple[float, Vec3]:
        """Distance of the hull from a solid (negative inside) and the unit vector away from it."""
        if isinstance(solid, Prism):
            return self._prism_gap(solid, x, y)
        dx, dy = x - solid.center_ned_m[0], y - solid.center_ned_m[1]
        planar = math.hypot(dx, dy)
        out = (dx / planar, dy / planar) if planar > 0.0 else (1.0, 0.0)
        if isinstance(solid, Cylinder):
            return planar - solid.radius_m - self._radius, (out[0], out[1], 0.0)
        dz = z - solid.center_ned_m[2]
        beside, above = max(planar - self._radius, 0.0), max(abs(dz) - self._half_height, 0.0)
        distance = math.hypot(beside, above)
        if distance == 0.0:
            return -solid.radius_m, (out[0], out[1], 0.0)
        normal = (beside * out[0] / distance, beside * out[1] / distance, math.copysign(above, dz) / distance)
        return distance - solid.radius_m, normal

    def _prism_gap(self, solid: Prism, x: float, y: float) -> tuple[float, Vec3]:
        """Gap to a prism; from its inside the shortest way out."""
        fx, fy = min(_feet(solid.polygon_ned_m, x, y), key=lambda foot: math.hypot(x - foot[0], y - foot[1]))
        dx, dy = x - fx, y - fy
        distance = math.hypot(dx, dy)
        if is_inside(solid.polygon_ned_m, x, y):
            dx, dy, distance = -dx, -dy, -distance
        size = abs(distance)
        out = (dx / size, dy / size) if size > 0.0 else (1.0, 0.0)
        return distance - self._radius, (out[0], out[1], 0.0)

    def force_ned_n(self, pos_ned_m: Sequence[float], vel_ned_m_s: Sequence[float]) -> Vec3:
        """Penalty force (3,) on the hull [N]: stiffness and damping along each normal, never pulling."""
        fx = fy = fz = 0.0
        for touch in self.touches(pos_ned_m):
            nx, ny, nz = touch.normal_ned
            closing = touch.speed_m_s - (vel_ned_m_s[0] * nx + vel_ned_m_s[1] * ny + vel_ned_m_s[2] * nz)
            push = max(0.0, CONTACT.stiffness_n_m * touch.depth_m + CONTACT.damping_n_s_m * closing)
            fx, fy, fz = fx + push * nx, fy + push * ny, fz + push * nz
        return fx, fy, fz


def moved_to(solid: Cylinder | Sphere | Prism, north_m: float, east_m: float) -> Cylinder | Sphere | Prism:
    """A copy with its centre (of a prism: that of its corners) at another position."""
    if isinstance(solid, Cylinder):
        return replace(solid, center_ned_m=(north_m, east_m))
    if isinstance(solid, Sphere):
        return replace(solid, center_ned_m=(north_m, east_m, solid.center_ned_m[2]))
    count = len(solid.polygon_ned_m)
    away_n = north_m - sum(corner[0] for corner in solid.polygon_ned_m) / count
    away_e = east_m - sum(corner[1] for corner in solid.polygon_ned_m) / count
    return replace(solid, polygon_ned_m=tuple((n + away_n, e + away_e) for n, e in solid.polygon_ned_m))


class ContactLog:
    """Contacts of a run: one record per touch and thing touched, with the greatest depth."""

    def __init__(self) -> None:
        self.count = 0
        """Contacts so far."""
        self.depth_m = 0.0
        """Deepest penetration now, 0 = free."""
        self.max_depth_m = 0.0
        """Deepest penetration so far."""
        self._open: dict[str, ContactRecord] = {}
        self._closed: list[ContactRecord] = []

    @property
    def records(self) -> tuple[ContactRecord, ...]:
        """The first contacts of the run, in the order in which they ended; contacts that last come at the end."""
        return (*self._closed, *self._open.values())[: CONTACT.max_records]

    def update(self, t_us: int, touches: Sequence[Touch]) -> None:
        depths: dict[str, float] = {}
        for touch in touches:
            if touch.depth_m > 0.0:
                depths[touch.what] = max(depths.get(touch.what, 0.0), touch.depth_m)
        for what in [name for name in self._open if name not in depths]:
            ended = self._open.pop(what)
            if len(self._closed) < CONTACT.max_records:
                self._closed.append(ended)
        for what, depth in depths.items():
            before = self._open.get(what)
            if before is None:
                self.count += 1
                self._open[what] = ContactRecord(t_us=t_us, what=what, max_depth_m=depth)
            elif depth > before.max_depth_m:
                self._open[what] = ContactRecord(t_us=before.t_us, what=what, max_depth_m=depth)
        self.depth_m = max(depths.values(), default=0.0)
        self.max_depth_m = max(self.max_depth_m, self.depth_m)
