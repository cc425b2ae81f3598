"""Constants of the current models, by module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CurrentLearningTuning:
    """Constants of :mod:`autopilot.control.current.current_learning`."""

    flow_m_s: tuple[float, float, float] = (0.2, 0.1, 0.03)
    """Standard deviations of the varying part of the flow that are weighed against each other ..."""
    closed_flow_prior: tuple[float, float, float] = (0.6, 0.3, 0.1)
    open_flow_prior: tuple[float, float, float] = (0.15, 0.25, 0.6)
    """... and how likely each is beforehand: in a closed basin what flows must turn, in open water it mostly flows
    on."""
    closed_mean_m_s: float = 0.03
    open_mean_m_s: float = 0.3
    """Standard deviation of the uniform part: in a closed basin, and in open water."""
    noise_m_s: float = 0.03
    """Standard deviation of a cell's mean estimate: the estimate lags, and contains model errors."""
    length_fraction: float = 0.25
    """Correlation length over the narrowest width of the workspace: a jet and its return flow side by side need it."""
    open_length_m: float = 6.0
    """Without a workspace: eddies and jets that a small vehicle meets within minutes."""
    evidence_fraction: float = 0.5
    """Exponent of the likelihood: neighbouring estimates err alike, because they lag."""
    shortest_m: float = 0.3
    longest_m: float = 50.0
    cells_per_length: float = 2.5
    max_cells: int = 100
    forget_s: float = 900.0
    """Time constant of forgetting."""
    refresh_s: float = 1.0
    """The fit is made anew at most so often."""
    full_weight_s: float = 0.5
    """An estimate counts in full after so much time in its cell."""


CURRENT_LEARNING = CurrentLearningTuning()


@dataclass(frozen=True, slots=True)
class CurrentMapTuning:
    """Constants of :mod:`autopilot.control.current.current_map`."""

    depth: int = 1
    north: int = 2
    east: int = 3


CURRENT_MAP = CurrentMapTuning()


@dataclass(frozen=True, slots=True)
class CurrentMemoryTuning:
    """Constants of :mod:`autopilot.control.current.currents`."""

    cells_per_scale: int = 4
    """Nodes per length over which the current changes."""
    spread: float = 0.2
    """An observation counts for the nodes round it by a Gaussian of this share of that length ..."""
    reach: int = 2
    """... and for those of 5 x 5 at most."""
    nodes: int = 128
    """Per side: a window of 32 lengths that wraps round. A node forgets one place when it gets another."""
    variance_floor_m2_s2: float = 0.02**2
    """An estimate is not better than this whatever its covariance says: it lags behind a current that varies along the
    way, and it carries what the model lacks, which depends on the manoeuvre."""
    forget_s: float = 900.0
    """Time constant of forgetting."""
    longest_lesson_s: float = 0.2
    """Largest duration weight of one update, whatever the time since the last."""


CURRENT_MEMORY = CurrentMemoryTuning()


@dataclass(frozen=True, slots=True)
class CurrentTrustTuning:
    """Constants of :mod:`autopilot.control.current.current_learning`."""

    step_fraction: float = 0.2
    """Looks are so far apart, in lengths of the flow ..."""
    least_step_m: float = 0.1
    near_fraction: float = 0.4
    far_fraction: float = 2.5
    """... and a forecast is judged when it was made between so many lengths from here."""
    kept: int = 16
    """Forecasts on their way to be judged."""
    error_m_s: float = 0.05
    """Standard deviation of a forecast that is right, and of the estimate that judges it."""
    worst: float = 3.0
    """Largest change of the log-likelihood ratio by one update: one bad estimate decides nothing."""
    limit: float = 3.0
    """Bounds of the log-likelihood ratio, so that a decision can be reversed within a few updates."""
    sure: float = 2.0
    unsure: float = -2.0
    """Balance to begin with: in a basin that is known to be closed and in open water, and within a fence of which
    nothing is known. Eddies of open water are over before a forecast has proved itself. A fence is no wall, but the
    flow's length is taken from it: near the speed limit a promise of a little less current beside the vehicle is worth
    a detour, so it has to be earned there."""
    ramp_s: float = 1.0
    """The share that is used follows the balance with this time constant: plans do not jump."""


CURRENT_TRUST = CurrentTrustTuning()


@dataclass(frozen=True, slots=True)
class CurrentsTuning:
    """Constants of :mod:`autopilot.control.current.currents`."""

    material_m_s: float = 0.03
    """A forecast that has changed by more than this is another one: a tenth of the usual cruise speed."""
    tank_scale_m: float = 1.0
    """Length over which the current in a tank changes: a jet of a thruster, 0.7 m wide."""
    open_water_scale_m: float = 10.0
    """The same outdoors: eddies behind piers; correlation length of what ocean models miss."""
    full_within_m: float = 0.3
    """The present correction holds in full so far round the vehicle, the acceptance ball of a goal; beyond it fades by
    a Gaussian of the field's scale."""
    lasting_s: float = 30.0
    """It does not fade with time within this: longer than any prediction of the controller."""
    fade_s: float = 600.0
    """Beyond, it fades exponentially: tides turn within hours."""


CURRENTS = CurrentsTuning()


@dataclass(frozen=True, slots=True)
class BuoyancyEstimatorTuning:
    """Constants of :mod:`autopilot.control.current.buoyancy`."""

    first_s: float = 0.5
    """What is found first is believed within about this time, what is found later as the mean of all that was seen,
    ..."""
    follow_s: float = 3.0
    """... and from then on within this: a wave of 6 s gets through by a third."""
    longest_s: float = 0.5
    """Longer gaps are not learned from."""
    submerged: float = 1.5
    """Above so many half heights of the hull below the surface the hull may lose buoyancy by coming out of the
    water."""
    most_fraction: float = 0.7
    """Beyond this share of the vertical thrust nothing is left to steer with: margins take 30 % of a thruster."""
    reported_fraction: float = 0.15
    """Fraction of the vertical thrust above which the operator is notified."""
    reported_after_s: float = 10.0
    """Once it has been learned from for so long ..."""
    stands_s: float = 3.0
    """... and has been beyond for so long."""


BUOYANCY_ESTIMATOR = BuoyancyEstimatorTuning()


@dataclass(frozen=True, slots=True)
class MapReadingTuning:
    """Constants of :mod:`autopilot.control.current.map_reading`."""

    plausible_m_s: float = 5.0
    """Faster than almost every tidal stream (Saltstraumen: up to 10 m/s in its narrows): wrong units or an undeclared
    fill value."""
    rectilinear_m: float = 1.0
    """Two-dimensional latitudes and longitudes that differ by less from row to row are still rows and columns."""
    metres_per_degree: float = 111_000.0
    """Roughly, for rectilinear_m only."""


MAP_READING = MapReadingTuning()
