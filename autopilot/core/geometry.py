"""Fence shapes in local metres, for planner and controller."""

from dataclasses import dataclass, field
from typing import TypeAlias

from autopilot.core.frames import FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Circle:
    """A vertical cylinder, given in plan view."""

    center_ned_m: FloatArray
    """(2,) north, east."""
    radius_m: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Polygon:
    """A vertical prism, given in plan view: simple (no self-intersection), not closed, any winding, convex or not."""

    vertices_ned_m: FloatArray
    """(n, 2) north, east; n >= 3."""


Shape: TypeAlias = Circle | Polygon


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Fence:
    """The workspace. The vehicle's *centre* keeps a body radius from every boundary; the shapes are not inflated."""

    inclusions: tuple[Shape, ...] = field(default=())
    """The vehicle stays inside every one of them (none = open water)."""
    exclusions: tuple[Shape, ...] = field(default=())
    """The vehicle stays outside all of them."""
    depth_min_m: float = 0.0
    depth_max_m: float = 1000.0
    """Depth band of the vehicle's centre."""
