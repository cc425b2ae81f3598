"""An estimate that is no number, through the whole tick: no thruster turns for it, and the operator hears of it."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from piloted_world import PilotedWorld
from pymavlink.dialects.v20 import development as mav

from autopilot.core.messages import Failsafe, NavDoubt, NavHealth, NavState, Outputs
from autopilot.core.operator_messages import CONTROL_NOT_FINITE, ESTIMATE_FINITE, ESTIMATE_NOT_FINITE
from autopilot.core.samples import AhrsSample, PoseSample, PowerSample

FIELDS = ("pos_ned_m", "rpy_rad", "vel_frd_m_s", "vel_water_frd_m_s", "rate_frd_rad_s", "current_ned_m_s", "variance")
NEUTRAL_US = (1500,) * 4
ARM = mav.MAV_CMD_COMPONENT_ARM_DISARM


class Lying:
    """The estimator, with one number of its answer replaced for a while."""

    def __init__(self, inner: Any) -> None:
        self._inner = inner
        self.lie: tuple[str, int, float] | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def step(self, *given: Any) -> NavState | None:
        nav: NavState | None = self._inner.step(*given)
        if nav is None or self.lie is None:
            return nav
        field, place, value = self.lie
        numbers = getattr(nav, field).copy()
        numbers[place] = value
        return replace(nav, **{field: numbers})


@pytest.fixture
def world() -> PilotedWorld:
    made = PilotedWorld()
    made.service._estimation._estimator = made.liar = Lying(made.service._estimation._estimator)  # type: ignore
    made.run(3.0)
    assert made.command(ARM, 1.0) == 0
    assert made.command_int(mav.MAV_CMD_DO_REPOSITION, 0.5, 0.5, 0.5, frame=1) == 0
    made.run(1.0)
    return made


def _pulses(outputs: Outputs) -> tuple[int, ...]:
    return outputs.command.pwm_us[:4]


def test_a_moment_without_a_number_is_bridged_by_the_last_estimate(world: Any) -> None:
    """Each field, each kind, on ticks of the controller and between them: thrust goes on, finite, nothing is blamed."""
    world.inbox.clear()
    lies = [(field, value) for field in FIELDS for value in (math.nan, math.inf, -math.inf, 1e308)]
    for number, (field, value) in enumerate(lies):
        world.liar.lie = (field, number % 3, value)
        for _ in range(1 + number % 6):
            outputs = world.tick()
            assert np.isfinite(outputs.command.thrust_n).all()
            assert outputs.nav is not None
            assert np.isfinite(outputs.nav.pos_ned_m).all()
        world.liar.lie = None
        world.run(0.3)
    outputs = world.run(1.5)
    assert outputs.mode.armed
    assert not outputs.faults
    said = world.texts()
    assert said.count(ESTIMATE_NOT_FINITE.template) == 1
    assert ESTIMATE_FINITE.template in said
    counted = sum(1 + number % 6 for number in range(len(lies)))
    assert world.service._estimation.counts({})["nav.not_finite"] == counted


def test_an_estimate_that_stays_no_number_is_a_position_lost(world: Any) -> None:
    world.liar.lie = ("vel_water_frd_m_s", 0, math.nan)
    ticks = [world.tick() for _ in range(600)]
    assert all(np.isfinite(tick.command.thrust_n).all() for tick in ticks)
    lost = next(n for n, tick in enumerate(ticks) if tick.mode.failsafes)
    assert all(_pulses(tick) == NEUTRAL_US for tick in ticks[30:lost]), "0.2 s after the last sound one"
    assert lost > 60
    assert ticks[lost].mode.failsafes == 1 << Failsafe.NAV_LOST, "no sensor is blamed"
    assert all(tick.nav.health is NavHealth.INVALID for tick in ticks[30:])
    world.liar.lie = None
    assert np.isfinite(world.run(3.0).command.thrust_n).all()


@pytest.mark.parametrize(
    "answer", [7, {"pos_ned_m": np.zeros(2)}, {"variance": np.zeros(3)}, {"rpy_rad": [0.0, 0.0, 0.0]}, {"health": None}]
)
def test_an_answer_of_another_shape_is_a_fault_of_the_estimator(world: Any, answer: Any) -> None:
    """One tick: the last estimate stands, nothing else fails."""
    world.service._estimation._guard.raises = False
    last, step = world.tick().nav, world.liar.step
    world.liar.step = lambda *given: replace(step(*given), **answer) if isinstance(answer, dict) else answer
    outputs = world.tick()
    assert [fault.part for fault in outputs.faults] == ["estimator"]
    assert outputs.mode.armed and np.array_equal(outputs.nav.pos_ned_m, last.pos_ned_m)
    world.liar.step = step
    outputs = world.run(0.5)
    assert outputs.mode.armed and not outputs.faults and np.isfinite(outputs.command.thrust_n).all()


def test_evidence_is_of_now_while_the_estimate_is_no_number(world: Any) -> None:
    world.liar.lie, world.liar.doubts = ("vel_water_frd_m_s", 0, math.nan), frozenset({NavDoubt.GYRO})
    world.tick()
    assert world.service._estimation.doubts == {NavDoubt.GYRO}


def test_a_speed_that_no_prediction_can_follow_is_no_thrust(world: Any) -> None:
    """Finite, and infinite one thruster lag later: full reverse on all thrusters in a compiled clamp that drops NaN."""
    world.inbox.clear()
    world.liar.lie = ("vel_frd_m_s", 0, 500.0)  # without a current the same as through the water
    ticks = [world.tick() for _ in range(40)]
    world.liar.lie = None
    # What was flown comes off as fast as commands may change.
    assert all(_pulses(tick) == NEUTRAL_US for tick in ticks[30:])
    assert all((np.abs(tick.command.thrust_n) < 12.0).all() for tick in ticks)
    assert all(np.isfinite(tick.command.thrust_n).all() for tick in ticks)
    world.run(1.0)
    assert world.texts().count(CONTROL_NOT_FINITE.template) == 1


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e308, 5e-324])
def test_samples_that_are_no_numbers_move_no_thruster_beyond_its_limits(world: Any, value: float) -> None:
    """Every field of every sample the world knows, one at a time."""
    kinds = {AhrsSample: ("rpy_rad", "rate_frd_rad_s", "accel_frd_m_s2"), PoseSample: ("pos_ned_m", "sigma_pos_m")}
    numbers = {PoseSample: ("yaw_rad", "sigma_yaw_rad"), PowerSample: ("voltage_v", "current_a", "remaining")}
    limit_n = world.params["THR_LIMIT"]
    cases = [(kind, name, True) for kind, names in kinds.items() for name in names]
    cases += [(kind, name, False) for kind, names in numbers.items() for name in names]
    for kind, name, array in cases:
        for _ in range(10):
            world.t_us += 10_000
            samples = world.samples()
            world.t_us -= 10_000
            lie = {name: np.full(3, value) if array else value}
            spoilt = [replace(sample, **lie) if isinstance(sample, kind) else sample for sample in samples]
            outputs = world.tick(samples=spoilt)
            assert (np.abs(outputs.command.thrust_n) <= limit_n).all(), (kind, name)
            assert all(1000 <= pulse <= 2000 for pulse in _pulses(outputs))
            assert outputs.nav is None or np.isfinite(outputs.nav.pos_ned_m).all()
        world.run(0.2)
