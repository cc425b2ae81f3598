"""``run.json``: description of the run for plots and verdicts.

The composition root fills a :class:`RunDescription` and :mod:`autopilot.log.log_session` attaches it to the log.
Local metres (NED, origin at the water surface), radians and SI. A log without this attachment can still be read and
plotted, without bounds and geometry.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import msgspec
import numpy as np

from autopilot.core.errors import LogError
from autopilot.core.geometry import Circle, Fence, Polygon, Shape

ATTACHMENT = "run.json"
RUN_RECORD = "run"
"""Name of the metadata record with version, revision, scenario, seed, speed and ``epoch_ns``."""

Point2: TypeAlias = tuple[float, float]
Point3: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptBounds:
    """Acceptance bounds of the run, None = not judged. Names as in a scenario's ``[accept]``; defaults: paper, IV;
    :meth:`of_limits` scales them to other limits.
    """

    laps: int | None = None
    """Times that the waypoints have to be visited in order (back to the first one if the tour is closed)."""
    cylinder_clearance_m: float | None = 0.46
    """Vehicle's centre to the axis of a cylinder of the paper's radius; other radii keep the same ball."""
    wall_clearance_m: float | None = 0.3
    """Vehicle's centre to the tank's walls and to the fence."""
    tolerance_m: float = 0.010
    """By how much a clearance may be missed."""
    depth_min_m: float | None = 0.0
    depth_max_m: float | None = 1.2
    planar_speed_m_s: float | None = 0.52
    """Norm of surge and sway relative to the water."""
    heave_m_s: float | None = 0.26
    yaw_rate_rad_s: float | None = 1.05
    thrust_n: float | None = 12.0
    pos_rms_m: float | None = 0.010
    yaw_rms_deg: float | None = 0.5

    @classmethod
    def of_limits(cls, params: Mapping[str, float], laps: int | None) -> "AcceptBounds":
        """Bounds from the controller's limits, with the paper's tolerance beyond its own."""
        return cls(
            laps=laps,
            depth_max_m=params["DEPTH_MAX"],
            planar_speed_m_s=round(params["SPD_PLANAR_MAX"] + 0.02, 6),
            heave_m_s=round(params["SPD_HEAVE_MAX"] + 0.01, 6),
            yaw_rate_rad_s=round(params["SPD_YAW_MAX"] + 0.05, 6),
            thrust_n=params["THR_LIMIT"],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Obstacle:
    """A solid of the world: a vertical cylinder (``center_m`` of 2) or a sphere (``center_m`` of 3)."""

    center_m: tuple[float, ...]
    """Of one that moves: where it begins."""
    radius_m: float
    name: str = ""
    path_m: tuple[Point2, ...] = ()
    """Corners of the polyline along which it moves; empty = static."""
    speed_m_s: float = 0.0
    ends: str = "bounce"
    """Behaviour at the last corner: "bounce" back, "loop" to the first one or "stop"."""
    start_s: float = 0.0
    """On the service's clock."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FenceItemDescription:
    """One fence item: a circle (center and radius) or a polygon (vertices)."""

    inclusion: bool
    center_m: Point2 | None = None
    radius_m: float | None = None
    vertices_m: tuple[Point2, ...] = ()

    @property
    def shape(self) -> Shape:
        if self.center_m is not None and self.radius_m is not None:
            return Circle(center_ned_m=np.array(self.center_m), radius_m=self.radius_m)
        return Polygon(vertices_ned_m=np.array(self.vertices_m))


