"""How smooth commands are: figures of made-up commands that are known by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from autopilot.core.messages import FALLBACK_TEXT, Fallback
from autopilot.log.smoothness import BARS, ThrustCommands, is_reported, low_passed, measure

T_S = np.arange(400) * 0.05


def commands(thrust_n: np.ndarray, **changes: object) -> ThrustCommands:
    """20 s of control steps: the same command for port and starboard, the others rest."""
    columns = np.stack([thrust_n, thrust_n, 0 * thrust_n, 0 * thrust_n], axis=1)
    still = {"fallback": np.zeros(len(T_S), np.uint8), "starts_s": np.zeros(1), "reported_s": np.zeros(0)}
    return ThrustCommands(**{"t_s": T_S, "thrust_n": columns, "limit_n": 12.0, **still, **changes})  # type: ignore[arg-type]


def test_slow_commands_keep_every_bar() -> None:
    found = measure(commands(7.0 + 4.5 * np.sin(1.5 * T_S)))
    assert found is not None and not BARS.broken(found)
    assert found.ratio == pytest.approx(1.0, abs=0.02)
    assert found.variation_n_s == pytest.approx(0.5 * 4.5 * 1.5 * 2.0 / math.pi, rel=0.03)
    assert found.alternating == found.reversals_1_s == found.silent == 0


def test_a_tenth_of_the_steps_alternates() -> None:
    thrust = np.full(400, 3.0)
    thrust[100:140:2] = 6.5
    found = measure(commands(thrust))
    assert found is not None
    assert found.alternating == pytest.approx(39 / 400)
    assert found.variation_n_s == pytest.approx(0.5 * 40 * 3.5 / (399 * 0.05))
    assert found.step_n == 3.5 and found.step_at_s == pytest.approx(5.0)
    assert set(BARS.broken(found)) == {"alternating", "ratio", "step_n"}


@pytest.mark.parametrize("times", [0.3, 1.0, 2.5])
def test_steps_are_judged_by_the_thrust_limit(times: float) -> None:
    thrust = np.full(400, 1.0)
    for step_n, kept in ((2.9, True), (3.1, False)):
        thrust[200:] = 1.0 + step_n
        found = measure(commands(times * thrust, limit_n=times * 12.0))
        assert found is not None and ("step_n" not in BARS.broken(found)) is kept


def test_noise_on_a_straight_way_is_judged_by_the_limit_and_not_by_what_does_not_have_to_change() -> None:
    rng = np.random.default_rng(4)
    for sigma_n, kept in ((0.1, True), (0.2, False)):
        thrust = 2.0 + rng.normal(0.0, sigma_n, len(T_S))
        found = measure(commands(thrust))
        unlimited = measure(commands(thrust, limit_n=math.inf))
        assert found is not None and unlimited is not None
        assert ("ratio" not in BARS.broken(found)) is kept
        assert unlimited.ratio > BARS.ratio, "a log that does not say what its thrusters may"


def test_steps_of_starts_and_into_the_limit_do_not_count() -> None:
    thrust = np.full(400, 1.0)
    thrust[200:300] = 9.0
    plain = commands(thrust)
    found = measure(plain)
    assert found is not None and found.step_n == 8.0
    started = measure(replace(plain, starts_s=np.array([0.0, 9.9, 15.0])))
    assert started is not None and started.step_n == 0.0
    late = measure(replace(plain, starts_s=np.array([0.0, 9.7, 15.0])))
    assert late is not None and late.step_n == 8.0 and late.step_at_s == pytest.approx(10.0)
    limited = measure(replace(plain, limit_n=9.0))
    assert limited is not None and limited.step_n == 0.0


def test_reversals_need_thrust_on_both_sides() -> None:
    found = measure(commands(2.0 * np.sin(2.0 * math.pi * 0.5 * T_S + 0.1)))
    assert found is not None and found.reversals_1_s == pytest.approx(1.0, abs=0.06)
    hum = measure(commands(0.09 * np.sin(2.0 * math.pi * 0.5 * T_S + 0.1)))
    assert hum is not None and hum.reversals_1_s == 0.0


def test_fallbacks_want_a_word() -> None:
    fallback = np.zeros(400, np.uint8)
    fallback[100:116] = Fallback.STATION_KEEPING
    fallback[200:300] = Fallback.NEUTRAL
    plain = commands(np.ones(400), fallback=fallback)
    found, told = measure(plain), measure(replace(plain, reported_s=np.array([1.0])))
    assert found is not None and found.silent == 16
    assert told is not None and told.silent == 0
    assert is_reported([f"{FALLBACK_TEXT} holding", "Mission complete"]).tolist() == [True, False]


def test_a_pause_is_no_step_and_a_moment_says_nothing() -> None:
    thrust = np.where(T_S < 10.0, 1.0, 9.0)
    found = measure(commands(thrust, t_s=T_S + np.where(T_S < 10.0, 0.0, 3.0)))
    assert found is not None and found.step_n == 0.0
    few = commands(thrust)
    assert measure(replace(few, t_s=T_S[:10], thrust_n=few.thrust_n[:10], fallback=few.fallback[:10])) is None


def test_the_low_pass_has_no_delay_and_keeps_lines() -> None:
    line = np.stack([0.3 * T_S, -T_S], axis=1)
    assert low_passed(T_S, line) == pytest.approx(line, abs=1e-9)
    slow, fast = np.sin(2.0 * math.pi * 0.2 * T_S), np.sin(2.0 * math.pi * 8.0 * T_S)
    left = low_passed(T_S, (slow + fast)[:, None])[:, 0]
    assert left[20:-20] == pytest.approx(slow[20:-20], abs=0.02)
