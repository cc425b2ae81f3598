"""The tables of a scenario file as immutable structs (what they mean as a whole: :mod:`sitl.scenario`)."""

from itertools import pairwise
from typing import Annotated, Literal, TypeAlias

import msgspec

from autopilot.core.vehicle import NonNegative, Port, Positive, Vec2, Vec3

Probability = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Latitude = Annotated[float, msgspec.Meta(ge=-90.0, le=90.0)]
Longitude = Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]
Seed = Annotated[int, msgspec.Meta(ge=0)]


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A TOML table: immutable, unknown keys are errors."""


class Header(_Table, frozen=True, kw_only=True):
    """``[scenario]``"""

    name: str
    description: str
    seed: Seed = 1
    duration_s: Positive | None = None
    """The run ends here, None = when it is stopped."""
    plan: str | None = None
    """Plan file that ``sitl --start`` flies, relative to the scenario file (:func:`plan_path`)."""


class Origin(_Table, frozen=True, kw_only=True):
    """``[origin]``: where the local frame lies on the earth. Default: the campus of NTU Athens, the paper's authors."""

    lat_deg: Latitude = 37.9755
    lon_deg: Longitude = 23.7790
    alt_m: float = 0.0


class Tank(_Table, frozen=True, kw_only=True):
    """``[tank]``: vertical walls and a flat floor. Absent = open water."""

    polygon_m: Annotated[list[Vec2], msgspec.Meta(min_length=3)]
    """Corners [north, east], simple, not closed, any winding, may be non-convex."""
    depth_m: Positive

    def __post_init__(self) -> None:
        corners = self.polygon_m
        for index, corner in enumerate(corners):
            if corner == corners[index - 1]:
                raise ValueError(f"`polygon_m` repeats the corner [{corner[0]:g}, {corner[1]:g}]")
        walls = [(corners[index - 1], corner) for index, corner in enumerate(corners)]
        for index, wall in enumerate(walls):
            for other in walls[index + 2 :]:
                if _cross(*wall, *other):
                    raise ValueError(f"`polygon_m`: the walls {list(wall)} and {list(other)} cross")


def _side(a: Vec2, b: Vec2, p: Vec2) -> float:
    """Twice the signed area of the triangle a, b, p."""
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])


def _cross(a: Vec2, b: Vec2, c: Vec2, d: Vec2) -> bool:
    """True if the segments a-b and c-d cross in their inside."""
    return _side(a, b, c) * _side(a, b, d) < 0.0 and _side(c, d, a) * _side(c, d, b) < 0.0


class CylinderObstacle(_Table, frozen=True, kw_only=True, tag_field="kind", tag="cylinder"):
    """A vertical cylinder from the floor to above the surface."""

    center_m: Vec2
    radius_m: Positive
    surprise: bool = False
    """The obstacle sensor reports it as it comes into range; whoever drew the fence did not know of it."""


class SphereObstacle(_Table, frozen=True, kw_only=True, tag_field="kind", tag="sphere"):
    """A sphere."""

    center_m: Vec3
    radius_m: Positive


class MovingObstacle(_Table, frozen=True, kw_only=True, tag_field="kind", tag="moving"):
    """A vertical cylinder through the whole depth that moves along a polyline; the obstacle sensor reports it."""

    path_m: Annotated[list[Vec2], msgspec.Meta(min_length=2)]
    """Corners [north, east]."""
    speed_m_s: Positive
    radius_m: Positive
    ends: Literal["bounce", "loop", "stop"] = "bounce"
    """At the last corner it turns back, goes on to the first one, or stops."""
    start_s: NonNegative = 0.0
    """Until then it stands at the first corner."""

    def __post_init__(self) -> None:
        corners = self.path_m if self.ends != "loop" else [*self.path_m, self.path_m[0]]
        for before, corner in pairwise(corners):
            if before == corner:
                raise ValueError(f"`path_m` repeats the corner [{corner[0]:g}, {corner[1]:g}]")


