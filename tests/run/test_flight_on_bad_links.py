"""A mission by a tether with latency, jitter and loss: sound poses are not doubted, and thrust is not cut out."""

from itertools import pairwise
from pathlib import Path

import numpy as np
from ardusub_tank import Tank

from autopilot.core.messages import Outputs
from tests.lossy_link import LinkConditions

TETHER = LinkConditions(latency_s=0.1, jitter_s=0.01, loss=0.05, burst=2.0, reorder=0.02, duplicate=0.02)
WRONG = ("Failsafe", "Position reset", "wrong", "clock jumped", "silent", "disarmed", "Dead reckoning", "lost")


def test_a_mission_by_a_tether_is_flown_as_by_a_cable(tmp_path: Path) -> None:
    flight = Tank(tmp_path, conditions=TETHER, EST_EXT_DELAY=0.11)
    off_m, turned = [], list[int]()

    def done(outputs: Outputs) -> bool:
        nav = outputs.nav
        assert nav is None or not nav.doubts
        if nav is not None and flight.below.armed:
            off_m.append(float(np.linalg.norm(nav.pos_ned_m - flight.world.truth.pos_ned_m)))
        turned.append(max(abs(us - 1500) for us in flight.below.servos_us))
        return flight.reported("Reached item 1")

    try:
        flight.run(done, 90.0)
    finally:
        flight.close()
    found = [text for _, text in flight.texts if any(word in text for word in WRONG)]
    assert found == []
    begun = next(n for n, us in enumerate(turned) if us)
    assert not any(before > 20 and after == 0 for before, after in pairwise(turned[begun:])), "thrust was cut out"
    assert np.percentile(off_m, 95) < 0.03 and max(off_m) < 0.08
    lost = {name: (link.lost, link.sent) for name, link in vars(flight).items() if name in ("up", "down", "poses")}
    assert all(0.02 < gone / sent < 0.09 for gone, sent in lost.values()), lost
