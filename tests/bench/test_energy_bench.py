"""The energy benchmark: cases, optimum, committed data and bookkeeping."""

import math
from dataclasses import replace

import numpy as np
import pytest

from autopilot.control.energy.power import PowerModel, energy_per_metre, speed_table
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState
from autopilot.core.vehicle import load_vehicle
from autopilot.sitl.scenario import load_scenario, plan_path
from tests.bench.energy.bench import against_optimum
from tests.bench.energy.cases import CASES, REGION_M, Case, EnergyGoal, uniform
from tests.bench.energy.flight import EnergyFlight, fly, plant_field
from tests.bench.energy.optimum import (
    Guess,
    LeastEnergy,
    solve_laps,
    start_state,
    tank_guess,
    tank_guesses,
    tank_legs,
    worst_gap_m,
)
from tests.bench.energy.record import CORRIDOR, CORRIDOR_LAPS, LAPS, SINGLE, case_of, comparator, load_records

VEHICLE = load_vehicle("lbv150")
MODEL, POWER = VEHICLE.to_model(), PowerModel.of(VEHICLE)


def leg(along_m_s: float, length_m: float) -> Case:
    goal = EnergyGoal(pos_ned_m=(length_m, 0.0, 5.0), yaw_rad=None)
    return Case(
        name="leg", flow_name="uniform", flow=uniform(along_m_s, 0.0), start=(0.0, 0.0, 5.0, 0.0), goals=(goal,)
    )


@pytest.mark.parametrize("along_m_s", [0.0, -0.15])
def test_optimum_of_a_straight_leg_is_speed_to_fly(along_m_s: float) -> None:
    """Two legs differ by what steady motion over the difference of their lengths takes: ends drop out."""
    energies = []
    for length in (6.0, 9.0):
        case = leg(along_m_s, length)
        program = LeastEnergy(MODEL, POWER, case, 45, 5)
        guess = Guess(label="straight", paths_ned_m=((),), yaw_rad=(None,))
        optimum = program.solve(guess, start_state(case))
        assert optimum.solved
        assert worst_gap_m(MODEL, case, optimum, 0.05) < 1e-3
        energies.append(optimum.energy_j)
    steady = energy_per_metre(speed_table(MODEL, POWER, 0.5, 200), np.array([along_m_s]), np.array([0.0]))
    assert energies[1] - energies[0] == pytest.approx(3.0 * float(steady[0]), rel=0.01)


@pytest.mark.parametrize("name", list(CASES))
def test_flow_of_a_case_is_the_plants(name: str) -> None:
    case, field = CASES[name], plant_field(CASES[name])
    for x, y in ((0.3, 0.4), (-1.6, -0.35), (1.75, 0.9)):
        assert case.flow(x, y, math) == pytest.approx(field.velocity((x, y, 0.4), 0.0)[:2], abs=1e-6)


@pytest.mark.parametrize("name", ["b1", "b2", "b3", "b4", "b5"])
def test_scenarios_are_the_cases(name: str) -> None:
    known, unknown = load_scenario(name), load_scenario(f"{name}-est")
    assert known.current == unknown.current
    assert (known.controller.currents, unknown.controller.currents) == ("map", "estimate")
    assert unknown.vehicle.mismatch == {"mass": 1.2, "drag": 1.2}
    assert plan_path(name, known) is not None
    case = next(case for key, case in CASES.items() if key.startswith(name))
    assert known.vehicle.start_m[:2] == case.start[:2]


def test_committed_optima_fit_their_cases() -> None:
    records = load_records()
    assert set(records) == {CORRIDOR, CORRIDOR_LAPS, LAPS, *CASES}
    for name, record in records.items():
        case = case_of(name)
        assert record.track_ned_m[0] == pytest.approx(case.start[:2], abs=2e-3)
        assert np.hypot(*(record.track_ned_m[-1] - case.goals[-1].pos_ned_m[:2])) <= REGION_M + 2e-3
        assert record.energy_j > 12.0 * record.duration_s
        assert record.energy_j == pytest.approx(sum(record.leg_j), abs=0.1)
        assert record.energy_j == pytest.approx(sum(record.lap_j), abs=0.1)
        assert record.energy_j == pytest.approx(min(record.classes.values()), abs=0.1)
        assert record.gap_m < 5e-3
        # The grid knows neither inertia nor turning, which in a tank is a fifth.
        assert (0.75 if case.tank else 0.98) < record.grid_j / record.energy_j < 1.01


def test_committed_optima_of_a_neutral_vehicle_are_the_published_ones() -> None:
    """Legs of B2 in a current are published as the limit of steady motion; what the ends make of it is small."""
    for record in load_records().values():
        assert record.neutral_j < record.energy_j, record.name
        if record.published_j is not None:
            assert record.neutral_j == pytest.approx(record.published_j, rel=0.005), record.name


