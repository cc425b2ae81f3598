"""Conversion of a device's clock to the service's time: tracks drift, follows the latency, and finds jumps.

Arrival times have scheduling jitter; the device's own stamps do not. The mean difference of both contains the mean
latency, which the caller subtracts.

A jump of the clock, another latency and lost samples all change the difference, and whichever it was, the clock is
set anew once the difference is steady. Only what latency and losses together cannot do is taken for a jump:

- back: more samples arrive than the device's clock has gone on for (each stamp is sent once);
- forward: the clock skips a time that is no multiple of the usual step, or many steps on a line that loses nothing; or
  samples arrive so early that those before must have had a latency that no line has.

A clock that jumps repeatedly is not used: samples then have their time of arrival. Those of a clock that stands still
have it too, until it goes on.
"""

from collections import deque
from statistics import median

from autopilot.core import operator_messages as notices
from autopilot.core.core_tuning import CLOCK
from autopilot.core.notice_queue import NoticeQueue


class DeviceClock(NoticeQueue):
    GAIN = 0.01
    """Share of a new difference once the start is over (1 s at 100 Hz)."""
    CLIP_US = 5_000.0
    """A late arrival moves the mean no further than if it had been late by this."""

    def __init__(self, span_us: int = CLOCK.any_span_us) -> None:
        """``span_us``: the device's counter begins anew after this."""
        self._span_us = span_us
        self.jumps = 0
        """Number of jumps of the device's clock by more than CLOCK.far_us."""
        super().__init__()
        self._unreported: list[int] = []
        self._reported_us: int | None = None
        self._emitted_us = -(1 << 62)
        self.begin()

    def begin(self) -> None:
        """The device has been opened: its clock may show anything."""
        self._raw_us: int | None = None
        self._device_us = self._arrival_us = self._front_us = 0
        self._count = self._seen = 0
        self._offset_us = self._least_us = 0.0
        self._steps = _Steps()
        self._run: _Run | None = None
        self._jumped_us: deque[int] = deque(maxlen=CLOCK.often)
        self._by_arrival = self._stands = False
        self._moved_us = self._still = 0
        """Arrival of the last stamp that differed from the one before, and the number of equal ones since."""

    def stamp(self, arrival_us: int, device_us: int) -> int | None:
        """The service's time at which the device read ``device_us``, plus the mean latency [us]; later with every call.

        None for a sample that cannot be stamped: a stamp of before, or a clock that has just jumped."""
        if self._stands and device_us != self._raw_us:
            self.begin()
        repeated = device_us == self._raw_us
        step_us = self._step(device_us)
        if self._stopped(arrival_us, repeated=repeated):
            stamped: int | None = arrival_us
        elif repeated:  # an equal stamp says nothing about the difference of the clocks
            stamped = None
        else:
            self._device_us += step_us
            stamped = self._stamped(arrival_us, step_us)
            self._arrival_us = arrival_us
            self._front_us = max(self._front_us, self._device_us)
            self._tell(arrival_us)
        if stamped is None or stamped <= self._emitted_us:
            return None
        self._emitted_us = stamped
        return stamped

    @property
    def offset_us(self) -> float:
        """The service's time minus the device's, mean latency included, modulo the range of its counter."""
        return self._offset_us

    def _stopped(self, arrival_us: int, *, repeated: bool) -> bool:
        """Whether the clock stands still while samples arrive."""
        if not repeated:
            self._moved_us, self._still = arrival_us, 0
            return False
        self._still += 1
        if self._still < CLOCK.still_count or arrival_us - self._moved_us < CLOCK.still_us:
            return False
        if not self._stands:
            self._stands = True
            self._notices.append(notices.CLOCK_JUMPED(what="clock stopped", used=""))
        return True

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
            self._least_us = difference
            return arrival_us
        passed_us = arrival_us - self._arrival_us
        self._least_us += CLOCK.most_drift * passed_us
        error = difference - self._offset_us
        ahead_us = self._device_us - self._front_us
        skips = self._steps.skips(ahead_us, passed_us) and _explains(ahead_us - self._steps.usual_us, error)
        self._steps.take(step_us)
        self._seen += 1
        run = self._run_of(error, back=step_us < -CLOCK.most_latency_us)
        run.take(arrival_us, difference, self._device_us)
        run.jumped |= skips or difference < self._least_us - CLOCK.most_latency_us
        if run.far:
            return self._when_far(arrival_us, difference, run)
        lasts = run.side < 0 or arrival_us - run.since_us >= CLOCK.withheld_us
        self._least_us = min(self._least_us, difference)
        if run.side and lasts and run.is_steady(arrival_us):
            self._anchor(run.middle)
        else:
            self._follow(error)
        return arrival_us if self._not_usable(arrival_us) else self._by_clock(arrival_us)

    def _by_clock(self, arrival_us: int) -> int:
        """The stamp by the device's clock."""
        return min(round(self._device_us + self._offset_us), arrival_us + CLOCK.early_us)

    def _run_of(self, error: float, *, back: bool) -> "_Run":
        """The run that a sample with this error belongs to. ``back``: the clock has gone back before it."""
        before = self._run
        side = 0 if abs(error) <= CLOCK.near_us else 1 if error > 0.0 else -1
        stays = before is not None and before.far and before.side == side
        far = abs(error) > (CLOCK.stays_far_us if stays else CLOCK.far_us)
        if before is None or back or (before.side, before.far) != (side, far):
            before = self._run = _Run(side, far, self._arrival_us, self._front_us)
        return before

    def _follow(self, error: float) -> None:
        self._count += 1
        gain = max(1.0 / self._count, self.GAIN)
        if self._count > 1.0 / self.GAIN:
            error = max(-self.CLIP_US, min(self.CLIP_US, error))
        self._offset_us += gain * error

    def _anchor(self, difference: float) -> None:
        self._count, self._offset_us = 1, difference
        self._front_us = self._device_us
        self._run = None

    def _when_far(self, arrival_us: int, difference: float, run: "_Run") -> int | None:
        """The difference is far from its mean: late samples, another latency, or a jump."""
        late_us = difference - self._offset_us
        repeats = run.repeats(self._steps.usual_us, late_us)
        if self._seen < CLOCK.settled and (late_us < 0.0 or repeats):  # samples buffered at the start are late as well
            self._least_us = difference
            self._anchor(difference)
            return arrival_us
        steady = run.is_steady(arrival_us)
        if steady or arrival_us - run.since_us >= CLOCK.withheld_us:
            settled = run.middle
            late_us = settled - self._offset_us
            clear = abs(late_us) > (CLOCK.far_us if steady else CLOCK.most_latency_us)
            if clear and (run.jumped or run.repeats(self._steps.usual_us, late_us)):
                self._note_jump(arrival_us, settled)
            self._least_us = min(self._least_us, settled)
            self._anchor(settled)
            return arrival_us if self._not_usable(arrival_us) else self._by_clock(arrival_us)
        if late_us < 0.0 or self._not_usable(arrival_us):
            return arrival_us
        if repeats or arrival_us - run.first_arrival_us > CLOCK.late_burst_us:
            return None
        return self._by_clock(arrival_us)

    def _note_jump(self, t_us: int, difference: float) -> None:
        self.jumps += 1
        self._unreported.append(round(self._offset_us - difference))
        self._jumped_us.append(t_us)
        self._least_us = difference
        self._steps.lossless = CLOCK.lossless

    def _not_usable(self, t_us: int) -> bool:
        """Whether the clock jumps so often that arrivals are the better stamps."""
        jumped = self._jumped_us
        if not self._by_arrival:
            self._by_arrival = len(jumped) == CLOCK.often and t_us - jumped[0] <= CLOCK.often_us
        elif t_us - jumped[-1] > CLOCK.often_us:
            self._by_arrival = False
            jumped.clear()
        return self._by_arrival

    def _tell(self, t_us: int) -> None:
        if not self._unreported or (self._reported_us is not None and t_us - self._reported_us < CLOCK.tell_every_us):
            return
        self._reported_us = t_us
        last, times = f"{1e-6 * self._unreported[-1]:+.3g} s", len(self._unreported)
        self._unreported = []
        what = f"clock jumped {last}" if times == 1 else f"clock jumped {times} times, last {last}"
        used = ", not used" if self._by_arrival else ""
        self._notices.append(notices.CLOCK_JUMPED(what=what, used=used))


