"""Constants of minimum-energy planning, by module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FieldTuning:
    """Constants of :mod:`autopilot.control.energy.field`."""

    jog_nodes: int = 2
    snap_m: float = 0.4
    """A start or goal so far from free ground still finds it."""
    gap_reach_m: float = 1.5
    """A way this far from everything has no side."""
    gap_apart_m: float = 0.8
    wall_reach_m: float = 4.0
    wall_points: int = 81


FIELD = FieldTuning()


@dataclass(frozen=True, slots=True)
class FlowTuning:
    """Constants of :mod:`autopilot.control.energy.flow`."""

    max_samples: int = 1500
    finest_sample_m: float = 0.1
    least_samples: int = 5
    """Per axis: a cubic spline needs four."""
    uniform_m_s: float = 1e-6
    """Samples that differ by less are the same everywhere."""
    open_water_border_m: float = 3.0
    open_water_fraction: float = 0.45
    """Without a workspace, lateral extent of the search area relative to the distance: half a circle would need 0.5."""


FLOW = FlowTuning()


@dataclass(frozen=True, slots=True)
class EnergyGuidanceTuning:
    """Constants of :mod:`autopilot.control.energy.energy_guidance`."""

    off_track_m: float = 0.15
    """Distance from the trajectory beyond which it is abandoned: the space between is not known to be free. A vehicle
    that has drifted that much farther from its goal since the rest of a leg was left to the route guidance gets a new
    plan."""
    track_lost_m: float = 1.0
    """Distance from the trajectory beyond which it is abandoned: the space between is not known to be free. A vehicle
    that has drifted that much farther from its goal since the rest of a leg was left to the route guidance gets a new
    plan."""
    changed_m_s: float = 0.03
    """Currents along the next seconds that differ by so much (rms) from those of the plan make a new one."""
    lookahead_s: float = 10.0
    check_steps: int = 10
    """The water is compared every so many control steps (0.5 s)."""
    replan_steps: int = 40
    """Plans are brought up to date at most this often (2 s)."""
    next_leg_s: float = 6.0
    """Remaining time of a leg at which the next one is planned: three times the planning time."""
    long_leg_m: float = 20.0
    long_next_leg_s: float = 12.0
    """One that is longer than this is planned earlier: its plan may take three times as long."""
    last_update_s: float = 2.0
    """A trajectory that has less than this left, and the time of an answer, is not brought up to date any more."""
    same_end_m: float = 0.1
    """An updated trajectory that ends no farther than this from where the old one did may run on into the next
    leg's."""
    route_steps: int = 10
    """Time to wait for a route: a leg's first plan starts on the path on which the vehicle departs."""
    late_steps: int = 100
    """Control steps (5 s) after which a missing plan is late, and the operator is notified."""
    end_hold_s: float = 0.5
    """At the end of a trajectory the vehicle, which lags a little, is held where the next one begins until the goal
    counts as reached: for so long by the trajectory's clock (1.7 s), then the route guidance brings it to the goal's
    centre."""
    running_out_s: float = 20.0
    running_out_fraction: float = 0.6
    """A trajectory that does not reach its goal is continued when it has less than this time or share left."""
    following_thrust_weight: float = 0.2
    """Least weight on the difference to the planned thrust while a trajectory is followed: to be a little off it costs
    less than to correct it at once. (In the paper's tank 2 % of a lap against 0.02; the limits are kept by other
    means.)"""
    end_stages: float = 80.0
    """Additional weight of position and heading at the end of a trajectory, in stages of the running cost
    (REFERENCE_DT_S). A trajectory only just enters its goal's region: centimetres and degrees are corrected gently on
    approach, while the path itself is tracked softly."""
    followed_steps: int = 4
    """The full search begins where the optimiser predicts the vehicle once it has followed the quick plan for so
    long."""
    short_s: float = 6.0
    running_m_s: float = 0.08
    """Shorter legs are left to the route guidance in currents above that (four standard deviations of the estimate at
    departure), unless planned in advance: they are over before the current along the path is known, and their goal
    would be missed by centimetres."""
    set_out_steps: int = 20
    """Steps (1 s) with that reduced weight at departure: the lateral thrust's peak in the paper's tank is 7 N instead
    of 12."""
    bound_fraction: float = 0.96
    """Fraction of the limits on heave, yaw rate and thrust used by plans: the rest is for tracking."""
    speed_fraction: float = 0.98
    """The same for the planar speed, which has a margin of its own (MPC_SPEED_MARGIN)."""
    other_cap_m_s: float = 0.015
    """A limit of the planar speed that has moved by more is worth another plan."""


