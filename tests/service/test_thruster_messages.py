"""What the operator hears of weak thrusters and late commands that the vehicle allows for."""

import numpy as np
from commander_bench import Bench

from autopilot.control.thrust.losses import ThrusterLosses
from autopilot.core.messages import NavState
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import load_vehicle
from tests.plan_items import nav


def test_a_weak_thruster_is_named_once_and_the_vehicle_goes_on() -> None:
    bench = Bench().armed()
    bench.status.thruster_effectiveness = (0.48, 1.0, 1.0, 1.0)
    decision = bench.run(5.0)
    assert [text for text in bench.texts if "Thruster" in text] == ["Thruster port gives 48 % of its thrust"]
    assert decision.failsafes == 0
    bench.status.thruster_effectiveness = (1.0,) * 4
    bench.run(1.0)
    assert bench.texts[-1] == "Thruster port gives its full thrust again"


def test_one_of_several_is_named_with_its_twins_until_it_is_known_which() -> None:
    bench = Bench().armed()
    bench.status.thruster_effectiveness, bench.status.thrusters_doubtful = (
        (1.0, 1.0, 0.55, 0.55),
        (("vertical", "lateral"),),
    )
    bench.run(5.0)
    told = [text for text in bench.texts if "thrust" in text]
    assert told == ["One of vertical, lateral gives 10 % of its thrust"]
    bench.status.thruster_effectiveness, bench.status.thrusters_doubtful = (1.0, 1.0, 1.0, 0.0), ()
    bench.run(1.0)
    told = [text for text in bench.texts if "hrust" in text]
    assert told[1:] == ["Thruster lateral gives 0 % of its thrust"]
    bench.status.thruster_effectiveness, bench.status.thrusters_doubtful = (
        (0.6, 0.6, 1.0, 1.0),
        (("port", "starboard"),),
    )
    bench.run(1.0)
    bench.status.thruster_effectiveness, bench.status.thrusters_doubtful = (1.0,) * 4, ()
    bench.run(1.0)
    assert bench.texts[-1] == "port, starboard give their full thrust again"


def test_after_a_flight_it_is_said_of_which_thrusters_silence_says_nothing() -> None:
    bench = Bench().armed()
    bench.status.thrusters_unseen = ("vertical",)
    bench.run(25.0)
    assert not any("Thrust not estimated" in text for text in bench.texts)
    bench.commander.disarm(force=True)
    bench.run(1.0)
    told = [text for text in bench.texts if "Thrust not estimated" in text]
    assert told == ["Thrust not estimated, used too little: vertical"]


def test_thrusters_that_were_never_asked_for_anything_are_not_taken_for_sound() -> None:
    vehicle, params = load_vehicle("lbv150"), ParamSet()
    care = ThrusterLosses(vehicle, params)
    for tick in range(300):
        care.step(tick * 10_000, _at_rest(tick * 10_000), np.zeros(4), 12.0, None, armed=True)
    assert care.unseen == ("port", "starboard", "vertical", "lateral")
    params.set("THR_DETECT", 0)
    for tick in range(300, 400):
        care.step(tick * 10_000, _at_rest(tick * 10_000), np.zeros(4), 12.0, None, armed=True)
    assert not care.unseen


def _at_rest(t_us: int) -> NavState:
    return nav(0.0, 0.0, 0.5, t_us=t_us)


def test_a_delay_that_is_allowed_for_is_only_told() -> None:
    bench = Bench().armed()
    bench.status.command_delay_s = 0.32
    decision = bench.run(5.0)
    assert decision.failsafes == 0
    assert [text for text in bench.texts if "latency" in text] == ["Command latency 0.3 s: check the tether"]
    bench.status.command_delay_s = 0.0
    bench.run(1.0)
    assert bench.texts[-1] == "Command latency is back to normal"
