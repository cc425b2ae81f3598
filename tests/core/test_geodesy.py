"""Local metres and degrees: against the definition of the tangent plane, and there and back."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.core.errors import ConfigError
from autopilot.core.geodesy import (
    ECCENTRICITY_SQ,
    SEMI_MAJOR_M,
    Origin,
    deg_from_e7,
    e7_from_deg,
    geodetic_from_ned,
    local_e4_from_m,
    m_from_local_e4,
    ned_from_geodetic,
    radii_m,
    surface_distance_m,
)

ATHENS = Origin(lat_deg=37.9755, lon_deg=23.7790)
origins = st.builds(
    Origin,
    lat_deg=st.floats(-80.0, 80.0),
    lon_deg=st.floats(-180.0, 180.0),
    alt_m=st.floats(-400.0, 4000.0),
)
harbour_m = st.floats(-5000.0, 5000.0)


def _ecef_m(lat_deg: float, lon_deg: float, alt_m: float) -> np.ndarray:
    lat, lon = math.radians(lat_deg), math.radians(lon_deg)
    prime = SEMI_MAJOR_M / math.sqrt(1.0 - ECCENTRICITY_SQ * math.sin(lat) ** 2)
    return np.array(
        [
            (prime + alt_m) * math.cos(lat) * math.cos(lon),
            (prime + alt_m) * math.cos(lat) * math.sin(lon),
            (prime * (1.0 - ECCENTRICITY_SQ) + alt_m) * math.sin(lat),
        ]
    )


@given(origins, st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
def test_north_and_east_are_the_tangent_planes(origin: Origin, dlat: float, dlon: float) -> None:
    lat, lon = origin.lat_deg + dlat, origin.lon_deg + dlon
    off = _ecef_m(lat, lon, origin.alt_m) - _ecef_m(origin.lat_deg, origin.lon_deg, origin.alt_m)
    la, lo = math.radians(origin.lat_deg), math.radians(origin.lon_deg)
    north = np.dot(off, [-math.sin(la) * math.cos(lo), -math.sin(la) * math.sin(lo), math.cos(la)])
    east = np.dot(off, [-math.sin(lo), math.cos(lo), 0.0])
    got = ned_from_geodetic(origin, lat, lon, origin.alt_m)
    assert got == pytest.approx([north, east, 0.0], abs=1e-6)


@given(origins, harbour_m, harbour_m, st.floats(0.0, 100.0))
def test_round_trip_closes_below_a_millimetre(origin: Origin, north: float, east: float, depth: float) -> None:
    back = ned_from_geodetic(origin, *geodetic_from_ned(origin, np.array([north, east, depth])))
    assert back == pytest.approx([north, east, depth], abs=1e-5)


@given(st.floats(-3000.0, 3000.0), st.floats(-3000.0, 3000.0))
def test_round_trip_through_wire_integers_is_within_their_resolution(north: float, east: float) -> None:
    lat, lon, _ = geodetic_from_ned(ATHENS, np.array([north, east, 0.0]))
    back = ned_from_geodetic(ATHENS, deg_from_e7(e7_from_deg(lat)), deg_from_e7(e7_from_deg(lon)), 0.0)
    assert math.hypot(back[0] - north, back[1] - east) < 0.0075


@given(st.integers(-900_000_000, 900_000_000))
def test_degrees_survive_both_ways(value: int) -> None:
    assert e7_from_deg(deg_from_e7(value)) == value
    assert local_e4_from_m(m_from_local_e4(value)) == value


def test_depth_does_not_change_with_distance() -> None:
    far = geodetic_from_ned(ATHENS, np.array([5000.0, 5000.0, 10.0]))
    assert far[2] == -10.0


def test_across_the_date_line() -> None:
    origin = Origin(lat_deg=-17.0, lon_deg=179.9999)
    _, lon, _ = geodetic_from_ned(origin, np.array([0.0, 100.0, 0.0]))
    assert -180.0 <= lon < -179.99
    assert ned_from_geodetic(origin, -17.0, lon, 0.0)[1] == pytest.approx(100.0, abs=0.01)


def test_radii_of_curvature_at_equator_and_pole() -> None:
    """a (1 - e^2) and a; both a / sqrt(1 - e^2) (WGS 84)."""
    one = 1.0 - ECCENTRICITY_SQ
    assert radii_m(0.0) == pytest.approx((SEMI_MAJOR_M * one, SEMI_MAJOR_M), rel=1e-14)
    assert radii_m(0.5 * math.pi) == pytest.approx((SEMI_MAJOR_M / math.sqrt(one),) * 2, rel=1e-14)


def test_surface_distance_tells_near_from_far() -> None:
    assert surface_distance_m(ATHENS, 38.9755, 23.7790) == pytest.approx(111e3, rel=0.01)
    assert surface_distance_m(ATHENS, -37.9755, 23.7790 - 180.0) == pytest.approx(math.pi * SEMI_MAJOR_M, rel=1e-6)


@pytest.mark.parametrize(
    ("lat", "lon", "alt", "word"),
    [
        (89.9, 0.0, 0.0, "latitude"),
        (math.nan, 0.0, 0.0, "latitude"),
        (0.0, 181.0, 0.0, "longitude"),
        (0.0, 0.0, math.inf, "altitude"),
    ],
)
def test_impossible_origins_are_refused(lat: float, lon: float, alt: float, word: str) -> None:
    with pytest.raises(ConfigError, match=word):
        Origin(lat_deg=lat, lon_deg=lon, alt_m=alt)