Obstacle: TypeAlias = CylinderObstacle | SphereObstacle | MovingObstacle


class NoCurrent(_Table, frozen=True, kw_only=True, tag_field="kind", tag="none"):
    """Still water."""


class UniformCurrent(_Table, frozen=True, kw_only=True, tag_field="kind", tag="uniform"):
    """The same everywhere; optionally with a tide: velocity + tide * sin(2 pi t / period)."""

    velocity_m_s: Vec3
    tide_m_s: Vec3 = (0.0, 0.0, 0.0)
    tide_period_s: Positive = 44712.0
    """Default: the M2 tide, 12.42 h."""


class JetCurrent(_Table, frozen=True, kw_only=True, tag_field="kind", tag="jet"):
    """Jet along +x in the middle of a rectangular tank, return flow along its walls."""

    speed_m_s: float = 0.25
    center_m: Vec2 = (0.0, 0.0)
    length_m: Positive = 5.0
    width_m: Positive = 3.0
    direction_rad: float = 0.0
    """The whole field turned about its centre, clockwise seen from above; then it does not follow the walls."""


class VortexCurrent(_Table, frozen=True, kw_only=True, tag_field="kind", tag="vortex"):
    """Lamb-Oseen vortex."""

    center_m: Vec2 = (0.0, 0.0)
    circulation_m2_s: float
    """Positive turns clockwise seen from above (north to east)."""
    core_m: Positive


class ShearCurrent(_Table, frozen=True, kw_only=True, tag_field="kind", tag="shear"):
    """Linear shear: along x, growing with y."""

    speed_m_s: float = 0.0
    """On the line y = center_y_m."""
    shear_1_s: float
    center_y_m: float = 0.0


class BickleyCurrent(_Table, frozen=True, kw_only=True, tag_field="kind", tag="bickley"):
    """Bickley jet along x: speed * sech^2((y - center_y) / width)."""

    speed_m_s: float
    width_m: Positive
    center_y_m: float = 0.0


class GyreCurrent(_Table, frozen=True, kw_only=True, tag_field="kind", tag="gyre"):
    """Taylor-Green gyres of size cell_m."""

    speed_m_s: float
    cell_m: Positive


class GridCurrent(_Table, frozen=True, kw_only=True, tag_field="kind", tag="grid"):
    """Gridded, linear between the nodes in space and time (:mod:`sitl.grid_current`)."""

    file: str
    """``.npz`` or NetCDF-3, relative to the scenario file."""


Current: TypeAlias = (
    NoCurrent | UniformCurrent | JetCurrent | VortexCurrent | ShearCurrent | BickleyCurrent | GyreCurrent | GridCurrent
)


class VehicleStart(_Table, frozen=True, kw_only=True):
    """``[vehicle]``"""

    model: str = "lbv150"
    """Name of a shipped vehicle or path of a vehicle file."""
    start_m: Vec3
    start_yaw_rad: float = 0.0
    mismatch: dict[str, NonNegative] = {}
    """Factors that make the plant differ from the vehicle file (sitl.mismatch.MISMATCH_KEYS)."""
    tether_entry_m: Vec3 | None = None
    """Where the tether enters the water; absent = no tether."""
    held: bool = False
    """A hand holds the vehicle where it starts until a thruster is commanded for the first time."""
    command_latency_s: NonNegative = 0.0
    """From the service's command to the amplifiers (tether electronics)."""


