"""JSON of the page: scene (on change), frame (10 Hz), pictures, current field.

Local metres (NED, origin at the surface), radians, SI; units in the names. None = unknown. The page
(``autopilot/data/view``) reads these names; tests/view checks that both agree.
"""

from typing import TypeAlias

import msgspec

from autopilot.log.description import Point2, Point3, Waypoint

Arrow: TypeAlias = tuple[float, float, float, float]
"""North, east [m], northward, eastward [m/s]."""


class Outline(msgspec.Struct, frozen=True, kw_only=True):
    """A shape of the fence, circles as polygons."""

    inclusion: bool
    corners_m: tuple[Point2, ...]


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """Bounds of the controller."""

    planar_speed_m_s: float
    heave_m_s: float
    yaw_rate_rad_s: float
    thrust_n: float
    solve_ms: float
    """Time between two control steps."""


class AgeLimits(msgspec.Struct, frozen=True, kw_only=True):
    """Ages beyond which displayed values are stale [s], by their nominal rates."""

    link_s: float
    """Real time without a frame of the loop. All others are in the vehicle's time."""
    estimate_s: float
    control_s: float
    picture_s: float
    battery_s: float
    loop_s: float
    flow_s: float
    track_s: float


class FaultOffer(msgspec.Struct, frozen=True, kw_only=True):
    label: str
    fault: dict[str, object]
    """A scenario's ``[[fault]]`` table without ``at_s``."""


class Steerable(msgspec.Struct, frozen=True, kw_only=True):
    """Interventions available on the page: empty on a real vehicle."""

    pause: bool = False
    speed: bool = False
    reset: bool = False
    current: bool = False
    obstacles: bool = False
    faults: tuple[FaultOffer, ...] = ()
    missing: tuple[str, ...] = ()
    """Missing devices with the reason, a line each."""


class SceneView(msgspec.Struct, frozen=True, kw_only=True):
    title: str
    vehicle: str
    simulated: bool
    body_radius_m: float
    half_height_m: float
    tank_m: tuple[Point2, ...]
    """Corners of the walls; empty = open water."""
    tank_depth_m: float | None
    fence: tuple[Outline, ...]
    places: tuple[Waypoint, ...]
    """With the regions in which they count as reached."""
    limits: Limits
    ages: AgeLimits
    thrusters: tuple[str, ...]
    camera_px: tuple[int, int] | None
    """None: no camera delivers pictures."""
    steerable: Steerable
    parameters: dict[str, float]
    trail_ned_m: tuple[Point3, ...]
    """Where it has been, oldest first."""


class Estimate(msgspec.Struct, frozen=True, kw_only=True):
    age_s: float
    health: str
    pos_ned_m: Point3
    rpy_rad: Point3
    vel_water_frd_m_s: Point3
    vel_frd_m_s: Point3
    rate_frd_rad_s: Point3
    current_ned_m_s: Point3
    sigma_pos_m: Point3
    sigma_yaw_rad: float
    resets: int
    doubts: tuple[str, ...]


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """What is known of the vehicle while it does not know its place. None: too old."""

    rpy_rad: Point3 | None
    """Of the AHRS, yaw magnetic."""
    depth_m: float | None
    """Of the pressure sensor."""


class TrueState(msgspec.Struct, frozen=True, kw_only=True):
    """Ground truth, in simulations only."""

    pos_ned_m: Point3
    rpy_rad: Point3
    current_ned_m_s: Point3
    thrust_n: tuple[float, ...]
    power_w: float
    contacts: int
    contact_depth_m: float


class Solid(msgspec.Struct, frozen=True, kw_only=True):
    """An obstacle of the simulated world at its present position."""

    number: int
    kind: str
    """cylinder, sphere or prism."""
    center_m: Point2
    depth_m: float | None
    """Of a sphere's centre."""
    radius_m: float
    corners_m: tuple[Point2, ...]
    """Of a prism."""


class ObstacleView(msgspec.Struct, frozen=True, kw_only=True):
    number: int
    pos_ned_m: Point2
    vel_ned_m_s: Point2
    radius_m: float
    age_s: float


class GoalView(msgspec.Struct, frozen=True, kw_only=True):
    pos_ned_m: Point3
    yaw_rad: float | None
    accept_radius_m: float
    accept_yaw_rad: float
    speed_m_s: float
    speed_asked: bool
    """False = an upper bound."""
    item: int


