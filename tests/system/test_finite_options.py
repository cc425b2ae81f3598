"""No number of the command line may be nan or inf, which pass comparisons or open ends, and none is printed as JSON."""

import json
import math
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
import pytest

from autopilot.cli.console_output import emit_json
from autopilot.cli.main import cli, run


def numbers(group: click.Group, words: tuple[str, ...] = ()) -> Iterator[tuple[str, click.Parameter]]:
    """Name and parameter of all that take real numbers, in all commands."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from numbers(command, (*words, name))
            continue
        for param in command.params:
            if isinstance(param.type, click.types.FloatParamType):
                yield " ".join((*words, name, max(param.opts, key=len))), param


NUMBERS = dict(numbers(cli))


def test_they_are_found() -> None:
    assert {name.split()[0] for name in NUMBERS} >= {"sitl", "run", "campaign", "motors", "mission"}


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize("name", NUMBERS)
def test_each_is_finite(name: str, value: str) -> None:
    """The last one of several values is the wrong one."""
    param = NUMBERS[name]
    values = ("1",) * (param.nargs - 1) + (value,)
    given = values[0] if param.nargs == 1 else values
    with pytest.raises(click.BadParameter, match="is not a finite number"):
        param.type_cast_value(click.Context(cli), [given] if param.multiple else given)


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_a_campaign_does_not_begin(value: str, tmp_path: object, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["campaign", "r1", "--runs", "2", "--out", f"{tmp_path}/out", "--duration", value]
    assert run(lambda: cli(command, prog_name="autopilot", standalone_mode=False)) == 2
    assert f"'--duration': {value} is not a finite number" in capsys.readouterr().err


def test_json_has_null_for_numbers_that_it_cannot_write(capsys: pytest.CaptureFixture[str]) -> None:
    def refused(text: str) -> None:
        raise AssertionError(text)

    emit_json({"rows": [{"far": math.inf, "near": (1.5, math.nan)}], "none": np.float64("-inf"), "name": Path("a")})
    told = json.loads(capsys.readouterr().out, parse_constant=refused)
    assert told == {"rows": [{"far": None, "near": [1.5, None]}], "none": None, "name": "a"}
