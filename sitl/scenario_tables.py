"""The tables of a scenario file as immutable structs (what they mean as a whole: :mod:`autopilot.sitl.scenario`)."""

from itertools import pairwise
from typing import Annotated, Literal, TypeAlias

import msgspec

from autopilot.core.toml_table import NonNegative, Positive, Table, Vec2, Vec3
from autopilot.sitl.current_fields import Current, NoCurrentTable
from autopilot.sitl.fault_tables import (
    HullFault,
    MachineFault,
    Mishap,
    OperatorFault,
    PictureFault,
    SensorFault,
    SensorFrozen,
)
from autopilot.sitl.sensor_tables import ImageModel, OptionalName, Probability, Sensors

Latitude = Annotated[float, msgspec.Meta(ge=-90.0, le=90.0)]
Longitude = Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]
Seed = Annotated[int, msgspec.Meta(ge=0)]


class Header(Table, frozen=True, kw_only=True):
    """``[scenario]``"""

    name: str
    description: str
    seed: Seed = 1
    duration_s: Positive | None = None
    """The run ends here, None = when it is stopped."""
    plan: str | None = None
    """Plan file that ``sitl --start`` flies, relative to the scenario file (:func:`plan_path`)."""
    fence: Literal["from tank and obstacles"] | None = None
    """The plan's fence is drawn from this file's tank and obstacles; None = it is the plan's own."""


class OriginSection(Table, frozen=True, kw_only=True):
    """``[origin]``: where the local frame lies on the earth. Default: the campus of NTU Athens, the paper's authors."""

    lat_deg: Latitude = 37.9755
    lon_deg: Longitude = 23.7790
    alt_m: float = 0.0


class Tank(Table, frozen=True, kw_only=True):
    """``[tank]``: vertical walls and a flat floor. Absent = open water."""

    polygon_m: Annotated[list[Vec2], msgspec.Meta(min_length=3)]
    """Corners [north, east], simple, not closed, any winding, may be non-convex."""
    depth_m: Positive

    def __post_init__(self) -> None:
        _check_outline(self.polygon_m)


def _check_outline(corners: list[Vec2]) -> None:
    """ValueError if the walls between the corners are no simple polygon."""
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


class CylinderObstacle(Table, frozen=True, kw_only=True, tag_field="kind", tag="cylinder"):
    """A vertical cylinder from the floor to above the surface."""

    center_m: Vec2
    radius_m: Positive
    surprise: bool = False
    """The obstacle sensor reports it as it comes into range; whoever drew the fence did not know of it."""


class SphereObstacle(Table, frozen=True, kw_only=True, tag_field="kind", tag="sphere"):
    """A sphere."""

    center_m: Vec3
    radius_m: Positive


class PrismObstacle(Table, frozen=True, kw_only=True, tag_field="kind", tag="prism"):
    """A vertical prism from the floor to above the surface: a box, an inner wall, a quay."""

    polygon_m: Annotated[list[Vec2], msgspec.Meta(min_length=3)]
    """Corners [north, east], simple, not closed, any winding, may be non-convex."""

    def __post_init__(self) -> None:
        _check_outline(self.polygon_m)


class MovingObstacle(Table, frozen=True, kw_only=True, tag_field="kind", tag="moving"):
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


Obstacle: TypeAlias = CylinderObstacle | SphereObstacle | PrismObstacle | MovingObstacle


class Waves(Table, frozen=True, kw_only=True):
    """``[waves]``: surface waves by linear theory (:mod:`autopilot.sitl.waves`). Absent = a flat surface."""

    height_m: NonNegative
    """Crest to trough; of an irregular sea the significant height."""
    period_s: Positive
    """Of an irregular sea that of the spectrum's peak."""
    direction_rad: float = 0.0
    """Towards which they run, clockwise from north."""
    phase_rad: float = 0.0
    """Regular: 0 = a crest over the origin at the start."""
    spectrum: Literal["regular", "jonswap"] = "regular"
    """One regular wave, or a sea of many."""
    seed: Seed = 1
    """Of the phases of an irregular sea."""