class Control(msgspec.Struct, frozen=True, kw_only=True):
    status: str
    fallback: str
    age_s: float
    solve_ms: float
    iterations: int
    cost: float
    slack: float
    margin_m: float
    """Smallest clearance in the prediction beyond body and tube."""
    tube_now_m: float
    penalty_use: float
    horizon_ned_m: tuple[Point3, ...]
    route_ned_m: tuple[Point2, ...]
    tube_m: tuple[float, ...]
    """Round ``horizon_ned_m``; empty while there is none."""
    eta_s: float | None
    energy_j: float | None
    """To the goal, as planned (energy mode)."""
    plan_age_s: float | None
    """Of ``eta_s`` and ``energy_j``."""


class SensorView(msgspec.Struct, frozen=True, kw_only=True):
    name: str
    state: str
    test_ratio: float
    fused: bool
    age_s: float
    limit_s: float
    """Older than that it is silent."""


class DeviceView(msgspec.Struct, frozen=True, kw_only=True):
    """Last data of a device, used or not."""

    name: str
    age_s: float
    limit_s: float
    """Older than that it is silent."""


class ProgressView(msgspec.Struct, frozen=True, kw_only=True):
    state: str
    item: int
    reached: int
    lap: int


class BatteryView(msgspec.Struct, frozen=True, kw_only=True):
    """Last reading of the battery monitor."""

    age_s: float
    voltage_v: float
    current_a: float
    energy_used_j: float
    remaining: float


class Loop(msgspec.Struct, frozen=True, kw_only=True):
    """How the loop gets on, of the last second."""

    age_s: float
    longest_tick_ms: float
    cpu_share: float
    overruns: int
    lost_messages: int
    lost_pictures: int
    late_part: str


class MessageView(msgspec.Struct, frozen=True, kw_only=True):
    number: int
    """Counts from 1."""
    t_s: float
    severity: str
    text: str


class ViewFrame(msgspec.Struct, frozen=True, kw_only=True):
    """Dynamic state; frames are independent, viewers may miss any."""

    scene: int
    """Which scene it belongs to."""
    sent_s: float
    """When the process made it, real time on a clock of its own: how much later than others it arrives is its delay."""
    t_s: float
    stale_s: float
    """Real time since the loop left what this was made of."""
    paused: bool
    speed: float
    """That is asked for; 0 = as fast as possible."""
    viewers: int
    armed: bool
    mode: str
    failsafes: tuple[str, ...]
    estimate: Estimate | None
    measured: Measured | None
    """Where there is no valid estimate."""
    truth: TrueState | None
    solids: tuple[Solid, ...]
    extra_current_ned_m_s: Point2 | None
    """Flow that was added from the page; None where there is no such control."""
    tracks: tuple[ObstacleView, ...]
    clearance_m: float | None
    """Of the vehicle's centre to the fence in force, negative beyond it."""
    goal: GoalView | None
    progress: ProgressView | None
    control: Control | None
    thrust_n: tuple[float, ...]
    pwm_us: tuple[int, ...]
    effectiveness: tuple[float, ...]
    """Effectiveness of each thruster; empty while unknown."""
    sensors: tuple[SensorView, ...]
    devices: tuple[DeviceView, ...]
    battery: BatteryView | None
    loop: Loop | None
    messages: tuple[MessageView, ...]
    """The last ones, oldest first."""


class PictureView(msgspec.Struct, frozen=True, kw_only=True):
    """A camera picture with its detections."""

    t_s: float
    width_px: int
    height_px: int
    """Of the camera's own picture, in which corners are counted."""
    jpeg: str
    """base64"""
    markers: tuple[tuple[int, tuple[Point2, ...]], ...]
    """Id and corners."""
    laser_px: Point2 | None


class FlowView(msgspec.Struct, frozen=True, kw_only=True):
    """The simulated current on a grid, at the vehicle's depth."""

    t_s: float
    arrows: tuple[Arrow, ...]
    """Over all that the plan shows."""
    near: tuple[Arrow, ...] = ()
    """A finer grid round the vehicle, in open water."""


class LogView(msgspec.Struct, frozen=True, kw_only=True):
    """A log that the page plays."""

    name: str
    begin_s: float
    end_s: float
    scene: SceneView
    events: tuple[MessageView, ...]
    """All messages of the run."""


class LogFramesView(msgspec.Struct, frozen=True, kw_only=True):
    """Frames at regular times, without messages."""

    frames: tuple[ViewFrame, ...]
    trail_ned_m: tuple[Point3, ...]
    """Where the vehicle had been at the time of the first one, oldest first."""
