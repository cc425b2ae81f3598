"""The legs at shipped defaults: flow, parameters, and one of them flown beside its optimum."""

import math

import numpy as np
import pytest

from autopilot.core.toml_table import convert
from autopilot.core.vehicle import load_vehicle
from autopilot.sitl.current_fields import current_field
from autopilot.sitl.mismatch import mismatched
from autopilot.sitl.scenario import load_tables
from autopilot.sitl.scenario_tables import Scenario
from tests.bench.energy.record import flown_model
from tests.bench.energy.rivals import BASE, LEGS, PILOTS, SHORT_LEGS, Leg, fly_leg, leg_optimum, row_of


@pytest.mark.parametrize("leg", LEGS, ids=lambda leg: leg.case.name)
def test_flow_of_a_leg_is_the_plants(leg: Leg) -> None:
    scenario = convert({**load_tables(BASE), "current": leg.current}, Scenario, BASE)
    field = current_field(scenario.current)
    for x, y in ((0.0, 0.0), (9.0, 4.0), (15.0, -2.0)):
        assert leg.case.flow(x, y, math) == pytest.approx(field.velocity((x, y, 5.0), 0.0)[:2], abs=1e-9)


def test_drag_of_the_optimum_is_the_plants() -> None:
    vehicle = load_vehicle("lbv150")
    flown = mismatched(vehicle, {"mass": 1.2, "drag": 1.2}).body
    model = flown_model(vehicle, mass=1.2, drag=1.2)
    assert model.quadratic_drag[:3] == pytest.approx(flown.quadratic_drag_n_s2_m2)
    assert model.mass_kg[:3] == pytest.approx(np.add(flown.mass_kg, flown.added_mass_kg))


@pytest.mark.long
def test_a_leg_upstream_by_line_of_sight_beside_its_optimum() -> None:
    (leg,) = SHORT_LEGS
    row = row_of(leg, fly_leg(leg, PILOTS[-1]), leg_optimum(leg))
    assert row.pilot == "los-pid" and row.finished
    assert 1.0 < row.ratio < 1.5
    assert row.top_m_s < 0.5
