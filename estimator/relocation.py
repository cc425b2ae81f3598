"""Detection of a wrong position: consecutive rejected fixes that are mutually consistent."""

from collections import deque

from autopilot.core.frames import FloatArray
from autopilot.estimator.aiding import REJECT_COUNT
from autopilot.estimator.measure_pose import PoseFix
from autopilot.estimator.startup import AGREE_COUNT, SLOW_WINDOW_US, WINDOW_US, agree


class Relocation:
    """Monitors rejected fixes, independent of the filter, which may have diverged."""

    def __init__(self) -> None:
        self._fixes: deque[PoseFix] = deque(maxlen=REJECT_COUNT)

    def accepted(self) -> None:
        self._fixes.clear()

    def agreeing_with(self, fix: PoseFix) -> int:
        """Number of the last rejected fixes that are consistent with this one, in a row; outliers interrupt it."""
        count = 0
        for other in reversed(self._fixes):
            if not agree(fix, other):
                break
            count += 1
        return count

    def rejected(self, fix: PoseFix, lost: bool) -> FloatArray | None:
        """A fix did not pass. Not None: accept it and move there, at this velocity (3,) NED over ground.

        As many fixes must agree as make a sensor count as rejecting, or, when the filter is ``lost`` (no good fix
        for a while), as at start-up."""
        self._fixes.append(fix)
        count, longest_us = (AGREE_COUNT, SLOW_WINDOW_US) if lost else (REJECT_COUNT, WINDOW_US)
        last = list(self._fixes)[-count:]
        first = last[0]
        span_us = fix.t_us - first.t_us
        if len(last) < count or not 0 < span_us <= longest_us:
            return None
        if not all(agree(fix, other) for other in last):
            return None
        return (fix.z[:3] - first.z[:3]) / (1e-6 * span_us)
