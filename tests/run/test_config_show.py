"""`config show` tells where every value of a run comes from; `config new` writes a configuration to edit."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from autopilot.cli.config_command import config
from autopilot.core.errors import ConfigError
from autopilot.run.vehicle_config import config_names, load_config


@pytest.mark.parametrize("name", config_names())
def test_a_vehicles_configuration(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("AUTOPILOT_LOG_DIR", str(tmp_path))
    done = CliRunner().invoke(config, ["show", "--config", name, "--json"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.output)
    assert told["settings"]["connect"]["origin"] == f"file {name}.toml"
    assert told["settings"]["log_dir"] == {"value": str(tmp_path), "origin": "environment AUTOPILOT_LOG_DIR"}
    assert told["settings"]["plan"]["origin"] == "default"
    assert all(device["driver"] for device in told["devices"].values())
    assert told["vehicle"]["thruster"]


def test_one_or_the_other() -> None:
    done = CliRunner().invoke(config, ["show", "paper-tank", "--config", "lbv150"])
    assert done.exit_code == 2 and "give one" in done.output


@pytest.mark.parametrize("name", config_names())
def test_a_copy_to_edit_loads(name: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(config, ["new", "mine", "--from", name, "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert load_config(str(tmp_path / "mine.toml")).file == load_config(name).file
    again = CliRunner().invoke(config, ["new", "mine", "--out", str(tmp_path)])
    assert isinstance(again.exception, ConfigError) and "choose another name" in str(again.exception)


@pytest.mark.parametrize("name", config_names())
def test_write_is_another_word_for_new_and_copies_the_shipped_one_of_that_name(name: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(config, ["write", name, "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert load_config(str(tmp_path / f"{name}.toml")).file == load_config(name).file
    listed = CliRunner().invoke(config, ["--help"]).output
    assert "new " in listed and "write " not in listed.partition("Commands:")[2]
