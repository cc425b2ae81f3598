"""What a machine inside a vehicle is set up with says what this program understands."""

import configparser
import json
import re
import shlex
import shutil
import subprocess
import tomllib
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from string import Template

import click
import pytest

from autopilot.cli.main import cli
from autopilot.run.config import ENVIRONMENT_PREFIX, vehicle_defaults
from autopilot.view.http_server import DEFAULT_PORT

ROOT = Path(__file__).parents[1]
DEPLOY = ROOT / "docs" / "deploy"
UNIT = DEPLOY / "underwater-autopilot.service"
LARGEST_EXPOSURE = 4.0
"""By `systemd-analyze security`, of 10."""
INSTALLED = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["data-files"]


class Unit(configparser.ConfigParser):
    """A systemd unit: names keep their case, one may come more than once."""

    def __init__(self) -> None:
        super().__init__(strict=False, interpolation=None)
        self.optionxform = str  # type: ignore[assignment,method-assign]


def understands(arguments: list[str]) -> None:
    """The command exists and knows these options."""
    context = click.Context(cli)
    name, command, rest = cli.resolve_command(context, arguments)
    assert command is not None
    command.make_context(name, rest, parent=context, resilient_parsing=False)


def test_the_unit_starts_what_is_there() -> None:
    unit = Unit()
    unit.read_string(UNIT.read_text())
    service = unit["Service"]
    program, *arguments = shlex.split(service["ExecStart"])
    assert program.endswith("/bin/autopilot")
    understands(arguments)
    assert service["Type"] == "notify", "or the watchdog has nobody to listen to"
    assert float(service["WatchdogSec"]) > 0.0


@pytest.mark.parametrize("name", ["underwater-autopilot.service", "Containerfile"])
def test_variables_are_settings(name: str) -> None:
    text = (DEPLOY / name).read_text()
    found = set(re.findall(rf"{ENVIRONMENT_PREFIX}([A-Z_]+)=", text))
    assert {"STATE_DIR", "LOG_DIR", "LOG_QUOTA_MB"} <= found
    assert {each.lower() for each in found} <= set(vehicle_defaults(0))


def test_the_image_starts_what_is_there() -> None:
    text = (DEPLOY / "Containerfile").read_text()
    (command,) = re.findall(r"^CMD (\[.*\])$", text, re.MULTILINE)
    shell, option, script = json.loads(command)
    assert (shell, option) == ("sh", "-c")
    for program in re.findall(r"\bautopilot ([^;&|]*)", script):
        understands(shlex.split(program))
    assert "exec autopilot run" in script, "or it is not the service that gets the signal to stop"
    assert "USER autopilot" in text


def test_the_image_is_built_from_all_that_is_installed() -> None:
    lines = (ROOT / ".dockerignore").read_text().split()
    kept = {line[1:] for line in lines if line.startswith("!")}
    for pattern in (*chain(*INSTALLED.values()), "autopilot", "drivers", "estimator", "mission", "sitl", "setup.py"):
        above = {str(path) for path in (Path(pattern), *Path(pattern).parents)}
        assert above & kept or not above.intersection(lines), f"{pattern} is not in the image"


def image_labels() -> dict[str, str]:
    """Of the container file, as a builder has them: continued lines joined, variables at their defaults."""
    text = (DEPLOY / "Containerfile").read_text().replace("\\\n", "")
    defaults = dict(re.findall(r'^ARG (\w+)="(.*)"$', text, re.MULTILINE))
    labels = {}
    for name, quoted in re.findall(r"^LABEL (\w+)=(.*)$", text, re.MULTILINE):
        (value,) = shlex.split(quoted)
        labels[name] = value if quoted.startswith("'") else Template(value).substitute(defaults)
    return labels


def test_the_image_is_an_extension_of_blueos() -> None:
    labels = image_labels()
    assert labels["version"] == version("underwater-autopilot")
    assert re.fullmatch(r"core >= \d+\.\d+", labels["requirements"])
    assert labels["type"] in ("device-integration", "example", "theme", "other", "tool", "education")
    tags = json.loads(labels["tags"])
    assert 0 < len(tags) <= 10 and all(re.fullmatch(r"[a-z0-9-]+", tag) for tag in tags)
    assert json.loads(labels["authors"])[0].keys() == {"name", "email"}
    assert json.loads(labels["company"])["name"] and "website" in json.loads(labels["links"])
    permissions = json.loads(labels["permissions"])
    given = dict(each.split("=") for each in permissions["Env"])
    names = {name.removeprefix(ENVIRONMENT_PREFIX).lower(): value for name, value in given.items()}
    assert names == {"view": str(DEFAULT_PORT), "view_address": "0.0.0.0"}, "BlueOS looks at open ports only"
    assert names.keys() <= vehicle_defaults(0).keys()
    host = permissions["HostConfig"]
    assert host["NetworkMode"] == "host" and "Privileged" not in host and host["CapDrop"] == ["ALL"]
    (bind,) = host["Binds"]
    assert bind.startswith("/usr/blueos/extensions/")
    text = (DEPLOY / "Containerfile").read_text()
    assert f"VOLUME {bind.partition(':')[2]}\n" in text and f"STATE_DIR={bind.partition(':')[2]} " in text


def test_the_unit_names_files_that_a_wheel_installs() -> None:
    """A virtual environment has the data files of a wheel under its own folder."""
    unit = UNIT.read_text()
    program = re.search(r"ExecStart=(\S+)/bin/autopilot ", unit)
    page = re.search(r"Documentation=file:(\S+)", unit)
    assert program is not None and page is not None
    folder = "share/underwater-autopilot"
    files = INSTALLED[folder]
    assert page[1] == f"{program[1]}/{folder}/deploy.md"
    assert all((ROOT / file).is_file() for file in files) and str(UNIT.relative_to(ROOT)) in files


def test_commands_beside_the_service_have_its_user_and_state() -> None:
    """Else `mavlink key make` would write a key that the service does not read."""
    unit = UNIT.read_text()
    page = (ROOT / "docs" / "deploy.md").read_text()
    user, program = re.search(r"^User=(\w+)", unit, re.MULTILINE), re.search(r"ExecStart=(\S+)", unit)
    state = re.search(r"AUTOPILOT_STATE_DIR=\S+", unit)
    assert user is not None and program is not None and state is not None
    assert f"alias autopilot='runuser -u {user[1]} -- env {state[0]} {program[1]}'" in page


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
