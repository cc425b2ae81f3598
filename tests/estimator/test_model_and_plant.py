"""The vehicle model as a sensor against the simulated hull, whose equations are others: the same acceleration however
the vehicle is tilted."""

from collections.abc import Iterator

import numpy as np
import pytest

from autopilot.core.frames import FloatArray, r_ned_from_frd
from autopilot.core.samples import AhrsSample
from autopilot.core.vehicle import Vehicle, load_vehicle
from autopilot.estimator.inertial import level
from autopilot.estimator.measure_model import VehicleAcceleration, planar_mass_ratios
from autopilot.estimator.measurement import Moment
from autopilot.estimator.states import CURRENT, CURRENT_DOWN, NX, VEL, YAW
from autopilot.sitl.plant import Truth, build_plant
from autopilot.sitl.scenario import load_scenario


@pytest.mark.parametrize(("name", "tilt_deg"), [("bluerov2", 20.0), ("bluerov2-heavy", 20.0), ("lbv150", 0.0)])
def test_whatever_the_tilt(name: str, tilt_deg: float) -> None:
    vehicle = load_vehicle(name)
    model, most_rad = VehicleAcceleration(vehicle.to_model(), planar_mass_ratios(vehicle)), 0.0
    for truth in dived(vehicle):
        sample = AhrsSample(
            t_us=truth.t_us,
            rpy_rad=truth.rpy_rad,
            rate_frd_rad_s=truth.rate_frd_rad_s,
            accel_frd_m_s2=truth.accel_frd_m_s2,
        )
        moment = Moment(level(sample), tuple(truth.thrust_n[: len(vehicle.thrusters)].tolist()))
        planar_m_s2 = np.subtract(model.at(state_of(truth), moment)[:2], moment.inertial.accel_level_m_s2[:2])
        assert np.abs(planar_m_s2).max() < 1e-4, (truth.t_us, truth.rpy_rad)
        down_m_s2 = model.at(state_of(truth), moment)[2] - moment.inertial.accel_level_m_s2[2]
        assert abs(down_m_s2) < 0.01, "but for the weight of the water that the file rounds"
        most_rad = max(most_rad, float(np.abs(truth.rpy_rad[:2]).max()))
    assert most_rad >= np.radians(tilt_deg)


def dived(vehicle: Vehicle) -> Iterator[Truth]:
    """Any thrust in the plane, a new one each second; the vertical ones keep the depth."""
    rng = np.random.default_rng(1)
    plant, pulses = build_plant(load_scenario("open-water"), vehicle), np.full(8, 1500)
    vertical = [(i, thruster.direction_frd[2]) for i, thruster in enumerate(vehicle.thrusters)]
    for tick in range(1, 3001):
        truth = plant.truth
        if tick % 100 == 1:
            pulses = 1500 + rng.integers(-120, 121, 8)
        for i, down in vertical:
            if abs(down) > 0.9:
                wanted = 100.0 * (3.0 - truth.pos_ned_m[2]) - 150.0 * truth.vel_frd_m_s[2]
                pulses[i] = 1500 + round(float(np.clip(np.sign(down) * wanted, -200.0, 200.0)))
        plant.advance(10_000 * tick, pulses.tolist())
        if tick > 500:  # the hull is under water
            yield plant.truth


def state_of(truth: Truth) -> FloatArray:
    x, r = np.zeros(NX), r_ned_from_frd(truth.rpy_rad)
    current_ned_m_s = r @ (truth.vel_frd_m_s - truth.vel_water_frd_m_s)
    x[YAW], x[VEL] = truth.rpy_rad[2], r @ truth.vel_frd_m_s
    x[CURRENT], x[CURRENT_DOWN] = current_ned_m_s[:2], current_ned_m_s[2]
    return x
