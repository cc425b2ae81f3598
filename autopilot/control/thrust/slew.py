"""Rate limit of thrust."""

from collections import deque

import numpy as np

from autopilot.control.thrust.thrust_tuning import BY_HAND
from autopilot.core.frames import FloatArray


def slewed(wanted_n: FloatArray, last_n: FloatArray, limit_n: FloatArray, elapsed_s: float) -> FloatArray:
    """Thrust (n,) within ``limit_n`` (n,), no farther from ``last_n`` (n,) than it may change in ``elapsed_s``."""
    fraction = BY_HAND.slew_fraction_1_s * max(elapsed_s, 0.0)
    each = zip(wanted_n.tolist(), last_n.tolist(), limit_n.tolist(), strict=True)
    slow = [(min(max(wanted, last - fraction * limit), last + fraction * limit), limit) for wanted, last, limit in each]
    return np.array([min(max(thrust, -limit), limit) for thrust, limit in slow])


class SlewWindow:
    """Bounds the change of thrust over any window of a control step's length: the inner loop's commands between two
    steps and the next step's add up otherwise.
    """

    def __init__(self, window_s: float) -> None:
        self._window_us, self._fraction = round(window_s * 1e6), BY_HAND.slew_fraction_1_s * window_s
        self._recent: deque[tuple[int, list[float]]] = deque()

    def clear(self) -> None:
        """Forget the commands: the next one is free."""
        self._recent.clear()

    def limited(self, t_us: int, wanted_n: FloatArray, limit_n: FloatArray) -> FloatArray:
        """Thrust (n,) nearest to ``wanted_n`` (n,) that is no farther from any command of the window than a control
        step may change it. A limit (n,) that has just become smaller has precedence.
        """
        recent = self._recent
        while recent and not 0 <= t_us - recent[0][0] <= self._window_us:
            recent.popleft()
        kept: list[float] = wanted_n.tolist()
        limits: list[float] = limit_n.tolist()
        if recent:
            columns = zip(kept, zip(*(thrust for _, thrust in recent), strict=True), limits, strict=True)
            kept = [
                min(max(wanted, max(column) - self._fraction * limit), min(column) + self._fraction * limit)
                for wanted, column, limit in columns
            ]
        kept = [min(max(thrust, -limit), limit) for thrust, limit in zip(kept, limits, strict=True)]
        recent.append((t_us, kept))
        return np.array(kept)
