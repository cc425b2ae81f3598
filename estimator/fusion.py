"""A filter core with its history: gating, update and report of measurements, and reset after divergence."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import AidStatus
from autopilot.estimator.aiding import Aid, ScalarAid
from autopilot.estimator.filter_core import FilterCore, Innovation
from autopilot.estimator.history import History, Node, Reopening
from autopilot.estimator.measure_pose import PoseFix
from autopilot.estimator.measurement import Measurement
from autopilot.estimator.states import INITIAL_SIGMA, POS


class Fusion:
    def __init__(self, core: FilterCore) -> None:
        self.core = core
        self.past: History | None = None
        """None until it is known where the vehicle is."""
        self.now_us = -1
        self.resets = 0
        """How often fixes have moved the filter."""
        self._statuses: list[AidStatus] = []

    @property
    def history(self) -> History:
        assert self.past is not None
        return self.past

    def begin_at(self, node: Node) -> None:
        self.past = History(self.core, node)

    def take_statuses(self) -> tuple[AidStatus, ...]:
        """Results of all measurements since the last call."""
        result = tuple(self._statuses)
        self._statuses.clear()
        return result

    def judge(self, node: Node, measurement: Measurement) -> Innovation:
        """Innovation and gate of a measurement at ``node``."""
        return self.core.innovation(node.state, measurement, node.moment, 1e-6 * (measurement.t_us - node.t_us))

    def report(self, measurement: Measurement, aid: Aid, judged: Innovation, *, used: bool) -> None:
        """Count a measurement and record its result."""
        fit = measurement.fit if isinstance(measurement, PoseFix) else None
        self._statuses.append(aid.judged(measurement.t_us, self.now_us, judged, used, fit))

    def fuse(self, node: Node, measurement: Measurement, aid: Aid) -> Innovation:
        judged = self.judge(node, measurement)
        if judged.passes:
            self.history.correct(node, measurement, judged)
        self.report(measurement, aid, judged, used=judged.passes)
        return judged

    def fuse_scalar(self, node: Node, measurement: Measurement, aid: ScalarAid[Any], *, fixed: bool) -> None:
        """Process a measurement other than a pose. A sensor with persistent, consistent residuals is reset: its own
        states are reopened. ``fixed``: a fix has been used recently.
        """
        judged = self.fuse(node, measurement, aid)
        if judged.passes:
            aid.used(measurement)
            return
        if fixed:
            aid.denied(measurement)
        miss = aid.agreed_miss(judged)
        part = None if miss is None else aid.reopened(measurement, fixed=fixed)
        if miss is None or part is None:
            return
        variance = max(miss, _initial_variance(part))
        self.history.forget(node, Reopening(aid.sensor, measurement.t_us, part, variance))
        self.resets += part.start == POS.start  # the position moves with the next measurement
        aid.reset(self.now_us)

    def forget(self, node: Node, aid: Aid, part: slice) -> None:
        """Know these states at ``node`` as little as at the start."""
        self.history.forget(node, Reopening(aid.sensor, node.t_us, part, _initial_variance(part)))

    def move(self, pose: FloatArray, noise: FloatArray, vel_ned_m_s: FloatArray, forgotten: Iterable[slice]) -> None:
        """Move the newest node to a pose (4,) with covariance (4, 4) and a velocity (3,), forget its states
        ``forgotten``, and the past."""
        newest = self.history.newest
        state = self.core.relocate(newest.state, pose, noise, vel_ned_m_s)
        for part in forgotten:
            state = self.core.reopen(state, part, _initial_variance(part))
        self.begin_at(Node(newest.t_us, newest.moment, None, state))


def _initial_variance(part: slice) -> float:
    """The largest one of these states at start-up."""
    return float(np.square(INITIAL_SIGMA[part]).max())
