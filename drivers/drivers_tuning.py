"""Tuned numbers, by module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FrameClockTuning:
    """Constants of :mod:`autopilot.drivers.frame_clock`."""

    first: int = 60
    """Arrivals before the period is estimated; until then arrival times are used."""
    again: int = 15
    """Arrivals between estimates of the period, which take milliseconds."""
    window: int = 240
    """Arrivals that the line goes through: 8 s at 30 Hz, in which clocks of cameras drift by less than a
    millisecond."""
    least_order: float = 0.45
    """Phase coherence of periodic arrivals (1 = all at the same phase): arrivals without a period reach about 0.35 at
    best."""
    least_fraction: float = 0.65
    """The longest beat that comes so near to the best is it: half of a beat and a third are beats, too."""
    clip: float = 2.5
    """Arrivals farther from the line than so many standard deviations pull it no more than that."""
    scatter_most: float = 0.25
    """Standard deviation about the line, in beats, at which there is none: arrivals at any time have 0.29."""
    early_sigmas: float = 3.3
    early: tuple[float, float] = (0.05, 0.45)
    """Earliest arrival in standard deviations, and its bounds in periods; an arrival later than the rest of a period is
    taken for the next image. Delays have long tails on one side only."""
    pause_beats: float = 60.0
    """Missing images after which the period is estimated again."""
    lost_count: int = 20
    """Consecutive arrivals off the line on one side after which the transport has changed, and the line is
    restarted."""
    stream_window: int = 1800
    """Arrivals that show the offset of a stream's clock: a minute at 30 Hz."""
    quickest_percent: float = 10.0
    pause_us: float = 2_000_000.0
    step_us: float = 200_000.0
    """A stream's clock begins anew after a longer step, a step back, or when :attr:`lost_count` arrivals in a row are
    so far off."""
    stream_sigma_us: float = 1000.0
    """Of its stamps: encoder and rolling shutter."""
    few: int = 8
    unknown_sigma_us: float = 10_000.0
    """Jitter that is assumed until there are more arrivals."""
    mad_sigma: float = 1.4826
    """Standard deviation over median distance from the median, of a normal distribution."""


FRAMES = FrameClockTuning()
