"""Errors in tables whose keys are free, such as ``[spread]`` and ``[params]``: the entry is named."""

import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.core.errors import ConfigError
from autopilot.core.toml_table import convert
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
