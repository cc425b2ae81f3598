"""A pool with waves: they are no broken accelerometer, late line or weak thruster, and hide no dead one."""

from pathlib import Path

import pytest
from system_harness import OpenSession

WAVES = """
[waves]
height_m = {height_m}
period_s = {period_s}
"""
LOSS = """
[[fault]]
kind = "thruster_loss"
at_s = 25.0
thruster = "lateral"
"""
FALSE = ("Command latency", "Accelerometer", "Failsafe", "Position reset", "Poses wrong", "Thruster")


def _texts(session: OpenSession, tmp_path: Path, vehicle: str, world: str) -> list[str]:
    """What the operator reads in a minute of a free vehicle in the pool."""
    shipped = Path("sitl/scenarios")
    scenario, plan = ((shipped / name).read_text() for name in ("pool.toml", "pool.mission.toml"))
    free = scenario.replace("held = true", "held = false").replace('model = "bluerov2"', f'model = "{vehicle}"')
    (tmp_path / "waves.toml").write_text(free + world)
    (tmp_path / "pool.mission.toml").write_text(plan)
    texts: list[str] = []
    session(
        str(tmp_path / "waves.toml"), sensors="pose", start=True, duration=60.0, log=tmp_path / "run.mcap",
        on_tick=lambda out: texts.extend(event.text for event in out.events),
    ).run()  # fmt: skip
    return texts


@pytest.mark.parametrize(("vehicle", "height_m", "period_s"), [("bluerov2", 0.1, 3.0), ("lbv150", 0.1, 3.0)])
def test_waves_are_taken_for_no_fault(
    session: OpenSession, tmp_path: Path, vehicle: str, height_m: float, period_s: float
) -> None:
    """Not with the period of a BlueROV2's pitch: docs/hardware.md, Limits."""
    texts = _texts(session, tmp_path, vehicle, WAVES.format(height_m=height_m, period_s=period_s))
    assert not [text for text in texts if text.startswith(FALSE)], texts
    assert "Reached item 0" in texts


def test_waves_hide_no_dead_thruster(session: OpenSession, tmp_path: Path) -> None:
    texts = _texts(session, tmp_path, "lbv150", WAVES.format(height_m=0.07, period_s=5.0) + LOSS)
    named = {" ".join(text.split()[:2]) for text in texts if text.startswith("Thruster")}
    assert named == {"Thruster lateral"}, texts
