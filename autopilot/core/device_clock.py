"""Conversion of a device's clock to the service's time: tracks drift, and recovers from a jump within half a second.

Arrival times have scheduling jitter; the device's own stamps do not. The mean difference of both contains the mean
latency, which the caller subtracts.

A jump and a late arrival both change the difference. They differ in the step from one device stamp to the next: a
healthy clock makes even steps, however late the samples arrive; a jump is an uneven step that the arrivals do not
show. Only a change of the difference after an uneven step is taken as a jump. A clock that jumps repeatedly is not
used: samples then have their time of arrival.
"""

from collections import deque
from statistics import median

from autopilot.core import operator_messages as notices
from autopilot.core.messages import Severity

LOST_US = 50_000.0
"""A difference that is off by more belongs to a late arrival or to another setting of the clock."""
TOGETHER = 1.5
"""Hysteresis of the limit on either side of a jump."""
STEADY_US, STEADY_COUNT = 150_000, 5
"""Samples whose clock may have jumped are withheld until it has been steady for so long and so many of them,"""
STEADY_SPREAD_US = 25_000.0
"""within this spread of the difference,"""
WITHHELD_US = 400_000
"""and no longer than this: then arrivals are the stamps."""
LATE_BURST_US = 50_000
"""Samples that a stalled line delivers late come at once; those that stay late for longer have a wrong stamp."""
EVEN_SHARE, EVEN_US, EVEN_MOST_US = 0.3, 3_000.0, 6_000.0
"""A step of the device is even if it differs from the usual one by no more than this share, within these times."""
SMALL_US, MATCH_US, MATCH_SHARE = 6_000.0, 3_000.0, 0.2
"""A jump of less than LOST_US is one from the first on, if the uneven step explains it within the others."""
EXPLAINED_SHARE = 0.5
"""A step is part of a jump if the difference without it is below this fraction."""
STEPS = 15
"""Number of steps whose median is the usual step."""
SETTLED = 100
"""Stamps after which a clock is known; until then it may be set without a notice."""
OFTEN, OFTEN_US = 3, 5_000_000
"""Number of jumps within a time after which arrivals are used as stamps, until there has been none for as long."""
TELL_EVERY_US = 5_000_000
ANY_SPAN_US = 1 << 63
"""Of a clock that does not wrap."""


