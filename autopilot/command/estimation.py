"""The estimator in the service: fallback on a fault of the estimator, and notices about its state."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from autopilot.core import operator_messages as notices
from autopilot.core.guard import Guard
from autopilot.core.messages import (
    AidStatus,
    EstimatorInputs,
    Event,
    Inputs,
    NavDoubt,
    NavHealth,
    NavState,
    ShadowStatus,
)
from autopilot.core.model4 import NO_STATE
from autopilot.core.sensors import AID_SENSORS
from autopilot.estimator.protocol import Estimator

LAST_ESTIMATE_US = 200_000
"""Time for which the last estimate is used after a fault of the estimator; then there is none."""

FIXES = ("markers", "external")
"""Aiding sensors that measure the position."""
GOOD_FRAMES = ("frames.ok", "frames.late", "frames.foggy")
"""Counts of pictures that are not of refused ones."""
UNUSED_COUNTS = ("rejected", "late", "duplicate", "future", "malformed")
"""Counts of samples and measurements that were not used."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Estimated:
    """Result of the estimator on one tick."""

    nav: NavState | None
    ahrs_us: int | None
    aids: tuple[AidStatus, ...] = ()
    shadow: ShadowStatus | None = None
    doubts: frozenset[NavDoubt] = frozenset()


_VECTORS = ("pos_ned_m", "rpy_rad", "vel_frd_m_s", "vel_water_frd_m_s", "rate_frd_rad_s", "current_ned_m_s")
_SHAPES = {**dict.fromkeys(_VECTORS, (3,)), "variance": (12,)}
"""Of a state's arrays."""
FINITE_AGAIN_US = 1_000_000
"""After so long without one that is not finite."""


class Estimation:
    """Runs the estimator under the guard.

    An estimate that is not finite or out of range is replaced by the last one, as after a fault of the estimator.
    It is counted as ``nav.not_finite`` and reported.
    """

    def __init__(self, estimator: Estimator, guard: Guard) -> None:
        self._estimator = estimator
        self._guard = guard
        self._estimated_us = 0
        self._ahrs_us: int | None = None
        self._remarks: list[Event] = []
        self._not_finite = 0
        self._not_finite_us: int | None = None
        self.nav: NavState | None = None
        """The estimate of the last tick."""
        self.doubts: frozenset[NavDoubt] = frozenset()
        """Evidence against it or its sensors."""
        self.aid_ratio: dict[str, float] = {}
        """Test ratio of the newest measurement of each aiding sensor."""
        self.fix_us: int | None = None
        """Of the newest fix that met its gate: it agreed with the estimate within their sigmas."""
        self.errors = (0, 0, 0, 0)
        """AHRS samples refused, fixes not used, other aiding measurements not used, resets."""

    def step(self, inputs: Inputs, given: EstimatorInputs) -> Estimated:
        """Estimate of this tick; when the estimator fails the last one for a moment, then none that is valid."""
        found = self._guard.run("estimator", lambda: self._estimate(inputs, given), None, lambda: (inputs, given))
        if found is None:
            found = self._stand_in(inputs.t_us)
        elif not self._finite(inputs.t_us, found.nav):
            found = replace(found, nav=self._stand_in(inputs.t_us).nav)
        else:
            self._estimated_us = inputs.t_us
        self.nav, self.doubts, self._ahrs_us = found.nav, found.doubts, found.ahrs_us
        self.aid_ratio.update((aid.sensor, aid.test_ratio) for aid in found.aids)
        self.fix_us = max((aid.t_us for aid in found.aids if aid.fused and aid.sensor in FIXES), default=self.fix_us)
        return found

    def _estimate(self, inputs: Inputs, given: EstimatorInputs) -> Estimated:
        estimator, t_us = self._estimator, inputs.t_us
        nav = _shaped(estimator.step(t_us, inputs.samples + given.samples, given.thrust_n))
        remarks = estimator.take_remarks()
        self._remarks += [notices.ESTIMATOR_REMARK.event(t_us, text=text) for text in remarks]
        return Estimated(
            nav=nav,
            ahrs_us=estimator.ahrs_us,
            aids=estimator.take_aids(),
            shadow=estimator.shadow,
            doubts=estimator.doubts,
        )

    def _finite(self, t_us: int, nav: NavState | None) -> bool:
        """Whether an estimate is usable; reports one that is not."""
        if nav is None or nav.health is NavHealth.INVALID:
            return True
        finite = sum([sum(map(abs, getattr(nav, name).tolist())) for name in _VECTORS]) < NO_STATE
        finite = finite and sum(map(abs, nav.variance.tolist())) < NO_STATE**2
        if not finite:
            if self._not_finite_us is None:
                self._remarks.append(notices.ESTIMATE_NOT_FINITE.event(t_us))
            self._not_finite, self._not_finite_us = self._not_finite + 1, t_us
        elif self._not_finite_us is not None and t_us - self._not_finite_us > FINITE_AGAIN_US:
            self._not_finite_us = None
            self._remarks.append(notices.ESTIMATE_FINITE.event(t_us))
        return finite

    def _stand_in(self, t_us: int) -> Estimated:
        """After a fault of the estimator: the last estimate, for a limited time."""
        last = self.nav
        if last is not None:
            stale = t_us - self._estimated_us > LAST_ESTIMATE_US
            last = replace(last, t_us=t_us, health=NavHealth.INVALID if stale else last.health)
        return Estimated(nav=last, ahrs_us=self._ahrs_us, doubts=self.doubts)

    def take_remarks(self) -> list[Event]:
        """The estimator's messages to the operator since the last call."""
        remarks, self._remarks = self._remarks, []
        return remarks

    def counts(self, pictures: Mapping[str, int]) -> dict[str, int]:
        """Its counts and those of the ``pictures``, for the log; in short they are :attr:`errors`."""
        counts = self._estimator.counters()
        unused = {sensor: sum(counts.get(f"{sensor}.{what}", 0) for what in UNUSED_COUNTS) for sensor in AID_SENSORS}
        fixes = sum(unused[sensor] for sensor in FIXES)
        refused = sum(count for name, count in pictures.items() if name not in GOOD_FRAMES)
        self.errors = (
            sum(counts.get(f"ahrs.{what}", 0) for what in (*UNUSED_COUNTS, "old", "stuck")),
            fixes + refused,
            sum(unused.values()) - fixes,
            counts.get("resets", 0),
        )
        return {**counts, **pictures, "nav.not_finite": self._not_finite}


def _shaped(nav: object) -> NavState | None:
    """What an estimator has returned, if it is a state with arrays of the right shapes; else a TypeError."""
    if nav is None:
        return None
    if not isinstance(nav, NavState) or not isinstance(nav.health, NavHealth):
        raise TypeError(f"step() must return a NavState or None, not {nav!r:.80}")
    for name, shape in _SHAPES.items():
        part = getattr(nav, name)
        if not isinstance(part, np.ndarray) or part.shape != shape or part.dtype.kind not in "fiu":
            raise TypeError(f"{name} must be an array {shape} of numbers, not {part!r:.80}")
    return nav
