"""The estimator in the shadow of the flown one: silent in health and in gaps, a flag when they part."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from test_markers_pose import MarkerWorld
from truth import Faults, World, fly, tank_jet, uniform_current

from autopilot.core.frames import FloatArray
from autopilot.core.markers import MarkerMap
from autopilot.core.messages import AidStatus, NavDoubt, NavState, ShadowStatus
from autopilot.core.samples import LaserSample, MarkerSighting, PoseSample, Sample
from autopilot.core.vehicle import Vehicle
from autopilot.estimator import engine
from autopilot.estimator.complementary import create_complementary
from autopilot.estimator.create import create_estimator
from autopilot.estimator.ekf import create_ekf
from autopilot.estimator.markers_pose import MarkerSolver
from autopilot.estimator.measure_pose import PoseFix
from autopilot.estimator.shadow import Shadowed
from autopilot.estimator.states import SheetStates


class Displaced:
    """A flown estimator whose answer is wrong during a time."""

    def __init__(self, inner: Shadowed, from_us: int, to_us: int) -> None:
        self._inner, self._from_us, self._to_us = inner, from_us, to_us

    def step(self, t_us: int, samples: Sequence[Sample], thrust_n: FloatArray) -> NavState | None:
        nav = self._inner.step(t_us, samples, thrust_n)
        if nav is None or not self._from_us <= t_us < self._to_us:
            return nav
        return replace(nav, pos_ned_m=nav.pos_ned_m + np.array([0.4, 0.0, 0.0]))

    def take_aids(self) -> tuple[AidStatus, ...]:
        return self._inner.take_aids()

    def counters(self) -> Mapping[str, int]:
        return self._inner.counters()

    def take_made(self) -> tuple[PoseSample | LaserSample, ...]:
        return ()

    @property
    def doubts(self) -> frozenset[NavDoubt]:
        return self._inner.doubts

    @property
    def ahrs_us(self) -> int | None:
        return self._inner.ahrs_us

    @property
    def shadow(self) -> ShadowStatus | None:
        return None


@pytest.mark.parametrize("name", ["ekf", "complementary"])
def test_the_flown_estimate_is_not_touched(name: str, vehicle: Vehicle) -> None:
    """Bit for bit what it says alone; and the two agree, also without vision for five seconds."""
    alone = create_estimator(name, vehicle, None, floor_depth_m=1.5)
    watched = create_estimator(name, vehicle, None, floor_depth_m=1.5, shadow=True)
    gap = Faults(vision_gap_s=(5.0, 9.9), laser=True)
    ratios = []
    for (truth, samples, command), (_, same, _) in zip(
        World(uniform_current, gap).run(11.0), World(uniform_current, gap).run(11.0), strict=True
    ):
        one = alone.step(truth.t_us, samples, command)
        two = watched.step(truth.t_us, same, command)
        assert (one is None) == (two is None)
        if one is not None and two is not None:
            np.testing.assert_array_equal(one.pos_ned_m, two.pos_ned_m)
            np.testing.assert_array_equal(one.variance, two.variance)
        if watched.shadow is not None:
            ratios.append(watched.shadow.ratio)
            assert not watched.shadow.disagrees
    assert len(ratios) > 900
    assert max(ratios) < 1.0
    assert watched.counters()["shadow.disagreements"] == 0


def test_parting_is_flagged_after_a_second_and_taken_back(vehicle: Vehicle) -> None:
    inner = create_ekf(vehicle, None, 1.5)
    flown = Displaced(Shadowed(inner, create_complementary(vehicle, None, 1.5)), 5_000_000, 8_000_000)
    watched = Shadowed(flown, create_complementary(vehicle, None, 1.5))
    flags = []
    for truth, samples, command in World(tank_jet).run(10.0):
        watched.step(truth.t_us, samples, command)
        if watched.shadow is not None and watched.shadow.disagrees:
            flags.append(truth.t_us)
    assert flags[0] == pytest.approx(6_000_000, abs=20_000)
    assert flags[-1] == pytest.approx(9_000_000, abs=20_000)
    assert watched.counters()["shadow.disagreements"] == 1


def test_a_lost_shadow_has_nothing_to_say(vehicle: Vehicle) -> None:
    watched = create_estimator("ekf", vehicle, None, shadow=True)
    fly(watched, World(tank_jet, Faults(vision_gap_s=(3.0, 20.0))), 10.0)
    assert watched.shadow is None


def test_poses_from_pictures_are_made_once(vehicle: Vehicle, floor: MarkerMap, monkeypatch: pytest.MonkeyPatch) -> None:
    """The shadow is fed what the flown estimator made of the markers, with the pictures' own times."""
    calls = []

    class Counting(MarkerSolver):
        def track(
            self,
            sighting: MarkerSighting,
            pos_ned_m: FloatArray,
            rpy_rad: FloatArray,
            sheets: SheetStates | None = None,
        ) -> PoseFix | None:
            calls.append(sighting.t_us)
            return super().track(sighting, pos_ned_m, rpy_rad, sheets)

        def locate(
            self, sighting: MarkerSighting, roll_rad: float, pitch_rad: float, sheets: SheetStates | None = None
        ) -> PoseFix | None:
            calls.append(sighting.t_us)
            return super().locate(sighting, roll_rad, pitch_rad, sheets)

    monkeypatch.setattr(engine, "MarkerSolver", Counting)
    watched = create_estimator("ekf", vehicle, floor, shadow=True)
    world = MarkerWorld(tank_jet)
    world.floor = floor
    sightings = 0
    for truth, samples, command in world.run(4.0):
        sightings += sum(isinstance(sample, MarkerSighting) for sample in samples)
        watched.step(truth.t_us, samples, command)
    assert watched.shadow is not None
    assert watched.shadow.ratio < 0.5
    assert sightings - 3 <= len(calls) <= sightings
