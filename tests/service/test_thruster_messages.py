"""What the operator hears of weak thrusters, and when the vehicle gives up its mission."""

import numpy as np
import pytest
from commander_bench import Bench

from autopilot.control.thrust.losses import ThrusterLosses
from autopilot.core.messages import Failsafe, NavHealth, NavState
from autopilot.core.params import ParamSet
from autopilot.core.vehicle import load_vehicle
from autopilot.mavlink.api import CommandResult, FlightMode


def test_a_weak_thruster_is_named_once_and_the_vehicle_goes_on() -> None:
    bench = Bench().armed()
    bench.status.thruster_share = (0.48, 1.0, 1.0, 1.0)
    decision = bench.run(5.0)
    assert [text for text in bench.texts if "Thruster" in text] == ["Thruster port gives 48 % of its thrust"]
    assert decision.failsafes == 0
    bench.status.thruster_share = (1.0,) * 4
    bench.run(1.0)
    assert bench.texts[-1] == "Thruster port gives its full thrust again"


def test_one_of_several_is_named_with_its_twins_until_it_is_known_which() -> None:
    bench = Bench().armed()
    bench.status.thruster_share, bench.status.thrusters_doubtful = (1.0, 1.0, 0.55, 0.55), (("vertical", "lateral"),)
    bench.run(5.0)
    told = [text for text in bench.texts if "thrust" in text]
    assert told == ["One of vertical, lateral gives 10 % of its thrust"]
    bench.status.thruster_share, bench.status.thrusters_doubtful = (1.0, 1.0, 1.0, 0.0), ()
    bench.run(1.0)
    told = [text for text in bench.texts if "hrust" in text]
    assert told[1:] == ["Thruster lateral gives 0 % of its thrust"]
    bench.status.thruster_share, bench.status.thrusters_doubtful = (0.6, 0.6, 1.0, 1.0), (("port", "starboard"),)
    bench.run(1.0)
    bench.status.thruster_share, bench.status.thrusters_doubtful = (1.0,) * 4, ()
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
    return NavState(
        t_us=t_us,
        health=NavHealth.GOOD,
        pos_ned_m=np.array([0.0, 0.0, 0.5]),
        rpy_rad=np.zeros(3),
        vel_frd_m_s=np.zeros(3),
        vel_water_frd_m_s=np.zeros(3),
        rate_frd_rad_s=np.zeros(3),
        current_ned_m_s=np.zeros(3),
        variance=np.zeros(12),
    )


@pytest.mark.parametrize(
    ("action", "mode"), [(0, FlightMode.HOLD), (1, FlightMode.HOLD), (2, FlightMode.SURFACE)], ids=str
)
def test_the_failsafe_acts_by_its_parameter(action: int, mode: FlightMode) -> None:
    bench = Bench(FS_THR_ACT=action).armed()
    bench.status.thruster_problem = "depth cannot be held (thruster vertical 0 %)"
    assert bench.run(2.5).failsafes == 0
    decision = bench.run(1.0)
    assert decision.failsafes == 1 << Failsafe.THRUSTER
    assert decision.mode is mode
    assert "Failsafe: depth cannot be held (thruster vertical 0 %)" in bench.texts
    assert any("Failsafe " + mode.name in text for text in bench.texts) == (action > 0)


def test_a_vehicle_that_cannot_stay_is_not_armed() -> None:
    bench = Bench()
    bench.status.thruster_problem = "heading cannot be held (thruster port 0 %, starboard 0 %)"
    bench.run()
    answer = bench.commander.arm(force=False)
    assert answer.result is CommandResult.DENIED
    assert "THRn_HEALTH" in answer.reason
