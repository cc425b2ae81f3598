"""Motion of an obstacle: constant speed along a polyline, known for all times, deterministic."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, NamedTuple, TypeAlias

from autopilot.core.toml_table import Vec2

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