def _explains(more_us: float, error: float) -> bool:
    """Whether a clock that has gone on by so much more explains an error of the difference."""
    return abs(error + more_us) < CLOCK.explained_share * abs(error)


class _Steps:
    """Steps from one stamp to the next."""

    def __init__(self) -> None:
        self._last: deque[int] = deque(maxlen=CLOCK.steps)
        self.usual_us = 0.0
        self._deviation_us = 0.0
        """Mean deviation of single steps from the usual one."""
        self.lossless = 0
        """Number of steps since samples were lost."""

    def take(self, step_us: int) -> None:
        if step_us <= 0:
            return
        self._last.append(step_us)
        steps_us: list[float] = sorted(self._last)
        single_us = steps_us[len(steps_us) // 4]  # many are longer, where samples are lost
        if steps_us[-1] >= 1.5 * single_us:
            steps_us = [step_us / max(1, round(step_us / single_us)) for step_us in steps_us]
        self.usual_us = float(median(steps_us))
        self.lossless = self.lossless + 1 if step_us < 1.5 * self.usual_us else 0
        if self.lossless:
            self._deviation_us += (abs(step_us - self.usual_us) - self._deviation_us) / CLOCK.steps

    def skips(self, step_us: int, passed_us: int) -> bool:
        """Whether the clock has gone further than samples lost since the last one, ``passed_us`` ago, explain."""
        usual_us = self.usual_us
        if not usual_us or step_us <= passed_us:
            return False
        steps = max(round(step_us / usual_us), 1)
        if steps > 1 + CLOCK.skipped and self.lossless >= CLOCK.lossless and passed_us < 2.0 * usual_us:
            return True
        # The usual step is known to a fraction of the deviation, which adds up over many.
        even_us = max(CLOCK.even_us, CLOCK.even_deviations * self._deviation_us) * max(1.0, steps / CLOCK.skipped)
        return abs(step_us - steps * usual_us) > even_us and even_us < 0.25 * usual_us


class _Run:
    """Samples in a row whose difference is off to the same side."""

    def __init__(self, side: int, far: bool, before_us: int, front_us: int) -> None:
        self.side, self.far = side, far
        self.since_us = self.first_arrival_us = before_us
        """Arrival of the sample before the run, and of its first."""
        self._front_us = front_us
        """The latest device time before it,"""
        self._first_us: int | None = None
        self._newest_us: int | None = None
        """the first and the latest in it."""
        self._count = 0
        """Samples in it that came in order."""
        self.jumped = False
        """Whether the clock has skipped a time on the way."""
        self._last: deque[tuple[int, float]] = deque()

    def take(self, arrival_us: int, difference: float, device_us: int) -> None:
        if not self._last:
            self.since_us = max(self.since_us, arrival_us - CLOCK.withheld_us // 2)
            self.first_arrival_us = arrival_us
        self._last.append((arrival_us, difference))
        while len(self._last) > CLOCK.steady_count and arrival_us - self._last[1][0] >= CLOCK.steady_us:
            self._last.popleft()
        if self._newest_us is None or device_us > self._newest_us:
            self._newest_us = device_us
            self._count += 1
        if self._first_us is None:
            self._first_us = device_us

    def repeats(self, usual_us: float, late_us: float) -> bool:
        """Whether the device's clock has gone back: it shows, in order, times that it has shown before."""
        if self._newest_us is None or self._first_us is None or late_us <= 0.0:
            return False
        if late_us > CLOCK.most_latency_us and self._newest_us < self._front_us:
            return True
        back_us = self._front_us + usual_us - self._first_us
        again_us = self._count * usual_us - (self._newest_us - self._front_us)
        return abs(late_us - back_us) < CLOCK.explained_share * late_us and again_us > CLOCK.again_share * late_us

    @property
    def middle(self) -> float:
        """Median difference of the last samples."""
        return median([difference for _, difference in self._last])

    def is_steady(self, arrival_us: int) -> bool:
        """Whether the last samples agree."""
        if len(self._last) < CLOCK.steady_count or arrival_us - self._last[0][0] < CLOCK.steady_us:
            return False
        differences = [difference for _, difference in self._last]
        return max(differences) - min(differences) <= CLOCK.steady_spread_us
