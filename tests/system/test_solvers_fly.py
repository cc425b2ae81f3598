"""The vehicle flies with and without the compiled step, the same way, and says with which."""

from pathlib import Path

import numpy as np
import pytest
from system_harness import PAPER_PLAN, OpenSession

from autopilot.core import compiled
from autopilot.log.reader import Log, open_log


def _flown(session: OpenSession, path: Path) -> Log:
    session(sensors="pose", plan=str(PAPER_PLAN), start=True, duration=6.0, log=path).run()
    return open_log(path)


def _said(log: Log) -> list[str]:
    return [text for text in (message.value["msg"] for message in log.messages("/rosout")) if "olver" in text]


@pytest.mark.long
def test_both_solvers_fly_the_same_way(session: OpenSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logs = [_flown(session, tmp_path / "as_installed.mcap")]
    monkeypatch.setenv(compiled.SWITCH, compiled.OFF)
    logs.append(_flown(session, tmp_path / "not_compiled.mcap"))
    solvers = [log.description.solver if log.description else "" for log in logs]
    assert solvers[0].split(" ")[0] == "native"
    assert solvers[1].startswith("hpipm (native: switched off by AUTOPILOT_COMPILED=no")
    for log, solver in zip(logs, solvers, strict=True):
        assert f"Solver: {solver}" in _said(log)[-1]
    assert len(_said(logs[0])) == 1
    assert "Slower solver" in _said(logs[1])[0]
    places = [log["/sim/truth"]["pos_ned_m"] for log in logs]
    assert float(np.linalg.norm(places[0][-1] - places[0][0])) > 0.3
    assert float(np.abs(places[0] - places[1]).max()) < 2e-3
