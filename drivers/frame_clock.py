"""Exposure times of images without stamps: a filter for the camera's period that rejects transport jitter.

A camera exposes periodically; encoders, networks and load delay each image at random. The arrivals scatter about a
line (time over frame number), and the line is closer to the exposure than the arrival. Its mean delay remains; that is
``latency_s`` of a camera. A camera without a period (longer exposure in the dark, external trigger) is detected by
arrivals that are uniformly distributed between two frames; arrival times are then used as they are.
"""

import math
import time
from collections import deque

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.drivers.drivers_tuning import FRAMES

TRIED = np.geomspace(0.28, 1.4, 800)
"""Beats that are tried, in median steps: of a stream that loses most pictures a step is two or three beats, and a
step's delay may be a third of a beat more than the one's before."""


def machine_us() -> int:
    """The machine's clock that only counts."""
    return time.monotonic_ns() // 1000


class LoopTime:
    """Converts the machine's monotonic clock to the loop's time.

    Polls give the loop's time, which is the due time of the tick: a late tick gives a value that is too small. The
    largest difference over some seconds is that of a punctual tick.
    """

    def __init__(self, polls: int = 200) -> None:
        self._ahead_us: deque[int] = deque(maxlen=polls)

    def observe(self, t_us: int, clock_us: int) -> None:
        """Add a pair: loop time ``t_us``, machine clock ``clock_us``."""
        self._ahead_us.append(t_us - clock_us)

    def at(self, clock_us: int) -> int:
        """Loop time [us] for a machine time; needs at least one pair."""
        return clock_us + max(self._ahead_us)


class StreamClock:
    """Stamps of a stream that are times (RTP, V4L2) on the machine's clock.

    Between both is an offset, which the quickest arrivals of a minute show: load and retransmission delay the others.
    What the mean of the first arrivals was later than the quickest of them is added, as ``latency_s`` is a mean.
    """

    def __init__(self) -> None:
        self._late_us: deque[float] = deque(maxlen=FRAMES.stream_window)
        self._last_us = 0.0
        self._arrivals = self._off = 0
        self._offset_us = self._mean_us = 0.0

    def stamp(self, arrival_us: int, stream_us: float) -> int | None:
        """Arrival time of this image at the mean delay [us]; None while that is not known."""
        late_us = self._late_us
        if not 0.0 < stream_us - self._last_us < FRAMES.pause_us or self._off >= FRAMES.lost_count:
            late_us.clear()
            self._arrivals = self._off = 0
        self._last_us = stream_us
        late_us.append(arrival_us - stream_us)
        self._arrivals += 1
        if self._arrivals < FRAMES.first:
            return None
        if self._arrivals % FRAMES.again == 0:
            values = np.array(late_us)
            quickest_us = float(np.percentile(values, FRAMES.quickest_percent))
            if self._arrivals == FRAMES.first:
                self._mean_us = float(values.mean()) - quickest_us
            self._offset_us = quickest_us + self._mean_us
        self._off = self._off + 1 if abs(late_us[-1] - self._offset_us) > FRAMES.step_us else 0
        return round(stream_us + self._offset_us)


class FrameClock:
    """Without stamps of a stream."""

    def __init__(self) -> None:
        self._times_us: deque[int] = deque(maxlen=FRAMES.window)
        self._line: _Line | None = None
        self._off = 0
        self._unplaced = 0
        """Arrivals without a period since the last estimate."""

    @property
    def rate_hz(self) -> float:
        """Estimated frame rate [Hz]; 0 = no period found."""
        return 0.0 if self._line is None else 1e6 / self._line.beat_us

    @property
    def sigma_us(self) -> float:
        """Standard deviation of the last stamp about the exposure and the mean delay."""
        times = self._times_us
        if self._line is not None:
            return self._line.stamp_sigma_us(len(times))
        if len(times) <= FRAMES.few:
            return FRAMES.unknown_sigma_us
        steps_us = np.diff(np.array(times, dtype=float))
        off_us = np.abs(steps_us - np.median(steps_us))
        return float(np.median(off_us)) * FRAMES.mad_sigma / math.sqrt(2.0)  # a step has the jitter of two arrivals

    def stamp(self, arrival_us: int) -> int:
        """Arrival time of this image at the mean delay [us]. Arrivals must be in order."""
        times, line = self._times_us, self._line
        if times and (arrival_us <= times[-1] or (line and arrival_us - times[-1] > FRAMES.pause_beats * line.beat_us)):
            times.clear()
            self._line = line = None
        times.append(arrival_us)
        if line is not None:
            self._follow(line)
        else:
            self._unplaced += 1
            if len(times) >= FRAMES.first and self._unplaced >= FRAMES.again:
                self._unplaced = 0
                self._line = _find(np.array(times, dtype=float))
        line = self._line
        return arrival_us if line is None else round(line.of(arrival_us))

    def _follow(self, line: "_Line") -> None:
        """The line anew with the last arrival; none if arrivals do not keep to it."""
        off = (self._times_us[-1] - line.of(self._times_us[-1])) / max(line.sigma_us, 1.0)
        same_side = self._off * off >= 0.0
        self._off = (self._off if same_side else 0) + (int(math.copysign(1, off)) if abs(off) > FRAMES.clip else 0)
        if abs(self._off) >= FRAMES.lost_count:
            self._off = 0
            while len(self._times_us) > FRAMES.first:
                self._times_us.popleft()
            self._line = None
        else:
            self._line = line.through(np.array(self._times_us, dtype=float))


