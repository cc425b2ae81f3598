"""Without --log every arming has a log of its own, closed when the vehicle is disarmed."""

import json
from pathlib import Path

import pytest
from wire_client import ArmingSchedule

from autopilot.log.reader import open_log
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import open_sitl


def test_one_log_per_arming(tmp_path: Path) -> None:
    settings = flight_settings(
        tmp_path / "state", {"sensors": "pose", "duration": 7.0, "log_dir": str(tmp_path / "logs")}
    )
    open_sitl(settings, {"FENCE_REQUIRED": 0.0}, peers=[ArmingSchedule({2.0: 1, 3.5: 0, 4.5: 1, 6.0: 0})]).run()
    logs = sorted((tmp_path / "logs").rglob("*.mcap"))
    assert len(logs) == 2
    for path, begin_s in zip(logs, (2.0, 4.5), strict=True):
        log = open_log(path)
        assert not log.problems
        mode = log["/sys/mode"]
        assert mode["armed"][0] == 1
        assert mode["armed"][-1] == 0
        assert mode["t_us"][0] * 1e-6 == pytest.approx(begin_s, abs=0.02)
        assert path.with_suffix(".tlog").exists()
        assert set(json.loads(log.attachments["plans.json"])) == {"mission", "fence", "rally"}


def test_old_logs_make_room_for_a_new_one_which_says_so(tmp_path: Path) -> None:
    old = tmp_path / "logs" / "2020-02-02" / "10_20_30.mcap"
    old.parent.mkdir(parents=True)
    old.write_bytes(bytes(2_000_000))
    settings = flight_settings(
        tmp_path / "state",
        {"sensors": "pose", "duration": 3.0, "log_dir": str(tmp_path / "logs"), "log_quota_mb": 1.0},
    )
    open_sitl(settings, {"FENCE_REQUIRED": 0.0}, peers=[ArmingSchedule({2.0: 1})]).run()
    (new,) = sorted((tmp_path / "logs").rglob("*.mcap"))
    assert new != old
    assert open_log(new).metadata["run"]["removed_logs"] == "2020-02-02/10_20_30.mcap"
