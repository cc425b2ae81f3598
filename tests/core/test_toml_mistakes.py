"""Every mistake of a file is named at once, whatever the combination."""

import copy
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.errors import ConfigError
from autopilot.sitl.scenario import _of_tables as scenario_of

Tables = dict[str, Any]

SOUND: Tables = {
    "scenario": {"name": "a", "description": "A tank", "seed": 1},
    "tank": {"polygon_m": [[-2.5, -1.5], [2.5, -1.5], [2.5, 1.5], [-2.5, 1.5]], "depth_m": 1.5},
    "obstacle": [
        {"kind": "cylinder", "center_m": [north, 0.0], "radius_m": 0.1, "surprise": False} for north in (-1.0, 0.0, 1.0)
    ],
    "vehicle": {"model": "lbv150", "start_m": [0.0, 1.0, 0.5], "start_yaw_rad": 0.0},
    "sensors": {"ahrs": {"rate_hz": 100.0}},
    "fault": [{"kind": "thruster_loss", "thruster": "port", "at_s": 3.0}],
    "params": {"MPC_COST": 0.0, "SPD_CRUISE": 0.2},
}


def renamed(table: str, key: str, wrong: str) -> Callable[[Tables], None]:
    def act(tables: Tables) -> None:
        tables[table][wrong] = tables[table].pop(key)

    return act


def put(value: Any, *path: Any) -> Callable[[Tables], None]:
    def act(tables: Tables) -> None:
        here: Any = tables
        for step in path[:-1]:
            here = here[step]
        here[path[-1]] = value

    return act


def without(*path: Any) -> Callable[[Tables], None]:
    def act(tables: Tables) -> None:
        here: Any = tables
        for step in path[:-1]:
            here = here[step]
        del here[path[-1]]

    return act


MISTAKES: dict[str, Callable[[Tables], None]] = {
    "unknown field `descripton` - at `$.scenario`; did you mean description?": renamed(
        "scenario", "description", "descripton"
    ),
    "Expected `int`, got `str` - at `$.scenario.seed`": put("three", "scenario", "seed"),
    "Expected `float`, got `str` - at `$.tank.polygon_m[1][1]`": put("a", "tank", "polygon_m", 1, 1),
    "missing required field `radius_m` - at `$.obstacle[0]`": without("obstacle", 0, "radius_m"),
    "Invalid value 'cylindr' - at `$.obstacle[1].kind`; did you mean cylinder?": put("cylindr", "obstacle", 1, "kind"),
    "got `str` - at `$.obstacle[2].surprise`": put("no", "obstacle", 2, "surprise"),
    "unknown field `start` - at `$.vehicle`; did you mean start_m?": renamed("vehicle", "start_m", "start"),
    "unknown field `rate` - at `$.sensors.ahrs`": put(1.0, "sensors", "ahrs", "rate"),
    "Expected `float`, got `str` - at `$.params.MPC_COST`": put("one", "params", "MPC_COST"),
    "unknown field `curent`; did you mean current?": put({"kind": "none"}, "curent"),
    "`$.params.SPD_CRUISE`: parameter SPD_CRUISE = 99 is out of range": put(99.0, "params", "SPD_CRUISE"),
    "`$.params.SPD_CRUS`: parameter 'SPD_CRUS' is not known; did you mean SPD_CRUISE?": put(0.1, "params", "SPD_CRUS"),
    "`$.vehicle.mismatch`: factor 'drog' is not known; did you mean drag?": put({"drog": 1.1}, "vehicle", "mismatch"),
    "`$.fault[0].thruster`: thruster 'bow' is not known": put("bow", "fault", 0, "thruster"),
}


@settings(max_examples=40)
@given(st.sets(st.sampled_from(sorted(MISTAKES)), min_size=1))
def test_all_mistakes_are_named_at_once(chosen: set[str]) -> None:
    tables = copy.deepcopy(SOUND)
    scenario_of(tables, "my.toml")
    # Of one obstacle's table either the kind or a key: the key's index counts obstacles as they stand in the file.
    for name in sorted(chosen):
        MISTAKES[name](tables)
    with pytest.raises(ConfigError) as caught:
        scenario_of(tables, "my.toml")
    text = str(caught.value)
    assert [name for name in chosen if name not in text] == []
    head, *lines = text.splitlines()
    assert (len(lines), head.startswith("my.toml: ")) == (len(chosen) if len(chosen) > 1 else 0, True)
