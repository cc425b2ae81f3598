"""Depth, Doppler log and external pose reach the estimator and the log; a frozen AHRS is a failsafe."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import development as mav
from system_harness import ROOT, OpenSession

from autopilot.core.messages import Failsafe, NavHealth, Outputs
from autopilot.core.sensors import AID_SENSORS
from autopilot.log.reader import open_log

FROZEN_S = (4.0, 6.0)
TABLES = f"""
[sensors.depth]
[sensors.dvl]
[[fault]]
kind = "ahrs_freeze"
at_s = {FROZEN_S[0]}
duration_s = {FROZEN_S[1] - FROZEN_S[0]}
"""


class Positioning:
    """A client that sends VISION_POSITION_ESTIMATE at 10 Hz: where the vehicle thinks it is, 50 ms ago."""

    def __init__(self) -> None:
        self._mav = mav.MAVLink(None, srcSystem=42, srcComponent=197)
        self._nav: list[Outputs] = []

    def seen(self, outputs: Outputs) -> None:
        self._nav = [*self._nav[-4:], outputs]

    def step(self, t_us: int, received: Sequence[bytes]) -> list[bytes]:
        if t_us % 100_000 or not self._nav or self._nav[0].nav is None:
            return []
        nav = self._nav[0].nav
        variance = [0.01] + [0.0] * 5 + [0.01] + [0.0] * 4 + [0.01] + [0.0] * 8 + [0.01]
        north, east, down = nav.pos_ned_m.tolist()
        message = mav.MAVLink_vision_position_estimate_message(
            nav.t_us, north, east, down, 0.0, 0.0, float(nav.rpy_rad[2]), variance, 0
        )
        return [bytes(message.pack(self._mav))]


def test_aids_and_a_frozen_ahrs(session: OpenSession, tmp_path: Path) -> None:
    scenario, log = tmp_path / "aided.toml", tmp_path / "run.mcap"
    base = (ROOT / "sitl" / "scenarios" / "paper-tank.toml").read_text(encoding="utf-8")
    scenario.write_text(base + TABLES, encoding="utf-8")
    client, ticks = Positioning(), []

    def on_tick(outputs: Outputs) -> None:
        client.seen(outputs)
        ticks.append((outputs.t_us * 1e-6, outputs.mode.failsafes, outputs.nav))

    session(str(scenario), sensors="pose", duration=7.0, log=log, peers=(client,), on_tick=on_tick).run()

    stale = [t_s for t_s, failsafes, _ in ticks if failsafes >> Failsafe.AHRS_STALE & 1]
    assert FROZEN_S[0] + 0.5 < min(stale) < FROZEN_S[0] + 0.9, "20 repeats, then half a second"
    assert FROZEN_S[1] < max(stale) + 0.02 < FROZEN_S[1] + 0.1
    blind = [nav.health for t_s, _, nav in ticks if FROZEN_S[0] + 0.4 < t_s < FROZEN_S[1] and nav is not None]
    assert NavHealth.GOOD not in blind

    read = open_log(log)
    last = read["/nav/counters"][-1]
    fused = dict(zip(AID_SENSORS, last["fused"].tolist(), strict=False))
    assert all(fused[sensor] > 10 for sensor in ("markers", "external", "velocity", "depth", "heading", "laser"))
    assert last["ahrs_stuck"] > 150
    for sensor in ("external", "velocity", "depth"):
        assert read[f"/nav/aid/{sensor}"]["fused"].mean() > 0.5
    assert len(read["/in/depth"]) > 40 and len(read["/in/velocity"]) > 30
    shadow = read["/nav/shadow"]
    assert len(shadow) > 40 and not shadow["disagrees"].any()
    assert np.abs(shadow["pos_difference_ned_m"]).max() < 0.3