GUIDANCE = EnergyGuidanceTuning()


@dataclass(frozen=True, slots=True)
class LegTaskTuning:
    """Constants of :mod:`autopilot.control.energy.leg_task`."""

    intervals: int = 48
    """Intervals of a trajectory: 0.2 s each in the paper's tank."""
    longest_s: float = 43.0
    """Planning distance; beyond it the energy field gives the remaining cost. (Twice as far needs a program with twice
    as many RK4 steps, 200 MB more, and intervals that are too long for narrow passages.)"""
    longer: float = 1.3
    longer_s: float = 3.0
    """A solution takes at most so many times as long as its guess, and so much more: RK4 steps must not grow
    unstable."""
    radius_fraction: float = 0.93
    yaw_fraction: float = 0.8
    """Shares of the acceptance region that a trajectory aims at, so that it is surely reached in spite of small
    errors."""
    sure_fraction: float = 0.95
    """Where the estimate's uncertainty leaves less than this share of the acceptance, a trajectory aims at the least
    that it may leave,"""
    spare: float = 0.05
    """and at this share less: it is followed to 2 cm, which is as much as that would leave of the paper's 0.3 m."""
    gate_radius_m: float = 0.5
    """Region in which a trajectory ends that does not reach its goal within longest_s."""
    screen_rounds: int = 1
    polish_rounds: int = 3
    """Rounds of linearisation for every candidate, and more for the best."""
    second_start: float = 1.3
    """A program that is not solved from its guess is begun once more from one that takes so many times as long."""
    settled_fraction: float = 1e-4
    """A round that changes the cost by less than this share was the last."""
    slight_turn_rad: float = 0.8
    turned_within_m: float = 0.05
    shortest_guess_s: float = 1.0
    """Of a guess, where neither way nor depth nor turn asks for more."""
    turnless_s: float = 2.0
    """A guess that takes less keeps its heading, where the goal asks for none."""
    guess_turn_rad_s: float = 0.4
    """Rate at which first guesses turn from where the vehicle points to their way; where that would take more than half
    of the time they turn quicker."""
    linear_turn_s: float = 20.0
    """Duration up to which the initial guess turns evenly from start to end; on longer paths it follows the path."""
    slowing_m_s2: float = 0.1
    """Smallest deceleration required of a vehicle above its speed limit: that by drag at 0.2 m/s."""
    slowing_rad_s2: float = 0.3
    """The same of one that turns too fast."""
    between_m: float = 0.004
    """Clearance beyond the optimiser's own margin, for the motion between the nodes."""
    leg_depth_m: float = 0.3
    """A leg stays so near the depths of its start and goal. Sinking slowly and rising on the buoyancy at the end is
    cheaper by some 0.3 %, and over 360 m it went 5 m deeper than anyone had drawn."""
    widening_m_s: float = 0.02
    """A vehicle that is nearer than that goes away from the boundary so fast."""
    points_between: int = 4
    door_steps: int = 4
    """Search for passages that are too narrow for that, between the nodes: where both sides push positions."""


LEG_TASK = LegTaskTuning()


@dataclass(frozen=True, slots=True)
class PatienceTuning:
    """Constants of :mod:`autopilot.control.energy.patience`."""

    step_s: float = 0.05
    """Between control steps."""
    retry_steps: int = 20
    """Steps (1 s) before a failed request is repeated, doubled with every consecutive failure ..."""
    longest_retry_steps: int = 640
    """... up to so many (32 s)."""
    other_current_m_s: float = 0.03
    other_place_m: float = 2.0
    """A failure is of no account any more when the current has changed by so much, or the vehicle is so far from
    there."""


PATIENCE = PatienceTuning()


