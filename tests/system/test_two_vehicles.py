"""Two vehicles in one tank that know of each other by what each broadcasts, and by nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from plan_text import PILLARS, WORKSPACE, pillar, waypoint

from autopilot.core.messages import Severity
from autopilot.run.config import flight_settings
from autopilot.run.sitl_session import SitlSession, open_sitl

SCENARIOS = Path(__file__).parents[2] / "sitl" / "scenarios"
BODY_M = 0.3
"""Radius of a vehicle."""
WAYS = (((-1.8, 0.85, 0.45), (1.8, -0.3, 0.45)), ((1.8, 0.85, 0.45), (-1.8, -0.3, 0.45)))
"""Start and goal of both: the straight ways cross in the middle of the tank, where both would be at the same time."""
HEAD = WORKSPACE + "".join(pillar(*place) for place in PILLARS)


class Water:
    """Brings what one vehicle sends on its last link to the other, a tick later."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.other: Water | None = None

    def step(self, t_us: int, received: Sequence[bytes]) -> list[bytes]:
        """Of :class:`autopilot.run.outside.InProcessClient`."""
        assert self.other is not None
        heard, self.other.sent = self.other.sent, []
        self.sent += received
        return heard


def vehicle(folder: Path, instance: int, water: Water) -> SitlSession:
    """Instance ``instance``, which goes its way through the paper's tank."""
    start, goal = WAYS[instance]
    folder.mkdir()
    text = (SCENARIOS / "paper-tank-still.toml").read_text(encoding="utf-8")
    x, y, z = start
    lines = [
        f"start_m = [{x}, {y}, {z}]" if line.startswith("start_m") else line
        for line in text.splitlines()
        if not line.startswith(("plan", "held"))
    ]
    (folder / "tank.toml").write_text("\n".join(lines), encoding="utf-8")
    (folder / "m.toml").write_text(HEAD + waypoint(*goal, accept_m=0.3), encoding="utf-8")
    given = {"scenario": str(folder / "tank.toml"), "plan": str(folder / "m.toml"), "sensors": "pose", "start": True}
    return open_sitl(flight_settings(folder, given), {}, instance=instance, log=False, peers=(water,))


def least_distance_m(folder: Path) -> tuple[float, list[str]]:
    """How near the centres of two vehicles that cross come to each other, and what each said at its end."""
    waters = (Water(), Water())
    waters[0].other, waters[1].other = waters[1], waters[0]
    sessions = [vehicle(folder / name, number, waters[number]) for number, name in enumerate("ab")]
    least_m, said = np.inf, [list[str](), list[str]()]
    try:
        for tick in range(1, 6000):
            for number, session in enumerate(sessions):
                outputs = session.runtime.tick(10_000 * tick)
                said[number] += [event.text for event in outputs.events if event.severity <= Severity.INFO]
            one, two = (session.device.truth.pos_ned_m for session in sessions)
            least_m = min(least_m, float(np.linalg.norm((one - two)[:2])))
            if all(any(text.startswith("Mission complete") for text in texts) for texts in said):
                break
    finally:
        for session in sessions:
            session.runtime.close()
    assert all(session.device.truth.contact_count == 0 for session in sessions)
    return least_m, [next((text for text in texts if text.startswith("Mission complete")), "") for texts in said]


@pytest.mark.long
def test_two_vehicles_pass_each_other_in_the_papers_tank(tmp_path: Path) -> None:
    least_m, ends = least_distance_m(tmp_path)
    assert least_m > 2.0 * BODY_M
    assert all(ends), "both arrive"
