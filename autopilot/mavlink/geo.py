"""Local metres to degrees and back, for telemetry and go-to: the tangent plane of WGS 84 at the origin.

Second order in distance over earth radius: within 1 mm of the exact plane at 2 km, within 3 cm at 10 km (middle
latitudes); depth is depth under the level surface of the origin, as everywhere in the service.
"""

import math

from autopilot.mavlink.api import GeoPoint

WGS84_A_M = 6_378_137.0
"""Semi-major axis (NIMA TR8350.2)."""
WGS84_E2 = 6.694_379_990_14e-3
"""First eccentricity squared (NIMA TR8350.2)."""


class TangentPlane:
    """North, east, down metres around an origin."""

    def __init__(self, origin: GeoPoint) -> None:
        self.origin = origin
        lat_rad = math.radians(origin.lat_deg)
        w2 = 1.0 - WGS84_E2 * math.sin(lat_rad) ** 2
        prime_m = WGS84_A_M / math.sqrt(w2)
        self._meridian_m = prime_m * (1.0 - WGS84_E2) / w2 + origin.alt_m
        self._prime_m = prime_m + origin.alt_m
        self._cos = max(math.cos(lat_rad), 1e-9)
        self._tan = math.sin(lat_rad) / self._cos

    def geo_from_ned(self, north_m: float, east_m: float, down_m: float) -> GeoPoint:
        """Geodetic position of a local point."""
        sag_m = 0.5 * east_m * east_m * self._tan / self._prime_m
        dlat = (north_m - sag_m) / self._meridian_m
        dlon = east_m / (self._prime_m * self._cos) * (1.0 + dlat * self._tan)
        return GeoPoint(
            lat_deg=self.origin.lat_deg + math.degrees(dlat),
            lon_deg=self.origin.lon_deg + math.degrees(dlon),
            alt_m=self.origin.alt_m - down_m,
        )

    def ned_from_geo(self, point: GeoPoint) -> tuple[float, float, float]:
        """North, east, down [m] of a geodetic position."""
        dlat = math.radians(point.lat_deg - self.origin.lat_deg)
        dlon = math.remainder(math.radians(point.lon_deg - self.origin.lon_deg), 2.0 * math.pi)
        east_m = dlon * self._prime_m * self._cos * (1.0 - dlat * self._tan)
        north_m = dlat * self._meridian_m + 0.5 * east_m * east_m * self._tan / self._prime_m
        return north_m, east_m, self.origin.alt_m - point.alt_m
