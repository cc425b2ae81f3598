"""The tangent plane of WGS 84: the one conversion between degrees and local metres, for missions and for telemetry.

North and east are the topocentric coordinates of the point on the level surface of the origin (tangent plane at the
origin). Depth is depth below that surface, so that the curvature of the earth does not show up as depth (0.7 m at
3 km). Round trips close to better than a millimetre within :data:`MAX_RANGE_M` of every allowed origin.

Source: NIMA TR8350.2 (WGS-84 ellipsoid); geodetic to ECEF to local tangent plane, Fossen 2011, section 2.3.
"""

import math

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


def distance_m(lat0_deg: float, lon0_deg: float, lat_deg: float, lon_deg: float) -> float:
    """Great-circle distance [m] on a sphere: good to 0.5 %, for telling near from far."""
    lat0_rad, lat_rad = math.radians(lat0_deg), math.radians(lat_deg)
    half_chord_sq = (
        math.sin(0.5 * (lat_rad - lat0_rad)) ** 2
        + math.cos(lat0_rad) * math.cos(lat_rad) * math.sin(0.5 * math.radians(lon_deg - lon0_deg)) ** 2
    )
    return 2.0 * SEMI_MAJOR_M * math.asin(min(1.0, math.sqrt(half_chord_sq)))


def place_problem(lat0_deg: float, lon0_deg: float, lat_deg: float, lon_deg: float) -> str:
    """Why a place cannot be given in metres from an origin, "" if it can."""
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):
        return f"{lat_deg:.7f}, {lon_deg:.7f} is no place: latitude goes to 90 deg, longitude to 180"
    away_m = distance_m(lat0_deg, lon0_deg, lat_deg, lon_deg)
    return "" if away_m <= MAX_RANGE_M else far_text(away_m)


def far_text(away_m: float) -> str:
    """What is said of a place that is too far away."""
    return f"{away_m / 1e3:.1f} km from the origin, limit {MAX_RANGE_M / 1e3:g}: set the origin there first"