class _Line:
    """Time over number: ``at_us + n beat_us``."""

    def __init__(self, at_us: float, beat_us: float, sigma_us: float) -> None:
        self.at_us, self.beat_us, self.sigma_us = at_us, beat_us, sigma_us
        self._early = min(max(FRAMES.early_sigmas * sigma_us / beat_us, FRAMES.early[0]), FRAMES.early[1])

    def stamp_sigma_us(self, count: int) -> float:
        """Standard deviation at the end of the line through ``count`` arrivals, wrongly numbered ones among them."""
        wrong = math.erfc(0.5 * self.beat_us / (math.sqrt(2.0) * self.sigma_us))
        return math.hypot(2.0 * self.sigma_us / math.sqrt(count), self.beat_us * math.sqrt(wrong))

    def of(self, time_us: float) -> float:
        return self.at_us + math.floor((time_us - self.at_us) / self.beat_us + self._early) * self.beat_us

    def through(self, times_us: FloatArray) -> "_Line | None":
        """The line through these arrivals, numbered by this one; None if they have no beat."""
        numbers = np.floor((times_us - self.at_us) / self.beat_us + self._early)
        middle = float(numbers.mean())
        x = numbers - middle
        off = times_us - (self.at_us + numbers * self.beat_us)
        off = np.clip(off, -FRAMES.clip * self.sigma_us, FRAMES.clip * self.sigma_us)
        mean, slope = float(off.mean()), float(x @ off / max(float(x @ x), 1.0))
        rest = off - mean - slope * x
        sigma_us = max(math.sqrt(float(rest @ rest) / len(rest)) * 1.1, 0.005 * self.beat_us)  # 1.1: clipped
        if sigma_us > FRAMES.scatter_most * self.beat_us:
            return None
        number = round(middle)
        at_us = self.at_us + number * self.beat_us + mean + slope * (number - middle)
        return _Line(at_us, self.beat_us + slope, sigma_us)


def _find(times_us: FloatArray) -> _Line | None:
    """The beat in which arrivals are most alike (a peak of their periodogram); None if there is none."""
    begin_us = float(times_us[0])
    beats_us = float(np.median(np.diff(times_us))) * TRIED
    turns = np.modf((times_us[:, None] - begin_us) / beats_us)[0].astype(np.float32)
    angles = np.float32(2.0 * np.pi) * turns
    phasors = np.cos(angles).mean(axis=0) + 1j * np.sin(angles).mean(axis=0)
    orders = np.abs(phasors)
    peak = np.r_[False, (orders[1:-1] >= orders[:-2]) & (orders[1:-1] >= orders[2:]), False]
    good = np.flatnonzero(peak & (orders >= max(FRAMES.least_order, FRAMES.least_fraction * float(orders.max()))))
    if not len(good):
        return None
    beat_us, order = float(beats_us[good[-1]]), float(orders[good[-1]])
    phase = float(np.angle(phasors[good[-1]])) / (2.0 * math.pi)
    # Wrapped normal distribution: order = exp(-(2 pi sigma)^2 / 2).
    sigma_us = max(math.sqrt(max(-2.0 * math.log(order), 0.0)) / (2.0 * math.pi), 0.01) * beat_us
    line: _Line | None = _Line(begin_us + phase * beat_us, beat_us, sigma_us)
    for _ in range(3):
        line = line and line.through(times_us)
    return line
