"""The comparison of both costs: every water can be flown, and rows say what the flights did."""

from dataclasses import replace

import pytest

from autopilot.campaign.flight import fly
from autopilot.campaign.results import Margin, RunResult
from autopilot.log.smoothness import Smoothness
from tests.bench.modes import WATERS, Water, row_of, task_of


@pytest.mark.parametrize("water", WATERS, ids=lambda water: water.name)
def test_every_water_arms_and_sets_out(water: Water) -> None:
    """Plans that the vehicle refused would raise, one that it does not start would not arm."""
    task = replace(task_of(water, 0.0), duration_s=1.5)
    result = fly(task)
    assert result is not None
    assert result.error is None
    assert result.steps > 5
    assert result.laps_asked is not None


def test_a_row_has_the_figures_of_its_flight() -> None:
    smooth = Smoothness(
        alternating=0.01, variation_n_s=4.0, low_passed_n_s=2.0, step_n=2.5, step_at_s=1.0, reversals_1_s=0.2, silent=3
    )
    near = {name: Margin(margin=m, at_s=1.0, tolerance=0.0) for name, m in (("walls", 0.05), ("heave", 0.01))}
    result = RunResult(
        run=0, seed=1, drawn={}, laps=2, laps_asked=2, energy_j=[800.0, 900.0], lap_s=[20.0, 22.0], steps=400,
        fallbacks=4, cpu_s=4.0, margins=near, smoothness=smooth,
    )  # fmt: skip
    row = row_of(WATERS[0], 1.0, result)
    assert (row.mode, row.laps, row.lap_j, row.lap_s) == ("least energy", "2 of 2", 850.0, 21.0)
    assert row.nearest_mm == pytest.approx(50.0), "speeds are no distances"
    assert (row.alternating_pct, row.variation_ratio, row.silent) == (1.0, 2.0, 3)
    assert (row.fallbacks_pct, row.cpu_ms) == (1.0, 10.0)
