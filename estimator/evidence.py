"""Consistency of the estimate with fixes: size of the residuals, jumps, number of resets."""

import math
from collections import deque

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavDoubt
from autopilot.estimator.estimator_tuning import EVIDENCE, INERTIAL_MONITOR
from autopilot.estimator.filter_core import Innovation
from autopilot.estimator.history import Node
from autopilot.estimator.measure_depth import DepthAid
from autopilot.estimator.measure_range import LaserAid
from autopilot.estimator.measurement import CHI2_999
from autopilot.estimator.monitor import NOTHING, Monitor
from autopilot.estimator.states import LASER_BIAS


class Evidence(Monitor):
    """Judges every fix that met its gate."""

    def __init__(self, laser: LaserAid, depth: DepthAid) -> None:
        super().__init__()
        self._laser, self._depth = laser, depth
        self.denied = 0
        """Fixes rejected in a row that agree among themselves."""
        self.jumps = 0
        self._fix_ratio = self._heading_ratio = 0.0
        self._heading_miss_rad = 0.0
        """Of the newest fix."""
        self._fix_miss = np.zeros(4)
        self._jump_us: int | None = None
        self._jump_m_rad = np.zeros(4)
        self._resets_us: deque[int] = deque(maxlen=EVIDENCE.resets)

    @property
    def denies(self) -> bool:
        """Whether fixes speak against the estimate."""
        return self.denied >= INERTIAL_MONITOR.contradictions or self._fix_ratio > EVIDENCE.ratio_denies

    @property
    def shows(self) -> bool:
        """Whether they miss it by more than they should."""
        return self._fix_ratio > EVIDENCE.ratio_shows

    def denies_heading(self, gyro_apart_rad: float) -> bool:
        """Whether they do by their heading, and miss it as a gyro would make them that is so far from the compass: a
        picture that does not turn at all misses it by more."""
        explained = self._heading_miss_rad / gyro_apart_rad if gyro_apart_rad else 0.0
        return self._heading_ratio > EVIDENCE.ratio_denies and 0.0 < explained < EVIDENCE.explained

    def weigh(self, judged: Innovation, agreeing: int | None) -> None:
        """One fix; ``agreeing``: how many rejected ones agreed with it before, None = it was used.

        Outliers do not count: they do not agree with each other."""
        self.denied = 0 if agreeing is None else agreeing + 1
        if self.denied == 1:
            return
        self._heading_miss_rad = judged.y.item(3)
        heading = float(judged.y[3] ** 2 / judged.variance[3]) / CHI2_999[1]
        self._fix_ratio += EVIDENCE.ratio_gain * (min(judged.test_ratio, EVIDENCE.ratio_most) - self._fix_ratio)
        self._fix_miss = self._fix_miss + EVIDENCE.ratio_gain * (judged.y - self._fix_miss)
        self._heading_ratio += EVIDENCE.ratio_gain * (min(heading, EVIDENCE.ratio_most) - self._heading_ratio)

    def note_jump(self, t_us: int, miss: FloatArray) -> None:
        """Fixes that were used without a break have moved by ``miss`` (4,) [m, rad], and no sensor has felt it."""
        if float(np.linalg.norm(miss[:3])) > EVIDENCE.jump_m or float(miss[3]) > EVIDENCE.jump_rad:
            # A heading error grows into a position error along the further path.
            across = math.hypot(miss.item(0), miss.item(1), EVIDENCE.jump_path_m * min(miss.item(3), 1.0))
            self._jump_us, self._jump_m_rad = t_us, np.array([across, across, miss.item(2), miss.item(3)])
            self.jumps += 1

    def restart(self, t_us: int) -> None:
        self.forgive()
        self._resets_us.append(t_us)

    def forgive(self) -> None:
        """Discard the evidence so far: its cause has been corrected."""
        self.denied, self._fix_ratio, self._heading_ratio, self._fix_miss = 0, 0.0, 0.0, np.zeros(4)

    def doubts(self, t_us: int, newest: Node) -> set[NavDoubt]:
        found = set()
        jumped = self._jump_us is not None and t_us - self._jump_us <= EVIDENCE.jump_us
        if self.denied >= EVIDENCE.denied_after or jumped:
            found.add(NavDoubt.FIXES)
        if jumped:  # and gyro and vehicle model have felt nothing
            found.add(NavDoubt.CAMERA)
        if self._denies_height(newest):
            found.add(NavDoubt.RANGE)
        if self._depth.disagrees(newest.state.x):
            found.add(NavDoubt.DEPTH)
        if len(self._resets_us) == EVIDENCE.resets and t_us - self._resets_us[0] <= EVIDENCE.resets_us:
            found.add(NavDoubt.RESETS)
        return found

    def _denies_height(self, newest: Node) -> bool:
        """Whether the laser needs a larger offset than its mounting and its calibration explain."""
        least_m = max(EVIDENCE.range_miss_m, EVIDENCE.range_sigmas * self._laser.sigma_m)
        return abs(newest.state.x.item(LASER_BIAS)) > least_m

    def counts(self) -> dict[str, int]:
        return {"doubt.jumps": self.jumps}

    def systematic_variance(self, t_us: int, newest: Node) -> FloatArray:
        """See :class:`Monitor`: variance for contradictions between sensors that no state explains."""
        laser_bias_m = newest.state.x.item(LASER_BIAS)
        far = self._denies_height(newest)
        if self._jump_us is None and self._fix_ratio <= EVIDENCE.ratio_shows and not far:
            return NOTHING
        more = np.zeros(4)
        if self._jump_us is not None:
            more += self._jump_m_rad**2 * math.exp(-1e-6 * (t_us - self._jump_us) / EVIDENCE.jump_fade_s)
        if self._fix_ratio > EVIDENCE.ratio_shows:
            more += self._fix_miss**2
        if far:
            more[2] += laser_bias_m * laser_bias_m
        return more
