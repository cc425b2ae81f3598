"""SURFTRAK: the height over a floor that rises and falls, through Autopilot.step."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from piloted_world import ALTITUDE, PilotedWorld

from autopilot.command.vehicle_status import FRESH_US, FloorRanges
from autopilot.core.frames import r_ned_from_frd
from autopilot.core.samples import AltimeterSample, LaserSample, Sample

SURFTRAK = (4 << 16) | (11 << 24)
ACCEPTED, DENIED = 0, 2
FLAT_M = 1.4


class FloorWorld(PilotedWorld):
    """A vehicle whose laser looks at a floor; its depth is a function of north."""

    floor: Callable[[float], float] = staticmethod(lambda north: FLAT_M)
    ranges = True
    sonar = False
    """An altimeter in the laser's place."""
    every_us = 50_000
    doubles = 0.0
    """Share of readings of twice the range."""
    confidence = 1.0
    """Of a sonar's double."""
    frozen_m: float | None = None
    """A sonar's range that it goes on with."""

    def samples(self) -> tuple[Sample, ...]:
        said = super().samples()
        if not self.ranges or self.t_us % self.every_us:
            return said
        twice = np.random.default_rng(self.t_us).random() < self.doubles
        mount = self.vehicle.altimeter if self.sonar else self.vehicle.laser
        assert mount is not None
        range_m = (1 + twice) * (self.height - mount.position_frd_m[2])
        if self.sonar:
            confidence = self.confidence if twice else 1.0
            range_m = range_m if self.frozen_m is None else self.frozen_m
            return (*said, AltimeterSample(t_us=self.t_us, range_m=range_m, sigma_m=0.01, confidence=confidence))
        noise_m = 0.004 * math.sin(1.7 * self.t_us * 1e-4)
        return (*said, LaserSample(t_us=self.t_us, range_m=range_m + noise_m, sigma_m=0.01))

    @property
    def height(self) -> float:
        """Over the floor."""
        return float(self.floor(float(self.x[0])) - self.x[2])

    def heights(self, seconds: float, **sticks: int) -> tuple[float, float]:
        """Least and largest height while it is steered."""
        found = []
        for _ in range(round(10 * seconds)):
            self.steer(0.1, **sticks)
            found.append(self.height)
        return min(found), max(found)


def tracking(**kwargs: object) -> FloorWorld:
    """Armed, in SURFTRAK, settled."""
    world = FloorWorld(**kwargs)  # type: ignore[arg-type]
    world.run(1.5)
    world.arm()
    world.run(0.5)
    assert world.mode(SURFTRAK) == ACCEPTED, world.texts()
    world.steer(2.0)
    return world


def ridge(height_m: float, width_m: float = 1.0) -> Callable[[float], float]:
    return lambda north: FLAT_M - height_m * math.exp(-((north / width_m) ** 2))


@pytest.mark.parametrize(
    ("height_m", "sonar"),
    [(0.35, False), pytest.param(-0.35, False, marks=pytest.mark.long), (0.35, True)],
    ids=["ridge", "ditch", "by sonar"],
)
def test_the_height_is_held_over_a_floor_that_changes(height_m: float, sonar: bool) -> None:
    FloorWorld.sonar = sonar
    try:
        world = tracking(start=(-1.6, 0.5, 0.6, 0.0))
    finally:
        FloorWorld.sonar = False
    world.sonar = sonar
    held = world.height
    world.floor = ridge(height_m)
    least, largest = world.heights(25.0, x=350)
    assert world.x[0] > 1.0, "it came over"
    assert held - 0.1 < least and largest < held + 0.1
    assert max(abs(z - 0.6) for z in np.array(world.track)[:, 2]) > 0.25, "the depth followed"


@pytest.mark.long
def test_depth_hold_over_the_same_ridge_does_not_follow() -> None:
    """What the test above shows is the mode's doing."""
    world = tracking(start=(-1.6, 0.5, 0.6, 0.0))
    assert world.mode(ALTITUDE) == ACCEPTED
    world.floor = ridge(0.35)
    least, _ = world.heights(25.0, x=350)
    assert least < 0.55


def test_the_pilot_moves_the_height() -> None:
    world = tracking()
    held = world.height
    world.steer(2.0, z=750)
    world.steer(4.0)
    moved = world.height
    assert moved > held + 0.1
    world.floor = lambda north: FLAT_M - 0.2
    world.steer(8.0)
    assert world.height == pytest.approx(moved, abs=0.04)


def test_without_a_range_it_is_refused_and_one_that_is_lost_holds_the_depth() -> None:
    world = FloorWorld()
    world.ranges = False
    world.run(1.5)
    world.arm()
    assert world.mode(SURFTRAK) == DENIED
    assert "no range to the floor" in world.texts()
    world.ranges = True
    world.run(0.5)
    assert world.mode(SURFTRAK) == ACCEPTED
    world.steer(2.0)
    depth, held = world.x[2], world.height
    world.ranges = False
    world.floor = lambda north: FLAT_M - 0.2
    world.steer(4.0)
    assert "No range to the floor: holding depth" in world.texts()
    assert world.x[2] == pytest.approx(depth, abs=0.03)
    world.ranges = True
    world.steer(8.0)
    assert "Range to the floor is back" in world.texts()
    assert world.height == pytest.approx(held, abs=0.04)


