"""The table of shipped vehicles in docs/vehicles.md has the figures of ``autopilot vehicle check``."""

import pytest
from md_pages import ROOT

from autopilot.core.vehicle import load_vehicle, vehicle_names
from autopilot.core.vehicle_summary import facts_of


def table() -> dict[str, list[str]]:
    """Rows by their first cell."""
    lines = (ROOT / "docs" / "vehicles.md").read_text(encoding="utf-8").splitlines()
    begin = next(number for number, line in enumerate(lines) if line.startswith("| as shipped |"))
    rows: dict[str, list[str]] = {}
    for line in lines[begin:]:
        if not line.startswith("|"):
            break
        first, *cells = [cell.strip() for cell in line.strip("|").split("|")]
        rows[first] = cells
    return rows


@pytest.mark.parametrize("name", vehicle_names())
def test_figures_of_a_vehicle(name: str) -> None:
    rows = table()
    known = load_vehicle(name)
    facts, column = facts_of(known), rows["as shipped"].index(name)
    surge, sway, heave, yaw = facts.axes
    assert rows["thrusters"][column].split(",")[0] == str(len(known.thrusters))
    assert rows["body radius, m"][column] == f"{known.radius_m:.2f}"
    assert rows["surge, sway, heave, N"][column] == ", ".join(f"{axis.authority:.1f}" for axis in (surge, sway, heave))
    assert float(rows["yaw, N m"][column]) == pytest.approx(yaw.authority, rel=0.01)
    assert rows["steady speeds, m/s and rad/s"][column] == ", ".join(f"{axis.speed:.2f}" for axis in facts.axes)
    assert rows["power at rest, at 0.3 m/s ahead, W"][column] == f"{facts.hover_w:.1f}, {facts.cruise_w:.1f}"
