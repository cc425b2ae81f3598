"""State machine and counters of one aiding sensor: start, use, rejection, timeout, reset.

Every source has the same gate, counters and reports; only the reset differs. For a source with an offset that is a
filter state (heading, laser, depth), or that measures one kind of state only (velocity), the variance of these states
is reset after a series of rejected but mutually consistent residuals. A source of positions resets the whole filter
(:mod:`autopilot.estimator.fix_aid`).

Each source is a class beside its measurement model in ``measure_*.py``; :mod:`autopilot.estimator.sources` lists them.
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.messages import AidState, AidStatus, MarkerFit
from autopilot.estimator.filter_core import Innovation
from autopilot.estimator.history import Node
from autopilot.estimator.inertial import Inertial
from autopilot.estimator.measurement import Measurement

START_COUNT = 5
"""Measurements used in a row before a sensor counts as active."""
REJECT_COUNT = 12
"""Measurements rejected in a row before a sensor counts as rejecting (0.4 s of camera)."""
TIMEOUT_US = 1_000_000
"""Silence after which a sensor counts as stopped."""

AGREE_SIGMA = 3.0
"""Rejected residuals agree when they lie within so many of their expected deviations of their mean."""

COUNTS = ("received", "fused", "rejected", "late", "duplicate", "future", "malformed", "resets")
"""What is counted of every sensor."""


S_contra = TypeVar("S_contra", contravariant=True)
M = TypeVar("M")


class Aid:
    sensor: ClassVar[str]
    """One of ``AID_SENSORS``."""
    samples: ClassVar[tuple[type, ...]] = ()
    """Kinds of samples that it makes measurements of. The first source that names a kind counts its samples."""
    own: ClassVar[slice | None] = None
    """States that are reopened when the sensor is reset, None = it is not reset like that."""
    of_pictures: ClassVar[bool] = False
    """Whether its samples are made of pictures: stamped as these are, and trusted as the camera is."""

    def __init__(self, time_offset_s: float = 0.0) -> None:
        self._offset_us = round(1e6 * time_offset_s)
        self.counts = dict.fromkeys(COUNTS, 0)
        self.rejected_in_row = 0
        self.last_fused_us: int | None = None
        """Time of validity of the newest measurement that was used."""
        self._fused_in_row = 0
        self._state = AidState.STOPPED
        self._last_us: int | None = None
        self._rejected: deque[FloatArray] = deque(maxlen=REJECT_COUNT)

    @property
    def offset_us(self) -> int:
        """Correction of the stamps of its samples [us]."""
        return self._offset_us

    def counted(self, measurement: M | None) -> M | None:
        """Measurement of a sample; None = malformed."""
        if measurement is None:
            self.counts["malformed"] += 1
        return measurement

    def state(self, now_us: int) -> AidState:
        """State of the sensor in its life cycle."""
        if self._last_us is None or now_us - self._last_us > TIMEOUT_US:
            self._state = AidState.STOPPED
            self._fused_in_row = 0
        return self._state

    def judged(
        self, t_us: int, now_us: int, innovation: Innovation, fused: bool, fit: MarkerFit | None = None
    ) -> AidStatus:
        """Count one measurement that met its gate or did not, and report it; ``fit``: of one that is of markers."""
        self.state(now_us)
        self._last_us = now_us
        if fused:
            self.counts["fused"] += 1
            if self.rejected_in_row:
                self.rejected_in_row = 0
                self._rejected.clear()
            self._fused_in_row += 1
            if self.last_fused_us is None or t_us > self.last_fused_us:
                self.last_fused_us = t_us
        else:
            self.counts["rejected"] += 1
            self.rejected_in_row += 1
            self._rejected.append(innovation.y)
            self._fused_in_row = 0
        if self.rejected_in_row >= REJECT_COUNT:
            self._state = AidState.REJECTING
        elif self._fused_in_row >= START_COUNT:
            self._state = AidState.ACTIVE
        elif self._state is AidState.STOPPED:
            self._state = AidState.STARTING
        return AidStatus(
            t_us=t_us,
            sensor=self.sensor,
            innovation=_three(innovation.y),
            innovation_var=_three(innovation.variance),
            test_ratio=innovation.test_ratio,
            fused=fused,
            state=self._state,
            age_s=1e-6 * (now_us - t_us),
            fit=fit,
        )

    def agreed_miss(self, innovation: Innovation) -> float | None:
        """Mean square of the residuals if the sensor counts as rejecting and they agree, None if there is no case."""
        if self.own is None or self.rejected_in_row < REJECT_COUNT:
            return None
        residuals = np.array(self._rejected)
        mean = residuals.mean(axis=0)
        if (np.abs(residuals - mean) > AGREE_SIGMA * np.sqrt(innovation.variance)).any():
            return None
        return float((mean * mean).max())

    def reset(self, now_us: int) -> None:
        self.counts["resets"] += 1
        self.rejected_in_row = self._fused_in_row = 0
        self._rejected.clear()
        self._state = AidState.STARTING
        self._last_us = now_us

    def named_counts(self) -> Iterator[tuple[str, int]]:
        """Counts as ``sensor.what``."""
        for what, count in self.counts.items():
            yield f"{self.sensor}.{what}", count


class ScalarAid(Aid, ABC, Generic[S_contra]):
    """An aiding sensor other than a pose source."""

    contradicted = False
    """Whether fixes that were used have denied it: it is not used without them."""

    @abstractmethod
    def measured(self, sample: S_contra) -> Measurement | None:
        """The measurement of a sample; None = there is none in it, or none that can be used."""
        ...

    def wanted(self, sample: S_contra, node: Node) -> bool:
        """Whether a sample that belongs to ``node`` is of use now; one that is not is passed over."""
        return True

    def reopened(self, measurement: Any, *, fixed: bool) -> slice | None:
        """States to forget when it is reset after this measurement was rejected, None = it is not.

        ``fixed``: a fix has been used of late."""
        return self.own

    def used(self, measurement: Any) -> None:
        """A measurement has met its gate."""

    def denied(self, measurement: Any) -> None:
        """A measurement has not, while fixes were used."""


class InertialAid(ScalarAid[Inertial]):
    """An aiding sensor that is a part of the AHRS: some of its samples, whatever its rate."""

    every_s: ClassVar[float]
    """From one that is used to the next; the noise is for so many."""

    def __init__(self) -> None:
        super().__init__()
        self._passed_s = 0.0

    def due_s(self, dt_s: float) -> float:
        """Time since the last sample that was due, at one that comes ``dt_s`` after the one before; 0 = not due,
        the next one is nearer to the time."""
        self._passed_s += dt_s
        if self._passed_s + 0.5 * dt_s < self.every_s:
            return 0.0
        passed_s, self._passed_s = self._passed_s, 0.0
        return passed_s


def _three(values: FloatArray) -> FloatArray:
    """First three components (3,), missing ones 0."""
    result = np.zeros(3)
    result[: len(values)] = values[:3]
    return result
