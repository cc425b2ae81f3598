"""Names on the command line: what was meant, exit code 2, what the shell completes; where files lie."""

import json
import os
import shutil
import subprocess
import sys
from importlib import resources
from pathlib import Path

import pytest
from click.testing import CliRunner

from autopilot.cli.main import cli, run


def called(*words: str) -> int:
    return run(lambda: cli(list(words), prog_name="autopilot", standalone_mode=False))


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("sitl", "paper-tonk"), "scenario 'paper-tonk' is not known; did you mean paper-tank? use one of b1, "),
        (("sitl", "--vehicle", "bluerov"), "vehicle 'bluerov' is not known; did you mean bluerov2? "),
        (("sitl", "--param", "spd_cruse=1"), "parameter 'spd_cruse' is not known; did you mean SPD_CRUISE? `autopilot"),
        (("sitl", "--controller", "nmcp"), "'nmcp' is not known; did you mean nmpc? use one of nmpc, los-pid, or "),
        (("sitl", "--sensors", "camra"), "'camra' is not known; did you mean camera? use one of camera, pose"),
        (("bench", "refrence"), "'reference'"),
        (("scenario", "check", "harbor"), "did you mean harbour? "),
        (("scenario", "new", "mine", "--from", "vortx"), "did you mean vortex? "),
        (("config", "show", "--config", "bluerov2-ardusb"), "did you mean bluerov2-ardusub? "),
        (("mission", "check", "x.mission.toml", "--vehicle", "lbv"), "did you mean lbv150? "),
        (("campaign", "open-watr", "--out", "x", "--runs", "1"), "did you mean open-water? "),
        (("sitl", "zzz"), "scenario 'zzz' is not known; use one of b1, "),
    ],
)
def test_a_name_that_does_not_exist_is_a_usage_error(
    words: tuple[str, ...],
    text: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("AUTOPILOT_STATE_DIR", str(tmp_path / "state"))
    shutil.copy(resources.files("autopilot") / "sitl" / "scenarios" / "b6.mission.toml", tmp_path / "x.mission.toml")
    assert called(*words) == 2
    assert text in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("autopilot sitl paper", ["paper-tank", "paper-tank-still"]),
        ("autopilot scenario check har", ["harbour"]),
        ("autopilot campaign open", ["open-water"]),
        ("autopilot sitl --vehicle blue", ["bluerov2", "bluerov2-heavy"]),
        ("autopilot sitl --param SPD_CR", ["SPD_CRUISE="]),
        ("autopilot run --config bluerov2-", ["bluerov2-ardusub"]),
    ],
)
def test_the_shell_completes_names(words: str, offered: list[str]) -> None:
    count = len(words.split()) - 1
    shell = {"_AUTOPILOT_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(count)}
    program = "from autopilot.cli.main import cli; cli(prog_name='autopilot')"
    done = subprocess.run([sys.executable, "-c", program], env=os.environ | shell, capture_output=True, text=True)
    assert [line.removeprefix("plain,") for line in done.stdout.splitlines()] == offered, done.stderr


def test_where_state_and_logs_lie_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AUTOPILOT_STATE_DIR", str(tmp_path / "state of mine"))
    monkeypatch.setenv("AUTOPILOT_LOG_DIR", str(tmp_path / "logs"))
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "a.mcap").write_bytes(bytes(2_000_000))
    shown = CliRunner().invoke(cli, ["config", "paths"]).output
    assert "environment AUTOPILOT_STATE_DIR" in shown and "not there yet" in shown
    assert f"remove: rm -r {tmp_path / 'logs'}" in shown and "2.0 MB" in shown
    state, logs = json.loads(CliRunner().invoke(cli, ["config", "paths", "--json"]).output)
    assert state["folder"] == str(tmp_path / "state of mine") and logs["size_mb"] == 2.0


@pytest.mark.parametrize("command", ["scenario", "config"])
def test_a_copy_is_written_to_a_file_or_into_a_folder(command: str, tmp_path: Path) -> None:
    file, folder = tmp_path / "other.toml", tmp_path / "folder"
    for out in (file, folder):
        done = CliRunner().invoke(cli, [command, "new", "mine", "--out", str(out)])
        assert done.exit_code == 0, done.output
    assert file.is_file() and (folder / "mine.toml").is_file()
    again = CliRunner().invoke(cli, [command, "new", "mine", "--out", str(file)])
    assert "is there already" in str(again.exception)