def test_a_slow_sonar_is_no_floor_that_is_lost_again_and_again() -> None:
    """A range every 1.1 s was lost and back every time."""
    world = tracking()
    world.sonar, world.every_us = True, 1_100_000
    world.steer(4.0)  # of a sonar instead of the laser two ranges are needed
    world.inbox.clear()
    world.steer(15.0)
    assert "to the floor" not in world.texts()
    world.ranges = False
    world.steer(6.0)
    assert world.texts().count("No range to the floor: holding depth") == 1


def test_a_sonar_that_is_frozen_is_named_and_not_followed() -> None:
    """It was trusted for good: over a floor that rose the vehicle held its depth, and nobody was told."""
    world = tracking(start=(-1.6, 0.5, 0.6, 0.0), params={"FS_SENS_TIME": 1.0})
    world.sonar = True
    world.steer(2.0)
    world.floor, world.frozen_m = ridge(0.6), 0.75
    world.steer(1.5)
    assert "to the floor" not in world.texts(), "a vehicle at rest over a flat floor"
    world.heights(6.0, x=350)
    texts = world.texts()
    assert texts.count("No range to the floor: holding depth") == 1, texts
    assert texts.count("Failsafe: altimeter silent or frozen") == 1, texts
    world.frozen_m = None
    world.steer(2.0)
    assert "Failsafe over: altimeter silent or frozen" in world.texts()
    assert "Range to the floor is back: holding height" in world.texts()


@pytest.mark.parametrize(
    ("sonar", "every_us", "doubles", "confidence"),
    [(False, 50_000, 0.3, 1.0), (True, 100_000, 0.4, 1.0), (True, 500_000, 0.3, 1.0), (True, 100_000, 0.7, 0.3)],
    ids=["laser", "sonar", "slow sonar", "doubtful"],
)
def test_echoes_that_came_back_twice_do_not_move_it(
    sonar: bool, every_us: int, doubles: float, confidence: float
) -> None:
    world = tracking()
    world.sonar, world.every_us = sonar, every_us
    world.steer(2.0)
    held = world.height
    world.doubles, world.confidence = doubles, confidence
    least, largest = world.heights(10.0)
    assert held - 0.06 < least and largest < held + 0.06


def test_a_floor_that_falls_away_is_followed_no_deeper_than_the_band() -> None:
    world = tracking()
    world.floor = lambda north: FLAT_M + 3.0
    world.steer(15.0)
    assert world.x[2] <= world.parts.params["DEPTH_MAX"] + 0.02


def test_a_floor_that_rises_faster_than_the_vehicle_slows_it_down() -> None:
    world = tracking(start=(-1.6, 0.5, 0.8, 0.0), params={"PILOT_SPD_Z": 0.05})
    world.floor = lambda north: FLAT_M - 0.55 / (1.0 + math.exp(-4.0 * (north - 0.2)))
    least, _ = world.heights(30.0, x=1000)
    assert least > 0.25


def test_without_a_position_the_height_is_held_by_depth_rate() -> None:
    world = FloorWorld(fixes=False, depth=True, start=(0.0, 0.0, 0.6, 0.3))
    world.run(1.5)
    assert world.mode(SURFTRAK) == ACCEPTED
    world.run(0.5)
    world.arm()
    world.steer(6.0)
    held = world.height
    world.floor = lambda north: FLAT_M - 0.2
    world.steer(12.0)
    assert world.height == pytest.approx(held, abs=0.06)
    world.steer(2.0, z=200)
    assert world.height < held - 0.1


angle = st.floats(-0.4, 0.4)


@given(angle, angle, st.floats(0.3, 20.0), st.tuples(angle, angle), st.tuples(angle, angle, angle))
@settings(max_examples=60, deadline=None)
def test_the_height_is_that_over_a_level_floor(
    roll: float, pitch: float, height_m: float, tilt: tuple[float, float], place: tuple[float, float, float]
) -> None:
    beam = (*tilt, 1.0)
    rpy = np.array([roll, pitch, 0.7])
    down = r_ned_from_frd(rpy)[2]
    unit = np.array(beam) / np.linalg.norm(beam)
    range_m = (height_m - float(down @ np.array(place))) / float(down @ unit)
    ranges = FloorRanges()
    ranges.mount("laser", place, beam)
    if range_m > 0.0:
        ranges.note("laser", 0, range_m)
        assert ranges.height_m(FRESH_US, rpy) == pytest.approx(height_m)
        assert ranges.height_m(FRESH_US + 1, rpy) is None
