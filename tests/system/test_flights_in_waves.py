"""A pool with waves: what goes to and fro is neither a current, nor a broken accelerometer, nor a late line."""

from pathlib import Path

import pytest

from autopilot.run.config import gather, sitl_defaults
from autopilot.run.sitl_session import open_sitl

WAVES = """
[waves]
height_m = 0.2
period_s = 2.0
"""
FALSE = ("Command latency", "Accelerometer", "Failsafe", "Position reset", "Poses wrong")


@pytest.mark.parametrize("vehicle", ["bluerov2", "lbv150"])
def test_waves_are_taken_for_no_fault_of_sensors_or_line(tmp_path: Path, vehicle: str) -> None:
    shipped = Path("sitl/scenarios")
    scenario, plan = ((shipped / name).read_text() for name in ("pool.toml", "pool.mission.toml"))
    free = scenario.replace("held = true", "held = false")
    (tmp_path / "waves.toml").write_text(free + WAVES)
    (tmp_path / "pool.mission.toml").write_text(plan)
    given = {"scenario": str(tmp_path / "waves.toml"), "state_dir": str(tmp_path / "state"), "speed": 0.0}
    more = {"log": str(tmp_path / "run.mcap"), "start": True, "vehicle": vehicle, "sensors": "pose"}
    gathered = gather(sitl_defaults(0), {**given, **more}, {})
    gathered.put("duration", 60.0, "test")
    gathered.put("connect", (), "test")
    texts: list[str] = []
    session = open_sitl(gathered, {}, on_tick=lambda out: texts.extend(event.text for event in out.events))
    session.run()
    assert not [text for text in texts if text.startswith(FALSE)], texts
    assert "Reached item 0" in texts
