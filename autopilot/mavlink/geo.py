"""Local metres to degrees and back, for telemetry and go-to: the same plane as missions use, on plain numbers."""

import math

from autopilot.core.geodesy import lat_dlon_rad, north_east_m, wrap_rad
from autopilot.mavlink.api import GeoPoint


class TangentPlane:
    """North, east, down metres around an origin."""

    def __init__(self, origin: GeoPoint) -> None:
        self.origin = origin
        self._lat_rad, self._lon_rad = math.radians(origin.lat_deg), math.radians(origin.lon_deg)

    def geo_from_ned(self, north_m: float, east_m: float, down_m: float) -> GeoPoint | None:
        """Geodetic position of a local point; None so far out that it cannot be meant."""
        found = lat_dlon_rad(self._lat_rad, self.origin.alt_m, north_m, east_m)
        if found is None:
            return None
        lat_rad, dlon_rad = found
        return GeoPoint(
            lat_deg=math.degrees(lat_rad),
            lon_deg=math.degrees(wrap_rad(self._lon_rad + dlon_rad)),
            alt_m=self.origin.alt_m - down_m,
        )

    def ned_from_geo(self, point: GeoPoint) -> tuple[float, float, float]:
        """North, east, down [m] of a geodetic position."""
        dlon_rad = wrap_rad(math.radians(point.lon_deg) - self._lon_rad)
        north_m, east_m = north_east_m(self._lat_rad, self.origin.alt_m, math.radians(point.lat_deg), dlon_rad)
        return north_m, east_m, self.origin.alt_m - point.alt_m
