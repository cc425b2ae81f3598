"""The hull in C against the hull in Python: the same numbers, bit for bit."""

from typing import Any

import numpy as np
import pytest
from plant_helpers import VEHICLE

from autopilot.core import compiled
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.sitl.contact import Cylinder
from autopilot.sitl.current_fields import CurrentField, Gyre, Shear, TankJet, Uniform, Vortex
from autopilot.sitl.plant import Plant
from autopilot.sitl.scenario_tables import ThrusterLoss
from autopilot.sitl.simulated_waters import SimulatedWaters
from tests.hostile_numbers import HOSTILE

FLOWS: tuple[CurrentField, ...] = (
    Uniform(velocity_m_s=(0.2, -0.1, 0.03)),
    Uniform(velocity_m_s=(0.0, 0.0, 0.0), tide_m_s=(0.1, 0.2, -0.05), tide_period_s=7.0),
    TankJet(),
    Vortex(circulation_m2_s=1.5, core_m=0.4),
    Shear(shear_1_s=0.3, speed_m_s=0.1),
    Gyre(speed_m_s=0.3, cell_m=2.0),
)
FACTORS = ("mass", "drag", "added_mass", "buoyancy", "righting", "thrust", "lag", "power", "resistance", "tether")
pytestmark = pytest.mark.skipif(compiled.missing() is not None, reason="not compiled")


def flight(vehicle: Vehicle, seed: int) -> list[bytes]:
    """Truths of a drawn flight in a drawn tank, some of it against walls, floor and a pillar, or out of the water."""
    rng = np.random.default_rng(seed)
    pillar = Cylinder(name="pillar", center_ned_m=(1.6, 1.0), radius_m=0.2)
    world = SimulatedWaters(
        polygon_ned_m=((-2.5, -1.5), (2.5, -1.5), (2.5, 1.5), (-2.5, 1.5)),
        floor_m=1.5,
        solids=(pillar,),
        current=FLOWS[seed % len(FLOWS)],
        tether_entry_ned_m=(0.1, -0.2, 0.0) if seed % 2 else None,
    )
    options: dict[str, Any] = {"held": seed % 3 == 0, "froude_krylov": seed % 5 != 4}
    mismatch = {name: float(rng.uniform(0.7, 1.3)) for name in FACTORS} | ({"lag": 0.0} if seed % 4 == 3 else {})
    hull = Plant(
        vehicle,
        world,
        start_pos_ned_m=(*rng.uniform(-0.7, 0.7, 2), 0.7),
        start_rpy_rad=rng.uniform(-0.5, 0.5, 3).tolist(),
        start_vel_frd_m_s=rng.uniform(-0.3, 0.3, 3).tolist(),
        start_rate_frd_rad_s=rng.uniform(-0.5, 0.5, 3).tolist(),
        mismatch=mismatch,
        losses=[ThrusterLoss(at_s=2.0, thruster=vehicle.thrusters[1].name, loss=0.4)],
        **options,
    )
    truths, t_us = [], 0
    for k in range(100):
        pulses = rng.integers(1250, 1760, 8) if k > 10 else np.zeros(8, dtype=int)
        if k == 60:
            hull.set_external_wrench(force_frd_n=(1.0, -2.0, 0.5), moment_frd_n_m=(0.1, 0.0, -0.2))
        t_us += int(rng.integers(1, 90_000))
        hull.advance(t_us, [int(pulse) for pulse in pulses])
        truth = hull.truth
        arrays = [truth.pos_ned_m, truth.quat, truth.rpy_rad, truth.vel_frd_m_s, truth.vel_water_frd_m_s]
        arrays += [truth.rate_frd_rad_s, truth.accel_frd_m_s2, truth.current_ned_m_s, truth.thrust_n]
        numbers = [truth.power_w, truth.voltage_v, truth.energy_used_j, truth.max_penetration_m, truth.emerged_m]
        truths.append(np.concatenate((*arrays, np.array(numbers))).tobytes())
    return truths


@pytest.mark.parametrize("seed", range(12))
def test_compiled_or_not_the_hull_flies_the_same(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle = VEHICLE if seed % 2 else load_vehicle("bluerov2")
    by_library = flight(vehicle, seed)
    monkeypatch.setenv(compiled.SWITCH, compiled.OFF)
    assert flight(vehicle, seed) == by_library


def test_a_hull_away_from_everything_is_moved_by_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing falls back unseen: the equations in Python are not asked there."""
    hull = Plant(VEHICLE, SimulatedWaters(), start_pos_ned_m=(0.0, 0.0, 5.0))
    monkeypatch.setattr("autopilot.sitl.plant.rk4_step", lambda *_: pytest.fail("in Python"))
    hull.advance(1_000_000, (1700, 1600, 1500, 1450))
    assert hull.truth.vel_frd_m_s[0] > 0.01


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("value", HOSTILE)
def test_compiled_or_not_a_force_that_is_no_number_ends_the_same(value: float, monkeypatch: pytest.MonkeyPatch) -> None:
    ends = []
    for switch in ("", compiled.OFF):
        monkeypatch.setenv(compiled.SWITCH, switch)
        hull = Plant(VEHICLE, SimulatedWaters(), start_pos_ned_m=(0.0, 0.0, 5.0))
        hull.set_external_wrench(force_frd_n=(value, 0.0, 0.0), moment_frd_n_m=(0.0, 0.0, 0.0))
        try:
            hull.advance(100_000, (1700, 1600, 1500, 1450))
            ends.append(np.concatenate((hull.truth.pos_ned_m, hull.truth.vel_frd_m_s, hull.truth.rate_frd_rad_s)))
        except (ArithmeticError, ValueError):
            ends.append(np.full(9, np.nan))
    finite = [np.isfinite(end) for end in ends]
    assert (finite[0] == finite[1]).all() or not (finite[0].all() or finite[1].all())
    assert np.array_equal(ends[0][finite[0] & finite[1]], ends[1][finite[0] & finite[1]])
    assert finite[0].all() == (abs(value) < 1.0)
