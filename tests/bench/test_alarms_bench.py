"""Sound vehicles raise no alarm: the short form of ``autopilot bench alarms``, which flies everything for longer."""

import pytest

from autopilot.sitl.scenario import load_scenario
from tests.bench.alarms import FLIGHTS, fly_quietly


def test_an_idle_vehicle_says_nothing_for_as_long_as_it_lies_there() -> None:
    """The chance agreement of noise with some delay of the stamps must not add up."""
    quiet = fly_quietly("paper-tank", None, 1, 105.0, armed=False)
    assert quiet.flown_s > 100.0
    assert quiet.alarms == ()


@pytest.mark.parametrize(("scenario", "vehicle"), [("paper-tank", None), ("pool", None), ("open-water", "bluerov2")])
def test_a_sound_vehicle_says_nothing_while_it_is_armed_and_flies(scenario: str, vehicle: str | None) -> None:
    quiet = fly_quietly(scenario, vehicle, 2, 15.0)
    assert quiet.armed_s > 8.0
    assert quiet.alarms == ()


def test_nothing_is_wrong_in_the_flights() -> None:
    assert all(not load_scenario(scenario).fault for scenario, _ in FLIGHTS)


def test_a_fault_is_heard() -> None:
    """It would not be quiet for want of hearing: commands that act a second late are said."""
    quiet = fly_quietly("r6", None, 1, 18.0)
    assert not quiet.kept
