"""A vehicle's computer whose clock of day is decades off: no battery, no network, or set wrong while it runs."""

import time
from pathlib import Path

import pytest
from ardusub_tank import Tank, tanks

from autopilot.log.reader import open_log


@pytest.mark.parametrize("clock_s", [0, 2**31 + 10**9])
def test_a_flight_is_logged_whatever_the_clock_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, clock_s: int
) -> None:
    """1970 and 2069: before what MCAP and after what ROS can hold."""
    monkeypatch.setattr(time, "time_ns", lambda: clock_s * 10**9)
    with tanks(Tank, tmp_path) as made:
        flight = made()
        flight.run(lambda outputs: outputs.t_us >= 1_000_000, 2.0)
    log = open_log(tmp_path / "run.mcap")
    assert not log.problems and len(log["/in/tick"]) == 100
