"""Tuned numbers of missions, by module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CirclingTuning:
    pull_1_s: float = 0.6
    """How fast a distance from the circle is made good."""
    pull_share: float = 0.7
    """Share of the speed that may go into it."""
    join_m: float = 0.25
    """Farther off, the circle's nearest point is a place to go to."""
    fresh_ticks: int = 5
    accept_yaw_rad: float = 0.15
    yaw_share: float = 0.5
    """Share of SPD_YAW_MAX that a circle on which the heading turns may use."""
    ring_step_m: float = 0.01
    """Arcs of a circle are looked at down to this length."""
    ring_arcs: int = 72
    ring_parts: int = 4
    """Arcs that a circle begins with, and parts that an arc is divided into."""


CIRCLING = CirclingTuning()


@dataclass(frozen=True, slots=True)
class GoalsTuning:
    stop_deceleration_m_s2: float = 0.25
    """How hard a vehicle that is told to hold brakes: from cruise speed its drag alone gives it 0.25 to 0.35 m/s^2, so
    that it comes to rest without reverse thrust and without having to come back."""
    stop_samples: int = 8
    """Places between here and the end of the braking distance that are looked at."""
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
    """A smaller acceptance ball is below what any estimate can tell."""


NAV_ITEMS = NavItemsTuning()


@dataclass(frozen=True, slots=True)
class QgcPlanTuning:
    version: int = 1
    part_version: int = 2
    """Version of the mission, geoFence and rallyPoints objects."""
    autopilot_px4: int = 12
    type_submarine: int = 12


QGC_PLAN = QgcPlanTuning()


@dataclass(frozen=True, slots=True)
class StepGoalsTuning:
    goals_ahead: int = 2
    """A leg is planned with the next one's beginning in view, and the next leg while this one is flown."""
    sure_sigmas: float = 3.0
    doubt_share: float = 0.1
    """Reached means surely reached: acceptance shrinks by so many standard deviations, but by this share at most."""
    yaw_variance: int = 5
    """Index in NavState.variance."""


STEP_GOALS = StepGoalsTuning()


@dataclass(frozen=True, slots=True)
class UpstreamTuning:
    reported_m_s: float = 0.1
    """Legs on which less than this is left over ground are told: a third of the usual cruise speed."""
    samples: int = 40
    """Places per leg at which a map is asked."""
    jump_m: float = 1.0
    """A way that becomes longer by this from one look to the next is another way, not one that was drifted back ..."""
    made_s: float = 10.0
    """Time over which the speed is looked at with which a vehicle gets nearer."""
    fresh_starts: int = 2
    """... which begins the count anew, but not for ever: whoever plans another way every minute gets nowhere."""


UPSTREAM = UpstreamTuning()


@dataclass(frozen=True, slots=True)
class ValidationTuning:
    depth_tolerance_m: float = 1e-3
    """Altitudes arrive as 32-bit floats."""
    place_tolerance_m: float = 0.012
    """Rounding of a waypoint and of a fence point to 1e-7 degrees (11 mm) together."""
    approach_share: float = 0.6
    """The controller keeps MPC_MARGIN beyond the body radius, so that a place nearer to a boundary is only approached:
    what is missing may be this share of the acceptance radius (two walls at once make it 1.41 times as much) ..."""
    approach_m: float = 0.15
    """... and no more than this, beyond which the route planner does not look for free ground round a goal."""
    passage_m: float = 2.5e-3
    """A passage has to have this much more than the controller keeps on both sides, for the route planner to find it.
    What is narrower is refused here: the controller would not enter it."""
    max_gaps: int = 20
    """Narrow gaps of a fence are named up to this number."""


VALIDATION = ValidationTuning()