class VehicleStart(Table, frozen=True, kw_only=True):
    """``[vehicle]``"""

    model: str = "lbv150"
    """Name of a shipped vehicle or path of a vehicle file (beside the scenario file, else from the current folder)."""
    start_m: Vec3
    start_yaw_rad: float = 0.0
    mismatch: dict[str, NonNegative] = msgspec.field(default_factory=dict)
    """Factors that make the plant differ from the vehicle file (sitl.mismatch.MISMATCH_KEYS)."""
    tether_entry_m: Vec3 | None = None
    """Where the tether enters the water; absent = no tether."""
    held: bool = False
    """A hand holds the vehicle where it starts until a thruster is commanded for the first time."""
    command_latency_s: NonNegative = 0.0
    """From the service's command to the amplifiers (tether electronics)."""


class LaidByHand(Table, frozen=True, kw_only=True):
    """``[markers.laid]``: the floor is of sheets that somebody laid by ruler and tape; the vehicle has the plan."""

    sheet_m: Positive = 0.6
    """Side of a sheet."""
    sigma_m: NonNegative = 0.002
    """Standard deviation of a sheet's place, north and east."""
    sigma_rad: NonNegative = 0.006
    """Of its heading."""
    print_scale: Positive = 1.0
    """True size of a sheet and all on it over the planned one: what the printer made of 100 %."""
    print_sigma_m: NonNegative = 0.0
    """Standard deviation of a marker on its sheet, north and east."""
    told_sigma_m: NonNegative | None = None
    """What the vehicle is told of the sheets' places,"""
    told_sigma_rad: NonNegative | None = None
    """and of their headings; None = the truth."""
    seed: Seed | None = None
    """None = the scenario's."""


class Markers(Table, frozen=True, kw_only=True):
    """``[markers]``: the board on the floor. Default: two markers in view at any yaw from 0.45 m above the floor."""

    file: str | None = None
    """Marker map file, relative to the scenario file, with what lies where; then the other keys do not count."""
    pitch_m: Positive = 0.08
    size_m: Positive = 0.06
    dictionary: str = "DICT_4X4_1000"
    """OpenCV's name; ids repeat when the floor holds more markers."""
    seed: Seed = 7
    """Of the order of ids on the floor."""
    laid: LaidByHand | None = None
    """None = the markers lie exactly where the map has them."""
    told_deeper_m: float = 0.0
    """How much deeper than it lies the vehicle is told that the floor is."""

    def __post_init__(self) -> None:
        if self.size_m >= self.pitch_m:
            raise ValueError(f"`size_m` = {self.size_m:g} must be smaller than `pitch_m` = {self.pitch_m:g}")


class ControllerTable(Table, frozen=True, kw_only=True):
    """``[controller]``: what the vehicle is told."""

    currents: Literal["estimate", "map", "none", "uniform"] = "estimate"
    """A flow through all estimates, a map, what was estimated where, still water, or the estimate everywhere."""
    basin: Literal["closed", "open", "unknown"] = "unknown"
    """For ``currents = "estimate"``: whether what flows comes back within the fence. A belief, not a fact: estimates
    that speak against it count for more."""
    map: str | None = None
    """Map file for ``currents = "map"``, relative to the scenario file; None = the scenario's own field."""
    disturbance_n: NonNegative | None = None
    """Bound on unmodelled force per axis [N]; None = what parameter MPC_W_FORCE says."""
    disturbance_n_m: NonNegative | None = None
    """Bound on unmodelled yaw moment [N m]; None = what parameter MPC_W_MOMENT says."""

    def __post_init__(self) -> None:
        if self.map is not None and self.currents != "map":
            raise ValueError(f'`map` needs `currents` = "map", not "{self.currents}"')


class Plugins(Table, frozen=True, kw_only=True):
    """``[plugins]``: who flies, who estimates and what moves. A shipped name, one of an installed package, or
    "package:Class" (docs/extend.md)."""

    controller: str = "nmpc"
    estimator: str = "ekf"
    plant: str = "rigid-body"


