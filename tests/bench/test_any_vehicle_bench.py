"""Vehicles made at random: flown by the whole service or refused with the axis that lacks thrust, no exception."""

import pytest
from click.testing import CliRunner

from autopilot.cli.bench import bench
from autopilot.core.errors import ConfigError
from autopilot.core.vehicle import Vehicle, checked, convert
from tests.bench.any_vehicle import Outcome, fly, vehicle_tables
from tests.bench.tables import TITLES


def refused(seed: int) -> bool:
    try:
        checked(convert(vehicle_tables(seed), Vehicle, "made"), "made")
    except ConfigError:
        return True
    return False


def test_some_fly_and_some_are_refused() -> None:
    share = sum(refused(seed) for seed in range(100))
    assert 20 < share < 80


@pytest.mark.long
@pytest.mark.parametrize("seed", [3, 8])
def test_a_vehicle_made_at_random_flies(seed: int) -> None:
    outcome = fly(seed)
    assert not outcome.refused and outcome.problem == "", outcome


def test_what_neither_flies_nor_lacks_an_axis_is_told() -> None:
    common = {"seed": 0, "thrusters": 5, "tilt_deg": 0.0}
    assert "without an axis" in Outcome(**common, refused="no", left_m=0.0, faults=()).problem
    assert "fault" in Outcome(**common, refused="", left_m=0.0, faults=("boom",)).problem
    assert "left" in Outcome(**common, refused="", left_m=2.0, faults=()).problem


def test_the_command_prints_what_came_of_each() -> None:
    first = next(seed for seed in range(100) if refused(seed))
    done = CliRunner().invoke(bench, ["vehicles", "--runs", "1", "--seed", str(first)])
    assert done.exit_code == 0, done.output
    assert TITLES["vehicles"].split(",")[0] in " ".join(done.output.split())
