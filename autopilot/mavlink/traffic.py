"""Obstacles reported over MAVLink: other vehicles, and distance sensors.

GLOBAL_POSITION_INT of other vehicles, ADSB_VEHICLE and AIS_VESSEL become tracks of vertical cylinders with the
radius AVD_RADIUS (AIS: the ship's dimensions); OBSTACLE_DISTANCE becomes cylinders at the ends of its beams.
:mod:`autopilot.command.environment` drops obstacles that the fence already contains.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import deg_from_e7, ned_from_geodetic, refuse_place
from autopilot.core.samples import ObstacleTrack
from autopilot.mavlink.api import BEAM_TRACKS
from autopilot.mavlink.context import COMPID, Context, MavlinkPeer
from autopilot.mavlink.dialect import mav
from autopilot.mavlink.wire import Message

REACH_M = 500.0
"""Others farther away than this are of no concern yet."""
FASTEST_M_S = 9.9
"""Speed limit of tracks: faster objects could not be evaded."""
LARGEST_M = 99.0
"""Radii as well: from so near a longer ship's side is straight."""
DRAUGHT_M = 10.0
"""A ship is avoided down to here, and AVD_HEIGHT more."""
MAX_PER_TICK = 64
"""Reports of one tick; what is beyond them is dropped."""

_VEHICLE, _ADSB, _AIS, _BEAM = 1 << 28, 2 << 28, 3 << 28, BEAM_TRACKS
"""Offsets of track numbers by source, above those of our own sensors."""
_NUMBER = (1 << 28) - 1

MAX_BEAMS = 72
MAX_BLOBS = 24
"""Cylinders out of one sensor, the nearest first."""
GAP_M = 0.5
"""Ends of neighbouring beams nearer than this belong to one thing."""
BLOB_M = 1.0
"""Longer things are several cylinders."""
LEAST_RADIUS_M = 0.1
SAME_M = 0.4
"""A cylinder so near to one of the last scan is the same."""


@dataclass(slots=True)
class _Scan:
    """Last scan of one sensor: number -> position (2,)."""

    places: dict[int, FloatArray] = field(default_factory=dict)
    next: int = 0


