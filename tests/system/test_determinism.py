"""Same scenario, seed and inputs: the same log, but for run metadata and measurements of the machine."""

from pathlib import Path

import pytest
from system_harness import PAPER_PLAN, OpenSession

from autopilot.log.compare import compare_logs
from autopilot.log.reader import open_log


@pytest.mark.parametrize(("sensors", "duration_s"), [("pose", 4.0), ("camera", 2.0)])
def test_same_seed_gives_the_same_log(session: OpenSession, tmp_path: Path, sensors: str, duration_s: float) -> None:
    logs = []
    for name in ("first", "second"):
        path = tmp_path / f"{name}.mcap"
        session(sensors=sensors, plan=str(PAPER_PLAN), start=True, duration=duration_s, log=path).run()
        logs.append(open_log(path))
    assert logs[0].message_count > 1000
    assert compare_logs(*logs) == []


def test_another_seed_gives_another_log(session: OpenSession, tmp_path: Path) -> None:
    logs = []
    for seed in (1, 2):
        path = tmp_path / f"{seed}.mcap"
        session(sensors="pose", seed=seed, duration=2.0, log=path).run()
        logs.append(open_log(path))
    assert any(difference.topic == "/in/ahrs" for difference in compare_logs(*logs))
