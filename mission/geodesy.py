"""Local NED <-> geodetic coordinates, as missions use them: on :mod:`autopilot.core.geodesy`, with an origin that is
known to be one."""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.geodesy import (
    ECCENTRICITY_SQ,
    MAX_ORIGIN_LAT_DEG,
    MAX_RANGE_M,
    SEMI_MAJOR_M,
    distance_m,
    far_text,
    lat_dlon_rad,
    north_east_m,
    place_problem,
    wrap_rad,
)

__all__ = [
    "ECCENTRICITY_SQ",
    "MAX_ORIGIN_LAT_DEG",
    "MAX_RANGE_M",
    "SEMI_MAJOR_M",
    "Origin",
    "Place",
    "deg_from_e7",
    "e7_from_deg",
    "far_text",
    "geodetic_from_ned",
    "local_e4_from_m",
    "m_from_local_e4",
    "ned_from_geodetic",
    "refuse_place",
    "surface_distance_m",
]

DEG_PER_E7 = 1e-7
"""MAVLink's latitude and longitude unit [deg]."""
LOCAL_PER_METRE = 1e4
"""MAVLink's x and y unit in local frames: metres * 1e4 (MISSION_ITEM_INT)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A geodetic position."""

    lat_deg: float
    lon_deg: float
    alt_m: float = 0.0
    """Metres AMSL."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin(Place):
    """Where local axes can be put; its altitude is the water surface. ConfigError if out of range."""

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


def ned_from_geodetic(origin: Origin, lat_deg: float, lon_deg: float, alt_m: float) -> FloatArray:
    """Position (3,) north, east, depth [m] of a point given by latitude, longitude [deg] and altitude AMSL [m]."""
    dlon = wrap_rad(math.radians(lon_deg - origin.lon_deg))
    north, east = north_east_m(math.radians(origin.lat_deg), origin.alt_m, math.radians(lat_deg), dlon)
    return np.array([north, east, origin.alt_m - alt_m])


def geodetic_from_ned(origin: Origin, pos_ned_m: FloatArray) -> tuple[float, float, float]:
    """Latitude, longitude [deg], altitude AMSL [m] of a local position (3,): inverse of :func:`ned_from_geodetic`.

    ConfigError for a position so far out that it cannot be meant.
    """
    north, east, down = (float(v) for v in pos_ned_m)
    found = lat_dlon_rad(math.radians(origin.lat_deg), origin.alt_m, north, east)
    if found is None:
        raise ConfigError(f"local position {north:g}, {east:g} m is {far_text(math.hypot(north, east))}")
    lon_deg = math.degrees(wrap_rad(math.radians(origin.lon_deg) + found[1]))
    return math.degrees(found[0]), lon_deg, origin.alt_m - down


def surface_distance_m(origin: Place, lat_deg: float, lon_deg: float) -> float:
    """Great-circle distance [m] to the origin on a sphere: good to 0.5 %, for telling near from far."""
    return distance_m(origin.lat_deg, origin.lon_deg, lat_deg, lon_deg)


def refuse_place(origin: Place, lat_deg: float, lon_deg: float) -> str:
    """Why a geodetic position cannot be used with this origin, "" if it can."""
    return place_problem(origin.lat_deg, origin.lon_deg, lat_deg, lon_deg)


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
