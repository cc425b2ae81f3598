"""The three beliefs about the water."""

import numpy as np
import pytest

from autopilot.control.currents import EstimatedCurrent, MappedCurrent, NoCurrent
from autopilot.core.messages import NavHealth, NavState


def _nav(current: list[float]) -> NavState:
    return NavState(
        t_us=2_000_000,
        health=NavHealth.GOOD,
        pos_ned_m=np.array([1.0, 2.0, 0.5]),
        rpy_rad=np.zeros(3),
        vel_frd_m_s=np.array([0.3, 0.0, 0.0]),
        vel_water_frd_m_s=np.array([0.1, 0.0, 0.0]),
        rate_frd_rad_s=np.zeros(3),
        current_ned_m_s=np.array(current),
        variance=np.zeros(12),
    )


PLACES = np.array([[1.0, 2.0, 0.5], [2.0, 2.0, 0.5], [3.0, 2.5, 0.4]])
TIMES = np.array([0.0, 1.0, 2.0])


def test_the_estimate_holds_everywhere() -> None:
    out = np.empty((3, 3))
    EstimatedCurrent().fill(_nav([0.1, -0.2, 0.0]), PLACES, TIMES, out)
    assert (out == [0.1, -0.2, 0.0]).all()


def test_the_map_is_read_at_place_and_time_and_corrected_by_the_estimate() -> None:
    seen: list[float] = []

    def field(pos: tuple[float, float, float], t_s: float) -> tuple[float, float, float]:
        seen.append(t_s)
        return 0.1 * pos[0], 0.0, 0.0

    out = np.empty((3, 3))
    MappedCurrent(field).fill(_nav([0.15, 0.02, 0.0]), PLACES, TIMES, out)
    assert out[:, 0] == pytest.approx([0.15, 0.25, 0.35])
    assert out[:, 1] == pytest.approx([0.02] * 3)
    assert seen == pytest.approx([2.0, 2.0, 3.0, 4.0])


def test_without_currents_ground_speed_is_water_speed() -> None:
    view = NoCurrent().view(_nav([0.2, 0.0, 0.0]))
    assert (view.current_ned_m_s == 0.0).all()
    assert view.vel_water_frd_m_s == pytest.approx([0.3, 0.0, 0.0])
    out = np.ones((3, 3))
    NoCurrent().fill(view, PLACES, TIMES, out)
    assert not out.any()
