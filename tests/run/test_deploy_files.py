"""The files of docs/deploy.md: where they are installed, and what the service may do."""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
UNIT = ROOT / "docs" / "deploy" / "underwater-autopilot.service"
LARGEST_EXPOSURE = 4.0
"""By `systemd-analyze security`, of 10."""


def test_the_unit_names_files_that_a_wheel_installs() -> None:
    """A virtual environment has the data files of a wheel under its own folder."""
    unit = UNIT.read_text(encoding="utf-8")
    installed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["data-files"]
    program = re.search(r"ExecStart=(\S+)/bin/autopilot ", unit)
    page = re.search(r"Documentation=file:(\S+)", unit)
    assert program is not None and page is not None
    folder = "share/underwater-autopilot"
    files = installed[folder]
    assert page[1] == f"{program[1]}/{folder}/deploy.md"
    assert all((ROOT / file).is_file() for file in files) and str(UNIT.relative_to(ROOT)) in files


def test_commands_beside_the_service_have_its_user_and_state() -> None:
    """Else `mavlink key make` would write a key that the service does not read."""
    unit = UNIT.read_text(encoding="utf-8")
    page = (ROOT / "docs" / "deploy.md").read_text(encoding="utf-8")
    user, program = re.search(r"^User=(\w+)", unit, re.MULTILINE), re.search(r"ExecStart=(\S+)", unit)
    state = re.search(r"AUTOPILOT_STATE_DIR=\S+", unit)
    assert user is not None and program is not None and state is not None
    assert f"alias autopilot='runuser -u {user[1]} -- env {state[0]} {program[1]}'" in page


def test_the_image_is_built_from_all_that_is_installed() -> None:
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    assert "!docs/deploy" in ignored and "!docs/deploy.md" in ignored and ".git" in ignored
    for file in ("autopilot", "drivers", "estimator", "mission", "sitl", "pyproject.toml", "setup.py", "README.md"):
        assert (ROOT / file).exists() and file not in ignored


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
def test_the_unit_is_confined() -> None:
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=yes", "--no-pager", str(UNIT)],
        capture_output=True,
        text=True,
        check=False,
    )
    exposure = re.search(r"exposure level for \S+ ([\d.]+)", done.stdout)
    assert exposure is not None, done.stderr
    assert float(exposure[1]) < LARGEST_EXPOSURE
