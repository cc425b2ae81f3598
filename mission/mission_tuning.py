"""Tuned numbers of missions, by module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CalibrationTuning:
    margin_m: float = 0.05
    """Beyond the controller's own margin, to boundaries and to the ends of the depth band."""
    least_reach_m: float = 0.3
    most_reach_m: float = 0.5
    """Of the legs from their middle: shorter ones have no room to accelerate, longer ones take time."""
    accept_fraction: float = 0.5
    """Acceptance radius as a share of the reach."""
    least_height_m: float = 0.6
    """Over the floor: lower down the camera sees too few markers."""
    height_factor: float = 2.0
    least_factor: float = 1.25
    grid: int = 40
    """Places per axis in the search for room."""
    refinements: int = 3


CALIBRATION = CalibrationTuning()


@dataclass(frozen=True, slots=True)
class CirclingTuning:
    pull_1_s: float = 0.6
    """How fast a distance from the circle is made good."""
    pull_fraction: float = 0.7
    """Share of the speed that may go into it."""
    join_m: float = 0.25
    """Farther off, the circle's nearest point is a place to go to."""
    fresh_us: int = 50_000
    accept_yaw_rad: float = 0.15
    yaw_fraction: float = 0.5
    """Share of SPD_YAW_MAX that a circle on which the heading turns may use."""
    ring_step_m: float = 0.01
    """Minimum length to which arcs of a circle are bisected."""
    ring_arcs: int = 72
    ring_parts: int = 4
    """Arcs that a circle begins with, and parts that an arc is divided into."""


CIRCLING = CirclingTuning()


@dataclass(frozen=True, slots=True)
class GoalsTuning:
    stop_deceleration_m_s2: float = 0.25
    """Deceleration on hold: from cruise speed drag alone gives 0.25 to 0.35 m/s^2, so that the vehicle stops
    without reverse thrust and without overshoot."""
    stop_samples: int = 8
    """Sample points between here and the end of the braking distance."""
    accept_yaw_rad: float = 0.15
    """Acceptance band of the heading."""


GOALS = GoalsTuning()


@dataclass(frozen=True, slots=True)
class NavItemsTuning:
    dived_m: float = 0.1
    """NAV_TAKEOFF is done within this distance of its depth."""
    max_turns: int = 10_000
    min_ring_m: float = 0.1
    max_ring_m: float = 1000.0
    """Radii of circles, as CIRCLE_RADIUS has them."""
    min_accept_radius_m: float = 0.02
    """A smaller acceptance ball is below the accuracy of any estimate."""


NAV_ITEMS = NavItemsTuning()


@dataclass(frozen=True, slots=True)
class QgcPlanTuning:
    version: int = 1
    part_version: int = 2
    """Version of the mission, geoFence and rallyPoints objects."""
    autopilot_px4: int = 12
    type_submarine: int = 12
    speed_m_s: float = 0.35
    """Cruise and hover speed that are written."""


QGC_PLAN = QgcPlanTuning()


@dataclass(frozen=True, slots=True)
class StepGoalsTuning:
    goals_ahead: int = 2
    """A leg is planned with the next one's beginning in view, and the next leg while this one is flown."""
    yaw_variance: int = 5
    """Index in NavState.variance."""


STEP_GOALS = StepGoalsTuning()


@dataclass(frozen=True, slots=True)
class UpstreamTuning:
    reported_m_s: float = 0.1
    """Least speed over ground on a leg without a warning: a third of the usual cruise speed."""
    samples: int = 40
    """Places per leg at which a map is asked."""
    jump_m: float = 1.0
    """A path that becomes longer by this from one update to the next is another path, not drift ..."""
    made_s: float = 10.0
    """Averaging time of the speed towards the goal."""
    detour_fraction: float = 0.5
    detour_s: float = 120.0
    """A way round something is upstream if less than this fraction of the speed is made good on it in such a current
    and so much time is left."""
    fresh_starts: int = 2
    """... which restarts the count, but not for ever: replanning every minute makes no progress."""


UPSTREAM = UpstreamTuning()


@dataclass(frozen=True, slots=True)
class ValidationTuning:
    depth_tolerance_m: float = 1e-3
    """Altitudes arrive as 32-bit floats."""
    place_tolerance_m: float = 0.012
    """Rounding of a waypoint and of a fence point to 1e-7 degrees (11 mm) together."""
    approach_fraction: float = 0.6
    """The controller keeps MPC_MARGIN beyond the body radius, so that a position nearer to a boundary is only
    approached: the distance missing may be this share of the acceptance radius (two walls at once make it 1.41
    times as much) ..."""
    approach_m: float = 0.15
    """... and no more than this, beyond which the route planner does not search free space around a goal."""
    passage_m: float = 2.5e-3
    """Additional width of a passage beyond the controller's margin on both sides, for the route planner to find
    it. A narrower one is refused here: the controller would not enter it."""
    max_gaps: int = 20
    """Narrow gaps of a fence are named up to this number."""
    max_candidates: int = 500
    """Of gaps that may keep a leg's ends apart."""
    max_bottlenecks: int = 3
    """For so many legs without a path the gap is searched that would have to be wider (0.1 to 0.5 s each)."""


VALIDATION = ValidationTuning()
