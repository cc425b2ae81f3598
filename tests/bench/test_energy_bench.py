"""The energy benchmark: cases, optimum, committed data, bookkeeping and the follower."""

import math
from dataclasses import replace

import numpy as np
import pytest

from autopilot.bench.energy.cases import CASES, REGION_M, Case, EnergyGoal, uniform
from autopilot.bench.energy.flight import fly, los_pilot, plant_field
from autopilot.bench.energy.los_pid import LosGains
from autopilot.bench.energy.optimum import Guess, LeastEnergy, start_state, tank_guesses, worst_gap_m
from autopilot.bench.energy.record import CORRIDOR, load_records
from autopilot.control.energy.power import PowerModel, energy_per_metre, speed_table
from autopilot.core.vehicle import load_vehicle
from sitl.scenario import load_scenario, plan_path

VEHICLE = load_vehicle("lbv150")
MODEL, POWER = VEHICLE.model4.to_model(), PowerModel.of(VEHICLE)


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
        guess = Guess(label="straight", ways_ned_m=((),), yaw_rad=(None,))
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
    assert set(records) == {CORRIDOR, *CASES}
    for name, record in records.items():
        case = CASES["b1" if name == CORRIDOR else name]
        assert record.track_ned_m[0] == pytest.approx(case.start[:2], abs=2e-3)
        assert np.hypot(*(record.track_ned_m[-1] - case.goals[-1].pos_ned_m[:2])) <= REGION_M + 2e-3
        assert record.energy_j > 12.0 * record.duration_s
        assert record.energy_j == pytest.approx(sum(record.leg_j), abs=0.1)
        assert record.energy_j == pytest.approx(min(record.classes.values()), abs=0.1)
        assert record.gap_m < 5e-3
        # The grid knows neither inertia nor turning, which in a tank is a fifth.
        assert (0.75 if case.tank else 0.98) < record.grid_j / record.energy_j < 1.01


def test_committed_optima_of_a_neutral_vehicle_are_the_published_ones() -> None:
    """Legs of B2 in a current are published as the limit of steady motion; what the ends make of it is small."""
    for record in load_records().values():
        assert record.neutral_j == pytest.approx(record.published_j, rel=0.005), record.name
        assert record.neutral_j < record.energy_j, record.name


def test_classes_are_all_sides_and_turns() -> None:
    assert len({guess.label for guess in tank_guesses(False)}) == 16
    assert len({guess.label for guess in tank_guesses(True)}) == 64


def test_follower_reaches_both_goals_without_touching() -> None:
    flight = fly(CASES["b1"], los_pilot(VEHICLE, LosGains()), "pid", VEHICLE, laps=1)
    assert flight.finished
    assert flight.nearest_m > 0.0
    assert flight.energy_j == pytest.approx(sum(flight.leg_j))


def test_energy_of_a_drifting_vehicle_is_hotel_power() -> None:
    goal = EnergyGoal(pos_ned_m=(3.0, 0.0, 5.0), yaw_rad=None)
    case = replace(leg(0.3, 3.0), goals=(goal,), name="b2")
    flight = fly(case, lambda *_: np.array([0.0, 0.0, 0.6, 0.0]), "drift", VEHICLE)
    floats = 1.2 * (0.36 + 1e-4) ** 0.75 + 3 * 1.2 * 1e-3
    assert flight.finished
    assert flight.leg_s[0] == pytest.approx((3.0 - REGION_M) / 0.3, abs=0.3)
    assert flight.energy_j == pytest.approx(flight.leg_s[0] * (12.0 + floats), rel=1e-3)
