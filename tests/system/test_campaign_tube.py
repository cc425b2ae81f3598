"""Promises of plans against what the vehicle does."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from autopilot.campaign.tube_study import AHEAD_S, TubeCheck
from autopilot.control.protocol import simple_output
from autopilot.core.messages import ControlOutput
from tests.plan_items import nav

ALL = AHEAD_S[-1]


def plan(t_s: float, places: list[tuple[float, float]], tube_m: list[float], **changes: Any) -> ControlOutput:
    """One node every 0.5 s, the first one after 0.1 s."""
    nominal = np.zeros((len(places), 8))
    nominal[:, :2] = places
    return replace(
        simple_output(round(t_s * 1e6), nav(0.0, 0.0, 0.0), np.zeros(4)),
        nominal=nominal,
        nominal_t_s=0.1 + 0.5 * np.arange(len(places)),
        tube_m=np.array(tube_m),
        **changes,
    )


def fly_north(check: TubeCheck, begin_s: float, end_s: float, speed_m_s: float = 0.4) -> None:
    for tick in range(round(begin_s * 100), round(end_s * 100) + 1):
        check.update(tick / 100, speed_m_s * tick / 100, 0.0)


def test_nothing_announced_is_no_share() -> None:
    check = TubeCheck()
    fly_north(check, 0.0, 1.0)
    assert [check.fraction(ahead_s) for ahead_s in AHEAD_S] == [None] * len(AHEAD_S)


def test_nodes_are_looked_at_when_their_time_has_come() -> None:
    check = TubeCheck()
    # On the way north at 0.4 m/s: exact, 0.05 m beside within 0.06, 0.05 m beside and not within 0.04, 0.05 m late.
    check.announce(plan(1.0, [(0.44, 0.0), (0.64, 0.05), (0.84, 0.05), (0.99, 0.0)], [0.001, 0.06, 0.04, 0.049]))
    fly_north(check, 1.0, 1.05)
    assert check.fraction(ALL) is None
    fly_north(check, 1.05, 1.7)
    assert check.fraction(ALL) == 1.0
    fly_north(check, 1.7, 3.0)
    assert check.fraction(ALL) == pytest.approx(2 / 4)
    assert check.fraction(0.5) == check.fraction(1.0) == 1.0
    assert check.fraction(2.0) == check.fraction(ALL)


def test_between_two_looks_the_way_is_straight() -> None:
    check = TubeCheck()
    check.announce(plan(0.9, [(0.25, 0.25)], [1e-9]))
    check.update(0.5, 0.0, 0.0)
    check.update(1.5, 0.5, 0.5)
    assert check.fraction(ALL) == 1.0


def test_a_plan_that_began_anew_takes_back_what_was_said() -> None:
    check = TubeCheck()
    check.announce(plan(0.0, [(9.0, 9.0), (9.0, 9.0)], [0.1, 0.1]))
    fly_north(check, 0.0, 0.3)
    assert check.fraction(ALL) == 0.0
    check.announce(plan(0.3, [(0.16, 0.0)], [0.01], restarted=True))
    fly_north(check, 0.3, 2.0)
    assert check.fraction(ALL) == pytest.approx(1 / 2)
