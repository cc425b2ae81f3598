"""The NMPC by itself flies any vehicle to any goal within fence and limits."""

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from autopilot.api.goal_mpc import GoalMpc
from autopilot.core.errors import ConfigError
from autopilot.core.geometry import Circle, Fence, Polygon
from autopilot.core.vehicle import vehicle_names

POOL = Fence(
    inclusions=(Polygon(vertices_ned_m=np.array([[-4.0, -3.0], [4.0, -3.0], [4.0, 3.0], [-4.0, 3.0]])),),
    exclusions=(Circle(center_ned_m=np.array([0.0, 1.2]), radius_m=0.3),),
    depth_min_m=0.3,
    depth_max_m=2.0,
)
MADE = {name: GoalMpc(name, fence=POOL, params={"SPD_PLANAR_MAX": 0.4}) for name in vehicle_names()}
places = st.tuples(st.floats(-2.5, 2.5), st.floats(-1.5, 0.0), st.floats(0.6, 1.8), st.floats(-3.1, 3.1))


@pytest.mark.long
@given(st.sampled_from(sorted(MADE)), places, places, st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)))
@settings(deadline=None, max_examples=9, phases=[Phase.explicit, Phase.reuse, Phase.generate])  # slow to shrink
def test_a_vehicle_gets_there_within_its_limits(
    name: str, start: tuple[float, ...], goal: tuple[float, ...], flow: tuple[float, float]
) -> None:
    mpc, current = MADE[name], (*flow, 0.0)
    x = np.array([*start, 0.0, 0.0, 0.0, 0.0])
    for _ in range(700):
        thrust_n = mpc.step(x, goal, current)
        x = mpc.simulate(x, thrust_n, current)
        assert np.abs(thrust_n).max() <= mpc.params["THR_LIMIT"] + 1e-6
        assert np.hypot(x[4], x[5]) < 0.42 and abs(x[6]) < 1.05 * mpc.params["SPD_HEAVE_MAX"]
        assert np.hypot(x[0], x[1] - 1.2) > 0.3 + mpc.vehicle.radius_m - 0.01
    assert np.linalg.norm(x[:3] - goal[:3]) < 0.03
    assert np.allclose(mpc.nmpc.x[0], x, atol=0.05) and mpc.t_s[0] == 0.0


def test_the_prediction_is_drawn() -> None:
    mpc = GoalMpc("lbv150")
    mpc.step(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]), (1.0, 0.5, 1.2, 0.3))
    figure = mpc.plot()
    assert [axes.get_xlabel() for axes in figure.axes] == ["east [m]", "time [s]", "time [s]"]
    assert all(axes.has_data() and axes.get_ylabel() for axes in figure.axes)


def test_what_cannot_be_is_named() -> None:
    mpc = MADE["lbv150"]
    rest = np.array([0.0, -1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(ConfigError, match="x="):
        mpc.step(rest[:7], (0.0, 0.0, 1.0, 0.0))
    with pytest.raises(ConfigError, match="goal="):
        mpc.step(rest, (0.0, 0.0, 1.0))
    with pytest.raises(ConfigError, match="current_ned_m_s="):
        mpc.step(rest, (0.0, 0.0, 1.0, 0.0), (np.nan, 0.0, 0.0))
    with pytest.raises(ConfigError, match="MPC_Q_PO"):
        GoalMpc(params={"MPC_Q_PO": 1.0})
    with pytest.raises(ConfigError, match="submarine"):
        GoalMpc("submarine")
