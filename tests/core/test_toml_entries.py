"""Errors in tables whose keys are free, such as ``[spread]`` and ``[params]``: the entry is named."""

import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.core.errors import ConfigError
from autopilot.core.toml_table import MOST, convert, parse_toml
from autopilot.sitl.scenario_tables import Scenario

HEAD = {"scenario": {"name": "a", "description": "A tank"}, "vehicle": {"model": "lbv150", "start_m": [0.0, 0.0, 0.5]}}
SOUND = {f"vehicle.mismatch.{name}": {"low": 0.8, "high": 1.2} for name in ("surge_mass", "sway_mass", "thrust", "arm")}


def told(**tables: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        convert({**HEAD, **tables}, Scenario, "my.toml")
    return str(caught.value)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"low": 1.2, "high": 0.8}, "`high` = 0.8 is below `low` = 1.2"),
        ({"low": 0.8}, "give `low` and `high`, or `choice`"),
        ({"choice": []}, "length >= 1"),
        ({"normal": 0.8}, "unknown field `normal`"),
        ({"low": "a", "high": "b"}, "got `str`"),
        (3, "got `int`"),
    ],
)
@given(which=st.sampled_from(sorted(SOUND)))
def test_a_distribution_that_cannot_be_is_named(which: str, entry: Any, words: str) -> None:
    error = told(spread={**SOUND, which: entry})
    assert words in error and f'$.spread."{which}"' in error and "[...]" not in error
    assert re.search(r"; (correct|use one of|did you mean)", error), "and what to do"


def test_a_parameter_that_is_no_number_is_named() -> None:
    assert "$.params.SPD_PLANAR_MAX" in told(params={"THR_LIMIT": 12.0, "SPD_PLANAR_MAX": "fast"})


@given(st.floats(MOST, exclude_min=True, allow_infinity=False), st.sampled_from([-1, 1]))
def test_a_number_that_nothing_can_be_computed_with_is_named(size: float, sign: int) -> None:
    assert f"`$.params.THR_LIMIT` = {sign * size} is too large" in told(params={"THR_LIMIT": sign * size})


@pytest.mark.parametrize("text", ["a = " + "9" * 5000, "a = " + "[" * 100_000, "a = 1979-13-40"])
def test_text_that_python_cannot_parse_is_no_toml(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^my\.toml: is not valid TOML: .*; correct it") as caught:
        parse_toml(text, "my.toml")
    assert len(str(caught.value)) < 300


def test_a_whole_number_beyond_floats_is_named() -> None:
    assert len(told(params={"THR_LIMIT": 10**400})) < 200
