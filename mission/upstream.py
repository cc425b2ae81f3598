"""Speed made good against a current on the legs of a mission, and detection of a vehicle that makes none."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import Goal, NavHealth, NavState
from autopilot.mission.items import GoTo, Step
from autopilot.mission.mission_tuning import UPSTREAM

CurrentAt = Callable[[FloatArray], FloatArray]
"""Places (n, 2) -> current (n, 2) [m/s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlowLeg:
    """The leg of a mission on which the least is left."""

    seq: int
    """The item that it leads to."""
    left_m_s: float
    """Least speed over ground on it; 0 or less = the current is faster, or sweeps the vehicle off it."""
    time_s: float
    """For the whole leg, inf if it cannot be made."""
    current_m_s: float
    """Fastest on it."""

    def out_of_reach(self, least_m_s: float) -> bool:
        """Whether the speed left is below ``least_m_s``."""
        return self.left_m_s < least_m_s

    def made(self, speed_m_s: float, left_m: float, *, anyway: bool = False) -> "SlowLeg":
        """The same from the speed observed with so much path left: margins and estimate only give a prediction.
        ``anyway``: also a lower speed, of a way that is not straight."""
        if speed_m_s <= max(self.left_m_s, 0.0) and not anyway:
            return self
        return replace(self, left_m_s=speed_m_s, time_s=left_m / speed_m_s)

    def text(self, least_m_s: float) -> str:
        if self.out_of_reach(least_m_s):
            return f"Item {self.seq} is out of reach: current {self.current_m_s:.2f} m/s"
        minutes = self.time_s / 60.0
        duration = f"{minutes:.0f} min" if minutes >= 1.5 else f"{self.time_s:.0f} s"
        return f"Item {self.seq} is upstream: {self.left_m_s:.3f} m/s left, {duration}"


def ground_speed_m_s(direction: FloatArray, current: FloatArray, speed_m_s: float) -> FloatArray:
    """(...) along unit vectors (..., 2) in currents (..., 2) for a vehicle with ``speed_m_s`` through the water; -inf
    where it cannot stay on the path.
    """
    along = np.einsum("...i,...i", current, direction)
    radicand = speed_m_s**2 - (np.einsum("...i,...i", current, current) - along**2)
    return np.where(radicand >= 0.0, along + np.sqrt(np.maximum(radicand, 0.0)), -np.inf)


def slowest_leg(
    steps: Sequence[Step], here: FloatArray | None, first_seq: int, speed_m_s: float, current_at: CurrentAt
) -> SlowLeg | None:
    """The leg with the least speed over ground: straight lines between waypoints from ``first_seq`` on, the first from
    ``here`` (2,). None without a leg.

    All legs at once: leg by leg, the start of a mission of 500 items would keep the control loop for three ticks.
    """
    goals = [
        (step.seq, step.pos_ned_m[:2])
        for step in steps
        if isinstance(step, GoTo) and step.pos_ned_m is not None and step.seq >= first_seq
    ]
    places = [(-1, here)] * (here is not None) + goals
    points = np.array([place for _, place in places]).reshape(-1, 2)
    ways = np.diff(points, axis=0)
    lengths = np.hypot(ways[:, 0], ways[:, 1])
    legs = np.flatnonzero(lengths > 0.0)
    if not legs.size:
        return None
    begins, ways, lengths = points[legs, None], ways[legs, None], lengths[legs, None]
    fractions = (np.arange(UPSTREAM.samples) + 0.5) / UPSTREAM.samples
    samples = begins + fractions[:, None] * ways
    current = current_at(samples.reshape(-1, 2)).reshape(samples.shape)
    left = ground_speed_m_s(ways / lengths[:, None], current, speed_m_s)
    slowest = int(left.min(axis=1).argmin())
    least = float(left[slowest].min())
    time_s = float((lengths[slowest] / UPSTREAM.samples / left[slowest]).sum()) if least > 0.0 else math.inf
    return SlowLeg(
        seq=places[legs[slowest] + 1][0],
        left_m_s=least,
        time_s=time_s,
        current_m_s=float(np.hypot(*current[slowest].T).max()),
    )


class MadeGood:
    """Progress of a vehicle towards a goal, by the path length left."""

    def __init__(self) -> None:
        self._goal: tuple[float, ...] | None = None
        self._best_m = self.left_m = math.inf
        self._us = self._last_us = 0
        self._anew = 0
        self._seen_s = self._made_m_s = 0.0

    @property
    def made_m_s(self) -> float:
        """Speed with which it has got nearer lately; 0 = not known yet, or none."""
        return max(self._made_m_s, 0.0) if self._seen_s >= UPSTREAM.made_s else 0.0

    def forget(self) -> None:
        """Reset: there is no goal to travel to, or it has been reached."""
        self._goal = None

    def idle_s(self, t_us: int, goal: Goal, nav: NavState, path_left_m: float | None, step_m: float) -> float:
        """Time since the path left last decreased by ``step_m`` below its minimum. ``path_left_m``: from the guidance
        (horizontal), None = straight line. Time without a good position does not count.
        """
        north, east, down = goal.pos_ned_m.tolist()
        here_n, here_e, here_d = nav.pos_ned_m.tolist()
        left_m = math.hypot(north - here_n, east - here_e) if path_left_m is None else path_left_m
        left_m += abs(down - here_d)
        key: tuple[float, ...] = (goal.seq, north, east, down)
        if goal.drive is not None:
            key = (goal.seq,)  # on a circle the place moves along
        self._update(t_us, left_m, same=key == self._goal and nav.health is NavHealth.GOOD)
        if key != self._goal:
            self._goal, self._anew = key, 0
            self._best_m, self._us = left_m, t_us
        elif nav.health is not NavHealth.GOOD:
            self._us += t_us - self._last_us
        elif left_m < self._best_m - step_m:
            self._best_m, self._us = left_m, t_us
        elif left_m > self.left_m + UPSTREAM.jump_m and self._anew < UPSTREAM.fresh_starts:
            self._anew += 1
            self._best_m, self._us = left_m, t_us
        self.left_m, self._last_us = left_m, t_us
        return (t_us - self._us) * 1e-6

    def _update(self, t_us: int, left_m: float, *, same: bool) -> None:
        """Update the speed; a path whose length jumps is another one."""
        elapsed_s, nearer_m = (t_us - self._last_us) * 1e-6, self.left_m - left_m
        if not same or abs(nearer_m) > UPSTREAM.jump_m:
            self._seen_s = self._made_m_s = 0.0
        elif elapsed_s > 0.0:
            self._seen_s += elapsed_s
            mean_over_s = max(min(self._seen_s, UPSTREAM.made_s), elapsed_s)
            self._made_m_s += (nearer_m - self._made_m_s * elapsed_s) / mean_over_s
