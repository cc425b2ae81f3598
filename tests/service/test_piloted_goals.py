"""When a pilot's goal counts as another one: what is shown of it follows, and nothing is planned anew for nothing."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from autopilot.command.modes.piloted import _moved
from autopilot.core.messages import Goal, VelocityGoal


def _goal(north_m: float, east_m: float, down_m: float, drive: Any) -> Goal:
    place = np.array([north_m, east_m, down_m])
    return Goal(
        pos_ned_m=place, yaw_rad=0.0, speed_m_s=0.3, accept_radius_m=0.3, accept_yaw_rad=0.1, seq=-1, drive=drive
    )


HELD = VelocityGoal(north_m_s=0.0, east_m_s=0.0)


@pytest.mark.parametrize(
    ("drive", "gap", "moved"),
    [
        *((drive, (0.0, 0.0, 0.0), False) for drive in (None, HELD, replace(HELD, north_m_s=0.2))),
        *(
            (drive, gap, True)
            for drive in (None, HELD)
            for gap in ((0.01, 0.0, 0.0), (0.0, -0.01, 0.0), (0.0, 0.0, 0.01))
        ),
        *((replace(HELD, **{way: 0.2}), (0.05, -0.05, 0.0), False) for way in ("north_m_s", "east_m_s")),
        *(
            (replace(HELD, **{way: -0.2}), gap, True)
            for way in ("north_m_s", "east_m_s")
            for gap in ((0.11, 0.0, 0.0), (0.0, -0.11, 0.0))
        ),
        (replace(HELD, north_m_s=0.2), (0.0, 0.0, 0.01), True),
        (replace(HELD, east_m_s=0.2), (0.0, 0.0, -0.01), True),
    ],
)
def test_a_goal_is_another_one_by_place_or_depth(drive: Any, gap: tuple[float, ...], moved: bool) -> None:
    old = _goal(1.0, 2.0, 0.5, drive)
    assert _moved(_goal(1.0 + gap[0], 2.0 + gap[1], 0.5 + gap[2], drive), old) is moved
