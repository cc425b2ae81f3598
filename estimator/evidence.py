"""What fixes say against the estimate: how far they miss, whether they have jumped, how often all began anew."""

import math
from collections import deque

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavDoubt
from autopilot.estimator.doubt import CONTRADICTIONS
from autopilot.estimator.filter_core import Innovation
from autopilot.estimator.history import Node
from autopilot.estimator.measurement import CHI2_999
from autopilot.estimator.monitor import NOTHING, Monitor
from autopilot.estimator.states import LASER_BIAS

RATIO_SHARE = 0.2
RATIO_MOST = 2.0
RATIO_SHOWS = 0.35
RATIO_DENIES = 0.6
"""Squared distance of the fixes over its gate, smoothed over five of them: 0.2 with a filter that is right. From the
first limit on their mean miss counts as error of the estimate, from the second on they deny it."""
EXPLAINED = 1.6
"""Times gyro and compass are apart that fixes may miss the heading by: a gyro that is wrong makes both grow alike, but
for what is forgotten of the first (1.58 after 0.3 s)."""
DENIED_AFTER = 6
"""Fixes rejected in a row (0.2 s) after which the estimate is not called good."""
JUMP_M, JUMP_RAD = 0.05, 0.05
"""Smaller steps are what a filter does that has been a little wrong."""
JUMP_US = 5_000_000
"""So long an estimate is not called good after fixes have jumped."""
JUMP_FADE_S = 10.0
"""A jump that nothing on board felt fades from the variance with this: what the fixes say now may be as wrong."""
JUMP_WAY_M = 0.5
"""The position is off by the jump of the heading times this: the way within the seconds after it."""
RANGE_MISS_M = 0.04
"""A laser that needs a larger offset denies the height: twice what a mounted laser is off by."""
RESETS, RESETS_US = 3, 30_000_000
"""So many resets within so long are no accident: map, camera or stamps are wrong."""


class Evidence(Monitor):
    """Judges every fix that met its gate."""

    def __init__(self) -> None:
        super().__init__()
        self.denied = 0
        """Fixes rejected in a row that agree among themselves."""
        self.jumps = 0
        self._fix_ratio = self._heading_ratio = 0.0
        self._heading_miss_rad = 0.0
        """Of the newest fix."""
        self._fix_miss = np.zeros(4)
        self._jump_us: int | None = None
        self._jump_m_rad = np.zeros(4)
        self._resets_us: deque[int] = deque(maxlen=RESETS)

    @property
    def denies(self) -> bool:
        """Whether fixes speak against the estimate."""
        return self.denied >= CONTRADICTIONS or self._fix_ratio > RATIO_DENIES

    @property
    def shows(self) -> bool:
        """Whether they miss it by more than they should."""
        return self._fix_ratio > RATIO_SHOWS

    def denies_heading(self, gyro_apart_rad: float) -> bool:
        """Whether they do by their heading, and miss it as a gyro would make them that is so far from the compass: a
        picture that does not turn at all misses it by more."""
        explained = self._heading_miss_rad / gyro_apart_rad if gyro_apart_rad else 0.0
        return self._heading_ratio > RATIO_DENIES and 0.0 < explained < EXPLAINED

    def weigh(self, judged: Innovation, agreeing: int | None) -> None:
        """One fix; ``agreeing``: how many rejected ones agreed with it before, None = it was used.

        Outliers do not count: they do not agree with each other."""
        self.denied = 0 if agreeing is None else agreeing + 1
        if self.denied == 1:
            return
        self._heading_miss_rad = judged.y.item(3)
        heading = float(judged.y[3] ** 2 / judged.variance[3]) / CHI2_999[1]
        self._fix_ratio += RATIO_SHARE * (min(judged.test_ratio, RATIO_MOST) - self._fix_ratio)
        self._fix_miss = self._fix_miss + RATIO_SHARE * (judged.y - self._fix_miss)
        self._heading_ratio += RATIO_SHARE * (min(heading, RATIO_MOST) - self._heading_ratio)

    def note_jump(self, t_us: int, miss: FloatArray) -> None:
        """Fixes that were used without a break have moved by ``miss`` (4,) [m, rad], and no sensor has felt it."""
        if float(np.linalg.norm(miss[:3])) > JUMP_M or float(miss[3]) > JUMP_RAD:
            # A wrong heading turns the way that is still to come.
            across = math.hypot(miss.item(0), miss.item(1), JUMP_WAY_M * min(miss.item(3), 1.0))
            self._jump_us, self._jump_m_rad = t_us, np.array([across, across, miss.item(2), miss.item(3)])
            self.jumps += 1

    def begin_anew(self, t_us: int) -> None:
        """The filter has been moved to where fixes are."""
        self.forgive()
        self._resets_us.append(t_us)

    def forgive(self) -> None:
        """What fixes have said so far was due to something that has been put right."""
        self.denied, self._fix_ratio, self._heading_ratio, self._fix_miss = 0, 0.0, 0.0, np.zeros(4)

    def doubts(self, t_us: int, newest: Node) -> set[NavDoubt]:
        """See :class:`Monitor`."""
        found = set()
        jumped = self._jump_us is not None and t_us - self._jump_us <= JUMP_US
        if self.denied >= DENIED_AFTER or jumped:
            found.add(NavDoubt.FIXES)
        if jumped:  # and gyro and vehicle model have felt nothing
            found.add(NavDoubt.CAMERA)
        if abs(newest.state.x.item(LASER_BIAS)) > RANGE_MISS_M:
            found.add(NavDoubt.RANGE)
        if len(self._resets_us) == RESETS and t_us - self._resets_us[0] <= RESETS_US:
            found.add(NavDoubt.RESETS)
        return found

    def counts(self) -> dict[str, int]:
        """See :class:`Monitor`."""
        return {"doubt.jumps": self.jumps}

    def unexplained_variance(self, t_us: int, newest: Node) -> FloatArray:
        """See :class:`Monitor`: what sensors deny each other and no state explains."""
        laser_bias_m = newest.state.x.item(LASER_BIAS)
        far = abs(laser_bias_m) > RANGE_MISS_M
        if self._jump_us is None and self._fix_ratio <= RATIO_SHOWS and not far:
            return NOTHING
        more = np.zeros(4)
        if self._jump_us is not None:
            more += self._jump_m_rad**2 * math.exp(-1e-6 * (t_us - self._jump_us) / JUMP_FADE_S)
        if self._fix_ratio > RATIO_SHOWS:
            more += self._fix_miss**2
        if far:
            more[2] += laser_bias_m * laser_bias_m
        return more
