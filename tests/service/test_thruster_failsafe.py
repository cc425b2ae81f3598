"""What the operator hears of weak thrusters, and when the vehicle gives up its mission."""

import pytest
from commander_bench import Bench

from autopilot.core.messages import Failsafe
from autopilot.mavlink.api import CommandResult, FlightMode


def test_a_weak_thruster_is_named_once_and_the_vehicle_goes_on() -> None:
    bench = Bench().armed()
    bench.thruster_share = (0.48, 1.0, 1.0, 1.0)
    decision = bench.run(5.0)
    assert [text for text in bench.texts if "Thruster" in text] == ["Thruster port gives 48 % of its thrust"]
    assert decision.failsafes == 0
    bench.thruster_share = (1.0,) * 4
    bench.run(1.0)
    assert bench.texts[-1] == "Thruster port gives its full thrust again"


@pytest.mark.parametrize(
    ("action", "mode"), [(0, FlightMode.HOLD), (1, FlightMode.HOLD), (2, FlightMode.SURFACE)], ids=str
)
def test_the_failsafe_acts_by_its_parameter(action: int, mode: FlightMode) -> None:
    bench = Bench(FS_THR_ACT=action).armed()
    bench.thruster_problem = "depth cannot be held (thruster vertical 0 %)"
    assert bench.run(2.5).failsafes == 0
    decision = bench.run(1.0)
    assert decision.failsafes == 1 << Failsafe.THRUSTER
    assert decision.mode is mode
    assert "Failsafe: depth cannot be held (thruster vertical 0 %)" in bench.texts
    assert any("Failsafe " + mode.name in text for text in bench.texts) == (action > 0)


def test_a_vehicle_that_cannot_stay_is_not_armed() -> None:
    bench = Bench()
    bench.thruster_problem = "heading cannot be held (thruster port 0 %, starboard 0 %)"
    bench.run()
    answer = bench.commander.arm(force=False)
    assert answer.result is CommandResult.DENIED
    assert "THRn_HEALTH" in answer.reason