class AhrsSensor(_Table, frozen=True, kw_only=True):
    """``[sensors.ahrs]``. Defaults: an attitude reference of the SBG IG-500 class in a steel tank, all assumed."""

    rate_hz: Positive | None = None
    """None = as the vehicle file."""
    latency_s: NonNegative | None = None
    """None = as the vehicle file."""
    latency_jitter_s: NonNegative = 0.002
    """Standard deviation."""
    gyro_noise_rad_s_rthz: NonNegative = 8.7e-4
    gyro_bias_rad_s: NonNegative = 0.01
    """Standard deviation of the bias at start."""
    gyro_bias_walk_rad_s_rts: NonNegative = 2e-5
    accel_noise_m_s2_rthz: NonNegative = 2.5e-3
    accel_bias_m_s2: NonNegative = 0.05
    accel_bias_walk_m_s2_rts: NonNegative = 2e-4
    tilt_error_rad: NonNegative = 0.0087
    """Standard deviation of the slow (Gauss-Markov) roll and pitch error."""
    tilt_error_time_s: Positive = 20.0
    yaw_error_rad: NonNegative = 0.0175
    """Standard deviation of the slow (Gauss-Markov) yaw error."""
    yaw_error_time_s: Positive = 20.0
    yaw_offset_rad: NonNegative = 0.05
    """Standard deviation of the constant magnetic offset, drawn once per run."""
    yaw_bias_rad: float = 0.0
    """A further constant heading error, the same in every run."""
    yaw_field_rad: NonNegative = 0.035
    """Amplitude of the magnetic offset that changes from place to place (steel in the tank's walls)."""
    yaw_field_length_m: Positive = 3.0
    """Wave length of that change."""
    drop_probability: Probability = 0.0
    """Per frame, lost on the serial line."""
    corrupt_probability: Probability = 0.0
    """Per frame, one byte damaged."""


class Outages(_Table, frozen=True, kw_only=True):
    """Gaps in a sensor's output, beginning at random."""

    per_minute: NonNegative = 0.0
    min_s: NonNegative = 0.1
    max_s: NonNegative = 2.0

    def __post_init__(self) -> None:
        if self.max_s < self.min_s:
            raise ValueError(f"`max_s` = {self.max_s:g} is below `min_s` = {self.min_s:g}")


class CameraSensor(_Table, frozen=True, kw_only=True):
    """``[sensors.camera]``: when pictures come. How they look is ``[camera]``."""

    rate_hz: Positive | None = None
    """None = as the vehicle file."""
    latency_s: NonNegative | None = None
    """None = as the vehicle file."""
    latency_jitter_s: NonNegative = 0.01
    stamp_error_s: float = 0.0
    """Pictures are stamped so much later than they were exposed: latency that the vehicle file does not know of."""
    drop_probability: Probability = 0.01
    """Per frame."""
    outages: Outages = Outages()


class PoseSensor(_Table, frozen=True, kw_only=True):
    """``[sensors.pose]``: stands for camera and marker processing in fast studies."""

    rate_hz: Positive | None = None
    """None = the camera's."""
    latency_s: NonNegative | None = None
    """None = the camera's."""
    latency_jitter_s: NonNegative = 0.01
    sigma_xy_m: NonNegative = 0.0015
    """At 1 m above the floor; grows with the height. Measured on rendered pictures: 0.3 to 1.5 mm, z 0.7 mm."""
    sigma_z_m: NonNegative = 0.0007
    sigma_yaw_rad: NonNegative = 0.00035
    outlier_probability: Probability = 0.0
    """Per sample."""
    outlier_m: NonNegative = 0.5
    """Size of a wrong fix."""
    drop_probability: Probability = 0.01
    outages: Outages = Outages()


class LaserSensor(_Table, frozen=True, kw_only=True):
    """``[sensors.laser]``: the dot in the picture, or a range beside the pose sensor."""

    enabled: bool = True
    tilt_error_rad: Vec2 = (0.0, 0.0)
    """True direction of the beam against the vehicle file's: turned about the body's forward and starboard axes."""
    position_error_m: Vec3 = (0.0, 0.0, 0.0)
    """True place of the laser minus the vehicle file's, body frame."""
    sigma_m: NonNegative = 0.005
    """Of the range, when no picture is rendered."""
    outlier_probability: Probability = 0.0
    outlier_m: NonNegative = 0.3


