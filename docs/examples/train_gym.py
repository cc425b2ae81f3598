# %% [markdown]
# # Learning to keep a place by thrust
#
# Soft actor-critic against the whole service: the agent sees the estimate, commands every thruster, and is
# compared with doing nothing and with the shipped controller. Needs `pip install 'underwater-autopilot[gym]'
# stable-baselines3`; `python docs/examples/train_gym.py 5000` takes some 15 minutes.

# %%
import sys

import gymnasium
import numpy as np
from gymnasium.wrappers import RescaleAction

import autopilot.api.gym_env

PLACE = np.array([-1.2, 0.4, 0.6])
"""North, east, depth [m]: 0.7 m from the start."""
SECONDS = 15.0


def reward(nav, info):
    """1 at the place, less further away and when turning; never negative, else an early end would pay."""
    away_m, turn_rad_s = np.linalg.norm(info.truth.pos_ned_m - PLACE), abs(nav.rate_frd_rad_s[2])
    return float(np.exp(-2.0 * away_m) / (1.0 + turn_rad_s))


class Repeat(gymnasium.Wrapper):
    """The same thrust for 0.25 s."""

    def step(self, action):
        total = 0.0
        for _ in range(5):
            seen, gain, terminated, truncated, info = self.env.step(action)
            total += gain
            if terminated or truncated:
                break
        return seen, total, terminated, truncated, info


def make(action="thrust"):
    return autopilot.api.gym_env.UnderwaterEnv(
        "paper-tank", reward=reward, action=action, seconds=SECONDS, sensors="pose"
    )


def distance_m(env, act, seeds=(101, 102, 103)):
    """Mean distance in the last 5 s, over the seeds."""
    found = []
    for seed in seeds:
        seen, info = env.reset(seed=seed)
        over, begin_s = False, info["t_s"]
        while not over:
            seen, _, terminated, truncated, info = env.step(act(seen))
            over = terminated or truncated
            if info["t_s"] - begin_s > SECONDS - 5.0:
                found.append(np.linalg.norm(info["true_pos_ned_m"] - PLACE))
        if terminated:
            print(f"  seed {seed}: ended after {info['t_s'] - begin_s:.1f} s, contacts {info['contacts']}")
    return float(np.mean(found)) if found else float("nan")


# %%
if __name__ == "__main__":
    from stable_baselines3 import SAC

    steps = int(sys.argv[1]) if len(sys.argv) > 1 else 5000
    env = RescaleAction(Repeat(make()), -1.0, 1.0)
    agent = SAC("MlpPolicy", env, learning_starts=300, seed=1, gamma=0.97, verbose=0)
    print(f"{steps} steps of 0.25 s; mean distance in the last 5 s of {SECONDS:g}:")
    print(f"no thrust            {distance_m(env, lambda _: np.zeros(4, np.float32)):.2f} m")
    agent.learn(total_timesteps=steps)
    print(f"soft actor-critic    {distance_m(env, lambda seen: agent.predict(seen, deterministic=True)[0]):.2f} m")
    goal = np.array([*PLACE, 0.0], np.float32)
    print(f"shipped controller   {distance_m(make('goal'), lambda _: goal):.2f} m")
