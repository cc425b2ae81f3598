"""Currents: free of divergence, gradients that fit, walls that hold."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.core.toml_table import convert
from autopilot.sitl.current_fields import (
    Bickley,
    CurrentField,
    Gyre,
    Shear,
    TankJet,
    Turned,
    Uniform,
    Vortex,
    current_field,
)
from autopilot.sitl.scenario_tables import Scenario

FIELDS: dict[str, CurrentField] = {
    "uniform": Uniform(velocity_m_s=(0.1, -0.2, 0.05), tide_m_s=(0.3, 0.0, 0.1), tide_period_s=60.0),
    "jet": TankJet(),
    "turned jet": Turned(field=TankJet(length_m=9.0, width_m=9.0), center_m=(0.3, 0.2), cosine=0.8, sine=0.6),
    "vortex": Vortex(circulation_m2_s=2.0, core_m=0.8, center_m=(0.2, -0.1)),
    "shear": Shear(shear_1_s=0.3, speed_m_s=0.1, center_y_m=0.5),
    "bickley": Bickley(speed_m_s=0.3, width_m=0.7, center_y_m=-0.2),
    "gyre": Gyre(speed_m_s=0.3, cell_m=3.0),
}
STEP_M = 1e-5
places = st.tuples(st.floats(-2.4, 2.4), st.floats(-1.4, 1.4), st.floats(0.1, 1.4))


def numeric_gradient(field: CurrentField, place: tuple[float, float, float], t_s: float) -> np.ndarray:
    columns = []
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = STEP_M
        ahead = np.array(field.velocity(tuple(place + step), t_s))
        behind = np.array(field.velocity(tuple(place - step), t_s))
        columns.append((ahead - behind) / (2.0 * STEP_M))
    return np.array(columns).T


@pytest.mark.parametrize("name", FIELDS)
@given(place=places, t_s=st.floats(0.0, 100.0))
def test_no_divergence_and_the_gradient_is_that_of_the_velocity(
    name: str, place: tuple[float, float, float], t_s: float
) -> None:
    field = FIELDS[name]
    numeric = numeric_gradient(field, place, t_s)
    np.testing.assert_allclose(np.reshape(field.gradient(place, t_s), (2, 2)), numeric[:2, :2], atol=1e-8)
    assert not numeric[2].any()
    assert not numeric[:, 2].any()
    assert abs(np.trace(numeric)) < 1e-8
    rate = np.subtract(field.velocity(place, t_s + 1e-4), field.velocity(place, t_s - 1e-4)) / 2e-4
    np.testing.assert_allclose(field.rate(place, t_s), rate, atol=1e-7)
    if field.steady_uniform:
        assert not numeric.any()
        assert not rate.any()


@given(st.floats(-1.5, 1.5), st.floats(-2.5, 2.5))
def test_jet_does_not_flow_through_the_walls(y: float, x: float) -> None:
    jet = TankJet()
    for end in (-2.5, 2.5):
        assert jet.velocity((end, y, 0.5), 0.0)[0] == pytest.approx(0.0, abs=1e-15)
    for side in (-1.5, 1.5):
        assert jet.velocity((x, side, 0.5), 0.0)[1] == pytest.approx(0.0, abs=1e-15)


def test_jet_has_its_peak_in_the_middle_and_returns_along_the_walls() -> None:
    jet = TankJet(speed_m_s=0.25)
    peak_x = -2.5 + 5.0 / 3.0
    np.testing.assert_allclose(jet.velocity((peak_x, 0.0, 0.5), 0.0), (0.25, 0.0, 0.0), atol=1e-15)
    np.testing.assert_allclose(jet.velocity((peak_x, 1.5, 0.5), 0.0), (-0.25, 0.0, 0.0), atol=1e-15)
    speeds = [
        math.hypot(*jet.velocity((x, y, 0.0), 0.0))
        for x in np.linspace(-2.5, 2.5, 101)
        for y in np.linspace(-1.5, 1.5, 61)
    ]
    assert max(speeds) <= 0.25 + 1e-12


@pytest.mark.parametrize("x", [-2.0, -0.5, 1.0, 2.2])
def test_jet_carries_as_much_water_back_as_ahead(x: float) -> None:
    jet = TankJet()
    flow = [jet.velocity((x, -1.5 + 0.01 * k, 0.5), 0.0)[0] for k in range(300)]
    assert math.fsum(flow) * 0.01 == pytest.approx(0.0, abs=1e-12)
    assert max(flow) > 0.005


def test_places_outside_the_tank_see_its_wall() -> None:
    jet = TankJet()
    assert jet.velocity((-3.0, 0.4, 0.5), 0.0) == jet.velocity((-2.5, 0.4, 0.5), 0.0)
    assert jet.velocity((0.0, 2.0, 0.5), 0.0) == jet.velocity((0.0, 1.5, 0.5), 0.0)


def test_vortex_turns_from_north_to_east_and_its_circulation_is_right() -> None:
    vortex = Vortex(circulation_m2_s=6.0, core_m=2.0)
    u, v, w = vortex.velocity((3.0, 0.0, 0.0), 0.0)
    assert v > 0.0
    assert u == w == 0.0
    far = vortex.velocity((0.0, 40.0, 0.0), 0.0)
    assert -far[0] * 2.0 * math.pi * 40.0 == pytest.approx(6.0)
    assert vortex.velocity((0.0, 0.0, 0.0), 0.0) == (0.0, 0.0, 0.0)


@given(st.floats(0.9, 1.1))
def test_vortex_series_joins_the_formula(scale: float) -> None:
    vortex = Vortex(circulation_m2_s=6.0, core_m=2.0)
    r = 2.0 * math.sqrt(1e-3) * scale
    exact = 6.0 / (2.0 * math.pi * r) * -math.expm1(-r * r / 4.0)
    assert vortex.velocity((r, 0.0, 0.0), 0.0)[1] == pytest.approx(exact, rel=1e-9)


def test_bickley_and_shear_and_gyre_at_known_places() -> None:
    assert Bickley(speed_m_s=0.3, width_m=3.0, center_y_m=10.0).velocity((5.0, 10.0, 0.0), 0.0) == (0.3, 0.0, 0.0)
    assert Shear(shear_1_s=0.1, speed_m_s=0.2).velocity((0.0, 2.0, 0.0), 0.0) == pytest.approx((0.4, 0.0, 0.0))
    gyre = Gyre(speed_m_s=0.3, cell_m=20.0)
    np.testing.assert_allclose(gyre.velocity((10.0, 0.0, 0.0), 0.0), (0.3, 0.0, 0.0), atol=1e-12)


@pytest.mark.parametrize(
    ("table", "kind"),
    [
        ({"kind": "none"}, Uniform),
        ({"kind": "uniform", "velocity_m_s": [0.1, 0.0, 0.0]}, Uniform),
        ({"kind": "jet"}, TankJet),
        ({"kind": "vortex", "circulation_m2_s": 1.0, "core_m": 1.0}, Vortex),
        ({"kind": "shear", "shear_1_s": 0.1}, Shear),
        ({"kind": "bickley", "speed_m_s": 0.1, "width_m": 1.0}, Bickley),
        ({"kind": "gyre", "speed_m_s": 0.1, "cell_m": 4.0}, Gyre),
    ],
)
def test_every_kind_of_a_scenario_becomes_its_field(table: dict[str, object], kind: type) -> None:
    tables = {"scenario": {"name": "x", "description": "x"}, "vehicle": {"start_m": [0, 0, 1]}, "current": table}
    scenario: Scenario = convert(tables, Scenario, "test")
    assert type(current_field(scenario.current)) is kind


def test_a_turned_jet_flows_the_other_way() -> None:
    tables = {
        "scenario": {"name": "x", "description": "x"},
        "vehicle": {"start_m": [0.0, 0.0, 0.5]},
        "current": {"kind": "jet", "speed_m_s": 0.2, "center_m": [0.1, -0.1], "direction_rad": math.pi / 6.0},
    }
    field = current_field(convert(tables, Scenario, "test").current)
    straight = TankJet(speed_m_s=0.2).velocity((0.0, 0.0, 0.0), 0.0)[0]
    flow = field.velocity((0.1, -0.1, 0.5), 0.0)
    assert flow == pytest.approx((straight * math.cos(math.pi / 6.0), straight * 0.5, 0.0))


@pytest.mark.parametrize("place", [(2.8, 0.2, 0.5), (-2.8, 0.4, 0.5), (0.5, 1.8, 0.5), (2.9, -1.9, 0.5)])
def test_outside_the_tank_the_gradient_is_still_that_of_the_velocity(place: tuple[float, float, float]) -> None:
    numeric = numeric_gradient(TankJet(), place, 0.0)[:2, :2]
    np.testing.assert_allclose(np.reshape(TankJet().gradient(place, 0.0), (2, 2)), numeric, atol=1e-8)
