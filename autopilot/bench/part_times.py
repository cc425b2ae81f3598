"""CPU time of the stages of a mean tick."""

from collections.abc import Sequence

import numpy as np

from autopilot.core.marks import LoopPart


class PartTimes:
    def __init__(self) -> None:
        self._parts_s = np.zeros(len(LoopPart))
        self._ticks = 0

    def add(self, part_s: Sequence[float]) -> None:
        """The stage times of a tick [s]."""
        self._parts_s += part_s
        self._ticks += 1

    @property
    def mean_ms(self) -> dict[LoopPart, float]:
        """Mean per tick, the largest first; parts that take nothing left out."""
        mean_ms = 1e3 * self._parts_s / max(self._ticks, 1)
        parts = {part: float(mean_ms[part]) for part in LoopPart if mean_ms[part] > 0.0}
        return dict(sorted(parts.items(), key=lambda each: -each[1]))
