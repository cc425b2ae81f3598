"""Tuned numbers of commands and failsafes, by module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CameraWatchTuning:
    for_us: int = 500_000
    """Time with bad pictures only before a report; the same time with good ones ends it."""
    least: int = 3
    """And at least so many of them."""
    silent_us: int = 800_000
    """Time without pictures after which a camera that has sent some is silent."""
    markers_us: int = 300_000
    """A picture counts as good if markers were detected within this time."""
    fog_contrast: float = 6.0
    """Grey levels between neighbouring pixels of the coarse picture: a floor of markers has 20 and more in clear water,
    noise alone 3."""
    clipped_fraction: float = 0.5
    """Share of white or black pixels from which on a picture in which nothing is found is over- or under-exposed."""


CAMERA_WATCH = CameraWatchTuning()


@dataclass(frozen=True, slots=True)
class CollisionTuning:
    base_time_s: float = 0.5
    """Averaging time of the baseline of a jolt: tilt, current and thrust change more slowly."""
    jolt_us: int = 300_000
    """Longest jolt; a longer one is a faulty sensor, or a tilt."""


COLLISION = CollisionTuning()


@dataclass(frozen=True, slots=True)
class VehicleStatusTuning:
    latched_us: int = 2_000_000
    """Hold time of a wet probe: splashing water makes and breaks the contact."""
    frozen_readings: int = 20
    """Equal readings in a row that count as frozen: the last digits of every sensor here are noise."""
    frozen_m: float = 0.3
    """A range that stays the same over so many readings while the vehicle moves by so much is frozen: it moves up and
    down by a centimetre meanwhile, and echoes scatter by as much."""
    frozen_v: float = 0.02
    frozen_a: float = 0.05
    """A power monitor whose readings stay within these,"""
    frozen_thrust_n: float = 8.0
    """while the sum of commanded thrusts changes by so much (1 A and more), is frozen."""
    late_every_us: int = 1_000_000
    """Averaging time of the share of late ticks."""
    jump_s: float = 0.5
    """A clock of day that is set by less than this is being kept in step, not set."""
    fresh_us: int = 1_000_000
    """Age beyond which a heading or a depth is invalid."""
    shown_us: int = 10_000_000
    """Time for which a clock jump or a collision is reported."""


VEHICLE_STATUS = VehicleStatusTuning()


@dataclass(frozen=True, slots=True)
class FaultResponseTuning:
    say_every_us: int = 5_000_000
    """Interval at which the same fault is reported again; it is counted every time."""
    shown_us: int = 5_000_000
    """Time after the last fault in the thruster command path for which the failsafe bit stays and arming is refused."""
    max_kinds: int = 64
    """Kinds of fault that are remembered; beyond that the oldest is dropped."""


FAULT_RESPONSE = FaultResponseTuning()


@dataclass(frozen=True, slots=True)
class MapCheckTuning:
    circle_places: int = 36
    lattice: int = 120
    """Sample points per axis of a workspace, beside the cells that hold gaps."""
    edge_m: float = 1e-3
    """Distance from a boundary within which points are tested exactly."""
    same_origin_deg: float = 1e-6
    """A map of latitudes lies where it belongs while the origin stays within this (0.1 m)."""


MAP_CHECK = MapCheckTuning()


@dataclass(frozen=True, slots=True)
class MissionRunTuning:
    shortfall_s: float = 8.0
    """Longest time without progress towards a goal that the current puts out of reach: longer than a gust."""
    upstream_us: int = 5_000_000
    """Interval at which the speed made good on the present leg is checked: a vehicle at rest does not know the
    current yet."""
    reached_us: int = 1_000_000
    """Interval between reports of items reached: a hundred may be close together."""
    reached_named: int = 5
    """Maximum number of them named."""
    path_moved_m: float = 0.02
    """A vehicle that has moved by so much is asked again whether it gets to the mission's next place (1 to 5 ms)."""


MISSION_RUN = MissionRunTuning()


@dataclass(frozen=True, slots=True)
class MotorTestsTuning:
    most_fraction: float = 0.3
    """Of the pulse's span."""
    most_s: float = 5.0
    """In one go, and of one word."""
    rest_s: float = 1.0
    """After so long."""
    silence_s: float = 0.5
    """Validity of a motor test command without a timeout: ArduSub requires two a second."""
    away_m: float = 0.2
    """From every boundary, beyond what the controller keeps: nothing brakes a vehicle while a thruster is tested."""


MOTOR_TESTS = MotorTestsTuning()


@dataclass(frozen=True, slots=True)
class PhotographerTuning:
    min_interval_s: float = 0.2
    """Stills of full size are not taken faster."""
    min_distance_m: float = 0.01
    max_pending: int = 4
    """Stills that may be asked for and not there yet: a camera that does not follow gets no longer queue."""
    answer_timeout_us: int = 10_000_000
    """A still without a result is given up after this time; the camera's driver gives up sooner, with a reason."""
    max_records: int = 10_000
    """Stills that can be requested again; beyond that the oldest is dropped."""
    nav_kept: int = 400
    """Ticks of the estimate that are kept: an exposure is known 4 s later at most."""


PHOTOGRAPHER = PhotographerTuning()


@dataclass(frozen=True, slots=True)
class ServiceTuning:
    warm_at_tick: int = 100
    """A second after the start, when the links are served, the controller has prepared what its first routes need."""
    serve_after_ticks: int = 2
    """Clients are served so many ticks after a decision, so that no tick has the work of both."""
    counters_every_ticks: int = 100
    """The estimator's counts go to the log once per second."""
    fixed_us: int = 1_000_000
    """Age of the newest fix beyond which the estimate is dead reckoning, as the estimator has it."""


SERVICE = ServiceTuning()


@dataclass(frozen=True, slots=True)
class FailsafeInputsTuning:
    update_us: int = 100_000
    """Interval of inputs that need geometry."""
    energy_us: int = 1_000_000
    slow_m_s: float = 0.05
    """Slower is not moving,"""
    pushed: float = 1.0 / 3.0
    """when a thruster is at this share of its limit"""
    away_m: float = 0.3
    """and the path left is at least this long,"""
    nearer_m: float = 0.15
    """and becomes no shorter by this: who stems a current is slow, too."""
    window_s: float = 60.0
    """Averaging time of the energy per metre,"""
    least_s: float = 15.0
    least_m: float = 1.0
    """and the distance flown before it is known."""
    max_steps: int = 2000
    """Steps of a mission, with its jumps, that are examined."""


FAILSAFE_INPUTS = FailsafeInputsTuning()


@dataclass(frozen=True, slots=True)
class EnvironmentTuning:
    known_m: float = 0.3
    """Distance from a shape of the fence within which beam returns are attributed to it."""
    range_us: int = 200_000
    """The laser's range is worked out of pictures this often."""
    power_s: float = 30.0
    """Time over which the mean power is taken."""


ENVIRONMENT = EnvironmentTuning()


@dataclass(frozen=True, slots=True)
class WatchTuning:
    effectiveness_news: float = 0.15
    """A change of a thruster's effectiveness that is worth a message."""
    flight_us: int = 20_000_000
    """A shorter time armed is no flight to summarise."""
    cause_us: int = 3_000_000
    """Time within which a cause is named of fixes that disagree: a window of the stamps' watch, and some."""
    jolt_us: int = 500_000
    """Time within which a collision is found that an accelerometer in doubt has felt: a jolt of 0.3 s, and some."""
    delay_news_s: float = 0.25
    """A change of the commands' delay that is worth a message."""


WATCH = WatchTuning()
