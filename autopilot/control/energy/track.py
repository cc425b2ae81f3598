"""A planned trajectory as reference: projection of the vehicle on it, the part ahead, and the motion after its end."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from autopilot.control.energy.energy_tuning import TRACK
from autopilot.control.energy.trajectory import Trajectory
from autopilot.core import compiled
from autopilot.core.frames import FloatArray, unwrap_near
from autopilot.core.messages import Goal
from autopilot.core.model4 import NX, YAW, R, U, V, W, X, Z

_NONE = np.zeros(0, dtype=np.intp)


class TrackedTrajectory:
    """One trajectory towards one goal, followed by its clock."""

    def __init__(self, trajectory: Trajectory, goal: Goal, complete: bool) -> None:
        self.trajectory = trajectory
        self.goal = goal
        self.complete = complete
        """It ends in the goal's region."""
        self.clock_s = 0.0
        """Where on the trajectory the vehicle is."""
        dt = np.diff(trajectory.t_s)
        self._impulse = np.vstack(
            [np.zeros(trajectory.thrust_n.shape[1]), np.cumsum(trajectory.thrust_n * dt[:, None], axis=0)]
        )

        # States and impulse side by side: one search finds both.
        self._rows = np.hstack([trajectory.x, self._impulse])
        self._t_s = np.ascontiguousarray(trajectory.t_s, dtype=float)
        self._library, self._away_m = compiled.load(), np.zeros(1)
        rows = compiled.fitting("states and impulse", self._rows, len(self._t_s), NX + self._impulse.shape[1])
        self._table = (*self._rows.shape, compiled.fitting("t_s", self._t_s, len(self._rows)), rows)

    @property
    def length_s(self) -> float:
        return float(self.trajectory.t_s[-1])

    @property
    def rest_s(self) -> float:
        """Time to the end, negative when it has passed."""
        return float(self.trajectory.t_s[-1]) - self.clock_s

    def locate(self, x0: FloatArray, around_s: float) -> float:
        """Set the clock to the point nearest to the vehicle (8,) within WINDOW_S of ``around_s``; its distance [m]."""
        self.clock_s, away_m = self._nearest(x0, around_s)
        return away_m

    def advance(self, elapsed_s: float, x0: FloatArray) -> float:
        """Move the clock on to where the vehicle (8,) is; the distance [m] to that point."""
        low, high = self.clock_s + TRACK.slowest_rate * elapsed_s, self.clock_s + TRACK.fastest_rate * elapsed_s
        nearest_s, away_m = self._nearest(x0, self.clock_s)
        self.clock_s = min(max(nearest_s, low), high)
        return away_m

    def _nearest(self, x0: FloatArray, around_s: float) -> tuple[float, float]:
        """Time of the point nearest to a state, heading counted, and how far its place is [m]."""
        begin_s, end_s = max(0.0, around_s - TRACK.window_s), around_s + TRACK.window_s
        here, step_s = np.array(x0, dtype=float), (end_s - begin_s) / (TRACK.search_points - 1)
        window = compiled.fitting("x0", here, NX), begin_s, step_s, TRACK.search_points
        found_s: float = self._library.nearest_at(
            *self._table, *window, TRACK.yaw_lever_m, compiled.address(self._away_m)
        )
        return found_s, float(self._away_m[0])

    def _at(self, t_s: FloatArray) -> FloatArray:
        """States and thrust integrated from the beginning [N s] (m, 8 + n) on the trajectory, its ends held."""
        times, out = np.array(t_s, dtype=float), np.empty((len(t_s), self._rows.shape[1]))
        self._library.rows_at(*self._table, len(times), compiled.address(times), compiled.address(out))
        return out

    def sample(
        self, t_s: FloatArray, current_ned_m_s: FloatArray, then: "TrackedTrajectory | None" = None
    ) -> tuple[FloatArray, FloatArray]:
        """References (N+1, 8) and mean thrust (N, n) at times ``t_s`` (N+1,) from now.

        After the end ``then`` is followed, which begins where this one ends. Without it the reference comes to rest at
        the goal's centre; that of a vehicle that is at the end already goes over to this (:attr:`missing`). Thrust at
        rest is zero, to be filled in by the caller for the velocities of the reference.
        """
        at = self.clock_s + t_s
        end_s = float(self.trajectory.t_s[-1])
        both = self._at(at)
        x, impulse = both[:, :NX].copy(), both[:, NX:]
        late = np.flatnonzero(at > end_s) if at[-1] > end_s else _NONE
        onward = then is not None and self.missing < 1.0
        if len(late) and self.complete and not (onward and self.missing == 0.0):
            self._settle(x, at, late, current_ned_m_s)
        if len(late) and then is not None and onward:
            follows = then._at(at[late] - end_s)
            coming = follows[:, :NX]
            coming[:, YAW] += _turn_rad(self.trajectory, then.trajectory)
            x[late] = coming if self.missing == 0.0 else coming + self.missing * (x[late] - coming)
            impulse[late] += follows[:, NX:]
        return x, (impulse[1:] - impulse[:-1]) / (t_s[1:] - t_s[:-1])[:, None]

    @property
    def missing(self) -> float:
        """Fraction (0 to 1) by which the reference is moved from the trajectory's end to the goal.

        Gradually: the end is reached by the prediction to the time at which commands act, the region by the vehicle.
        """
        return min(max(-self.rest_s - TRACK.arriving_s, 0.0) / TRACK.missing_s, 1.0)

    def _settle(self, x: FloatArray, at: FloatArray, late: NDArray[np.intp], current_ned_m_s: FloatArray) -> None:
        """Fill the states after the end: exponentially to the goal's centre and heading."""
        end, goal = self.trajectory.x[-1], self.goal
        place = np.asarray(goal.pos_ned_m, dtype=float)
        yaw = float(end[YAW]) if goal.yaw_rad is None else unwrap_near(goal.yaw_rad, float(end[YAW]))
        fade = np.exp(-(at[late] - self.trajectory.t_s[-1]) / TRACK.settle_s)
        x[late, X : Z + 1] = place + fade[:, None] * (end[: Z + 1] - place)
        x[late, YAW] = yaw + fade * (end[YAW] - yaw)
        rate = -fade / TRACK.settle_s
        velocity = rate[:, None] * (end[: Z + 1] - place) - current_ned_m_s
        c, s = np.cos(x[late, YAW]), np.sin(x[late, YAW])
        x[late, U], x[late, V] = c * velocity[:, 0] + s * velocity[:, 1], c * velocity[:, 1] - s * velocity[:, 0]
        x[late, W], x[late, R] = velocity[:, 2], rate * (end[YAW] - yaw)

    def ahead(self) -> FloatArray:
        """(m, 2) remaining positions."""
        later = int(np.searchsorted(self.trajectory.t_s, self.clock_s, side="right"))
        return np.vstack([self.trajectory.x[later:, :2], np.asarray(self.goal.pos_ned_m[:2], dtype=float)[None]])


def joined(first: Trajectory, from_s: float, second: Trajectory) -> Trajectory:
    """The part of ``first`` after ``from_s``, followed by ``second``, which starts at its end."""
    end_s = float(first.t_s[-1])
    if from_s >= end_s:
        return second
    later = first.t_s > from_s
    here = np.array([np.interp(from_s, first.t_s, column) for column in first.x.T])
    onward = second.x[1:].copy()
    onward[:, YAW] += _turn_rad(first, second)
    return replace(
        second,
        t_s=np.concatenate([[0.0], first.t_s[later] - from_s, second.t_s[1:] + end_s - from_s]),
        x=np.vstack([here, first.x[later], onward]),
        thrust_n=np.vstack([first.thrust_n[later[1:]], second.thrust_n]),
    )


def _turn_rad(first: Trajectory, second: Trajectory) -> float:
    """Whole turns that bring the heading with which ``second`` begins to the one with which ``first`` ends."""
    begin = float(second.x[0, YAW])
    return unwrap_near(begin, float(first.x[-1, YAW])) - begin