@dataclass(frozen=True, slots=True, kw_only=True)
class Waypoint:
    name: str
    pos_ned_m: Point3
    yaw_rad: float | None = None
    accept_radius_m: float = 0.3
    accept_yaw_rad: float = 0.15


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraView:
    """The camera as configured in the service."""

    width_px: int
    height_px: int
    focal_px: Point2
    center_px: Point2
    distortion: tuple[float, ...]
    """k1 k2 p1 p2 k3; of a fisheye k1 k2 k3 k4. Of the lens in air if it is behind a flat pane."""
    fisheye: bool
    position_frd_m: Point3
    """Projection centre in the body frame."""
    r_frd_from_cam: tuple[float, ...]
    """(9,) mounting, by rows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PartOrigin:
    """Origin of a controller, an estimator or a plant: identifies the exact code."""

    name: str
    """As it was asked for: a shipped name, a package's, or package:Class."""
    target: str
    """``module:attribute`` that made it."""
    version: str
    """Distribution and version, "" for a file that is of none."""
    sha256: str = ""
    """Of that module's file; "" for a shipped one, which version and revision of the run identify."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunDescription:
    """Everything about a run that is not a time series."""

    scenario: str
    """Name of the scenario; on hardware the name of the site or an empty string."""
    vehicle: str
    parts: dict[str, PartOrigin] = field(default_factory=dict)
    """By role: controller, estimator, plant; empty in logs without it."""
    solver: str = ""
    """Solver of the controller's plans, and why no faster one; empty in logs without it."""
    seed: int | None = None
    speed: float | None = None
    """Requested speed relative to real time, 0 = as fast as possible; None on hardware."""
    origin_lat_deg: float | None = None
    origin_lon_deg: float | None = None
    origin_alt_m: float | None = None
    body_radius_m: float = 0.3
    """Ball round the vehicle's centre."""
    hull_m: Point2 | None = None
    """Radius and half height of a cylinder as large as the hull, for drawing."""
    camera: CameraView | None = None
    hotel_power_w: float = 0.0
    """Electrical power beside the thrusters, part of the energy per lap."""
    thruster_names: tuple[str, ...] = ()
    """In the order of commands; as many as the vehicle has, or none."""
    tank_polygon_m: tuple[Point2, ...] = ()
    """Corners of the walls; empty = open water."""
    tank_depth_m: float | None = None
    obstacles: tuple[Obstacle, ...] = ()
    fence: tuple[FenceItemDescription, ...] = ()
    waypoints: tuple[Waypoint, ...] = ()
    """In the order of one lap."""
    closed_tour: bool = True
    """A lap ends at the first waypoint again (A-B-A); False = at the last one."""
    tour: tuple[int, ...] = ()
    """Numbers of the waypoints (from 0) as the mission visits them; empty = laps of all of them."""
    accept: AcceptBounds = field(default_factory=AcceptBounds)
    paper_bounds: dict[str, float] = field(
        default_factory=lambda: {"planar_speed_m_s": 0.5, "heave_m_s": 0.25, "yaw_rate_rad_s": 1.0, "thrust_n": 12.0}
    )
    """Dashed lines of the figures: the bounds of the controller."""
    mode_names: dict[str, str] = field(default_factory=dict)
    """custom_mode (as decimal text) -> name, for the report."""
    parameters: dict[str, float] = field(default_factory=dict)
    """All parameters as they were at the start."""


def fence_shapes(fence: Fence) -> tuple[FenceItemDescription, ...]:
    """The fence in force as the description keeps it."""
    inside = [_shape(shape, True) for shape in fence.inclusions]
    return tuple(inside + [_shape(shape, False) for shape in fence.exclusions])


def _shape(shape: Shape, inclusion: bool) -> FenceItemDescription:
    if isinstance(shape, Polygon):
        vertices = tuple((float(x), float(y)) for x, y in shape.vertices_ned_m)
        return FenceItemDescription(inclusion=inclusion, vertices_m=vertices)
    circle: Circle = shape
    north, east = (float(v) for v in circle.center_ned_m)
    return FenceItemDescription(inclusion=inclusion, center_m=(north, east), radius_m=circle.radius_m)


def to_json(description: RunDescription) -> bytes:
    return msgspec.json.format(msgspec.json.encode(description), indent=1)


def from_json(data: bytes, origin: str) -> RunDescription:
    """The description of a log. LogError names the problem."""
    try:
        return msgspec.json.decode(data, type=RunDescription)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise LogError(
            f"{origin}: attachment {ATTACHMENT} is damaged ({error}); the log can only be read raw"
        ) from error
