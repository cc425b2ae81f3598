"""GPS in the estimator: it begins at the surface, makes nothing surer than it is, and gives way to better sources."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from truth import Faults, World, no_current

from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavHealth, NavState
from autopilot.core.samples import DepthSample, PlanarFixSample, PoseSample, Sample
from autopilot.core.vehicle import load_vehicle
from autopilot.estimator.create import create_estimator
from autopilot.estimator.options import EstimatorOptions

SIGMA_M = 1.5
LEVER_M = 0.5
"""The antenna is so far ahead of the centre of gravity."""


class Surface:
    """A vehicle at rest whose antenna is above the water; the error of its fixes stays the same."""

    def __init__(self, name: str = "ekf", *, depth_m: float = 0.1) -> None:
        shipped = load_vehicle("bluerov2")
        gps = msgspec.structs.replace(shipped.gps, position_frd_m=(LEVER_M, 0.0, -0.2))
        vehicle = msgspec.structs.replace(shipped, gps=gps)
        self.estimator = create_estimator(name, vehicle, None, options=EstimatorOptions(sigma_limit_m=5.0))
        self.world = World(no_current, Faults(seed=2, vision=False, yaw_offset=0.02, yaw_offset_swing=0.0))
        self.world.goals = [(self.world.n, self.world.e, depth_m, 0.0)] * 2
        self.world.d = depth_m
        self.error_m: FloatArray = np.array([0.8, -0.6])
        self.sigma_m = SIGMA_M
        self.gps = True
        self.markers = False
        self.nav: NavState | None = None
        self.used = 0

    def run(self, seconds: float) -> NavState | None:
        for truth, samples, thrust in self.world.run(seconds):
            given: list[Sample] = [s for s in samples if self.markers or not isinstance(s, PoseSample)]
            t_us = truth.t_us
            if t_us % 100_000 == 0:
                given.append(DepthSample(t_us=t_us, depth_m=float(truth.pos[2]), sigma_m=0.005))
            if self.gps and t_us % 200_000 == 0:
                ahead = LEVER_M * np.array([math.cos(truth.yaw), math.sin(truth.yaw)])
                place = truth.pos[:2] + ahead + self.error_m
                given.append(PlanarFixSample(t_us=t_us, pos_ned_m=place, sigma_m=self.sigma_m))
            if self.markers and t_us % 100_000 == 0:
                sigma = np.full(3, 0.005)
                given.append(
                    PoseSample(t_us=t_us, pos_ned_m=truth.pos, yaw_rad=truth.yaw, sigma_pos_m=sigma, sigma_yaw_rad=0.01)
                )
            self.nav = self.estimator.step(t_us, given, thrust)
            self.used += sum(aid.fused for aid in self.estimator.take_aids() if aid.sensor == "gps")
        return self.nav

    @property
    def off_m(self) -> float:
        assert self.nav is not None
        return float(np.hypot(*(self.nav.pos_ned_m - self.world.truth().pos)[:2]))

    @property
    def sigma_now_m(self) -> float:
        assert self.nav is not None
        return math.sqrt(float(self.nav.variance[:2].max()))


def test_it_begins_by_gps_and_is_no_surer_than_that() -> None:
    flight = Surface()
    nav = flight.run(60.0)
    assert nav is not None and nav.health is NavHealth.GOOD
    assert flight.sigma_now_m > 0.45 * SIGMA_M, "300 fixes of one and the same error"
    assert flight.off_m < 3.0 * flight.sigma_now_m
    assert flight.used < 40


def test_the_observer_passes_gps_over() -> None:
    assert Surface("complementary").run(10.0) is None


def test_under_water_no_fix_is_used_and_none_begins_it() -> None:
    flight = Surface(depth_m=1.0)
    assert flight.run(5.0) is None
    flight.markers = True
    assert flight.run(5.0) is not None
    flight.markers = False
    before = flight.used
    nav = flight.run(8.0)
    assert flight.used == before == 0
    assert nav is not None and nav.health is NavHealth.INVALID, "no fix for 5 s"


def test_markers_take_over_and_are_not_moved_by_gps() -> None:
    flight = Surface()
    flight.run(20.0)
    assert flight.off_m > 0.3
    flight.markers = True
    nav = flight.run(10.0)
    assert nav is not None and nav.health is NavHealth.GOOD
    assert flight.off_m < 0.03 and flight.sigma_now_m < 0.03
    before = flight.used
    flight.error_m = np.array([30.0, 0.0])
    flight.run(20.0)
    assert flight.used == before and flight.off_m < 0.03


def test_a_fix_far_off_is_rejected_and_one_that_stays_is_believed() -> None:
    flight = Surface()
    flight.run(20.0)
    right_m = flight.error_m
    flight.error_m = np.array([60.0, 0.0])
    flight.run(3.0)
    assert flight.off_m < 5.0
    flight.error_m = right_m
    flight.run(10.0)
    assert flight.off_m < 5.0
    counts = dict(flight.estimator.counters())
    flight.error_m = np.array([60.0, 0.0])
    nav = flight.run(120.0)
    assert nav is not None
    assert flight.off_m > 50.0
    assert flight.estimator.counters()["gps.resets"] == counts["gps.resets"] + 1
    assert nav.reset_count == 1, "the controller plans anew"


@pytest.mark.parametrize(
    "change",
    [
        {"pos_ned_m": np.array([math.nan, 0.0])},
        {"pos_ned_m": np.zeros(3)},
        {"pos_ned_m": np.array([1e7, 0.0])},
        {"sigma_m": -1.0},
        {"sigma_m": math.inf},
    ],
)
def test_malformed_fixes_are_counted(change: dict[str, object]) -> None:
    flight = Surface()
    flight.run(5.0)
    good = PlanarFixSample(t_us=flight.world.t_us + 5_000, pos_ned_m=np.zeros(2), sigma_m=1.0)
    wrong = replace(good, **change)  # type: ignore[arg-type]
    for truth, samples, thrust in flight.world.run(0.1):
        given = [*[s for s in samples if not isinstance(s, PoseSample)], *([wrong] if wrong is not None else [])]
        flight.estimator.step(truth.t_us, given, thrust)
        wrong = None  # type: ignore[assignment]
    assert flight.estimator.counters()["gps.malformed"] == 1
