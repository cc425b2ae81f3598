"""Constants of fence and obstacle constraints, by module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FeaturesTuning:
    """Constants of :mod:`autopilot.control.constraints.features`."""

    tiny_m: float = 1e-9
    far_m: float = 1e6
    """Stands for "no boundary anywhere near"."""
    many_features: int = 16
    """With more features than this, distant ones are left out (not by the compiled half-planes)."""
    on_edge: float = 1e-9
    """A projection beyond an edge by this share still counts as on the edge."""


FEATURES = FeaturesTuning()


@dataclass(frozen=True, slots=True)
class TracksTuning:
    """Constants of :mod:`autopilot.control.constraints.tracks`."""

    standing_m_s: float = 0.03
    """Slower tracks are static."""
    growth_m_s: float = 0.02
    """Growth rate of a moving track's radius: assumed error of its velocity."""
    largest_growth_m: float = 0.3
    """Beyond this much a circle would only make the vehicle boxed in."""
    forget_moving_us: int = 5_000_000
    forget_standing_us: int = 300_000_000
    """After so long without news: a mover is somewhere else, what stands is likely to stand there still."""
    deep_m: float = 1.0
    """A vehicle that is so far inside of something is not: the report is wrong, or the circle round a ship is mostly
    water. There is no way out of it, and a vehicle that flees from everywhere presses against its fence."""
    max_tracks: int = 32
    """The oldest one is dropped for a new one."""
    largest_radius_m: float = 100.0
    fastest_m_s: float = 10.0
    farthest_m: float = 1e5
    """Values beyond these are taken for errors."""
    moved_m: float = 0.05
    """What stands and is seen this far from where it was believed to be has been moved: routes are planned anew."""
    waiting_m_s: float = 0.05
    waited_us: int = 8_000_000
    """A vehicle slower than that with a moving obstacle on its way waits; after so long it looks for another way ..."""
    detour_us: int = 15_000_000
    """... for so long."""


TRACKS = TracksTuning()
