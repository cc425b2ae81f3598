"""What a machine inside a vehicle is set up with says what this program understands."""

import configparser
import re
import shlex
from pathlib import Path

import click
import pytest

from autopilot.cli.main import cli
from autopilot.run.config import ENVIRONMENT_PREFIX, vehicle_defaults

DEPLOY = Path(__file__).parents[1] / "docs" / "deploy"


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
    unit.read_string((DEPLOY / "underwater-autopilot.service").read_text())
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
    (command,) = re.findall(r"^CMD \[(.*)\]$", text, re.MULTILINE)
    understands([part.strip().strip('"') for part in command.split(",")])
    assert "USER autopilot" in text