class TrafficReports:
    """Takes reports; ``take`` hands them on."""

    def __init__(self, ctx: Context) -> None:
        self._ctx = ctx
        self._tracks: list[ObstacleTrack] = []
        self._removed: list[int] = []
        self._scans: dict[tuple[int, int, int], _Scan] = {}

    def take(self) -> tuple[tuple[ObstacleTrack, ...], tuple[int, ...]]:
        """Reports since the last call, and numbers of obstacles that have gone."""
        if not self._tracks and not self._removed:
            return (), ()
        tracks, removed = tuple(self._tracks), tuple(self._removed)
        self._tracks, self._removed = [], []
        return tracks, removed

    def on_global_position_int(self, peer: MavlinkPeer, msg: Message) -> None:
        if peer.compid != COMPID or (msg.lat == 0 and msg.lon == 0):
            return
        place = (deg_from_e7(msg.lat), deg_from_e7(msg.lon), msg.alt * 1e-3)
        velocity = complex(msg.vx, msg.vy) * 0.01
        self._add(_VEHICLE | peer.sysid, place, velocity, self._ctx.params["AVD_RADIUS"], self._height)

    def on_adsb_vehicle(self, peer: MavlinkPeer, msg: Message) -> None:
        """ADSB_VEHICLE, with any subset of valid fields."""
        if not msg.flags & mav.ADSB_FLAGS_VALID_COORDS:
            return
        altitude_m = msg.altitude * 1e-3 if msg.flags & mav.ADSB_FLAGS_VALID_ALTITUDE else self._altitude_m
        velocity = 0j
        if msg.flags & mav.ADSB_FLAGS_VALID_VELOCITY and msg.flags & mav.ADSB_FLAGS_VALID_HEADING:
            velocity = _along(msg.heading * 0.01, msg.hor_velocity * 0.01)
        place = (deg_from_e7(msg.lat), deg_from_e7(msg.lon), altitude_m)
        number = _ADSB | msg.ICAO_address & _NUMBER
        self._add(number, place, velocity, self._ctx.params["AVD_RADIUS"], self._height, age_s=float(msg.tslc))

    def on_ais_vessel(self, peer: MavlinkPeer, msg: Message) -> None:
        """AIS_VESSEL: a ship, with its dimensions round the antenna."""
        length, width = msg.dimension_bow + msg.dimension_stern, msg.dimension_port + msg.dimension_starboard
        radius_m = max(0.5 * math.hypot(length, width), self._ctx.params["AVD_RADIUS"])
        velocity = _along(msg.COG * 0.01, msg.velocity * 0.01)
        place = (deg_from_e7(msg.lat), deg_from_e7(msg.lon), self._ctx.view.origin.alt_m)
        reach = DRAUGHT_M + self._height
        self._add(_AIS | msg.MMSI & _NUMBER, place, velocity, radius_m, reach, age_s=float(msg.tslc))

    @property
    def _height(self) -> float:
        return self._ctx.params["AVD_HEIGHT"]

    @property
    def _altitude_m(self) -> float:
        nav, origin = self._ctx.view.nav, self._ctx.view.origin
        return origin.alt_m if nav is None else origin.alt_m - float(nav.pos_ned_m[2])

    def _add(
        self,
        number: int,
        place: tuple[float, float, float],
        velocity: complex,
        radius_m: float,
        height_m: float,
        *,
        age_s: float = 0.0,
    ) -> None:
        """A report of something that is ``age_s`` old; ``height_m``: how far above or below it matters."""
        ctx = self._ctx
        nav = ctx.view.nav
        if ctx.params["AVD_RADIUS"] <= 0.0 or nav is None or len(self._tracks) >= MAX_PER_TICK:
            return
        if refuse_place(ctx.view.origin, place[0], place[1]):
            return
        there = ned_from_geodetic(ctx.view.origin, *place)
        if abs(there[2] - nav.pos_ned_m[2]) > height_m or np.hypot(*(there - nav.pos_ned_m)[:2]) > REACH_M:
            return
        if abs(velocity) > FASTEST_M_S:
            velocity *= FASTEST_M_S / abs(velocity)
        self._tracks.append(
            ObstacleTrack(
                t_us=max(0, ctx.t_us - round(1e6 * age_s)),
                track_id=number,
                pos_ned_m=np.array(there[:2]),
                vel_ned_m_s=np.array([velocity.real, velocity.imag]),
                radius_m=min(radius_m, LARGEST_M),
            )
        )

    # OBSTACLE_DISTANCE

    def on_obstacle_distance(self, peer: MavlinkPeer, msg: Message) -> None:
        """Beams round the vehicle; 0 is ahead (MAV_FRAME_BODY_FRD), or north."""
        nav = self._ctx.view.nav
        step_deg = msg.increment_f or float(msg.increment)
        if nav is None or self._ctx.params["AVD_RADIUS"] <= 0.0 or not 0.0 < abs(step_deg) <= 180.0:
            return
        start = math.radians(msg.angle_offset) + (float(nav.rpy_rad[2]) if msg.frame == mav.MAV_FRAME_BODY_FRD else 0.0)
        if not math.isfinite(start):
            return
        step = math.radians(step_deg)
        count = min(MAX_BEAMS, max(1, int(2.0 * math.pi / abs(step) + 1e-6)))
        here = complex(*nav.pos_ned_m[:2])
        beams = [start + n * step for n in range(count)]
        reach_m = [0.01 * d if d != 0xFFFF else math.nan for d in msg.distances[:count]]
        hits = [
            (angle, far_m)
            for angle, far_m in zip(beams, reach_m, strict=True)
            if 0.01 * msg.min_distance <= far_m <= 0.01 * msg.max_distance
        ]
        blobs = _blobs(here, hits, abs(step))
        blobs.sort(key=lambda blob: abs(blob[0] - here))
        key = (peer.sysid, peer.compid, int(msg.sensor_type))
        if key not in self._scans and len(self._scans) >= MAX_BLOBS:
            return
        self._note(self._scans.setdefault(key, _Scan()), blobs[:MAX_BLOBS], here, beams, reach_m, abs(step))

    def _note(
        self,
        scan: _Scan,
        blobs: list[tuple[complex, float]],
        here: complex,
        beams: list[float],
        reach_m: list[float],
        step: float,
    ) -> None:
        """Associate returns with the numbers of the last scan; obstacles that a beam has passed through are removed."""
        left = dict(scan.places)
        for center, radius_m in blobs:
            at = np.array([center.real, center.imag])
            near = min(left, key=lambda n: float(np.hypot(*(left[n] - at))), default=None)
            if near is None or np.hypot(*(left[near] - at)) > SAME_M:
                number, scan.next = scan.next, (scan.next + 1) % 4096
            else:
                number = near
                del left[near]
            scan.places[number] = at
            if len(self._tracks) < MAX_PER_TICK:
                self._tracks.append(
                    ObstacleTrack(
                        t_us=self._ctx.t_us,
                        track_id=_BEAM | number,
                        pos_ned_m=at,
                        vel_ned_m_s=np.zeros(2),
                        radius_m=radius_m,
                    )
                )
        for number, at in left.items():
            off = complex(*at) - here
            for angle, far_m in zip(beams, reach_m, strict=True):
                turned = abs(math.remainder(math.atan2(off.imag, off.real) - angle, 2.0 * math.pi))
                if turned <= 0.5 * step and far_m > abs(off) + SAME_M:
                    del scan.places[number]
                    self._removed.append(_BEAM | number)
                    break
        while len(scan.places) > 2 * MAX_BLOBS:
            first = next(iter(scan.places))
            del scan.places[first]
            self._removed.append(_BEAM | first)


def _along(course_deg: float, speed_m_s: float) -> complex:
    """North and east of a speed on a course."""
    course = math.radians(course_deg)
    return speed_m_s * complex(math.cos(course), math.sin(course))


def _blobs(here: complex, hits: list[tuple[float, float]], step: float) -> list[tuple[complex, float]]:
    """Cylinders (centre, radius) round the ends of beams."""
    groups: list[list[tuple[complex, float]]] = []
    for angle, far_m in hits:
        end = here + far_m * complex(math.cos(angle), math.sin(angle))
        group = groups[-1] if groups else None
        if group is None or abs(end - group[-1][0]) > max(GAP_M, far_m * step) or abs(end - group[0][0]) > BLOB_M:
            groups.append([])
        groups[-1].append((end, far_m))
    found = []
    for group in groups:
        center = 0.5 * (group[0][0] + group[-1][0])
        radius_m = max(abs(end - center) for end, _ in group) + 0.5 * step * group[0][1]
        found.append((center, min(max(radius_m, LEAST_RADIUS_M), LARGEST_M)))
    return found
