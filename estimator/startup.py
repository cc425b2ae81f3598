"""Initialisation: a pose is accepted once three fixes agree, at any position."""

import math
from collections import deque
from itertools import pairwise
from statistics import median

from autopilot.core import operator_messages as notices
from autopilot.core.frames import FloatArray, wrap_pi
from autopilot.estimator.measure_pose import PoseFix
from autopilot.estimator.remarks import Remarks

AGREE_COUNT = 3
"""Fixes that must agree, the newest among them."""
WINDOW_US = 1_000_000
SLOW_WINDOW_US = 2_500_000
"""For the newest three of a slow source: acoustic positioning gives one or two fixes a second."""
AGREE_M = 0.10
AGREE_RAD = 0.15
SPEED_M_S = 0.8
TURN_RAD_S = 1.2
"""Fixes agree if they lie within AGREE plus what the vehicle can have moved in between."""


class StartUp(Remarks):
    """Collects fixes until enough are consistent; that they are too rare for that is reported once."""

    def __init__(self) -> None:
        super().__init__()
        self._fixes: deque[PoseFix] = deque(maxlen=12)
        self._reported = False

    @property
    def interval_us(self) -> float | None:
        """Usual time between two fixes, None before the second."""
        times_us = sorted(fix.t_us for fix in self._fixes)
        return median(b - a for a, b in pairwise(times_us)) if len(times_us) > 1 else None

    def offer(self, fix: PoseFix) -> bool:
        """True if ``fix`` can be accepted: at least two others agree with it, of the last second or the newest two."""
        nearest = sorted((f for f in self._fixes if f.t_us != fix.t_us), key=lambda f: abs(fix.t_us - f.t_us))
        windows_us = (SLOW_WINDOW_US if k < AGREE_COUNT - 1 else WINDOW_US for k in range(len(nearest)))
        others = [f for f, window_us in zip(nearest, windows_us, strict=True) if abs(fix.t_us - f.t_us) <= window_us]
        self._fixes.append(fix)
        accepted = 1 + sum(agree(fix, other) for other in others) >= AGREE_COUNT
        every_us = self.interval_us
        if accepted or self._reported or every_us is None:
            return accepted
        alike = len(nearest) >= AGREE_COUNT - 1 and all(agree(fix, other) for other in nearest[: AGREE_COUNT - 1])
        if alike and (AGREE_COUNT - 1) * every_us > SLOW_WINDOW_US:
            self._reported = True
            self._texts.append(notices.FIXES_TOO_RARE(every_s=1e-6 * every_us).text)
        return False


def agree(a: PoseFix, b: PoseFix) -> bool:
    """Whether one vehicle can have been at both."""
    dt = 1e-6 * abs(a.t_us - b.t_us)
    step: FloatArray = a.z[:3] - b.z[:3]
    near = math.sqrt(float(step @ step)) <= AGREE_M + SPEED_M_S * dt
    return near and abs(wrap_pi(float(a.z[3] - b.z[3]))) <= AGREE_RAD + TURN_RAD_S * dt