class ObstacleSensor(_Table, frozen=True, kw_only=True):
    """``[sensors.obstacles]``: reports moving obstacles, and standing ones that are a surprise, as tracks."""

    range_m: NonNegative = 1.0
    """From the vehicle's centre to the obstacle's surface."""
    rate_hz: Positive = 5.0
    sigma_m: NonNegative = 0.01
    """Standard deviation of a reported position, each axis."""
    sigma_velocity_m_s: NonNegative = 0.01
    """Standard deviation of a reported velocity, each axis; what stands is known to stand."""
    latency_s: NonNegative = 0.1


class Sensors(_Table, frozen=True, kw_only=True):
    """``[sensors]``"""

    position: Literal["camera", "pose"] = "camera"
    """What the vehicle is localised by unless the command line says otherwise."""
    ahrs: AhrsSensor = AhrsSensor()
    camera: CameraSensor = CameraSensor()
    pose: PoseSensor = PoseSensor()
    laser: LaserSensor = LaserSensor()
    obstacles: ObstacleSensor = ObstacleSensor()


class CameraLook(_Table, frozen=True, kw_only=True):
    """``[camera]``: how pictures look. Defaults: a lit tank with clear water."""

    focal_factor: Positive = 1.0
    """True focal length over the calibrated one of the vehicle file."""
    mounting_error_rad: Vec3 = (0.0, 0.0, 0.0)
    """True mounting of the camera against the vehicle file's: roll, pitch, yaw about the body's axes."""
    position_error_m: Vec3 = (0.0, 0.0, 0.0)
    """True place of the camera minus the vehicle file's, body frame."""
    port: Port | None = None
    """``[camera.port]``: the true camera stands behind this flat pane; None = as the vehicle file says."""
    turbidity_1_m: NonNegative = 0.3
    """Contrast decays as exp(-turbidity * distance)."""
    blur_px: NonNegative = 0.8
    """Standard deviation of the optical blur."""
    exposure_s: NonNegative = 0.004
    """For motion blur."""
    noise_levels: NonNegative = 3.0
    """Standard deviation in grey levels of 0..255."""
    light: Positive = 1.0
    """Brightness of the scene, 1 = well exposed."""
    vignetting: Probability = 0.3
    """Loss of brightness in the corners."""
    caustics: Probability = 0.1
    """Relative amplitude of moving light patterns."""
    laser_brightness: NonNegative = 1.0


class Markers(_Table, frozen=True, kw_only=True):
    """``[markers]``: the board on the floor. Default: two markers in view at any yaw from 0.45 m above the floor."""

    file: str | None = None
    """Marker map file, relative to the scenario file, with what lies where; then the other keys do not count."""
    pitch_m: Positive = 0.08
    size_m: Positive = 0.06
    dictionary: str = "DICT_4X4_1000"
    """OpenCV's name; ids repeat when the floor holds more markers."""
    seed: Seed = 7
    """Of the order of ids on the floor."""

    def __post_init__(self) -> None:
        if self.size_m >= self.pitch_m:
            raise ValueError(f"`size_m` = {self.size_m:g} must be smaller than `pitch_m` = {self.pitch_m:g}")


class Controller(_Table, frozen=True, kw_only=True):
    """``[controller]``: what the vehicle is told."""

    currents: Literal["estimate", "map", "memory", "none", "uniform"] = "estimate"
    """A flow through all estimates, a map, what was estimated where, still water, or the estimate everywhere."""
    map: str | None = None
    """Map file for ``currents = "map"``, relative to the scenario file; None = the scenario's own field."""
    disturbance_n: NonNegative | None = None
    """Bound on unmodelled force per axis [N]; None = what parameter MPC_W_FORCE says."""
    disturbance_n_m: NonNegative | None = None
    """Bound on unmodelled yaw moment [N m]; None = what parameter MPC_W_MOMENT says."""

    def __post_init__(self) -> None:
        if self.map is not None and self.currents != "map":
            raise ValueError(f'`map` needs `currents` = "map", not "{self.currents}"')


