"""GPS sets the origin where nobody has, and its fixes reach the estimator in local metres."""

import math

import numpy as np
from service_world import ORIGIN, ServiceWorld

from autopilot.core.geodesy import GeodeticPosition, Origin, ned_from_geodetic, place_from_ned
from autopilot.core.samples import GpsSample, PlanarFixSample, Sample

HERE = GeodeticPosition(lat_deg=52.011, lon_deg=4.357, alt_m=1.5)
UNSET = Origin(lat_deg=0.0, lon_deg=0.0)


class GpsWorld(ServiceWorld):
    """With a receiver at a place; by markers the vehicle is at :attr:`pos_ned_m` beside."""

    at: GeodeticPosition | None = None
    sigma_m = 1.5

    def samples(self) -> tuple[Sample, ...]:
        if self.at is None or self.t_us % 200_000:
            return super().samples()
        at = self.at
        fix = GpsSample(t_us=self.t_us, lat_deg=at.lat_deg, lon_deg=at.lon_deg, alt_m=at.alt_m, sigma_m=self.sigma_m)
        return (*super().samples(), fix)

    def fixes(self, seconds: float) -> list[PlanarFixSample]:
        found = []
        for _ in range(round(100 * seconds)):
            given = self.tick().estimated_from
            samples = () if given is None else given.samples
            found += [sample for sample in samples if isinstance(sample, PlanarFixSample)]
        return found


def test_the_first_good_fixes_set_an_origin_that_is_not_set() -> None:
    world = GpsWorld(origin=UNSET)
    world.pos_ned_m = np.array([3.0, -2.0, 0.1])
    world.run(2.0)
    world.at = HERE
    world.sigma_m = 20.0
    assert world.fixes(7.0) == [] and world.parts.plans.origin == UNSET, "too uncertain"
    world.sigma_m = 1.5
    world.fixes(6.0)
    origin = world.parts.plans.origin
    assert "Origin set by GPS: 52.01" in world.texts()
    assert origin.alt_m == HERE.alt_m
    place = ned_from_geodetic(origin, HERE.lat_deg, HERE.lon_deg, origin.alt_m)
    assert np.abs(place[:2] - [3.0, -2.0]).max() < 0.02, "the vehicle stays where it is in the local frame"
    fixes = world.fixes(2.0)
    assert len(fixes) == 10 and np.abs(fixes[-1].pos_ned_m - [3.0, -2.0]).max() < 0.02
    moved = place_from_ned(origin, 500.0, 0.0, 0.0)
    assert moved is not None
    world.at = moved
    world.fixes(8.0)
    assert world.parts.plans.origin == origin, "once"


def test_an_armed_vehicle_keeps_what_it_has() -> None:
    world = GpsWorld(origin=UNSET)
    world.run(3.0)
    assert world.parts.commander.arm(force=True).reason == ""
    world.at = HERE
    world.fixes(8.0)
    assert world.parts.plans.origin == UNSET


def test_an_origin_that_is_set_stays_and_fixes_far_from_it_are_told() -> None:
    world = GpsWorld(origin=ORIGIN)
    world.run(0.5)
    world.inbox.clear()
    world.at = HERE
    assert world.fixes(8.0) == []
    assert world.parts.plans.origin == ORIGIN
    assert world.texts().count("GPS not used: ") == 1 and "km from the origin" in world.texts()
    near = place_from_ned(ORIGIN, 12.0, 7.0, 0.0)
    assert near is not None
    world.at = near
    fixes = world.fixes(1.0)
    assert len(fixes) == 5 and np.abs(fixes[-1].pos_ned_m - [12.0, 7.0]).max() < 0.02


def test_impossible_places_are_passed_over() -> None:
    world = GpsWorld(origin=ORIGIN)
    world.at = GeodeticPosition(lat_deg=math.nan, lon_deg=0.0)
    assert world.fixes(1.0) == []
    world.at = GeodeticPosition(lat_deg=91.0, lon_deg=0.0)
    assert world.fixes(1.0) == []
