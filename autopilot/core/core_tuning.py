"""Tuned numbers, by module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DeviceClockTuning:
    """Constants of :mod:`autopilot.core.device_clock`."""

    far_us: float = 50_000.0
    """A difference that is off by more belongs to late samples, another latency or another setting of the clock."""
    stays_far_us: float = 35_000.0
    """The same for the samples after one that is: hysteresis."""
    near_us: float = 6_000.0
    """One that is off by less is jitter."""
    early_us: int = 10_000
    """No stamp is later than the arrival by more, which drivers take off as latency."""
    steady_us: int = 150_000
    steady_count: int = 5
    """A difference is steady if so many samples over so long"""
    steady_spread_us: float = 25_000.0
    """are within this spread."""
    withheld_us: int = 400_000
    """Samples that may be stamped wrongly are withheld no longer than this: then arrivals are the stamps. Samples that
    are a little late (a busy machine) move the mean at once if they have been so for as long."""
    late_burst_us: int = 50_000
    """Samples that a stalled line delivers late come at once; those that stay late for longer have a wrong stamp."""
    even_us: float = 3_000.0
    even_deviations: float = 4.0
    """A step of the device is even if it differs from a multiple of the usual one by no more than this, or by so many
    of its mean deviations."""
    explained_share: float = 0.5
    """A step is part of a jump if the difference without it is below this fraction."""
    again_share: float = 0.8
    """Of a jump back, what is to be seen of the times that come again: samples get lost."""
    most_latency_us: float = 400_000.0
    """No line on which a vehicle is flown is slower: what arrives earlier by more has a clock that has jumped."""
    most_drift: float = 5e-4
    """Of a quartz."""
    lossless: int = 100
    skipped: int = 3
    """A line that has lost nothing for so many samples does not lose more than so many at once."""
    steps: int = 31
    """Number of steps that show the usual one."""
    settled: int = 100
    """Stamps after which a clock is known; until then it may be set without a notice."""
    often: int = 3
    often_us: int = 5_000_000
    """Number of jumps within a time after which arrivals are used as stamps, until there has been none for as long."""
    still_count: int = 10
    still_us: int = 100_000
    """So many equal stamps in a row over so long are those of a clock that stands still: links repeat single ones."""
    tell_every_us: int = 5_000_000
    any_span_us: int = 1 << 63
    """Of a clock that does not wrap."""


CLOCK = DeviceClockTuning()


@dataclass(frozen=True, slots=True)
class FreeSpaceTuning:
    """Constants of :mod:`autopilot.core.free_space`."""

    base_cells: int = 6000
    finest_base_m: float = 0.05
    """Cells to begin with, and how small they are at least."""
    tight_m: float = 0.02
    """Cells are halved down to this."""
    max_cells: int = 40_000
    """Largest number of cells; the rest stays coarse."""
    max_doubtful: int = 40_000
    """Cells of one size that are searched for a place in their parts; of more the rest counts as not free."""
    max_rounds: int = 24
    settled_m: float = 5e-4
    """Tolerance of the radius: passages that are open by a millimetre are found."""
    beyond_m: float = 2.5e-4
    """Aimed at beyond the radius, for the slope is only that of the nearest boundary."""
    settle_steps: int = 3
    """Steps towards the middle of a passage: each moves away from the nearer side."""
    comfort_steps: int = 2
    """Further steps towards positions with free lines to the neighbours, where there is space."""
    bisections: int = 9
    one_boundary: float = 0.8
    """Gradients within a cell whose unit vectors agree to this cosine belong to one boundary: a blocked link stays
    blocked."""
    first_attach: int = 4
    attach: int = 48
    """Number of nearest positions tried for one with a free line."""


SPACE = FreeSpaceTuning()
