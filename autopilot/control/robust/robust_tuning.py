"""Constants of robust control, by module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class AncillaryTuning:
    """Constants of :mod:`autopilot.control.robust.ancillary`."""

    state_weights: tuple[float, float, float, float, float, float, float, float] = (
        60.0,
        60.0,
        80.0,
        20.0,
        8.0,
        8.0,
        8.0,
        1.0,
    )
    """Error ahead, to starboard, depth, yaw, velocities. Per 0.1 s, as the optimiser's. Three times its weight on
    position: disturbances of 1 N then leave 3 cm, at bandwidths (1.5 1/s, yaw 4 1/s) that the thrusters' lag of 0.15 s
    allows."""
    thrust_weight: float = 0.02
    design_step_s: float = 0.02


ANCILLARY = AncillaryTuning()


@dataclass(frozen=True, slots=True)
class DisturbanceTuning:
    """Constants of :mod:`autopilot.control.robust.disturbance`."""

    bound_sigmas: float = 3.0
    """A bound is read as three standard deviations."""
    position_variance_limit_m2: float = 0.3**2
    velocity_variance_limit_m2_s2: float = 0.3**2
    """An estimate worse than this is one that navigation failsafes act upon; margins do not grow for ever with it."""


DISTURBANCE = DisturbanceTuning()


@dataclass(frozen=True, slots=True)
class MismatchTuning:
    """Constants of :class:`autopilot.control.robust.margins.SpeedEvidence`."""

    near_fraction: float = 0.8
    """Speeds above this fraction of the cap are used as evidence."""
    follow_s: float = 3.0
    """Faster changes of the speed are disturbances, not changes of the plan."""
    quick_s: float = 2.0
    slow_s: float = 6.0
    forget_s: float = 60.0
    """Time constants of decrease, increase, and of forgetting without evidence."""
    least_fraction: float = 0.5
    """Of the margin, whatever has been seen."""
    strong_ratio: float = 0.55
    strongest_ratio: float = 0.7
    """Credit is used in currents from such a share of the speed limit on, in full at the second: elsewhere there is
    speed enough."""
    shrink_m_s2: float = 0.005
    grow_m_s2: float = 0.05
    """The margin moves by no more than this: 0.25 and 2.5 mm/s from one step to the next."""
    largest_need: float = 4.0
    """Bound on the squared ratio of error to margin of one update: outliers are forgotten within seconds."""
    sigmas: float = 3.29
    """Margin in standard deviations: exceeded once in a thousand times."""
    longest_s: float = 0.2


EVIDENCE = MismatchTuning()


@dataclass(frozen=True, slots=True)
class WaterSpeedTuning:
    """Constants of :mod:`autopilot.control.robust.water_speed`."""

    models: tuple[tuple[float, float], ...] = (
        (0.002, 0.0025),
        (0.002, 0.007),
        (0.002, 0.02),
        (0.01, 0.0025),
        (0.01, 0.007),
        (0.01, 0.02),
        (0.01, 0.05),
        (0.03, 0.01),
        (0.1, 0.015),
        (0.3, 0.02),
        (0.1, 0.05),
    )
    """Change of the current per root metre of way [m/s] and unmodelled acceleration [m/s^2/sqrt(Hz)] of each filter:
    from still basins to jets of a tank, and from calm water to 2 N that change within a second."""
    uniform_per_root_m: float = 0.002
    mild_per_root_m: float = 0.01
    """Filters up to these changes stand for uniform water, and for water that is nearly so."""
    uniform: float = 0.5
    varying: float = 0.01
    refuted: float = 0.05
    """Probabilities. The result is used while that of uniform water is above the first and that of water that is not
    even nearly uniform below the second; below the third for uniform water the filters begin anew."""
    velocity_sigma_m_s: float = 0.01
    """Error of the estimated velocity over ground in one correction: twice that in simulated flights."""
    step_s: float = 0.09
    every_s: float = 0.19
    """Least time between predictions (two control steps) and between corrections: errors of the estimated velocity are
    correlated over about as long."""
    current_sigma_m_s: float = 0.25
    excess_sigma: float = 0.2
    """Before anything is known; the second is that of 20 % in drag or thrust."""
    known_sigma: float = 0.1
    """Standard deviation of the excess from which on it is used: half of the first one. Above, the result would be the
    assumption that 36 % are rare, and not what was seen."""
    excess_walk: float = 0.002
    """1/sqrt(s): growth, wear and supply change over minutes (estimator/tuning.py)."""
    inertia_error: float = 0.2
    inertia_s: float = 1.0
    """An acceleration is wrong by such a share for so long: errors of mass, thrust and lag."""
    at_rest_m_s: float = 0.02
    """Added to the way per second: water changes at a vehicle that stands still."""
    evidence_fraction: float = 0.5
    """Of every correction: consecutive ones are not independent."""
    largest_square: float = 16.0
    largest_odds: float = 8.0
    forget_s: float = 30.0
    """Bounds on one squared error and on the logarithm of the odds, and the time in which evidence is forgotten."""
    least_age_s: float = 6.0
    least_speed_m_s: float = 0.2
    """The speeds are compared from here on: below, small errors make a large ratio."""
    follow_s: float = 2.0
    """Low-pass on the ratio of the speeds."""
    likely_sigmas: float = 1.0
    sigmas: float = 2.0
    floor_m_s: float = 0.02
    """Always left of the limit: short disturbances, and what neither filter nor estimate knows."""
    shrink_m_s2: float = 0.02
    grow_m_s2: float = 0.05
    """The margin moves by no more than this."""
    longest_s: float = 0.3
    """After a longer pause the filters begin anew."""
    aslant_m_s: float = 0.03
    """Nothing is known of a vehicle whose tilt turns so much of its heave into horizontal speed: its drag and thrust
    are not those of a level one."""


WATER_SPEED = WaterSpeedTuning()


@dataclass(frozen=True, slots=True)
class FallbackTuning:
    """Constants of :mod:`autopilot.control.robust.fallback`."""

    position_gain_1_s: float = 0.4
    yaw_gain_1_s: float = 0.8
    velocity_gain_1_s: float = 1.5
    speed_limit_m_s: float = 0.15
    heave_limit_m_s: float = 0.1
    yaw_rate_limit_rad_s: float = 0.4
    water_speed_limit_m_s: float = 0.4
    over_steps: int = 20
    """Solved steps (1 s) after which a fallback is over: an intermittent one is reported once."""


FALLBACK = FallbackTuning()


@dataclass(frozen=True, slots=True)
class RegionsTuning:
    """Constants of :mod:`autopilot.control.robust.regions`."""

    answer_steps: int = 20
    """A certificate is taken so many control steps after it was asked for (1 s at 20 Hz): nothing waits for it."""
    current_step_m_s: float = 0.06
    """A goal is certified anew when the current there has changed by this."""
    buoyancy_step_n: float = 0.5
    """The same of the buoyancy that the vehicle has proved to have."""
    here_m: float = 1.0
    """The current where the vehicle is counts as that at its goal within this."""
    at_goal_m: float = 0.02
    at_goal_rad: float = 0.05
    """The end of a reference counts as the goal within these."""


REGIONS = RegionsTuning()


@dataclass(frozen=True, slots=True)
class StationTuning:
    """Constants of :mod:`autopilot.control.robust.station`."""

    hold_radius_m: float = 0.25
    hold_yaw_rad: float = 0.35
    hold_speed_m_s: float = 0.45
    hold_heave_m_s: float = 0.25
    hold_yaw_rate_rad_s: float = 1.0
    """The region in which the local law takes over from the cascade."""
    hold_samples: int = 2_000
    current_step_m_s: float = 0.05
    buoyancy_step_n: float = 0.5
    """The local law is made anew when the current or the buoyancy has changed by this."""


STATION = StationTuning()


@dataclass(frozen=True, slots=True)
class TerminalTuning:
    """Constants of :mod:`autopilot.control.robust.terminal`."""

    kappa: float = 1.3
    """With 1 the sampled decrease of the nonlinear model fails by 2 %; between 1.2 and 1.5 it holds."""
    samples: int = 20_000
    seed: int = 20_181_018
    shrink: float = 0.8
    """Factor on alpha after a sample that violates the decrease."""
    least_alpha: float = 1e-9
    free_yaw_rad: float = 0.5
    """Band of the heading where a goal leaves it free: beyond, the linearisation is another one."""


TERMINAL = TerminalTuning()


@dataclass(frozen=True, slots=True)
class TubeTuning:
    """Constants of :mod:`autopilot.control.robust.tube`."""

    force_correlation_s: float = 1.0
    current_correlation_s: float = 2.0
    """Correlation times of disturbances: the estimated current follows within about these times."""
    disc_sigmas: float = 3.72
    """A disc of so many standard deviations holds 99.9 % of a normal distribution in the plane: sqrt(-2 ln 0.001)."""
    band_sigmas: float = 3.29
    """The same for one dimension."""
    estimate_speed_sigmas: float = 2.0
    """Fraction of the estimate's spread in speed limits: they concern performance, not safety, and the estimator is
    conservative (errors are about half of its standard deviation)."""
    largest_fraction: float = 0.5
    """Back-offs never take more of a limit than this, however bad the estimate is: then failsafes act."""
    largest_thrust_fraction: float = 0.3
    """Fraction of the thrust limit; applied by the controller."""
    largest_clearance_m: float = 0.3
    growth_step_s: float = 0.05
    groups: int = 3
    """Force, moment, current error: their variances come at run time."""
    given: int = 28
    """Constants of the compiled library: see its enum."""
    states_out: int = 10
    """xx, xy, yy, zz, yaw, uu, uv, vv, ww, rr; the thrusts follow."""


TUBE = TubeTuning()


@dataclass(frozen=True, slots=True)
class YawRateTuning:
    """Constants of :class:`autopilot.control.robust.margins.YawRateExcess`."""

    follow_s: float = 0.1
    """Low-pass on the residual: two control steps. The gyros' noise is then 0.015 rad/s of the back-off (standard
    deviation); with half as much again the start of a turn is seen too late."""
    step_s: float = 0.05
    """Beside the thrusters' lag a command waits for no more than one control step."""
    longest_s: float = 0.2
    """After a longer pause nothing is known."""


YAW_RATE = YawRateTuning()
