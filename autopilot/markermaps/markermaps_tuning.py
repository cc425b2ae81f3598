"""Tuned numbers of marker maps, by module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class AdjustmentTuning:
    steps: int = 40
    first_damping: float = 1e-10
    last_damping: float = 1e-13
    """Shares of the diagonal that are added to it. Scale and bending of a whole floor are worth a billionth of what a
    single corner is: more damping would hold them where the first guess has them."""
    converged: float = 1e-7
    """Share of the cost that a step must win for another one to be tried."""
    shrink_px: float = 0.25
    shrink_sigma_px: float = 0.15
    """Prior of the corners' shift towards the centre, common,"""
    view_shrink_sigma_px: float = 0.1
    """and of what a view adds to it."""
    of_view: int = 7
    """Unknowns of a view: place, turn, shrink."""
    min_sigma_px: float = 0.03
    loss_sigmas: float = 2.5
    """Residuals of more than this count less and less (Cauchy)."""
    chunk: int = 256
    """Columns of the inverse that are solved for at a time."""


ADJUSTMENT = AdjustmentTuning()


@dataclass(frozen=True, slots=True)
class BootstrapTuning:
    agree_px: float = 12.0
    """Corners of a known marker lie this close to where the pose of the others puts them."""
    same_fraction: float = 0.5
    """A marker within this share of :data:`AMBIGUITY_M` of a known one of its id is that one."""
    most_hypotheses: int = 12
    """Markers of a view whose own poses are tried."""
    enough_fraction: float = 0.6
    """Share of agreeing known markers after which the search ends."""
    certain: int = 4
    """Number of agreeing markers that excludes coincidence; fewer are enough with a unique id."""
    max_passes: int = 6
    recognised_views: int = 24
    """Views, evenly among all, with which the position in a rough map is searched."""
    rough_slack: float = 3.0
    """By how much a rough map's markers may be farther off: 36 pixels, some centimetres."""
    bend_steps: int = 3
    """Behind a flat port rays have no common centre: PnP is repeated with points moved to where rays seem to pass."""


BOOTSTRAP = BootstrapTuning()


@dataclass(frozen=True, slots=True)
class CheckTuning:
    quiet_cells: float = 1.0
    """A black square needs this many of its cells of white around it, or detectors take two markers for one."""
    heights_m: tuple[float, float, float, float] = (0.3, 0.45, 0.8, 1.2)
    """Camera heights over the floor that are searched."""
    poses: int = 400
    """Random places and headings for each height."""
    above_m: float = 0.01
    """Depths are measured that well: markers higher above the water are a depth with the wrong sign."""


CHECK = CheckTuning()


@dataclass(frozen=True, slots=True)
class ScaleTuning:
    print_fraction: float = 0.003
    """Standard deviation of a print's scale, and of the blur at its edges."""
    tape_m: float = 0.001
    """Standard deviation of a measured length."""
    network_factor: float = 2.0
    """By so much the sigmas of a network without fixed markers are too small."""
    sigmas: float = 3.0
    """Lengths that are farther off are refused."""


SCALE = ScaleTuning()


@dataclass(frozen=True, slots=True)
class SheetsTuning:
    footer_mm: float = 9.0
    """Below the cut area, for the scale bar and the sheet's name."""
    mark_mm: float = 4.0
    """Length of crop marks, outside of what they crop."""
    bar_mm: float = 100.0
    label_mm: float = 2.5
    """Largest height of a marker's label."""
    label_place: float = 0.42
    label_fraction: float = 0.3
    """Baseline and height of a label in shares of the gap below its marker."""
    min_label_mm: float = 0.8
    max_pages: int = 2000


SHEETS = SheetsTuning()


@dataclass(frozen=True, slots=True)
class SightingsTuning:
    most_of_a_film: int = 120
    """Frames of a video that are used."""
    misread_cells: int = 2
    """Number of wrong cells in a sighting from which it is reported: a bad print, an object on it, or no marker at
    all."""
    min_markers: int = 2
    """A view of fewer markers ties nothing to anything."""


SIGHTINGS = SightingsTuning()


@dataclass(frozen=True, slots=True)
class SurveyTuning:
    min_sights: int = 2
    """A marker that fewer views show is left out of the map: nothing checks it."""
    fixed_sigma: tuple[float, float] = (0.0001, 0.0005)
    """Place [m] and angle [rad] of markers whose pose is given."""
    misread_fraction: float = 1.0 / 3.0
    """A marker whose cells are wrong in this fraction of its sights is worth a word."""
    shrink_sigmas: float = 5.0
    """Blur draws corners inwards by no more than so many sigmas of the prior: what is beyond is a wrong size."""
    used_weight: float = 0.25
    """A sight whose corners weigh less than this on average was rejected."""


SURVEY = SurveyTuning()
