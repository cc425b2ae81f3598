"""The Gymnasium environment: its own checker, spaces, ends, environments in processes."""

import math
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from autopilot.api.gym_env import OBSERVATION, UnderwaterEnv
from autopilot.api.simulation import StepInfo
from autopilot.core.errors import ConfigError
from autopilot.core.messages import NavState

ID = "autopilot.api.gym_env:Underwater-v0"


def nearer(nav: NavState, info: StepInfo) -> float:
    return -float(np.linalg.norm(info.truth.pos_ned_m))


@pytest.mark.parametrize("action", ["thrust", "goal"])
def test_the_checker_of_gymnasium_finds_nothing(action: str) -> None:
    env = gymnasium.make(ID, reward=nearer, action=action, sensors="pose")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Newtons and metres, as the vehicle file has them: RescaleAction makes -1 to 1 of them.
        warnings.filterwarnings("ignore", ".*symmetric and normalized.*")
        check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_an_episode_ends_by_a_contact_or_after_its_time() -> None:
    env = UnderwaterEnv("paper-tank", reward=nearer, sensors="pose", seconds=1.0)
    assert env.observation_space.shape == (len(OBSERVATION),) and env.action_space.shape == (4,)
    env.reset(seed=1)
    ends = [env.step(np.zeros(4, np.float32))[2:4] for _ in range(20)]
    assert ends == [(False, False)] * 19 + [(False, True)]
    env.reset(seed=1)
    ahead = np.array([1.0, 1.0, 0.0, 0.0], np.float32) * env.action_space.high
    long = UnderwaterEnv("paper-tank", reward=nearer, sensors="pose")
    long.reset(seed=1)
    for _ in range(400):
        seen, gain, terminated, truncated, info = long.step(ahead)
        assert not truncated and long.observation_space.contains(seen) and gain < 0.0
        if terminated:
            break
    assert terminated and (info["contacts"] > 0 or info["mode"] != "HOLD")
    env.close()
    long.close()


def test_environments_fly_in_processes_of_their_own() -> None:
    kinds: dict[str, Any] = {"vectorization_mode": "async", "vector_kwargs": {"context": "spawn"}}
    envs = gymnasium.make_vec(ID, num_envs=2, **kinds, reward=nearer, sensors="pose")
    try:
        first, _ = envs.reset(seed=3)
        for _ in range(3):
            seen, gains, *_ = envs.step(np.zeros((2, 4), np.float32))
        assert first.shape == seen.shape == (2, len(OBSERVATION)) and (gains < 0.0).all()
        assert not np.array_equal(seen[0], seen[1]), "seeds 3 and 4"
        again, _ = envs.reset(seed=3)
        assert np.array_equal(first, again)
    finally:
        envs.close()


def test_what_cannot_be_is_named() -> None:
    with pytest.raises(ConfigError, match="action='fly' is not valid; use thrust or goal"):
        UnderwaterEnv(reward=nearer, action="fly")  # type: ignore[arg-type]
    for seconds in (-1, 0, math.nan, "5"):
        with pytest.raises(ConfigError, match=r"seconds=.* is not valid; use a number of seconds above 0"):
            UnderwaterEnv(reward=nearer, seconds=seconds)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="sensor='pose' is no option"):
        UnderwaterEnv(reward=nearer, sensor="pose")  # type: ignore[call-arg]
