"""A sonar altimeter in the simulated tank, with multiples and losses, through the whole service."""

from collections import Counter
from pathlib import Path

import numpy as np
from system_harness import OpenSession

from autopilot.core.messages import Outputs
from autopilot.sitl.toml_text import toml_text
from tests.bench.sensor_faults import PLAIN_WAY, FaultFlight, flight_tables

ALTIMETER = {"multiple_probability": 0.1, "drop_probability": 0.3}


def test_it_is_heard_all_the_time_and_used_when_nothing_else_knows_the_depth(
    session: OpenSession, tmp_path: Path
) -> None:
    at_s, gap_s = 6.0, 9.0
    flight = FaultFlight(gap_s=gap_s, at_s=at_s, changes={"sensors": {"altimeter": ALTIMETER}})
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(toml_text(flight_tables(flight)), encoding="utf-8")
    used: Counter[str] = Counter()
    inside: list[bool] = []
    counts: dict[str, int] = {}

    def look(outputs: Outputs) -> None:
        t_s, truth, nav = 1e-6 * outputs.t_us, run.device.truth, outputs.nav
        for aid in outputs.aids:
            if aid.sensor == "altimeter" and aid.fused:
                used["in the gap" if at_s < 1e-6 * aid.t_us < at_s + gap_s + 1.0 else "before or after"] += 1
        if outputs.counters is not None:
            counts.update(outputs.counters.counts)
        if nav is not None and t_s > 3.0:
            inside.append(abs(float(nav.pos_ned_m[2] - truth.pos_ned_m[2])) <= 3.0 * float(np.sqrt(nav.variance[2])))

    given = {"sensors": "pose", "duration": 18.0, "seed": 5, "start": True}
    run = session(str(scenario), params=PLAIN_WAY, on_tick=look, **given)
    run.run()
    assert run.device.truth.contact_count == 0
    assert counts["altimeter.received"] > 80
    assert used["in the gap"] > 20 and used["before or after"] == 0
    assert np.mean(inside) > 0.95
