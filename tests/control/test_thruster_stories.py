"""Lost thrusters against everything else that pushes: random vehicles, walls and tugs."""

import pytest

from tests.bench.thruster_health import NAMES, planned
from tests.bench.thruster_loops import Loss, fly


@pytest.mark.parametrize("seed", [1, 3, 8])
def test_a_sound_vehicle_far_from_its_file_is_not_blamed(seed: int) -> None:
    """Mass, drag and thrust far off, walls and tugs: a detector that compares thrusters blamed one in each of these."""
    flown = fly(seed, 40.0, None)
    assert flown.false == []
    assert flown.found == (1.0,) * 4


def test_a_munk_moment_far_above_the_file_is_no_loss() -> None:
    """Light in surge and yaw, heavy in sway, a tether that the estimator takes for water: the Munk moment is 2.6 times
    the file's, so that what is wrong with the water turns the hull far more than it drags it."""
    factors = {"surge_mass": 0.85, "sway_mass": 1.15, "yaw_inertia": 0.8, "tether_pull": 4.5}
    flown = fly(5, 30.0, None, factors=factors)
    assert flown.false == []
    assert flown.peak < 6.0


@pytest.mark.parametrize(("thruster", "seed"), [(0, 12), (1, 13), (3, 15)])
def test_a_dead_thruster_of_a_vehicle_far_from_its_file_is_found(thruster: int, seed: int) -> None:
    flown = fly(seed, 28.0, Loss(thruster=thruster, share=0.0, at_s=15.0))
    assert flown.false == []
    assert flown.first_s is not None
    assert flown.first_s - 15.0 < 10.0
    assert flown.found[thruster] < 0.35


def test_flights_of_the_bench_have_names_of_their_own_and_cover_sets_modes_and_thrusters() -> None:
    flights = planned(40, 24)
    assert len({flight.name for flight in flights}) == len(flights) == 2 * (40 + 24)
    sound = [flight for flight in flights if flight.thruster is None]
    assert {(flight.kind, flight.cost) for flight in sound} >= {
        (f"r{n}", cost) for n in (1, 2, 3, 4) for cost in (0, 1)
    }
    lossy = {(flight.thruster, flight.share) for flight in flights if flight.thruster is not None}
    assert lossy == {(i, share) for i in range(len(NAMES)) for share in (0.5, 0.0)}
    # More flights begin with the same ones: a folder is gone on with.
    assert planned(60, 30)[: len(flights) // 2] == flights[: len(flights) // 2]
