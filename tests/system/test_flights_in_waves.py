"""A pool with waves: they are no broken accelerometer, late line or weak thruster, and seldom hide a dead one."""

import random
from pathlib import Path

import pytest
from system_harness import OpenSession

from tests.bench.sensor_faults import FaultFlight, fly_fault

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


def _texts(session: OpenSession, tmp_path: Path, vehicle: str, world: str, seed: int = 1) -> list[str]:
    """What the operator reads in a minute of a free vehicle in the pool."""
    shipped = Path("sitl/scenarios")
    scenario, plan = ((shipped / name).read_text() for name in ("pool.toml", "pool.mission.toml"))
    free = scenario.replace("held = true", "held = false").replace('model = "bluerov2"', f'model = "{vehicle}"')
    (tmp_path / "waves.toml").write_text(free + world)
    (tmp_path / "pool.mission.toml").write_text(plan)
    texts: list[str] = []
    session(
        str(tmp_path / "waves.toml"), sensors="pose", start=True, duration=60.0, seed=seed, log=tmp_path / "run.mcap",
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


def test_waves_seldom_hide_a_dead_thruster(session: OpenSession, tmp_path: Path) -> None:
    """For half a minute, of a thruster that is asked for little, in one flight of four."""
    found = []
    for seed in range(1, 5):
        texts = _texts(session, tmp_path, "lbv150", WAVES.format(height_m=0.07, period_s=5.0) + LOSS, seed)
        found.append({" ".join(text.split()[:2]) for text in texts if text.startswith("Thruster")})
    assert set().union(*found) == {"Thruster lateral"} and found.count(set()) <= 1, found


def test_short_waves_are_rarely_taken_for_weak_thrusters_and_end_no_flight() -> None:
    """Seas drawn by machine, of periods in which the controller's answer lags just so far that a weak thruster would
    explain it: six of these twelve flights blamed one, four of them as dead."""
    blamed = []
    for seed in range(40, 52):
        rng = random.Random(seed)
        sea = {"period_s": rng.uniform(1.8, 2.6), "height_m": rng.choice((0.05, 0.1, 0.15, 0.2))}
        waves = {**sea, "direction_rad": rng.uniform(-3.0, 3.0)}
        scenario = rng.choice(("paper-tank", "harbour", "open-water", "pool"))
        flight = FaultFlight(at_s=15.0, seed=seed, scenario=scenario, duration_s=60.0, changes={"waves": waves})
        texts = fly_fault(flight).texts
        blamed += [seed] if any(text.startswith("Thruster") for text in texts) else []
        assert not [text for text in texts if text.startswith("Failsafe") and "thruster" in text]
    assert len(blamed) <= 4, blamed
