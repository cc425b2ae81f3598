"""Buffer of samples that arrive after their time of measurement: validation and counting."""

from collections import deque
from collections.abc import Iterable
from dataclasses import replace

from autopilot.core.samples import DepthSample, Sample, VelocitySample
from autopilot.core.sensors import AID_SENSORS
from autopilot.estimator.aiding import Aid
from autopilot.estimator.estimator_tuning import ENGINE
from autopilot.estimator.inertial import FUTURE_TOLERANCE_US

REMEMBERED = 64
"""Times of the latest samples of each kind, to recognise duplicates: two seconds of camera."""
WAITING_MAX = 64
"""Samples of each kind that may wait for the AHRS to catch up."""


class SampleBuffer:
    """Admits samples and hands them out in the order of their time of validity."""

    def __init__(self, aids: dict[type, Aid]) -> None:
        self._aids = aids
        self._seen: dict[type, deque[int]] = {kind: deque(maxlen=REMEMBERED) for kind in aids}
        self._order = {kind: AID_SENSORS.index(aid.sensor) for kind, aid in aids.items()}
        self._waiting: list[Sample] = []
        self._readings: dict[type, tuple[object, int]] = {}
        """Last reading of a kind, and how many before it were equal."""

    def admit(self, sample: Sample, now_us: int) -> None:
        """Keep a sample for :meth:`due`, or count it as from the future or as a duplicate, by its time or because the
        sensor repeats itself to the last digit."""
        kind = type(sample)
        aid = self._aids[kind]
        aid.counts["received"] += 1
        if sample.t_us > now_us + FUTURE_TOLERANCE_US:
            aid.counts["future"] += 1
        elif sample.t_us in self._seen[kind] or self._is_frozen(sample):
            aid.counts["duplicate"] += 1
        elif len(self._waiting) >= WAITING_MAX and sum(type(s) is kind for s in self._waiting) >= WAITING_MAX:
            aid.counts["late"] += 1
        else:
            self._seen[kind].append(sample.t_us)
            self._waiting.append(sample)

    def _is_frozen(self, sample: Sample) -> bool:
        """Whether a device goes on with an old reading: without fixes the estimate would follow it."""
        if isinstance(sample, DepthSample):
            reading: object = sample.depth_m
        elif isinstance(sample, VelocitySample):
            reading = sample.vel_frd_m_s.tobytes()
        else:
            return False
        last, equal = self._readings.get(type(sample), (None, 0))
        equal = equal + 1 if reading == last else 0
        self._readings[type(sample)] = reading, equal
        return equal >= ENGINE.frozen_readings

    def retime_pictures(self, later_us: int) -> None:
        """Shift the times of buffered image measurements."""
        of_pictures = {kind for kind, aid in self._aids.items() if aid.of_pictures}
        self._waiting = [replace(s, t_us=s.t_us + later_us) if type(s) in of_pictures else s for s in self._waiting]

    def due(self, until_us: int) -> Iterable[Sample]:
        """Samples valid at or before ``until_us``, oldest first; the others stay."""
        if not self._waiting:
            return ()
        ready = [s for s in self._waiting if s.t_us <= until_us]
        if ready:
            self._waiting = [s for s in self._waiting if s.t_us > until_us]
        if len(ready) > 1:
            ready.sort(key=lambda s: (s.t_us, self._order[type(s)]))
        return ready