class DeviceClock:
    GAIN = 0.01
    """Share of a new difference once the start is over (1 s at 100 Hz)."""
    CLIP_US = 5_000.0
    """A late arrival moves the mean no further than if it had been late by this."""
    UNBROKEN_COUNT = 50
    """Samples in a row that are off though the clock makes even steps: the latency is another."""

    def __init__(self, span_us: int = ANY_SPAN_US) -> None:
        """``span_us``: the device's counter begins anew after this."""
        self._span_us = span_us
        self.jumps = 0
        """Number of jumps of the device's clock."""
        self._notices: list[tuple[Severity, str]] = []
        self._unreported: list[int] = []
        self._reported_us: int | None = None
        self._emitted_us = -(1 << 62)
        self.begin()

    def begin(self) -> None:
        """The device has been opened: its clock may show anything."""
        self._raw_us: int | None = None
        self._device_us = self._arrival_us = 0
        self._count = self._seen = 0
        self._offset_us = 0.0
        self._steps: deque[int] = deque(maxlen=STEPS)
        self._episode: _Episode | None = None
        self._trial: _Trial | None = None
        self._jumped_us: deque[int] = deque(maxlen=OFTEN)
        self._by_arrival = False

    def stamp(self, arrival_us: int, device_us: int) -> int | None:
        """The service's time at which the device read ``device_us``, plus the mean latency [us]; later with every call.

        None for a sample that cannot be stamped: a stamp of before, or a clock that has just jumped."""
        step_us = self._step(device_us)
        self._device_us += step_us
        stamped = self._stamped(arrival_us, step_us)
        self._arrival_us = arrival_us
        self._tell(arrival_us)
        if stamped is None or stamped <= self._emitted_us:
            return None
        self._emitted_us = stamped
        return stamped

    def take_notices(self) -> list[tuple[Severity, str]]:
        """Notices to operators since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def _step(self, device_us: int) -> int:
        """Step from the last stamp to this one [us], modulo the counter's range."""
        last_us, self._raw_us = self._raw_us, device_us
        if last_us is None:
            return device_us
        half = self._span_us // 2
        return (device_us - last_us + half) % self._span_us - half

    def _stamped(self, arrival_us: int, step_us: int) -> int | None:
        difference = float(arrival_us - self._device_us)
        if self._count == 0:
            self._anchor(difference)
            return arrival_us
        known, usual_us = bool(self._steps), median(self._steps) if self._steps else float(step_us)
        if step_us > 0:
            self._steps.append(step_us)
        self._seen += 1
        error = difference - self._offset_us
        if abs(error) > self._jump_limit_us():
            arrived_us = arrival_us - self._arrival_us
            even = (known and self._even(step_us, usual_us)) or abs(arrived_us - step_us) < 0.5 * LOST_US
            if self._seen < SETTLED and (error < 0.0 or not even):  # samples buffered at the start are late as well
                self._anchor(difference)
                return arrival_us
            # Samples that are lost within a late burst make uneven steps as well, but not such as it is off by.
            explained = abs(error + step_us - usual_us) < EXPLAINED_SHARE * abs(error)
            stamped = self._when_off(arrival_us, difference, broken=explained and not even)
            return stamped if step_us else None
        self._episode = None
        shift = self._small_jump(arrival_us, step_us, usual_us, error)
        if step_us == 0:
            return None
        if self._not_usable(arrival_us):
            return arrival_us
        if shift:
            return round(self._device_us + self._offset_us + shift)
        self._follow(difference - self._offset_us)
        return round(self._device_us + self._offset_us)

    def _jump_limit_us(self) -> float:
        """From where on the difference is off; the limit depends on how the samples before were judged."""
        if self._trial is not None:
            return TOGETHER * LOST_US
        broken = self._episode is not None and self._episode.broken
        return LOST_US / TOGETHER if broken else LOST_US

    def _follow(self, error: float) -> None:
        self._count += 1
        gain = max(1.0 / self._count, self.GAIN)
        if self._count > 1.0 / self.GAIN:
            error = max(-self.CLIP_US, min(self.CLIP_US, error))
        self._offset_us += gain * error

    def _anchor(self, difference: float) -> None:
        self._count, self._offset_us = 1, difference
        self._episode = self._trial = None

    @staticmethod
    def _even(step_us: int, usual_us: float) -> bool:
        return abs(step_us - usual_us) <= min(max(EVEN_US, EVEN_SHARE * usual_us), EVEN_MOST_US)

    def _when_off(self, arrival_us: int, difference: float, *, broken: bool) -> int | None:
        """The difference is far from its mean: late samples, or a jump."""
        trial, self._trial = self._trial, None
        episode = self._episode
        if episode is None:
            before_us = self._arrival_us if trial is None else trial.since_us
            episode = self._episode = _Episode(before_us, arrival_us, broken=trial is not None)
        episode.take(arrival_us, difference, broken=broken)
        late = difference - self._offset_us
        if episode.broken:
            settled = episode.steady_difference(arrival_us)
            if settled is not None:
                self._note_jump(arrival_us, settled)
                self._anchor(settled)
            elif arrival_us - episode.before_us < WITHHELD_US and not self._not_usable(arrival_us):
                return None
            if settled is None or self._not_usable(arrival_us):
                return arrival_us
        elif episode.count >= self.UNBROKEN_COUNT:
            self._anchor(difference)
        elif self._not_usable(arrival_us):
            return arrival_us
        elif late > 0.0 and arrival_us - episode.since_us > LATE_BURST_US:
            return None
        return round(self._device_us + self._offset_us)

    def _small_jump(self, arrival_us: int, step_us: int, usual_us: float, error: float) -> float:
        """Correction of the stamp [us] while an uneven step may be a jump of less than LOST_US."""
        if self._trial is None:
            if self._even(step_us, usual_us):
                return 0.0
            self._trial = _Trial(arrival_us, usual_us)
        trial = self._trial
        trial.take(step_us, error)
        jump_us = trial.jump_us
        if arrival_us - trial.since_us >= STEADY_US and len(trial.errors) >= STEADY_COUNT:
            self._trial = None
            miss = median(trial.errors)
            if abs(miss) >= SMALL_US and abs(miss + jump_us) <= MATCH_US + MATCH_SHARE * abs(miss):
                self._note_jump(arrival_us, self._offset_us + miss)
                self._offset_us += miss
            return 0.0
        return -jump_us if abs(error + jump_us) < 0.5 * abs(error) else 0.0

    def _note_jump(self, t_us: int, difference: float) -> None:
        self.jumps += 1
        self._unreported.append(round(self._offset_us - difference))
        self._jumped_us.append(t_us)

    def _not_usable(self, t_us: int) -> bool:
        """Whether the clock jumps so often that arrivals are the better stamps."""
        jumped = self._jumped_us
        if not self._by_arrival:
            self._by_arrival = len(jumped) == OFTEN and t_us - jumped[0] <= OFTEN_US
        elif t_us - jumped[-1] > OFTEN_US:
            self._by_arrival = False
            jumped.clear()
        return self._by_arrival

    def _tell(self, t_us: int) -> None:
        if not self._unreported or (self._reported_us is not None and t_us - self._reported_us < TELL_EVERY_US):
            return
        self._reported_us = t_us
        last, times = f"{1e-6 * self._unreported[-1]:+.3g} s", len(self._unreported)
        self._unreported = []
        what = f"clock jumped {last}" if times == 1 else f"clock jumped {times} times, last {last}"
        used = ", not used" if self._by_arrival else ""
        self._notices.append(notices.CLOCK_JUMPED(what=what, used=used))


class _Episode:
    """Samples in a row whose difference is off."""

    def __init__(self, before_us: int, since_us: int, *, broken: bool) -> None:
        self.before_us = max(before_us, since_us - WITHHELD_US // 2)
        self.since_us = since_us
        self.broken = broken
        """Whether the clock has made an uneven step on the way."""
        self.count = 0
        self._last: deque[tuple[int, float]] = deque()

    def take(self, arrival_us: int, difference: float, *, broken: bool) -> None:
        self.broken |= broken
        self.count += 1
        self._last.append((arrival_us, difference))
        while len(self._last) > STEADY_COUNT and arrival_us - self._last[1][0] >= STEADY_US:
            self._last.popleft()

    def steady_difference(self, arrival_us: int) -> float | None:
        """The median difference of the last ones if they agree, else None."""
        if len(self._last) < STEADY_COUNT or arrival_us - self._last[0][0] < STEADY_US:
            return None
        differences = [difference for _, difference in self._last]
        if max(differences) - min(differences) > STEADY_SPREAD_US:
            return None
        return median(differences)


class _Trial:
    def __init__(self, since_us: int, usual_us: float) -> None:
        self.since_us = since_us
        self._usual_us = usual_us
        self.jump_us = 0.0
        """By how much the device's clock has gone further than the usual steps."""
        self.errors: list[float] = []
        """Of the differences [us]."""

    def take(self, step_us: int, error: float) -> None:
        self.jump_us += step_us - self._usual_us
        self.errors.append(error)
