"""What is not finite never becomes thrust: every input of the controller in turn."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from control_loop import MODEL, TANK, VEHICLE, A, nav_state

from autopilot.control.controller import MotionController
from autopilot.control.protocol import checked_thrust_n
from autopilot.control.thrust.actuation import Actuation
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState
from autopilot.core.operator_messages import CONTROL_NOT_FINITE
from autopilot.core.params import ParamSet
from autopilot.core.samples import ObstacleTrack

NO_NUMBERS = (math.nan, math.inf, -math.inf, 1e308, -1e308)
SMALL = (5e-324, -5e-324, 2e-308)
STEP_US = 50_000
FIELDS = [
    *(("pos_ned_m", i) for i in range(3)),
    ("rpy_rad", 2),
    *(("vel_water_frd_m_s", i) for i in range(3)),
    ("rate_frd_rad_s", 2),
    *(("current_ned_m_s", i) for i in range(3)),
]
"""What a state consists of."""


class Flown:
    """A controller on its way to the first goal, with a plan that it follows between its steps."""

    def __init__(self) -> None:
        self.controller, self.params = MotionController(VEHICLE), ParamSet({"MPC_COST": 0.0})
        self.nav = nav_state(0, np.array([-2.0, -0.8, 0.3, 0.1, 0.1, 0.0, 0.0, 0.0]))
        self.t_us = 0
        for _ in range(3):
            self.step()
        assert self.between() is not None

    def step(self, nav: NavState | None = None, **given: Any) -> FloatArray:
        self.t_us += STEP_US
        goal, limit_n = given.pop("goal", A), given.pop("limit_n", None)
        nav = replace(nav or self.nav, t_us=self.t_us)
        return self.controller.step(self.t_us, nav, goal, TANK, self.params, limit_n, **given).thrust_n

    def between(self, nav: NavState | None = None) -> FloatArray | None:
        return self.controller.tick(self.t_us + 10_000, replace(nav or self.nav, t_us=self.t_us + 10_000))

    def with_(self, field: str, place: int, value: float) -> NavState:
        numbers = getattr(self.nav, field).copy()
        numbers[place] = value
        return replace(self.nav, **{field: numbers})

    def told(self) -> list[str]:
        return [text for _, text in self.controller.take_news()]


@pytest.fixture
def flown() -> Flown:
    return Flown()


def _sound(thrust_n: FloatArray | None) -> bool:
    limit_n = ParamSet()["THR_LIMIT"]
    return thrust_n is None or bool((np.abs(thrust_n) <= limit_n).all())


def test_a_state_that_is_no_number_gives_no_thrust_and_is_told_once(flown: Flown) -> None:
    for field, place in FIELDS:
        for value in NO_NUMBERS:
            between = flown.between(flown.with_(field, place, value))
            assert between is not None, (field, value)
            assert not between.any(), (field, place, value, between)
            at_step = flown.step(flown.with_(field, place, value))
            assert not at_step.any(), (field, place, value, at_step)
            for _ in range(3):
                assert _sound(flown.step())
            assert flown.controller.situation is not None
            assert np.isfinite(flown.controller.nmpc.x).all()
    assert flown.told().count(CONTROL_NOT_FINITE.template) == 1, "one episode: not one line per tick"
    for _ in range(25):
        assert flown.step().any(), "nothing of it stays behind"
    cases = 2 * len(FIELDS) * len(NO_NUMBERS)
    assert f"Estimate finite again after {cases} ticks without thrust" in flown.told()


def test_a_finite_state_whose_prediction_overflows_gives_no_thrust(flown: Flown) -> None:
    for field, place in FIELDS[4:8]:
        for value in (500.0, -500.0, 1e5):
            between = flown.between(flown.with_(field, place, value))
            assert between is not None
            assert not between.any(), (field, place, value, between)
            assert not flown.step(flown.with_(field, place, value)).any()
            flown.step()
            assert flown.between() is not None
    assert flown.told().count(CONTROL_NOT_FINITE.template) == 1


def test_numbers_that_are_nearly_none_are_numbers(flown: Flown) -> None:
    plain = flown.between()
    assert plain is not None
    for field, place in FIELDS:
        for value in SMALL:
            near = flown.between(flown.with_(field, place, value))
            same = flown.between(flown.with_(field, place, 0.0))
            assert near is not None
            assert same is not None
            assert np.array_equal(near, same)
    assert CONTROL_NOT_FINITE.template not in flown.told()


def test_late_commands_do_not_remember_a_state_that_is_no_number(flown: Flown) -> None:
    """Predictions are compared with what comes: one that is no number would make all later ones none."""
    for _ in range(20):
        flown.step(delay_s=0.3)
    for value in NO_NUMBERS:
        assert not flown.step(flown.with_("vel_water_frd_m_s", 0, value), delay_s=0.3).any()
    assert not flown.step(flown.with_("vel_water_frd_m_s", 0, 500.0), delay_s=0.3).any()
    for _ in range(20):
        thrust = flown.step(delay_s=0.3)
    assert thrust.any()


def _track(north_m: float = 1.0, speed_m_s: float = 0.0, radius_m: float = 0.2) -> ObstacleTrack:
    return ObstacleTrack(
        t_us=0,
        track_id=1,
        pos_ned_m=np.array([north_m, 0.9]),
        vel_ned_m_s=np.array([speed_m_s, 0.0]),
        radius_m=radius_m,
    )


OTHER: dict[str, Callable[[float], dict[str, Any]]] = {
    "goal": lambda v: {"goal": replace(A, pos_ned_m=np.array([v, 0.0, 0.3]))},
    "goal depth": lambda v: {"goal": replace(A, pos_ned_m=np.array([1.0, 0.0, v]))},
    "goal heading": lambda v: {"goal": replace(A, yaw_rad=v)},
    "goal speed": lambda v: {"goal": replace(A, speed_m_s=v)},
    "limits": lambda v: {"limit_n": np.array([9.0, v, 9.0, 9.0])},
    "delay": lambda v: {"delay_s": v},
    "place of an obstacle": lambda v: {"tracks": [_track(v)]},
    "speed of an obstacle": lambda v: {"tracks": [_track(speed_m_s=v)]},
    "size of an obstacle": lambda v: {"tracks": [_track(radius_m=v)]},
}


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("what", OTHER)
def test_other_inputs_give_thrust_within_limits_or_none(flown: Flown, what: str) -> None:
    """An exception is the guard's: neutral, told, counted. Whatever is answered passes for a command."""
    for value in (*NO_NUMBERS, *SMALL[:1]):
        try:
            thrust = flown.step(**OTHER[what](value))
        except (ArithmeticError, ValueError):
            thrust = np.zeros(MODEL.thrusters)
        assert _sound(thrust), (value, thrust)
        flown.controller.reset()
        for _ in range(5):
            thrust = flown.step()
        assert _sound(thrust)
        assert thrust.any(), "a new start knows nothing of it"


