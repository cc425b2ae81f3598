"""Whether the vehicle stays within the tube that the controller predicts around its plan."""

import heapq
import math

from autopilot.core.messages import ControlOutput

AHEAD_S = (0.5, 1.0, 2.0, math.inf)
"""Bins of the prediction time: near nodes test the feedback, while the optimiser replans before the far ones are
due."""


class TubeCheck:
    """Compares the tube of every plan, node by node, with the position at the node's time. A new plan after a
    restart of the optimiser invalidates earlier ones.
    """

    def __init__(self) -> None:
        self._due: list[tuple[float, float, float, float, float]] = []
        """Heap of time [s], north, east, distance [m], how far ahead [s]."""
        self._before: tuple[float, float, float] | None = None
        """Time, north and east of the last call."""
        self._compared = dict.fromkeys(AHEAD_S, 0)
        self._inside = dict.fromkeys(AHEAD_S, 0)

    def fraction(self, ahead_s: float) -> float | None:
        """Share of the nodes at most ``ahead_s`` (of :data:`AHEAD_S`) ahead with the vehicle inside. None if no
        node has come due.
        """
        return self._inside[ahead_s] / self._compared[ahead_s] if self._compared[ahead_s] else None

    def announce(self, control: ControlOutput) -> None:
        """Add the prediction of a control step."""
        if control.restarted:
            self._due.clear()
        begin_s = control.status.t_us * 1e-6
        times, tube = control.nominal_t_s.tolist(), control.tube_m.tolist()
        for after_s, place, distance_m in zip(times, control.nominal[:, :2].tolist(), tube, strict=True):
            heapq.heappush(self._due, (begin_s + after_s, place[0], place[1], distance_m, after_s))

    def update(self, t_s: float, north_m: float, east_m: float) -> None:
        """Add the present position; nodes since the last call are compared with the linear interpolation."""
        before_s, from_n, from_e = self._before or (t_s, north_m, east_m)
        self._before = (t_s, north_m, east_m)
        while self._due and self._due[0][0] <= t_s:
            due_s, north, east, distance_m, after_s = heapq.heappop(self._due)
            if due_s < before_s:
                continue
            fraction = (due_s - before_s) / (t_s - before_s) if t_s > before_s else 1.0
            off_m = math.hypot(
                from_n + fraction * (north_m - from_n) - north, from_e + fraction * (east_m - from_e) - east
            )
            for ahead_s in AHEAD_S:
                if after_s <= ahead_s:
                    self._compared[ahead_s] += 1
                    self._inside[ahead_s] += off_m <= distance_m