@pytest.mark.parametrize(("name", "single"), list(SINGLE.items()))
def test_three_laps_are_an_optimum_of_their_own(name: str, single: str) -> None:
    """The first of them is a lap from rest, so not below the best such lap; the last need not care for a next one."""
    records = load_records()
    laps, lap = records[name].lap_j, records[single].energy_j
    assert len(laps) == CASES["b1"].laps
    assert laps[0] >= lap - 0.1
    assert max(laps) < 1.05 * lap
    assert records[CORRIDOR_LAPS].energy_j < records[LAPS].energy_j, "who may do more needs no more"


@pytest.mark.parametrize("laps", [1, 3])
@pytest.mark.parametrize("corridor", [True, False])
def test_a_flight_is_compared_with_the_optimum_that_has_its_freedom(laps: int, corridor: bool) -> None:
    records = load_records()
    other = comparator(records, "b1", laps, corridor, None)
    record = records[other.name]
    assert len(record.lap_j) == laps
    assert other.lap_j == pytest.approx(record.energy_j / laps)
    through = any(each[0] == "S" for lap in record.classes for each in lap.split())
    assert through == corridor, "ways south of the first cylinder"


def test_a_vehicle_that_is_not_as_believed_is_compared_with_its_own_optimum() -> None:
    records = load_records()
    for name in ("b1", "b2 0.15@60", "b3 up", "b4", "b5"):
        believed = comparator(records, name, CASES[name].laps, True, None)
        light, heavy = (comparator(records, name, CASES[name].laps, True, drag).lap_j for drag in (0.8, 1.2))
        assert light < believed.lap_j < heavy


def test_rows_show_the_comparator_and_its_joules() -> None:
    """Of a flight that is three laps through the open corridor, whatever it took."""
    flight = EnergyFlight(
        case="b1", pilot="any", finished=True, energy_j=1230.0, leg_j=(205.0,) * 6, leg_s=(12.0,) * 6,
        nearest_m=0.02, top_m_s=0.48, track=np.zeros((1, 2)), laps=3,
    )  # fmt: skip
    row = against_optimum(flight, 1.05, 1.02, load_records())
    assert (row.against, row.lap_j) == (CORRIDOR_LAPS, 410.0)
    assert row.ratio == pytest.approx(410.0 / row.against_j)
    assert row.kept
    short = replace(flight, leg_j=flight.leg_j[:3], finished=False)
    assert not against_optimum(short, 1.05, 1.02, load_records()).kept, "laps that were not flown are no laps"


def test_search_over_laps_finds_the_class_that_it_did_not_begin_with() -> None:
    """From legs of two dear laps the cheapest lap is put together."""
    case = CASES["b1"]
    program = LeastEnergy(MODEL, POWER, case, 16, 4)
    found = solve_laps(program, start_state(case), ["NN+ SS+", "NS- SS-"], 1)
    assert found[0].label == "NS- SS+"
    assert found[0].energy_j == min(each.energy_j for each in found)


def test_turns_of_laps_add_up() -> None:
    north = tank_legs(False)[0]
    assert tank_guess([north] * 4).yaw_rad == pytest.approx([math.pi, 2 * math.pi, 3 * math.pi, 4 * math.pi])
    again = tank_guess([north] * 2)
    assert again.paths_ned_m[1] == again.paths_ned_m[0][::-1]


def test_a_pilot_who_has_flown_before_keeps_his_clock() -> None:
    seen: list[tuple[int, int]] = []

    def drift(t_us: int, nav: NavState, *_: object) -> FloatArray:
        seen.append((t_us, nav.t_us))
        return np.zeros(4)

    fly(replace(leg(0.5, 0.6), name="b2"), drift, "drift", VEHICLE, clock_us=7_000_000)
    assert seen[:2] == [(7_000_000, 7_000_000), (7_050_000, 7_050_000)]


def test_classes_are_all_sides_and_turns() -> None:
    assert len({guess.label for guess in tank_guesses(False)}) == 16
    assert len({guess.label for guess in tank_guesses(True)}) == 64


def test_energy_of_a_drifting_vehicle_is_hotel_power() -> None:
    goal = EnergyGoal(pos_ned_m=(3.0, 0.0, 5.0), yaw_rad=None)
    case = replace(leg(0.3, 3.0), goals=(goal,), name="b2")
    flight = fly(case, lambda *_: np.array([0.0, 0.0, 0.6, 0.0]), "drift", VEHICLE)
    floats = 1.2 * (0.36 + 1e-4) ** 0.75 + 3 * 1.2 * 1e-3
    assert flight.finished
    assert flight.leg_s[0] == pytest.approx((3.0 - REGION_M) / 0.3, abs=0.3)
    assert flight.energy_j == pytest.approx(flight.leg_s[0] * (12.0 + floats), rel=1e-3)
