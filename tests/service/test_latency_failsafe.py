"""What the operator hears of late commands, and when the vehicle gives up its mission."""

import pytest
from commander_bench import Bench

from autopilot.core.messages import Failsafe
from autopilot.mavlink.api import FlightMode


def test_a_delay_that_is_allowed_for_is_only_told() -> None:
    bench = Bench().armed()
    bench.status.command_delay_s = 0.32
    decision = bench.run(5.0)
    assert decision.failsafes == 0
    assert [text for text in bench.texts if "latency" in text] == ["Command latency 0.3 s: check the tether"]
    bench.status.command_delay_s = 0.0
    bench.run(1.0)
    assert bench.texts[-1] == "Command latency is back to normal"


@pytest.mark.parametrize(
    ("action", "mode"), [(0, FlightMode.HOLD), (1, FlightMode.HOLD), (2, FlightMode.SURFACE)], ids=str
)
def test_the_failsafe_acts_by_its_parameter(action: int, mode: FlightMode) -> None:
    bench = Bench(FS_LAT_ACT=action, FS_LAT_MAX=0.6).armed()
    bench.status.command_delay_s = 0.55
    assert bench.run().failsafes == 0
    bench.status.command_delay_s = 0.95
    decision = bench.run()
    assert decision.failsafes == 1 << Failsafe.LATENCY
    assert decision.mode is mode
    assert "Failsafe: command latency high: check the tether" in bench.texts
    assert any("Failsafe " + mode.name in text for text in bench.texts) == (action > 0)
