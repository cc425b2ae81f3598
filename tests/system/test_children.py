"""Processes that the project starts: they run our code wherever they are started, and are judged by what they do."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from hostile_folder import make_hostile
from system_harness import PAPER_PLAN, ROOT

from autopilot.core.errors import AutopilotError
from autopilot.run.children import Child, autopilot_command, python_command


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    return make_hostile(tmp_path / "project")


def _without_python_path() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


def test_a_service_is_started_in_a_folder_with_modules_of_our_names(hostile: Path, tmp_path: Path) -> None:
    command = autopilot_command(
        *("sitl", "--sensors", "pose", "--speed", "0", "--duration", "0.05", "--connect", "udpout:127.0.0.1:9"),
        *("--log", str(tmp_path / "run.mcap")),
    )
    environment = {**_without_python_path(), "AUTOPILOT_STATE_DIR": str(tmp_path / "state")}
    done = subprocess.run(command, cwd=hostile, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_child_runs_the_code_of_its_parent(hostile: Path) -> None:
    command = python_command("import autopilot, autopilot.mission as m; print(autopilot.__file__, m.__file__)")
    done = subprocess.run(command, cwd=hostile, env=_without_python_path(), capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(ROOT / "autopilot/__init__.py"), str(ROOT / "autopilot/mission/__init__.py")]


def test_python_m_does_not_import_from_the_current_folder(hostile: Path) -> None:
    """Only the package itself is looked for there, by Python: that is what -m means."""
    shutil.rmtree(hostile / "autopilot")
    command = [sys.executable, "-m", "autopilot", "mission", "check", str(PAPER_PLAN)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=hostile, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "fit to fly" in done.stdout


def test_a_child_that_has_ended_is_named_with_its_exit_code() -> None:
    child = Child(python_command("raise SystemExit(7)"))
    child.process.wait()
    assert child.cpu_s() is None
    assert not child.works()
    with pytest.raises(AutopilotError, match="ended with exit code 7"):
        child.at_work()
    assert child.end() == 7


def test_a_child_that_only_sleeps_is_stuck_and_one_that_computes_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("autopilot.run.children.STUCK_S", 2.0)
    monkeypatch.setattr("autopilot.run.children.LOOK_S", 0.05)
    deaf = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(flush=True); "
    busy, asleep = Child(python_command("while True: pass")), Child(python_command(deaf + "time.sleep(1e6)"))
    try:
        while asleep.works():
            time.sleep(0.05)
        assert busy.works()
        assert asleep.end() == -signal.SIGKILL
    finally:
        asleep.process.kill()
        assert busy.end() == -signal.SIGTERM


def test_a_demo_that_is_ended_ends_its_service(tmp_path: Path) -> None:
    child = Child(autopilot_command("demo", "--laps", "1", "--out", str(tmp_path), "--speed", "1"))
    try:
        log = tmp_path / "run.mcap"
        while not log.exists():
            assert child.at_work()
            time.sleep(0.05)
        (service,) = psutil.Process(child.process.pid).children()
        assert child.end() == 128 + signal.SIGTERM
        assert not service.is_running()
    finally:
        child.process.kill()
