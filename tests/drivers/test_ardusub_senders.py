"""Who commands the thrusters, by reports of the servo rail, while ArduSub filters heave and nothing else."""

import math

import numpy as np
import pytest

from autopilot.drivers.ardusub_senders import OutputWatch

TICK_US, FILTER_HZ = 20_000, 2.0
SIGNS = {2: np.array([[-1.0, 1.0], [-1.0, -1.0]]), 4: np.array([[-1, 1, -1], [-1, -1, -1], [-1, 1, 1], [-1, -1, 1.0]])}
"""Per upright motor: heave, roll (and pitch)."""


@pytest.mark.parametrize("seed", range(20))
def test_filtered_heave_with_quick_roll_is_no_second_sender_and_one_is_found(seed: int) -> None:
    """From what depth hold had at the motors when it gave back."""
    rng = np.random.default_rng(seed)
    signs = SIGNS[int(rng.choice([2, 4]))]
    watch, keep = OutputWatch(), math.exp(-2.0 * math.pi * FILTER_HZ * 1e-6 * TICK_US)
    heave = float(rng.uniform(-250.0, 250.0))
    watch.skip(servos(np.zeros(4), signs, np.r_[heave, np.zeros(signs.shape[1] - 1)]))
    plane, upright = np.zeros(4), np.zeros(signs.shape[1])
    for turn in range(400):
        if turn % 4 == 0:
            plane, upright = rng.uniform(-90.0, 90.0, 4), rng.uniform(-90.0, 90.0, signs.shape[1])
        heave = keep * heave + (1.0 - keep) * upright[0]
        watch.sent(turn * TICK_US, servos(plane, signs, upright))
        found = servos(plane, signs, np.r_[heave, upright[1:]])
        if turn >= 350 and turn % 2:
            found = servos(plane, signs, np.r_[heave, upright[1:] + 60.0])  # a joystick's roll
        watch.check(turn * TICK_US, turn * TICK_US, found, slow_heave=signs[:, 0].tolist())
        assert turn >= 350 or not watch.rival
    assert watch.rival


def servos(plane: np.ndarray, signs: np.ndarray, upright: np.ndarray) -> tuple[int, ...]:
    return tuple(1500 + int(off) for off in (*plane, *(signs @ upright)))
