"""Constants of path planning and guidance, by module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DriveTuning:
    """Constants of :mod:`autopilot.control.path.drive`."""

    step_m: float = 0.12
    """Sampling distance of the path ahead."""
    most_steps: int = 150
    slowest_m_s: float = 0.01
    """Slower than this is standing: the place is held."""
    keep_extra_m: float = 0.02
    """Clearance of the path beyond the controller's, so that its reference can be followed."""
    pushes: int = 3
    """A step that ends too near to boundaries is pushed out of one after the other."""
    too_near_m: float = 5e-3
    """Remaining distance to boundaries that is missing after that, above which the path ends."""
    least_progress: float = 0.15
    """Smallest remaining fraction of a step at a boundary (about a perpendicular approach); below it the path ends."""
    fraction_over_m: float = 0.25
    """Distance ahead over which the speed along a boundary is the component of the velocity along it."""
    turn_fraction: float = 0.9
    """Share of the yaw rate limit that is asked for at most."""
    catch_up_s: float = 1.5
    """A heading that turns is caught up with in about so long."""
    hold_speed_m_s: float = 0.15
    """Speed at which a place that is held is come back to."""


DRIVE = DriveTuning()


@dataclass(frozen=True, slots=True)
class GuidanceTuning:
    """Constants of :mod:`autopilot.control.path.guidance`."""

    velocity_weights: tuple[float, float, float, float] = (8.0, 8.0, 8.0, 0.5)
    """Weights on u, v, w [1/(m/s)^2] and r [1/(rad/s)^2]: enough to hold the cruise speed."""
    replan_distance_m: float = 0.3
    replan_interval_us: int = 1_000_000
    """A vehicle that has been pushed this far off its route gets a new one, at most once a second."""
    answer_steps: int = 2
    """A route that is not a straight line comes so many control steps after it was asked for: 0.1 s at 20 Hz."""
    patience_steps: int = 20
    """Goals and fences that change faster than routes are found: after so many steps (1 s) without an answer the open
    search is left to end, and its route is taken if it is free."""
    least_progress_fraction: float = 0.8
    least_progress_m_s: float = 0.05
    """Progress that is expected of the vehicle: this share of the speed over ground that is asked for, at most so
    much."""
    facing_m: float = 0.1
    """A point of interest nearer than this gives no heading."""


GUIDANCE = GuidanceTuning()


@dataclass(frozen=True, slots=True)
class PlannerTuning:
    """Constants of :mod:`autopilot.control.path.planner`."""

    planning_extra_m: float = 0.04
    """Kept beyond the controller's own radius, so that the path lies where the controller can follow it with a margin,
    and a passage that is open by centimetres only is not chosen."""
    check_step_m: float = 0.05
    """Sampling distance of straight lines."""
    open_water_border_m: float = 3.0
    """Without a workspace the grid covers start, goal and obstacles and this much beyond ..."""
    open_water_step_m: float = 2.0
    """... up to the next multiple of this: a start that has moved a little has the same grid."""
    check_length_m: float = 10.0
    """Length of a path of an earlier fence that is checked before it is continued."""
    goal_snap_m: float = 0.3
    """A goal this near to free ground is approached as far as the constraints allow."""
    endpoint_relief_m: float = 0.25
    """Near its ends a straight line may be as near to a boundary as the end itself."""
    band_step_m: float = 0.1
    max_band_points: int = 60
    band_iterations: int = 25
    """Enough to round a corner over half a metre."""
    knight: tuple[tuple[int, int], tuple[int, int], tuple[int, int], tuple[int, int]] = (
        (1, 2),
        (2, 1),
        (1, -2),
        (2, -1),
    )
    """Moves beside those to the neighbours, so that ways have 16 directions."""


PLANNER = PlannerTuning()


@dataclass(frozen=True, slots=True)
class ReferenceTuning:
    """Constants of :mod:`autopilot.control.path.reference`."""

    margin_at_m_s: float = 0.5
    """Planar speed limit up to which MPC_SPEED_MARGIN holds."""
    deceleration_m_s2: float = 0.12
    heave_deceleration_m_s2: float = 0.1
    yaw_deceleration_rad_s2: float = 0.4
    """Deceleration of the approach to the goal: v = sqrt(2 a d)."""
    yaw_rate_fraction: float = 0.55
    """Share of the yaw rate limit that a planned turn uses."""
    heave_fraction: float = 0.6
    """Share of the heave limit that a planned change of depth uses."""
    min_depth_time_s: float = 1.0
    turn_ahead_m: float = 0.6
    """Lookahead distance of a free heading along the route."""
    corner_ahead_m: float = 0.2
    """The speed is chosen for the direction of the route this far ahead."""
    water_speed_fraction: float = 0.95
    upstream_speed_fraction: float = 0.985
    """Share of the planar speed limit that the reference asks for, and that it asks for against currents that are
    nearly as fast: there every centimetre per second of it is way that is made."""
    slow_current_fraction: float = 0.78
    fast_current_fraction: float = 0.88
    """Range of opposing current relative to the limit over which one is blended into the other."""
    slowest_m_s: float = 0.02
    turn_hysteresis_rad: float = 0.5
    """A half turn keeps its direction until the other way is shorter by this much."""
    turn_tie_rad: float = 0.2
    """Ways round that differ by less than twice this are about equal: 0.4 s of turning at the yaw rate limit."""


REFERENCE = ReferenceTuning()


@dataclass(frozen=True, slots=True)
class StrongStreamTuning:
    """Constants of :mod:`autopilot.control.path.strong_stream`."""

    enter_ratio: float = 0.8
    leave_ratio: float = 0.7
    """A stream is strong from the first share of the planar speed limit less MPC_SPEED_MARGIN on, and no more below the
    second."""
    least_made_m_s: float = 0.1
    """Taken for that difference at least: slower streams have no direction."""
    follow_s: float = 1.0
    """Time constant on the estimated current, whose noise must not move the speed limit from step to step."""
    thrust_fraction: float = 0.9
    regained_fraction: float = 0.8
    """A heading that needs more than this share of a thruster's limit is given up, and comes back below the second: the
    rest is for control and for thrust weaker than the vehicle file says."""
    left_radii: float = 2.0
    """A goal that has been reached is left beyond so many acceptance radii."""
    headway_m_s: float = 0.15
    """Speed over ground that the margin of the planar speed makes way for."""
    limit_fraction: float = 0.96
    """Of the planar speed limit that is used at most: the rest is the error of the estimate, seen in flight."""
    escape_m_s: float = 0.05
    """Headway near a boundary, beyond the limit if need be."""
    lee_m: float = 0.5
    """Boundaries so far downstream count as near."""
    near_m: float = 0.15
    far_m: float = 0.5
    """Clearances of the hull between which the speed limit gives way to the escape."""
    unlimited_n: float = 1e4
    """Thrust that no vehicle needs, to see how much a speed would take."""
    halvings: int = 10
    """The speed that can be made is known to a thousandth."""


STRONG_STREAM = StrongStreamTuning()
