"""Local tangent plane of WGS 84: the only conversion between degrees and local metres, for missions and telemetry.

North and east are the topocentric coordinates of the point on the level surface of the origin (tangent plane at the
origin). Depth is measured from that surface, so that the curvature of the earth does not appear in it (0.7 m at 3 km).
The error of a round trip is below a millimetre within :data:`MAX_RANGE_M` of every allowed origin.

Source: NIMA TR8350.2 (WGS-84 ellipsoid); geodetic to ECEF to local tangent plane, Fossen 2011, section 2.3.
"""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray

SEMI_MAJOR_M = 6378137.0
"""WGS-84 semi-major axis [m] (NIMA TR8350.2)."""
ECCENTRICITY_SQ = 6.69437999014e-3
"""WGS-84 first eccentricity squared (NIMA TR8350.2)."""
MAX_RANGE_M = 10_000.0
"""Home, go-to, origin (with plans in force) and items farther from the origin than this are refused. A vehicle of this
class swims an hour for 1 km, and at 10 km the plane lies 8 m beside the level surface: what is farther is a mistake."""
MAX_ORIGIN_LAT_DEG = 89.0
"""Nearer to a pole the east axis loses its meaning."""
_INVERSE_RANGE_M = 2.0 * MAX_RANGE_M
"""Farther out the inverse is not asked for: an estimate there has diverged."""
_INVERSE_STEPS = 24
"""Each step shrinks the error by range / earth radius * tan(latitude), 0.18 at most; they stop at rounding error."""
_CLOSED_RAD = 1e-15
DEG_PER_E7 = 1e-7
"""MAVLink's latitude and longitude unit [deg]."""
LOCAL_PER_METRE = 1e4
"""MAVLink's x and y unit in local frames: metres * 1e4 (MISSION_ITEM_INT)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GeodeticPosition:
    lat_deg: float
    lon_deg: float
    alt_m: float = 0.0
    """Metres AMSL."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin(GeodeticPosition):
    """Valid origin of the local frame; its altitude is the water surface. ConfigError if out of range."""

    def __post_init__(self) -> None:
        if not abs(self.lat_deg) <= MAX_ORIGIN_LAT_DEG:
            raise ConfigError(
                f"origin latitude {self.lat_deg:g} deg is out of range; use -{MAX_ORIGIN_LAT_DEG:g} to "
                f"{MAX_ORIGIN_LAT_DEG:g}"
            )
        if not abs(self.lon_deg) <= 180.0:
            raise ConfigError(f"origin longitude {self.lon_deg:g} deg is out of range; use -180 to 180")
        if not math.isfinite(self.alt_m):
            raise ConfigError(f"origin altitude {self.alt_m} m is not finite; give the water surface's altitude")


def radii_m(lat_rad: float) -> tuple[float, float]:
    """Radii of curvature in the meridian and in the prime vertical [m]."""
    w2 = 1.0 - ECCENTRICITY_SQ * math.sin(lat_rad) ** 2
    prime = SEMI_MAJOR_M / math.sqrt(w2)
    return prime * (1.0 - ECCENTRICITY_SQ) / w2, prime


def north_east_m(lat0_rad: float, level_m: float, lat_rad: float, dlon_rad: float) -> tuple[float, float]:
    """Topocentric north and east of a point at the origin's level, from differences: no digits are lost."""
    sin0, cos0 = math.sin(lat0_rad), math.cos(lat0_rad)
    sin1, cos1 = math.sin(lat_rad), math.cos(lat_rad)
    prime0, prime1 = radii_m(lat0_rad)[1], radii_m(lat_rad)[1]
    # Distance from the axis and height over the equator, both as differences to the origin's.
    half = 0.5 * (lat_rad - lat0_rad)
    mid = 0.5 * (lat_rad + lat0_rad)
    dsin, dcos = 2.0 * math.cos(mid) * math.sin(half), -2.0 * math.sin(mid) * math.sin(half)
    # prime1 - prime0 without cancellation: N = a / w.
    w0, w1 = SEMI_MAJOR_M / prime0, SEMI_MAJOR_M / prime1
    dprime = SEMI_MAJOR_M * ECCENTRICITY_SQ * dsin * (sin1 + sin0) / ((w0 + w1) * w0 * w1)
    axis1 = (prime1 + level_m) * cos1
    daxis = (prime1 + level_m) * dcos + dprime * cos0
    dheight = (prime1 * (1.0 - ECCENTRICITY_SQ) + level_m) * dsin + dprime * (1.0 - ECCENTRICITY_SQ) * sin0
    versine = 2.0 * math.sin(0.5 * dlon_rad) ** 2
    north = -sin0 * (daxis - axis1 * versine) + cos0 * dheight
    return north, axis1 * math.sin(dlon_rad)


def wrap_rad(angle_rad: float) -> float:
    """An angle within -pi to pi."""
    return math.remainder(angle_rad, 2.0 * math.pi)


