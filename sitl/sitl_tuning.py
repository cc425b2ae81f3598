"""Constants of the simulation, by module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class AhrsTuning:
    accuracy_rad: float = 0.02
    """What the device says of its own attitude."""
    clock_span_ms: int = 1 << 32
    """The device's counter of milliseconds has 32 bits."""
    noise_numbers: int = 16
    """Random numbers drawn per sample, whatever becomes of it, so that one fault does not change all that follows."""
    noise_samples: int = 256
    """Samples whose random numbers are drawn in one go."""


AHRS = AhrsTuning()


@dataclass(frozen=True, slots=True)
class ArdupilotJsonTuning:
    port: int = 9002
    rates_hz: tuple[int, int] = (1, 20000)
    """What a loop rate can be; anything else is a damaged packet."""
    off_us: int = 800
    """A shorter pulse is none."""


ARDUPILOT_JSON = ArdupilotJsonTuning()


@dataclass(frozen=True, slots=True)
class ArdusubVehicleTuning:
    pose_period_us: int = 33_333
    pose_sigma_m: float = 0.005
    yaw_sigma_rad: float = 0.008
    tracker_system: int = 200
    tracker_component: int = 197
    """MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY."""


ARDUSUB_VEHICLE = ArdusubVehicleTuning()


@dataclass(frozen=True, slots=True)
class CameraTuning:
    step_px: int = 8
    """Distance of the rays that are really cut with the floor."""
    wall_level: int = 60
    """Grey level of what is beyond the floor."""
    veil_bgr: tuple[float, float, float] = (92.0, 84.0, 52.0)
    """Colour of light scattered by the water, grey levels at full exposure."""
    fade_bgr: tuple[float, float, float] = (1.0, 1.0, 2.2)
    """Attenuation of the channels relative to the scenario's turbidity."""
    tint_bgr: tuple[float, float, float] = (0.94, 1.0, 0.92)
    """Colour of the boards in the tank's light."""
    mask_unit: int = 160
    """Value of the 8-bit brightness mask that stands for 1.0 (leaves room for bright caustics)."""
    noise_pad: int = 64
    """Pixels by which the stored noise is larger than a picture; each picture takes another cut-out."""
    noise_zero: int = 128
    """Value of the 8-bit noise that stands for none."""
    min_blur_px2: float = 0.01
    """Variance of a blur that is not worth applying."""
    small_blur_px2: float = 0.95
    """Variance up to which 3 x 3 pixels are enough."""
    min_skew_px2: float = 0.02
    """Covariance of a small blur that is not worth a kernel that does not separate: half a grey level at a sharp
    edge."""
    laser_spot_m: float = 0.0012
    """Standard deviation of the beam."""
    laser_glow_px: float = 1.2
    """Standard deviation of the dot's image for a point."""
    laser_bgr: tuple[float, float, float] = (70.0, 235.0, 60.0)
    """Grey levels that the dot adds at its centre, at brightness 1 in clear water."""
    caustic_waves_1_m: tuple[tuple[float, float], tuple[float, float], tuple[float, float], tuple[float, float]] = (
        (31.0, 9.0),
        (-14.0, 29.0),
        (22.0, -27.0),
        (-37.0, -8.0),
    )
    """Wave numbers north and east of the light pattern."""
    caustic_rates_1_s: tuple[float, float, float, float] = (1.9, 2.6, 2.2, 3.1)
    mean_exp_sin: float = 1.2661
    """Mean of exp(sin(x)), the Bessel function I0(1): the pattern moves light about and adds none."""
    horizon: float = 0.05
    """Rays that go down by less than this per unit of length see the wall."""


CAMERA_TUNED = CameraTuning()


@dataclass(frozen=True, slots=True)
class CameraFeedTuning:
    fog_level: float = 130.0
    fog_blur_px: float = 25.0
    degraded_noise: float = 2.0
    """Grey level and blur of a lens that has fogged up, and noise of spoilt pictures [grey levels]."""
    transport_fraction: float = 0.5
    """Part of the camera's latency that passes before the picture arrives; the rest is for finding the markers in
    it."""


CAMERA_FEED = CameraFeedTuning()


@dataclass(frozen=True, slots=True)
class ContactTuning:
    stiffness_n_m: float = 2.0e4
    """Assumed: a bumper bar; full thrust (29 N) presses it in by 1.5 mm, a run at 0.5 m/s by about 15 mm."""
    damping_n_s_m: float = 350.0
    """Assumed: about a third of the critical damping of a 16 kg body on that stiffness."""
    near_m: float = 0.05
    """Contact is looked for inside a step if the hull may be closer than this at its start (ten steps at 1 m/s)."""
    max_records: int = 1000
    """Contacts that are kept; all are counted."""


