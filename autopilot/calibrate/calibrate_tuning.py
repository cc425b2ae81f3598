"""Tuned numbers of calibration, by module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BoardsTuning:
    min_corners: int = 8
    """Least corners per view: a homography has eight unknowns, already four corners determine it."""
    refine_cells: float = 0.7
    """Half width of the refinement window in cells of a marker: OpenCV's 0.3 leaves 0.7 px of noise on small markers,
    more than 1 would take in the next cell's corner."""
    pitch_m: tuple[float, float] = (0.002, 1.0)
    """Least and most: what is beyond was not given in metres."""
    quiet_mm: float = 8.0
    """White round the pattern on the sheet."""
    scale_bar_mm: float = 100.0
    """A line to measure after printing."""


BOARDS = BoardsTuning()


@dataclass(frozen=True, slots=True)
class ExtrinsicsTuning:
    ahrs_error_time_s: float = 20.0
    """Correlation time of the slow errors of an attitude reference: they are drawn again at this interval."""
    hop_s: float = 0.4
    """Two hops in a row make one measurement of the lever arm."""
    step_s: float = 0.01
    """Accelerations are integrated with this step."""
    accel_bias_prior_m_s2: float = 0.3
    arm_prior_m: float = 0.5
    max_sigma_arm_m: float = 0.005
    """A component that is known worse than this is not written: a ruler does better."""
    rounds: int = 5


EXTRINSICS = ExtrinsicsTuning()


@dataclass(frozen=True, slots=True)
class FlightTuning:
    nearest_m: float = 0.4
    """A marker is taken for one no farther than this from where the logged estimate puts it: ids repeat after a
    metre."""
    min_markers: int = 3
    """One or two markers leave the tilt open."""
    min_frames: int = 60
    """2 s at 30 Hz."""
    max_state_age_us: int = 50_000


FLIGHT = FlightTuning()


@dataclass(frozen=True, slots=True)
class IntrinsicsTuning:
    min_views: int = 8
    """Each view brings six unknowns of its own; fewer leave focal length and distortion to chance."""
    same_px: float = 0.5
    """A view whose corners all are this near to those of one before adds nothing but confidence."""
    most_rms_px: float = 5.0
    """A fit that misses by more has taken something else for the board."""
    reject_factor: float = 2.5
    reject_floor_px: float = 0.3
    """A view whose rms is above both the factor times the median and this is left out."""
    reject_fraction: float = 0.4
    """No more views than these are left out for their misfit."""
    cells: tuple[int, int] = (8, 6)
    """The image is divided so for the coverage."""
    water_index: float = 1.333
    """Fresh water at 20 degC, green light."""
    good_coverage: float = 0.7
    good_radius: float = 0.85
    """Share of the half diagonal that corners should reach."""
    good_tilted_fraction: float = 0.3
    focal_band: float = 0.1
    """A focal length this far from the expected one is worth a word."""
    good_rms_px: float = 0.6
    other_focal: float = 0.05
    """The views are also fitted with focal lengths that are this share longer and shorter,"""
    focal_sigma: float = 0.01
    """and must determine it: the loss of fit gives the focal length's standard deviation, at most this share of it."""
    least_sigma_px: float = 0.1
    """Of a corner, for that: errors of a board and of its detection are not as independent as noise."""
    least_focal_sigma: float = 5e-4
    air_focal_sigma: float = 0.02
    """Of a focal length, as a share: no calibration is better than the first; one in air is off by the second."""
    least_distortion_sigma: float = 0.008
    air_distortion_sigma: float = 0.1
    """The same of the distortion."""


INTRINSICS = IntrinsicsTuning()


@dataclass(frozen=True, slots=True)
class LaserDotsTuning:
    per_picture: int = 3
    smooth_px: float = 1.5
    apart_px: int = 12
    centroid_px: int = 3
    min_sigmas: float = 7.0
    min_excess: float = 6.0
    edge_px: int = 6
    stamp_slack_s: float = 0.002
    own_fraction: float = 0.7
    """A lower detection rate means that the detector looks in the wrong place."""
    moved_m: float = 0.01
    """Least motion between samples: print under the dot shifts it, and a vehicle at rest would repeat the error."""


LASER_DOTS = LaserDotsTuning()


@dataclass(frozen=True, slots=True)
class LaserFitTuning:
    inlier_px: float = 4.0
    tries: int = 3000
    max_slope: float = 0.35
    """Beams inclined more than 20 degrees to the optical axis are not searched."""
    max_base_m: float = 0.5
    min_spread: float = 0.15
    """Least range of 1/Z over its mean: else position and direction of the beam are not separable."""
    min_dots: int = 15
    max_sigma_slope: float = 0.004
    sigma_factor: float = 2.0
    """As in the fit of the motion: simulated beams were off by up to 2.7 of the residuals' own."""
    rounds: int = 8
    lags: int = 3


LASER_FIT = LaserFitTuning()


@dataclass(frozen=True, slots=True)
class MotionFitTuning:
    baseline_s: float = 0.35
    """Long enough for the turn to stand out of the noise of two poses, short enough for the gyro noise."""
    baseline_slack_s: float = 0.12
    search_s: float = 0.4
    """Search range of the latency."""
    search_step_s: float = 0.01
    derivative_s: float = 0.002
    converged: float = 1e-6
    rounds: int = 8
    bias_moved_rad_s: float = 2e-5
    """Change of the bias after which the gyros are integrated again."""
    min_pairs: int = 50
    min_turn_rate_rad_s: float = 0.05
    """Standard deviation of the yaw rate: less is the noise of the poses."""
    mounting_prior_rad: float = 0.35
    """Keeps what the flight does not show where the vehicle file has it."""
    bias_prior_rad_s: float = 0.05
    sigma_factor: float = 2.0
    """By which the residuals' own standard deviations fall short: a flight turns a dozen times, not a thousand, and
    gyro bias and stamps wander. Simulated flights with known errors gave up to 2.5 of them."""


MOTION_FIT = MotionFitTuning()


@dataclass(frozen=True, slots=True)
class PoseFitTuning:
    steps: int = 8
    converged: float = 1e-7
    shrink_px: float = 0.25
    shrink_sigma_px: float = 0.1
    """Prior of the distance by which corners are found inside of the true ones, as in
    :mod:`autopilot.estimator.pnp`."""
    corner_sigma_px: float = 0.12
    """Only against the weight of that prior."""
    max_rms_px: float = 2.0
    corner_sigmas: float = 4.0
    corner_floor_px: float = 0.5
    """Corners further off than both are left out."""
    min_corners: int = 12


POSE_FIT = PoseFitTuning()


@dataclass(frozen=True, slots=True)
class ThrustCurveTuning:
    least_rows: int = 6
    most_v: float = 1000.0
    """Supply voltages above were given in millivolts."""
    still_fraction: float = 0.01
    """Thrusts below this part of the largest are none: a load cell's zero is never quite 0."""
    same_voltage: float = 0.03
    """Readings whose supply differs by no more than this share belong to one curve."""
    most_left: float = 0.3
    """A fit leaves no more than this share of the thrusts, rms."""


THRUST_CURVE = ThrustCurveTuning()


@dataclass(frozen=True, slots=True)
class ViewsTuning:
    new_view_fraction: float = 0.06
    """A live view is taken when the board's corners have moved by this share of the image's width since every other
    one."""
    still_px: float = 2.0
    """... and have moved by less than this since the frame before: no motion blur."""
    max_live_frames: int = 9000
    """5 minutes at 30 Hz."""


VIEWS = ViewsTuning()
