"""The change of thrust over a control step, the commands between two of them counted in."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from autopilot.control.protocol import STEP_S
from autopilot.control.thrust.slew import SlewWindow
from autopilot.control.thrust.thrust_tuning import BY_HAND

wanted = st.lists(st.tuples(*[st.floats(-20.0, 20.0)] * 3), min_size=1, max_size=40)
LIMIT_N = np.array([12.0, 12.0, 6.0])


@given(wanted, st.sampled_from((10_000, 20_000, 50_000)))
def test_no_window_of_a_control_step_sees_a_larger_change(commands: list[tuple[float, ...]], every_us: int) -> None:
    window = SlewWindow(STEP_S)
    flown = np.array([window.limited(k * every_us, np.array(u), LIMIT_N) for k, u in enumerate(commands)])
    most_n = BY_HAND.slew_fraction_1_s * STEP_S * LIMIT_N
    for apart in range(1, round(STEP_S * 1e6) // every_us + 1):
        assert (np.abs(flown[apart:] - flown[:-apart]) <= most_n + 1e-9).all()
    assert (np.abs(flown) <= LIMIT_N).all()
    assert np.array_equal(flown[0], np.clip(commands[0], -LIMIT_N, LIMIT_N))


def test_what_changes_slowly_is_left_as_it_is_and_a_cleared_window_binds_nothing() -> None:
    window = SlewWindow(STEP_S)
    ramp = np.linspace(0.0, 3.0, 40)[:, None] * np.ones(3)
    assert all(np.array_equal(window.limited(10_000 * k, u, LIMIT_N), u) for k, u in enumerate(ramp))
    window.clear()
    assert window.limited(400_000, np.full(3, -6.0), LIMIT_N).tolist() == [-6.0, -6.0, -6.0]
