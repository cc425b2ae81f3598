"""Local NED <-> geodetic coordinates.

North and east are the topocentric coordinates of the point on the level surface of the origin (WGS-84 ellipsoid,
tangent plane at the origin); down is depth below that surface, so that the curvature of the earth does not show up as
depth (0.7 m at 3 km). Round trips close to better than a millimetre within :data:`MAX_RANGE_M`.

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
DEG_PER_E7 = 1e-7
"""MAVLink's latitude and longitude unit [deg]."""
LOCAL_PER_METRE = 1e4
"""MAVLink's x and y unit in local frames: metres * 1e4 (MISSION_ITEM_INT)."""
MAX_RANGE_M = 20_000.0
"""A point farther from the origin than this is refused: the tangent plane is meant for tanks and harbours."""
MAX_ORIGIN_LAT_DEG = 89.0
"""Nearer to a pole the east axis loses its meaning."""
_INVERSE_STEPS = 5
"""Each step shrinks the error by range / earth radius * tan(latitude); five reach rounding error within MAX_RANGE_M."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """A geodetic position: local origin (its altitude is the water surface), or home. ConfigError if out of range."""

    lat_deg: float
    lon_deg: float
    alt_m: float = 0.0
    """Metres AMSL."""

    def __post_init__(self) -> None:
        """Refuse what cannot be an origin."""
        if not abs(self.lat_deg) <= MAX_ORIGIN_LAT_DEG:
            raise ConfigError(
                f"origin latitude {self.lat_deg:g} deg is out of range; use -{MAX_ORIGIN_LAT_DEG:g} to "
                f"{MAX_ORIGIN_LAT_DEG:g}"
            )
        if not abs(self.lon_deg) <= 180.0:
            raise ConfigError(f"origin longitude {self.lon_deg:g} deg is out of range; use -180 to 180")
        if not math.isfinite(self.alt_m):
            raise ConfigError(f"origin altitude {self.alt_m} m is not finite; give the water surface's altitude")


def _radii_m(lat_rad: float) -> tuple[float, float]:
    """Radii of curvature in the meridian and in the prime vertical [m]."""
    w2 = 1.0 - ECCENTRICITY_SQ * math.sin(lat_rad) ** 2
    prime = SEMI_MAJOR_M / math.sqrt(w2)
    return prime * (1.0 - ECCENTRICITY_SQ) / w2, prime


def _north_east_m(origin: Origin, lat_rad: float, dlon_rad: float) -> tuple[float, float]:
    """Topocentric north and east of a point at the origin's level, from differences: no digits are lost."""
    lat0 = math.radians(origin.lat_deg)
    sin0, cos0 = math.sin(lat0), math.cos(lat0)
    sin1, cos1 = math.sin(lat_rad), math.cos(lat_rad)
    prime0, prime1 = _radii_m(lat0)[1], _radii_m(lat_rad)[1]
    level = origin.alt_m
    # Distance from the axis and height over the equator, both as differences to the origin's.
    half = 0.5 * (lat_rad - lat0)
    mid = 0.5 * (lat_rad + lat0)
    dsin, dcos = 2.0 * math.cos(mid) * math.sin(half), -2.0 * math.sin(mid) * math.sin(half)
    # prime1 - prime0 without cancellation: N = a / w.
    w0, w1 = SEMI_MAJOR_M / prime0, SEMI_MAJOR_M / prime1
    dprime = SEMI_MAJOR_M * ECCENTRICITY_SQ * dsin * (sin1 + sin0) / ((w0 + w1) * w0 * w1)
    axis1 = (prime1 + level) * cos1
    daxis = (prime1 + level) * dcos + dprime * cos0
    dheight = (prime1 * (1.0 - ECCENTRICITY_SQ) + level) * dsin + dprime * (1.0 - ECCENTRICITY_SQ) * sin0
    versine = 2.0 * math.sin(0.5 * dlon_rad) ** 2
    north = -sin0 * (daxis - axis1 * versine) + cos0 * dheight
    return north, axis1 * math.sin(dlon_rad)


def _wrap_rad(angle_rad: float) -> float:
    return math.remainder(angle_rad, 2.0 * math.pi)


def ned_from_geodetic(origin: Origin, lat_deg: float, lon_deg: float, alt_m: float) -> FloatArray:
    """Position (3,) north, east, depth [m] of a point given by latitude, longitude [deg] and altitude AMSL [m]."""
    dlon = _wrap_rad(math.radians(lon_deg - origin.lon_deg))
    north, east = _north_east_m(origin, math.radians(lat_deg), dlon)
    return np.array([north, east, origin.alt_m - alt_m])


def geodetic_from_ned(origin: Origin, pos_ned_m: FloatArray) -> tuple[float, float, float]:
    """Latitude, longitude [deg], altitude AMSL [m] of a local position (3,): inverse of :func:`ned_from_geodetic`."""
    north, east, down = (float(v) for v in pos_ned_m)
    lat = math.radians(origin.lat_deg)
    dlon = 0.0
    for _ in range(_INVERSE_STEPS):
        have_north, have_east = _north_east_m(origin, lat, dlon)
        meridian, prime = _radii_m(lat)
        lat += (north - have_north) / (meridian + origin.alt_m)
        dlon += (east - have_east) / ((prime + origin.alt_m) * math.cos(lat))
    lon_deg = math.degrees(_wrap_rad(math.radians(origin.lon_deg) + dlon))
    return math.degrees(lat), lon_deg, origin.alt_m - down


def surface_distance_m(origin: Origin, lat_deg: float, lon_deg: float) -> float:
    """Great-circle distance [m] to the origin on a sphere: good to 0.5 %, for telling near from far."""
    lat0, lat1 = math.radians(origin.lat_deg), math.radians(lat_deg)
    half_chord_sq = (
        math.sin(0.5 * (lat1 - lat0)) ** 2
        + math.cos(lat0) * math.cos(lat1) * math.sin(0.5 * math.radians(lon_deg - origin.lon_deg)) ** 2
    )
    return 2.0 * SEMI_MAJOR_M * math.asin(min(1.0, math.sqrt(half_chord_sq)))


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