class ThrusterLoss(_Table, frozen=True, kw_only=True, tag_field="kind", tag="thruster_loss"):
    """A thruster gives only ``1 - loss`` of its thrust."""

    at_s: NonNegative
    thruster: str
    """Name in the vehicle file."""
    loss: Probability = 1.0


class CameraBlackout(_Table, frozen=True, kw_only=True, tag_field="kind", tag="camera_blackout"):
    """Pictures (and the poses and ranges made of them) stop."""

    at_s: NonNegative
    duration_s: Positive


class AhrsFreeze(_Table, frozen=True, kw_only=True, tag_field="kind", tag="ahrs_freeze"):
    """The AHRS repeats its last values in well-formed frames."""

    at_s: NonNegative
    duration_s: Positive


Fault: TypeAlias = ThrusterLoss | CameraBlackout | AhrsFreeze


class Accept(_Table, frozen=True, kw_only=True):
    """``[accept]``: the bounds that a run is judged by, on the plant's truth. Defaults: the paper's, section IV."""

    cylinder_clearance_m: NonNegative = 0.46
    """Centre of the vehicle to the axis of a cylinder: its radius plus the 0.3 m ball."""
    wall_clearance_m: NonNegative = 0.3
    tolerance_m: NonNegative = 0.010
    """By how much a clearance may be missed."""
    depth_min_m: float = 0.0
    depth_max_m: float = 1.2
    planar_speed_m_s: Positive = 0.52
    """Norm of surge and sway relative to the water."""
    heave_m_s: Positive = 0.26
    yaw_rate_rad_s: Positive = 1.05
    thrust_n: Positive = 12.0
    pos_rms_m: Positive = 0.010
    yaw_rms_deg: Positive = 0.5
    campaign: Literal["bounds", "contact"] = "bounds"
    """What a campaign holds against a run: broken bounds and missing laps, or only contacts."""

    def __post_init__(self) -> None:
        if self.depth_max_m <= self.depth_min_m:
            raise ValueError(
                f"`depth_max_m` = {self.depth_max_m:g} must be greater than `depth_min_m` = {self.depth_min_m:g}"
            )


class Spread(_Table, frozen=True, kw_only=True):
    """One entry of ``[spread]``: what a campaign draws for a key of the scenario, evenly distributed."""

    low: float | None = None
    high: float | None = None
    choice: Annotated[list[float | str], msgspec.Meta(min_length=1)] | None = None
    """One of these, all equally likely; instead of low and high."""

    def __post_init__(self) -> None:
        if self.choice is not None:
            if self.low is not None or self.high is not None:
                raise ValueError("give either `choice` or `low` and `high`")
        elif self.low is None or self.high is None:
            raise ValueError("give `low` and `high`, or `choice`")
        elif self.high < self.low:
            raise ValueError(f"`high` = {self.high:g} is below `low` = {self.low:g}")


class Scenario(_Table, frozen=True, kw_only=True):
    """One scenario file."""

    scenario: Header
    origin: Origin = Origin()
    tank: Tank | None = None
    obstacle: list[Obstacle] = []
    current: Current = NoCurrent()
    vehicle: VehicleStart
    sensors: Sensors = Sensors()
    camera: CameraLook = CameraLook()
    markers: Markers = Markers()
    controller: Controller = Controller()
    fault: list[Fault] = []
    params: dict[str, float] = {}
    """Parameters of the vehicle that this scenario is flown with (``[params]``); saved ones and ``--param`` win."""
    accept: Accept = Accept()
    spread: dict[str, Spread] = {}
    """Key of this file ("vehicle.mismatch.drag", "fault[0].at_s") -> what a campaign draws for it."""
