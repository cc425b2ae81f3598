"""The motion and the vehicle model in C against their Python: the same numbers, whatever the state and the vehicle."""

import numpy as np
import pytest

from autopilot.core import compiled
from autopilot.core.frames import FloatArray
from autopilot.core.model4 import AXES, Model4
from autopilot.estimator.inertial import Inertial, InertialStep, ProcessNoiseMode
from autopilot.estimator.measure_model import VehicleAcceleration, acceleration_jacobian, expected_acceleration
from autopilot.estimator.measurement import Moment
from autopilot.estimator.motion import MotionModel, add_model, fill_jacobian, moved
from autopilot.estimator.states import DRAG_EXCESS, NX, VEL
from tests.hostile_numbers import HOSTILE, agree, outcome, with_one

pytestmark = pytest.mark.skipif(compiled.missing() is not None, reason="not compiled")
TOLERANCE = 1e-12
"""Of terms of the size of one: both sum in nearly the same order."""


def state_of(rng: np.random.Generator) -> FloatArray:
    x: FloatArray = rng.normal(size=NX)
    x[3] *= 10.0
    return x


def test_motion_and_its_jacobian() -> None:
    rng, model = np.random.default_rng(1), MotionModel()
    for turn in range(300):
        x, mode = state_of(rng), ProcessNoiseMode(turn % len(ProcessNoiseMode))
        rate, ax, ay, az = rng.normal(size=4).tolist()
        slope = rng.normal(size=(3, NX)) if turn % 5 == 0 else None  # leftovers of such a step must not survive
        step = InertialStep(rng.uniform(0.001, 0.1), rate, (ax, ay, az), mode, slope)
        jacobian = np.eye(NX)
        fill_jacobian(jacobian, x, step)
        if slope is not None:
            add_model(jacobian, x, step, slope)
        np.testing.assert_allclose(model.step(x, step), moved(x, step), rtol=TOLERANCE, atol=TOLERANCE)
        np.testing.assert_allclose(model.jacobian, jacobian, rtol=TOLERANCE, atol=TOLERANCE)


@pytest.mark.parametrize("thrusters", [4, 5, 6, 7, 8, 9])
def test_the_vehicle_model_and_its_jacobian(thrusters: int) -> None:
    rng = np.random.default_rng(thrusters)
    for _ in range(100):
        model = model_of(rng, thrusters)
        follow = (rng.uniform(0.0, 1.0), rng.uniform(0.0, 1.0))
        look = VehicleAcceleration(model, follow)
        for _ in range(2):
            x, moment = state_of(rng), moment_of(rng, thrusters)
            wanted = expected_acceleration(model, follow, x, moment)
            np.testing.assert_allclose(look.at(x, moment), wanted, rtol=TOLERANCE, atol=TOLERANCE * 100.0)
            jacobian = acceleration_jacobian(model, follow, x, moment)
            np.testing.assert_allclose(look.jacobian(x, moment), jacobian, rtol=TOLERANCE, atol=TOLERANCE * 100.0)


def test_what_was_asked_last_is_not_told_of_another_state_or_moment() -> None:
    rng = np.random.default_rng(3)
    look = VehicleAcceleration(model_of(rng, 4), (0.3, 0.4))
    x, moment, other = state_of(rng), moment_of(rng, 4), moment_of(rng, 4)
    first, second, third = look.at(x, moment), look.at(x.copy() + 0.1, moment), look.at(x, other)
    assert len({first, second, third}) == 3
    assert look.at(x, moment) == first


@pytest.mark.parametrize("excess", [-10.0, -1.5, -1.0, 0.0, 3.0, 50.0])
def test_drag_always_brakes(excess: float) -> None:
    """A state beyond what drag can be is no engine: a blind step would run away with it."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        model, x = model_of(rng, 4), np.zeros(NX)
        x[VEL], x[DRAG_EXCESS] = rng.normal(size=3), excess
        inertial = Inertial(0, 0.0, 0.0, 0.0, 0.0, (0.0, 0.0, 0.0), np.zeros(3), (0.0, 0.0), True)
        moment = Moment(inertial, (0.0,) * 4)
        for ahead, right, *_ in (
            VehicleAcceleration(model, (0.3, 0.4)).at(x, moment),
            expected_acceleration(model, (0.3, 0.4), x, moment),
        ):
            assert ahead * x[VEL][0] <= 0.0 and right * x[VEL][1] <= 0.0


def model_of(rng: np.random.Generator, thrusters: int) -> Model4:
    """Any vehicle."""
    surge, sway, heave, yaw = (
        rng.normal(size=(AXES, thrusters)) * (rng.uniform(size=(AXES, thrusters)) > 0.3)
    ).tolist()
    mass, linear, quadratic = (tuple(rng.uniform(low, 30.0, AXES).tolist()) for low in (1.0, 0.0, 0.0))
    return Model4(
        mass_kg=mass,
        linear_drag=linear,
        quadratic_drag=quadratic,
        buoyancy_excess_n=rng.normal(),
        allocation=(tuple(surge), tuple(sway), tuple(heave), tuple(yaw)),
    )


def moment_of(rng: np.random.Generator, thrusters: int) -> Moment:
    roll, pitch, yaw_rate = rng.normal(size=3).tolist()
    inertial = Inertial(0, roll, pitch, 0.3, yaw_rate, (0.1, 0.2, 0.3), rng.normal(size=3), (0.0, 0.0), True)
    return Moment(inertial, tuple((10.0 * rng.normal(size=thrusters)).tolist()))


@pytest.mark.parametrize("value", HOSTILE)
def test_no_motion_is_made_of_what_is_no_number(value: float) -> None:
    rng, model = np.random.default_rng(1), MotionModel()
    for turn in range(60):
        x, forces = state_of(rng), rng.normal(size=4)
        if turn % 2:
            x = with_one(rng, x, value)
        else:
            forces = with_one(rng, forces, value)
        rate, ax, ay, az = forces.tolist()
        step, jacobian = InertialStep(0.01, rate, (ax, ay, az), ProcessNoiseMode.NOMINAL, None), np.eye(NX)
        assert agree(outcome(model.step, x, step), outcome(moved, x, step)), turn
        if np.isfinite(x[3]):  # of an angle that is none Python has no sine
            fill_jacobian(jacobian, x, step)
            assert agree(model.jacobian, jacobian), turn


@pytest.mark.parametrize("value", HOSTILE)
def test_no_acceleration_is_made_of_what_is_no_number(value: float) -> None:
    rng = np.random.default_rng(2)
    for turn in range(60):
        model = model_of(rng, 4)
        look, x, moment = VehicleAcceleration(model, (0.3, 0.4)), state_of(rng), moment_of(rng, 4)
        if turn % 2:
            x = with_one(rng, x, value)
        else:
            thrust = with_one(rng, np.array(moment.thrust_n), value)
            moment = Moment(moment.inertial, tuple(thrust.tolist()))
        ours = outcome(look.at, x, moment)
        theirs = outcome(expected_acceleration, model, (0.3, 0.4), x, moment)
        # Python leaves out a thruster that does nothing on an axis; the order of sums decides which overflow.
        finite = np.isfinite(ours)
        if abs(value) != 1e308 and np.ndim(theirs):
            assert agree(np.asarray(ours)[finite], np.broadcast_to(theirs, 4)[finite], 1e-6), (turn, ours, theirs)
        assert np.ndim(theirs) or not finite.all(), turn