class ThrusterLoss(Table, frozen=True, kw_only=True, tag_field="kind", tag="thruster_loss"):
    """A thruster gives only ``1 - loss`` of its thrust."""

    at_s: NonNegative
    thruster: str
    """Name in the vehicle file."""
    loss: Probability = 1.0


class CameraBlackout(Table, frozen=True, kw_only=True, tag_field="kind", tag="camera_blackout"):
    """Pictures (and the poses and ranges made of them) stop."""

    at_s: NonNegative
    duration_s: Positive


class CameraPicture(Table, frozen=True, kw_only=True, tag_field="kind", tag="camera_picture"):
    """Pictures come in time and show nothing of use."""

    at_s: NonNegative
    duration_s: Positive
    looks: Literal["black", "white", "fog", "frozen"]
    """Lens covered, over-exposed, fogged, or the same picture again and again."""


class AhrsFreeze(Table, frozen=True, kw_only=True, tag_field="kind", tag="ahrs_freeze"):
    """The AHRS repeats its last values in well-formed frames."""

    at_s: NonNegative
    duration_s: Positive


class SensorSilence(Table, frozen=True, kw_only=True, tag_field="kind", tag="sensor_silence"):
    """A pressure sensor, Doppler log, altimeter or hull sensor says nothing."""

    at_s: NonNegative
    duration_s: Positive
    sensor: OptionalName | Literal["hull"]


Fault: TypeAlias = (
    ThrusterLoss
    | CameraBlackout
    | CameraPicture
    | PictureFault
    | AhrsFreeze
    | SensorSilence
    | SensorFrozen
    | SensorFault
    | HullFault
    | Mishap
    | OperatorFault
    | MachineFault
)


class Accept(Table, frozen=True, kw_only=True):
    """``[accept]``: the bounds that a run is judged by, on the plant's truth. Defaults: the paper's, section IV; None =
    the run's own limit (a parameter), of speeds with the paper's allowance."""

    cylinder_clearance_m: NonNegative = 0.46
    """Centre of the vehicle to the axis of a cylinder: its radius plus the 0.3 m ball."""
    wall_clearance_m: NonNegative = 0.3
    tolerance_m: NonNegative = 0.010
    """By how much a clearance may be missed."""
    depth_min_m: float = 0.0
    depth_max_m: float | None = None
    planar_speed_m_s: Positive | None = None
    """Norm of surge and sway relative to the water."""
    heave_m_s: Positive | None = None
    yaw_rate_rad_s: Positive | None = None
    thrust_n: Positive | None = None
    pos_rms_m: Positive = 0.010
    yaw_rms_deg: Positive = 0.5
    campaign: Literal["bounds", "contact"] = "bounds"
    """What a campaign holds against a run: broken bounds and missing laps, or only contacts."""

    def __post_init__(self) -> None:
        if self.depth_max_m is not None and self.depth_max_m <= self.depth_min_m:
            raise ValueError(
                f"`depth_max_m` = {self.depth_max_m:g} must be greater than `depth_min_m` = {self.depth_min_m:g}"
            )


class SpreadTable(Table, frozen=True, kw_only=True):
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


class Scenario(Table, frozen=True, kw_only=True):
    """One scenario file."""

    scenario: Header
    origin: OriginSection = OriginSection()
    tank: Tank | None = None
    obstacle: list[Obstacle] = msgspec.field(default_factory=list)
    current: Current = NoCurrentTable()
    waves: Waves | None = None
    vehicle: VehicleStart
    sensors: Sensors = Sensors()
    camera: ImageModel = ImageModel()
    markers: Markers = Markers()
    controller: ControllerTable = ControllerTable()
    plugins: Plugins = Plugins()
    fault: list[Fault] = msgspec.field(default_factory=list)
    params: dict[str, float] = msgspec.field(default_factory=dict)
    """Parameters of the vehicle that this scenario is flown with (``[params]``); saved ones and ``--param`` win."""
    accept: Accept = Accept()
    spread: dict[str, SpreadTable] = msgspec.field(default_factory=dict)
    """Key of this file ("vehicle.mismatch.drag", "fault[0].at_s") -> what a campaign draws for it."""
