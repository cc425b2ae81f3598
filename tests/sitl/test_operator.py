"""The operator inside a simulated run."""

import subprocess
from pathlib import Path

import pytest

from autopilot.run.children import autopilot_command


def test_the_first_thing_that_a_newcomer_reads_is_no_refusal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AUTOPILOT_STATE_DIR", str(tmp_path))
    monkeypatch.setenv("AUTOPILOT_LOG_DIR", str(tmp_path))
    command = autopilot_command(
        *("sitl", "--start", "--speed", "0", "--sensors", "pose", "--duration", "1.5"),
        *("--connect", "udpout:127.0.0.1:9"),
    )
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "Arming denied" not in done.stdout
    assert "Armed" in done.stdout and "Mode MISSION" in done.stdout
