"""Thrust in, pulses and what they will give out: the order within a tick, and a vehicle that is only to be lifted."""

import numpy as np
import pytest

from autopilot.control.thrust.actuation import Actuation
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import load_vehicle

LIMIT_N = 4.0


def _actuation(name: str, **params: float) -> Actuation:
    """After a tick, in which it has read what operators tell of the thrusters."""
    made = Actuation(load_vehicle(name), ParamSet(params))
    made.learn(10_000, None, made.send(10_000), None, armed=False, reached=True)
    return made


@pytest.mark.parametrize("name", ["lbv150", "bluerov2", "bluerov2-heavy"])
def test_a_blind_vehicle_is_lifted_straight_up(name: str) -> None:
    lift_n = _actuation(name).lift_n(LIMIT_N)
    force = np.array(load_vehicle(name).to_model().allocation) @ lift_n
    assert force[2] < -0.9 * LIMIT_N
    assert np.abs(force[[0, 1, 3]]).max() < 1e-6
    assert np.abs(lift_n).max() == pytest.approx(LIMIT_N)


def test_what_is_dead_is_not_asked_to_lift() -> None:
    lift_n = _actuation("lbv150", THR3_HEALTH=0.0).lift_n(LIMIT_N)
    assert not lift_n.any()


def test_a_command_acts_on_the_next_tick_unless_the_device_did_not_take_it() -> None:
    made = _actuation("lbv150")
    wanted = np.array([3.0, 3.0, -2.0, 0.0])
    told = made.command(10_000, wanted, armed=True)
    assert told.pwm_us[0] > told.pwm_us[3] > told.pwm_us[2]
    acting_n = made.send(20_000)
    assert np.abs(acting_n - wanted).max() < 0.2
    made.command(20_000, wanted, armed=True)
    made.not_taken()
    assert not made.send(30_000).any()
    assert made.command(30_000, wanted, armed=False).pwm_us == made.neutral(30_000).pwm_us