CONTACT = ContactTuning()


@dataclass(frozen=True, slots=True)
class CurrentFieldsTuning:
    zero: tuple[float, float, float] = (0.0, 0.0, 0.0)
    zero_gradient: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    jet_profile: float = 27.0 / 4.0
    """Makes the largest value of xi (1 - xi)^2 on [0, 1] (at xi = 1/3) equal to 1."""
    vortex_series_limit: float = 1e-3
    """Below this (r / core)^2 the vortex profile is taken from its power series (error below 1e-10)."""


CURRENTS = CurrentFieldsTuning()


@dataclass(frozen=True, slots=True)
class FloorTuning:
    px_per_m: float = 1000.0
    """Resolution of the finest level; the camera of the LBV150 shows 900 px per metre from 1.1 m above the floor."""
    max_px: float = 40e6
    """Pixels of the finest level (bytes of memory); larger floors get a coarser picture."""
    levels: int = 4
    """Each has half the resolution of the one before, for views from far away."""
    white: int = 200
    black: int = 34
    """Grey levels of the boards' print under even light."""
    oversampling: int = 4
    """Of markers that do not lie along the picture's axes."""
    off_floor_m: float = 1e-3
    """Markers of a map file may lie this far off the floor."""
    sand_octaves: tuple[tuple[int, float], tuple[int, float], tuple[int, float], tuple[int, float]] = (
        (256, 7.0),
        (48, 5.0),
        (10, 4.0),
        (3, 3.0),
    )
    """Grain size [px] and standard deviation [grey levels] of the sand."""


FLOOR = FloorTuning()


@dataclass(frozen=True, slots=True)
class OperatorTuning:
    gcs_system: int = 255
    gcs_component: int = 190
    """Ids of an ordinary ground station (MAV_COMP_ID_MISSIONPLANNER)."""
    heartbeat_us: int = 1_000_000
    retry_us: int = 1_000_000
    """A refused or unanswered command is sent again after this time."""
    stick_us: int = 100_000
    """A joystick sends ten times per second."""
    ready_us: int = 100_000
    """Interval of SYS_STATUS, which says whether arming would be accepted."""
    patience_us: int = 5_000_000
    """So long after the start it waits until arming would be accepted."""
    sys_status: int = 1
    set_interval: int = 511
    arm: int = 400
    start: int = 300
    """SYS_STATUS; MAV_CMD_SET_MESSAGE_INTERVAL, MAV_CMD_COMPONENT_ARM_DISARM, MAV_CMD_MISSION_START (common.xml)."""


OPERATOR = OperatorTuning()


@dataclass(frozen=True, slots=True)
class PlantTuning:
    step_us: int = 10_000
    """Integration step in open water: 15 steps in the thruster lag of 0.15 s, the fastest thing there."""
    near_step_us: int = 5_000
    """Integration step where the hull may touch something: 36 steps in the period of the hull on the contact's
    spring."""
    gravity_m_s2: float = 9.80665
    """Standard gravity: what an accelerometer feels, and what drives waves."""
    zero: tuple[float, float, float] = (0.0, 0.0, 0.0)


PLANT = PlantTuning()


@dataclass(frozen=True, slots=True)
class PoseSensorTuning:
    reference_height_m: float = 1.0
    """Height of the camera above the floor at which the scenario's standard deviations hold."""
    least_scale: float = 0.3
    """Close to the floor the errors shrink no further: fewer markers are in view."""
    laser_least_range_m: float = 0.15
    laser_most_range_m: float = 2.0
    """Where the dot is in the picture, and bright enough."""
    usual: tuple[float, float] = (30.0, 0.06)
    """Rate [Hz] and latency [s] of a vehicle without a camera, where the scenario does not say: the shipped
    cameras'."""


POSE_SENSOR = PoseSensorTuning()


@dataclass(frozen=True, slots=True)
class WavesTuning:
    deep: float = 30.0
    """From this k h on the bottom is not felt: exp(-k h) is below 1e-13."""
    newton_steps: int = 50
    breaking: float = 0.142
    """Miche 1944: steepness height / length over tanh(k h) at which a regular wave breaks."""
    jonswap_peak: float = 3.3
    """Mean peak enhancement of the North Sea (Hasselmann et al. 1973)."""
    components: int = 24
    """Regular waves that stand for an irregular sea."""
    band: tuple[float, float] = (0.6, 3.0)
    """Frequencies of them over that of the peak: 98 % of the energy."""


WAVES = WavesTuning()