def lat_dlon_rad(lat0_rad: float, level_m: float, north_m: float, east_m: float) -> tuple[float, float] | None:
    """Latitude, and longitude from the origin's: inverse of :func:`north_east_m`. None too far out to be meant."""
    if not math.hypot(north_m, east_m) <= _INVERSE_RANGE_M:
        return None
    lat_rad, dlon_rad = lat0_rad, 0.0
    for _ in range(_INVERSE_STEPS):
        have_north_m, have_east_m = north_east_m(lat0_rad, level_m, lat_rad, dlon_rad)
        meridian_m, prime_m = radii_m(lat_rad)
        dlat = (north_m - have_north_m) / (meridian_m + level_m)
        dlon = (east_m - have_east_m) / ((prime_m + level_m) * math.cos(lat_rad))
        lat_rad, dlon_rad = lat_rad + dlat, dlon_rad + dlon
        if abs(dlat) + abs(dlon) < _CLOSED_RAD:
            break
    return lat_rad, dlon_rad


def ned_from_geodetic(origin: GeodeticPosition, lat_deg: float, lon_deg: float, alt_m: float) -> FloatArray:
    """Position (3,) north, east, depth [m] of a point given by latitude, longitude [deg] and altitude AMSL [m]."""
    dlon = wrap_rad(math.radians(lon_deg - origin.lon_deg))
    north, east = north_east_m(math.radians(origin.lat_deg), origin.alt_m, math.radians(lat_deg), dlon)
    return np.array([north, east, origin.alt_m - alt_m])


def place_from_ned(origin: GeodeticPosition, north_m: float, east_m: float, down_m: float) -> GeodeticPosition | None:
    """Geodetic position of a local one; None so far out that it cannot be meant."""
    found = lat_dlon_rad(math.radians(origin.lat_deg), origin.alt_m, north_m, east_m)
    if found is None:
        return None
    lon_deg = math.degrees(wrap_rad(math.radians(origin.lon_deg) + found[1]))
    return GeodeticPosition(lat_deg=math.degrees(found[0]), lon_deg=lon_deg, alt_m=origin.alt_m - down_m)


def geodetic_from_ned(origin: GeodeticPosition, pos_ned_m: FloatArray) -> tuple[float, float, float]:
    """Latitude, longitude [deg], altitude AMSL [m] of a local position (3,): inverse of :func:`ned_from_geodetic`.

    ConfigError for a position so far out that it cannot be meant.
    """
    north, east, down = (float(v) for v in pos_ned_m)
    place = place_from_ned(origin, north, east, down)
    if place is None:
        raise ConfigError(f"local position {north:g}, {east:g} m is {far_text(math.hypot(north, east))}")
    return place.lat_deg, place.lon_deg, place.alt_m


def surface_distance_m(origin: GeodeticPosition, lat_deg: float, lon_deg: float) -> float:
    """Great-circle distance [m] to the origin on a sphere: good to 0.5 %, for telling near from far."""
    lat0_rad, lat_rad = math.radians(origin.lat_deg), math.radians(lat_deg)
    half_chord_sq = (
        math.sin(0.5 * (lat_rad - lat0_rad)) ** 2
        + math.cos(lat0_rad) * math.cos(lat_rad) * math.sin(0.5 * math.radians(lon_deg - origin.lon_deg)) ** 2
    )
    return 2.0 * SEMI_MAJOR_M * math.asin(min(1.0, math.sqrt(half_chord_sq)))


def refuse_place(origin: GeodeticPosition, lat_deg: float, lon_deg: float) -> str:
    """Why a geodetic position cannot be given in metres from this origin, "" if it can."""
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):
        return f"{lat_deg:.7f}, {lon_deg:.7f} is no place: latitude goes to 90 deg, longitude to 180"
    away_m = surface_distance_m(origin, lat_deg, lon_deg)
    return "" if away_m <= MAX_RANGE_M else far_text(away_m)


def far_text(away_m: float) -> str:
    """Message for a position that is too far away."""
    return f"{away_m / 1e3:.1f} km from the origin, limit {MAX_RANGE_M / 1e3:g}: set the origin there first"


def e7_from_deg(angle_deg: float) -> int:
    """Degrees as MAVLink's 1e-7 degree integer, rounded to nearest (1 unit = 11 mm of latitude)."""
    return round(angle_deg / DEG_PER_E7)


def deg_from_e7(angle_e7: int) -> float:
    """MAVLink's 1e-7 degree integer in degrees."""
    return angle_e7 / 1e7


def local_e4_from_m(length_m: float) -> int:
    """Metres as MAVLink's local integer (0.1 mm)."""
    return round(length_m * LOCAL_PER_METRE)


def m_from_local_e4(length_e4: int) -> float:
    """MAVLink's local integer in metres."""
    return length_e4 / LOCAL_PER_METRE
