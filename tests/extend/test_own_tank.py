"""The tank of docs/own-tank.md can be flown."""

from pathlib import Path

from click.testing import CliRunner

from autopilot.cli.mission import mission
from autopilot.core.vehicle import load_vehicle
from autopilot.sitl.backend import simulated_vehicle
from autopilot.sitl.scenario import load_scenario, plan_path

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"


def test_the_tank_and_its_plan_fit_each_other() -> None:
    scenario = load_scenario(str(EXAMPLES / "my_tank.toml"))
    plan = plan_path(str(EXAMPLES / "my_tank.toml"), scenario)
    assert plan is not None and plan.name == "my_tank.mission.toml"
    told = CliRunner().invoke(mission, ["check", str(plan)])
    assert told.exit_code == 0 and "fit to fly" in told.output
    page = (EXAMPLES.parent / "own-tank.md").read_text(encoding="utf-8")
    assert "examples/my_tank.toml" in page and "examples/my_tank.mission.toml" in page


def test_the_tank_holds_the_vehicle_and_shows_it_markers() -> None:
    scenario = load_scenario(str(EXAMPLES / "my_tank.toml"))
    world = simulated_vehicle(scenario, load_vehicle(scenario.vehicle.model))
    assert world.truth.contact_count == 0
    assert world.markers is not None and len(world.markers.ids) > 1000
