"""Commands that act a second late: the service finds out with its first thrust, and holds."""

from pathlib import Path

import numpy as np
from system_harness import OpenSession

from autopilot.core.messages import Failsafe, Outputs
from autopilot.log.check import acceptance_table
from autopilot.log.reader import open_log

LATENCY_S = 1.0


def test_a_second_of_delay_is_found_and_nothing_is_touched(session: OpenSession, tmp_path: Path) -> None:
    log, outputs = tmp_path / "late.mcap", []

    def note(tick: Outputs) -> None:
        outputs.append((tick.t_us * 1e-6, tick.mode.armed, tick.mode.failsafes, np.abs(tick.command.thrust_n).max()))

    session("r6", sensors="pose", start=True, duration=11.0, log=log, on_tick=note).run()
    t_s, armed, bits, thrust_n = np.array(outputs).T
    began_s, found_s = t_s[armed > 0.0][0], t_s[bits.astype(int) >> Failsafe.LATENCY & 1 == 1][0]
    assert found_s - began_s < LATENCY_S + 1.5
    # In doubt before: the thrust stops when its effect does not come, and it is not known yet how late that is.
    waiting = (t_s > began_s + 0.2) & (t_s < found_s)
    assert (thrust_n[waiting] == 0.0).mean() > 0.4
    assert armed[-1]
    rows = {row.name: row for row in acceptance_table(open_log(log))}
    assert rows["contacts"].worst == 0
    for name in ("distance to cylinder 1", "distance to cylinder 2", "distance to walls"):
        margin = rows[name].margin
        assert margin is not None
        assert margin > 0.0
    assert rows["failsafes raised"].note == f"bits {1 << Failsafe.LATENCY:#x}"
    assert "lowest thruster effectiveness" not in rows or rows["lowest thruster effectiveness"].worst == 100.0
