"""A Gymnasium environment on :class:`autopilot.api.simulation.Simulation` (extra ``gym``).

``gymnasium.make("autopilot.api.gym_env:Underwater-v0", reward=mine)``, or :class:`UnderwaterEnv` itself.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, Unpack

import numpy as np
from numpy.typing import NDArray

from autopilot.api.arrays import is_number
from autopilot.api.settings import FlightOptions
from autopilot.api.simulation import Simulation, StepInfo
from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray
from autopilot.core.messages import NavState

try:
    import gymnasium
    from gymnasium.spaces import Box
except ImportError as error:
    raise ConfigError("needs the package gymnasium; pip install 'underwater-autopilot[gym]'") from error

OBSERVATION: tuple[tuple[str, str, float], ...] = (
    *((name, "m", 1000.0) for name in ("north", "east", "depth")),
    *((name, "rad", math.pi) for name in ("roll", "pitch", "yaw")),
    *((f"through water {name}", "m/s", 10.0) for name in ("ahead", "to starboard", "down")),
    *((name, "rad/s", 10.0) for name in ("roll rate", "pitch rate", "yaw rate")),
    *((f"current {name}", "m/s", 10.0) for name in ("north", "east", "down")),
)
"""Name, unit and bound (either way) of every element; what is estimated, not the truth."""

GOAL_REACH_M = 1000.0

Observed = NDArray[np.float32]
Reward = Callable[[NavState, StepInfo], float]


class UnderwaterEnv(gymnasium.Env[Observed, Observed]):
    """A vehicle under the service, 20 steps per second.

    An episode is terminated by a contact, by disarming (a failsafe, the end of a mission that was started) and by a
    complete mission.

    Parameters
    ----------
    scenario
        Name of a shipped scenario, or a file.
    reward
        Of a step: takes the estimate (NavState) and :class:`~autopilot.api.simulation.StepInfo`, whose ``truth`` an
        agent does not see.
    action
        ``"thrust"``: (N,) thrust of every thruster [N]. ``"goal"``: (4,) north, east, depth [m], yaw [rad], which the
        controller goes to.
    seconds
        Length of an episode [s], which truncates it.
    start, options
        As :class:`~autopilot.api.simulation.Simulation`'s.
    """

    metadata = {"render_modes": [], "render_fps": 20}  # noqa: RUF012 - declared so by Gymnasium

    def __init__(
        self,
        scenario: str | Path = "paper-tank",
        *,
        reward: Reward,
        action: Literal["thrust", "goal"] = "thrust",
        seconds: float = 60.0,
        start: bool = False,
        **options: Unpack[FlightOptions],
    ) -> None:
        if action not in ("thrust", "goal"):
            raise ConfigError(f"action={action!r} is not valid; use thrust or goal")
        if not is_number(seconds) or not seconds > 0.0:
            raise ConfigError(f"seconds={seconds!r} is not valid; use a number of seconds above 0")
        self._simulation = Simulation(scenario, start=start, **options)
        self._reward, self._action, self._seconds = reward, action, seconds
        self._begin_s = math.nan
        bound = np.array([most for _, _, most in OBSERVATION], dtype=np.float32)
        self.observation_space = Box(-bound, bound, dtype=np.float32)
        most = self._simulation.thrust_limit_n
        if action == "goal":
            most = np.array([GOAL_REACH_M, GOAL_REACH_M, GOAL_REACH_M, math.pi])
        self.action_space = Box(-most.astype(np.float32), most.astype(np.float32), dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """A vehicle that has just been armed; noise and faults by ``seed``, without by the environment's generator."""
        super().reset(seed=seed)
        nav = self._simulation.reset(int(self.np_random.integers(2**31)) if seed is None else seed)
        self._begin_s = 1e-6 * nav.t_us
        return self._seen(nav), {"t_s": self._begin_s}

    def step(self, action: Observed) -> tuple[Observed, float, bool, bool, dict[str, Any]]:
        given = np.asarray(action, dtype=np.float64)
        nav, info = self._simulation.step(given) if self._action == "thrust" else self._simulation.step(goal=given)
        terminated = info.over or info.contacts > 0
        truncated = info.t_s - self._begin_s >= self._seconds
        return self._seen(nav), float(self._reward(nav, info)), terminated, truncated, _told(info)

    def close(self) -> None:
        self._simulation.close()

    def _seen(self, nav: NavState) -> Observed:
        parts: tuple[FloatArray, ...] = (nav.pos_ned_m, nav.rpy_rad, nav.vel_water_frd_m_s, nav.rate_frd_rad_s)
        seen = np.concatenate((*parts, nav.current_ned_m_s)).astype(np.float32)
        space = self.observation_space
        assert isinstance(space, Box)
        return np.clip(seen, space.low, space.high)


def _told(info: StepInfo) -> dict[str, Any]:
    """What does not go into the observation, as numbers and arrays."""
    return {
        "t_s": info.t_s,
        "energy_j": info.energy_j,
        "contacts": info.contacts,
        "mode": info.mode,
        "true_pos_ned_m": info.truth.pos_ned_m.copy(),
        "thrust_n": info.thrust_n,
    }


gymnasium.register(id="Underwater-v0", entry_point="autopilot.api.gym_env:UnderwaterEnv")