def test_no_answer_that_is_no_number_passes() -> None:
    limit_n, thrust_n = np.full(4, 9.0), np.array([1.0, 20.0, -20.0, 0.0])
    assert checked_thrust_n(thrust_n, limit_n).tolist() == [1.0, 9.0, -9.0, 0.0]
    listed: Any = [1, 2.0, -3.0, 0.0]
    assert isinstance(checked_thrust_n(listed, limit_n), np.ndarray), "what comes behind it takes arrays"
    for value in (math.nan, math.inf, -math.inf):
        for place in range(4):
            wrong = thrust_n.copy()
            wrong[place] = value
            with pytest.raises(ValueError, match="thrust_n is not finite"):
                checked_thrust_n(wrong, limit_n)
    with pytest.raises(ValueError, match="limit_n is not a number"):
        checked_thrust_n(thrust_n, np.array([9.0, math.nan, 9.0, 9.0]))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_no_pulse_is_made_of_a_command_that_is_no_number(value: float) -> None:
    """The last gate before the drives."""
    actuation = Actuation(VEHICLE, ParamSet())
    assert actuation.command(0, np.full(4, 5.0), armed=True).pwm_us[:4] != actuation.allocation.neutral_us
    for place in range(4):
        thrust_n = np.full(4, 5.0)
        thrust_n[place] = value
        with pytest.raises(ValueError, match="thrust is not finite"):
            actuation.command(0, thrust_n, armed=True)
        assert actuation.command(0, thrust_n, armed=False).pwm_us[:4] == actuation.allocation.neutral_us
