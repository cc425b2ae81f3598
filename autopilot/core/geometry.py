"""Fence shapes in local metres, for planner and controller."""

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

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


def lengths_m(points: FloatArray) -> FloatArray:
    """(n,) length along a polyline (n, 2) up to each of its points [m]."""
    return np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))


def points_at(points: FloatArray, along_m: FloatArray, at_m: FloatArray) -> FloatArray:
    """(m, 2) points of a polyline (n, 2) at lengths (m,) along it; ``along_m`` (n,): its :func:`lengths_m`."""
    return np.stack([np.interp(at_m, along_m, points[:, 0]), np.interp(at_m, along_m, points[:, 1])], axis=1)
