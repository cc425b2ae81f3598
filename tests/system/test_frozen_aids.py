"""Pressure sensor and velocity log that go on with an old reading while there are no fixes."""

from pathlib import Path

import pytest
from system_harness import OpenSession

TABLES = """
[sensors.dvl]
[sensors.depth]
[[fault]]
kind = "camera_blackout"
at_s = 20.0
duration_s = 15.0
[[fault]]
kind = "sensor_frozen"
sensor = "depth"
at_s = 22.0
"""


@pytest.fixture(name="scenario")
def scenario_fixture(tmp_path: Path) -> str:
    plan = Path("sitl/scenarios/paper.plan").resolve()
    text = Path("sitl/scenarios/paper-tank.toml").read_text().replace('"paper.plan"', f'"{plan}"')
    (tmp_path / "frozen.toml").write_text(text + TABLES)
    return str(tmp_path / "frozen.toml")


def test_a_depth_that_freezes_in_a_gap_is_not_followed(session: OpenSession, scenario: str) -> None:
    """The vehicle sank or rose unseen: the fixes after the gap were called wrong, and it held for good."""
    texts: list[str] = []
    session(
        scenario, sensors="pose", start=True, duration=38.0,
        on_tick=lambda out: texts.extend(event.text for event in out.events),
    ).run()  # fmt: skip
    assert "Failsafe: depth sensor silent or frozen" in texts and "Position is good again" in texts, texts
    assert not [text for text in texts if text.startswith(("Poses", "Failsafe HOLD", "Accelerometer"))], texts