@dataclass(frozen=True, slots=True)
class PowerTuning:
    """Constants of :mod:`autopilot.control.energy.power`."""

    thrust_smoothing_n2: float = 1e-4
    """|F|^1.5 is taken as (F^2 + this)^0.75, twice differentiable at rest (10 mN)."""
    idle_n: float = 1e-9
    """A thruster that gives less stands still."""
    together: int = 4096
    """Edges per block: a field has 200,000 of them, each with every speed of the table."""
    slowest_ground_m_s: float = 0.01
    """Headway below this is none."""


POWER = PowerTuning()


@dataclass(frozen=True, slots=True)
class SearchTuning:
    """Constants of :mod:`autopilot.control.energy.search`."""

    shorter_s: tuple[float] = (18.0,)
    """Shorter planning distance if none of that length is solved: shorter intervals get through narrow passages."""
    substeps: tuple[int, int] = (1, 2)
    update_rounds: int = 1
    """Rounds for a plan that is only brought up to date."""
    stay_within: float = 1.1
    """A plan stays on its way while the energy field knows none that is cheaper by so much: near-ties would flip."""
    cheaper_fraction: float = 0.95
    """A full search replaces an active quick plan if its energy is below this fraction of the remaining one."""
    keep_within: float = 1.15
    """Candidates with more than this multiple of the best path's energy are dropped."""
    max_alternative_paths: int = 2
    tie_within: float = 1.15
    max_ties: int = 3
    """Among so many trajectories within so many times the best one's cost the leg after this one decides."""
    alike: float = 0.2
    """Trajectories that differ by less at every node [m, rad] are taken for the same."""
    slope_reach_m: float = 0.25
    comfort_m: float = 0.03
    """Kept beyond the radius by ways, if there are such: a passage that is open by centimetres only is not chosen."""


SEARCH = SearchTuning()


@dataclass(frozen=True, slots=True)
class ShootingTuning:
    """Constants of :mod:`autopilot.control.energy.shooting`."""

    planes: int = 6
    """Half-planes per node."""
    end_rows: int = 3
    """Distance from the goal, heading."""
    cost_scale: float = 1e-2
    coast_s: float = 1.0
    """A vehicle that arrives with a velocity is taken to be this much farther on at no cost."""


SHOOTING = ShootingTuning()


@dataclass(frozen=True, slots=True)
class TrackTuning:
    """Constants of :mod:`autopilot.control.energy.track`."""

    yaw_lever_m: float = 0.3
    """Weight of heading [m/rad] in the search for the nearest point of the trajectory."""
    slowest_rate: float = 0.3
    fastest_rate: float = 2.0
    """The trajectory's clock runs between these rates: it waits for a vehicle that is late and does not stand still."""
    window_s: float = 2.0
    search_points: int = 41
    arriving_s: float = 0.1
    missing_s: float = 0.2
    """By the clock, which goes at its slowest there: after so long behind the end the reference begins to go over to
    the goal's centre, and takes so long for it (0.3 and 0.7 s)."""
    settle_s: float = 1.5
    """Time constant with which the reference goes on to the goal's centre after the end of the trajectory."""


TRACK = TrackTuning()


@dataclass(frozen=True, slots=True)
class TrajectoryTuning:
    """Constants of :mod:`autopilot.control.energy.trajectory`."""

    substep_s: float = 0.5
    """Longest RK4 step: with longer ones the program makes a profit of integration errors in the unstable sway-yaw
    mode."""
    min_interval_s: float = 0.005
    rough_fraction: float = 3e-3
    rough_feasible: float = 1e-3
    """A rough solution is at hand when an iteration changes the cost by less than this share and dynamics and bounds
    are obeyed within so much: candidates differ by more, and the one that is flown is solved to the end."""
    fine_fraction: float = 1e-4
    feasible: float = 1e-4
    """The same of a trajectory that is flown, in three iterations one after the other (SI units)."""
    wide: float = 2.0
    """Velocities are bounded to so many times their limits at every iteration: far beyond them RK4 steps are unstable,
    and from there no way leads back (iterations of 100 ms, without a solution)."""


TRAJECTORY = TrajectoryTuning()
