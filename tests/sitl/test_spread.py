"""What a campaign draws: within its bounds, the same for the same seed, each key on its own, wrong keys named."""

import itertools
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.core.errors import ConfigError
from autopilot.sitl.scenario import load_scenario, load_tables, scenario_path
from autopilot.sitl.scenario_tables import SpreadTable
from autopilot.sitl.spread import RUN_SEEDS, drawn_tables, drawn_values, run_seed
from autopilot.sitl.toml_text import toml_text

SETS = ("r1", "r2", "r3", "r4", "r5", "r6")


def with_spread(folder: Path, lines: str) -> str:
    path = folder / "mine.toml"
    shipped = scenario_path("paper-tank").read_text(encoding="utf-8")
    path.write_text(
        f'{shipped}\n[[fault]]\nkind = "thruster_loss"\nat_s = 5.0\nthruster = "port"\n\n[spread]\n{lines}\n'
    )
    return str(path)


def test_values_lie_within_their_bounds_and_fill_them() -> None:
    spread = {
        "a": SpreadTable(low=0.8, high=1.2),
        "b": SpreadTable(low=-1.0, high=-0.5),
        "c": SpreadTable(choice=["x", "y", "z"]),
    }
    runs = [drawn_values(spread, 3, run) for run in range(400)]
    for key, low, high in (("a", 0.8, 1.2), ("b", -1.0, -0.5)):
        values = [float(run[key]) for run in runs]
        assert low <= min(values) < low + 0.02 * (high - low)
        assert high - 0.02 * (high - low) < max(values) <= high
        assert sum(values) / len(values) == pytest.approx(0.5 * (low + high), abs=0.06 * (high - low))
    counts = [sum(run["c"] == name for run in runs) for name in ("x", "y", "z")]
    assert min(counts) > 100


def test_a_run_is_the_same_again_and_differs_from_every_other() -> None:
    spread = {"a": SpreadTable(low=0.0, high=1.0)}
    drawn = {(seed, run): drawn_values(spread, seed, run)["a"] for seed in range(5) for run in range(20)}
    assert len(set(drawn.values())) == 100
    assert drawn[2, 7] == drawn_values(spread, 2, 7)["a"]
    assert run_seed(2, 7) == 2 * RUN_SEEDS + 7


def test_keys_are_drawn_on_their_own() -> None:
    alone = drawn_values({"b": SpreadTable(low=0.0, high=1.0)}, 1, 4)
    beside = drawn_values({"a": SpreadTable(low=0.0, high=1.0), "b": SpreadTable(low=0.0, high=1.0)}, 1, 4)
    assert beside["b"] == alone["b"] != beside["a"]


def test_a_drawn_scenario_is_a_file_of_its_own(tmp_path: Path) -> None:
    lines = (
        '"vehicle.mismatch.drag" = { low = 0.7, high = 0.8 }\n"tank.polygon_m[0][1]" = { low = -1.6, high = -1.5 }\n'
        '"sensors.pose.outages.per_minute" = { low = 2.0, high = 3.0 }\n'
        '"fault[0].thruster" = { choice = ["lateral"] }'
    )
    name = with_spread(tmp_path, lines)
    tables, spread = load_tables(name), load_scenario(name).spread
    before = toml_text(tables)
    drawn = tmp_path / "drawn.toml"
    drawn.write_text(toml_text(drawn_tables(tables, spread, 1, 3)), encoding="utf-8")
    scenario = load_scenario(str(drawn))
    assert scenario.scenario.seed == 1_000_003
    assert 0.7 <= scenario.vehicle.mismatch["drag"] <= 0.8
    assert scenario.tank is not None
    assert -1.6 <= scenario.tank.polygon_m[0][1] <= -1.5
    assert 2.0 <= scenario.sensors.pose.outages.per_minute <= 3.0
    assert "lateral" in repr(scenario.fault)
    assert scenario.spread == {}
    assert toml_text(tables) == before, "drawing leaves the tables alone"


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_any_text_survives_being_written_for_a_run(text: str) -> None:
    tables = {"scenario": {"description": text}}
    assert tomllib.loads(toml_text(tables)) == tables


WRONG: dict[str, tuple[str, str]] = {
    "unknown factor": (
        '"vehicle.mismatch.colour" = { low = 0.9, high = 1.1 }',
        r'`\$\.spread\."vehicle\.mismatch\.colour"` = 0\.9: .*\'colour\' is not known',
    ),
    "unknown key": ('"sensors.pose.smell" = { low = 0.0, high = 1.0 }', r"pose\.smell.*unknown field `smell`"),
    "low out of range": ('"current.speed_m_s" = { low = 0.1, high = 0.05 }', r"`high` = 0\.05 is below `low` = 0\.1"),
    "high out of range": (
        '"sensors.pose.outlier_probability" = { low = 0.0, high = 1.5 }',
        r"outlier_probability\"` = 1\.5: .*<= 1\.0",
    ),
    "not a number": ('"vehicle.model" = { low = 0.0, high = 1.0 }', r'"vehicle\.model"` = 0\.0: Expected `str`'),
    "no such element": ('"fault[1].at_s" = { low = 0.0, high = 1.0 }', r"there is no element \[1\]"),
    "through a number": ('"current.speed_m_s.x" = { low = 0.0, high = 1.0 }', "there is no key 'x'"),
    "no such thruster": ('"fault[0].thruster" = { choice = ["left"] }', r"= left: .*'left' is not known"),
    "no bounds": ('"current.speed_m_s" = {}', "give `low` and `high`, or `choice`"),
    "half of them": ('"current.speed_m_s" = { low = 0.1 }', "give `low` and `high`, or `choice`"),
    "misspelt bound": (
        '"vehicle.mismatch.drag" = { low = 0.8, hihg = 1.2 }',
        r"did you mean high\? use one of low, high, choice",
    ),
    "nothing to choose": ('"vehicle.mismatch.drag" = { choice = [] }', r"spread.*choice"),
    "no number": ('"vehicle.mismatch.drag" = { low = nan, high = 1.0 }', "is not a finite number"),
    "negative factor": ('"vehicle.mismatch.mass" = { low = -0.5, high = 1.0 }', r'\.mass"` = -0\.5'),
    "no such kind": ('"current.kind" = { choice = ["jet", "rapids"] }', "'rapids'"),
    "both": ('"current.speed_m_s" = { low = 0.1, high = 0.2, choice = [1.0] }', "give either `choice`"),
    "bad path": ('"current..speed_m_s" = { low = 0.1, high = 0.2 }', "is not a key of the world"),
    "seed": ('"scenario.seed" = { choice = [1] }', "is not a key of the world"),
    "not quoted": ("current.speed_m_s = { low = 0.1, high = 0.2 }", "unknown field `speed_m_s`"),
    "less than the hull": ('"vehicle.mismatch.surge_mass" = { low = 0.5, high = 1.0 }', "leaves less than the hull"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_spread_is_refused_with_the_name_of_the_key(tmp_path: Path, case: str) -> None:
    lines, message = WRONG[case]
    with pytest.raises(ConfigError, match=message) as caught:
        load_scenario(with_spread(tmp_path, lines))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", SETS)
def test_every_set_gives_good_scenarios(name: str, tmp_path: Path) -> None:
    tables, scenario = load_tables(name), load_scenario(name)
    assert scenario.sensors.position == "pose"
    assert scenario.spread
    drawn: list[Any] = []
    for run in range(3):
        path = tmp_path / f"{run}.toml"
        path.write_text(toml_text(drawn_tables(tables, scenario.spread, 1, run)), encoding="utf-8")
        assert tomllib.loads(path.read_text()) == drawn_tables(tables, scenario.spread, 1, run)
        drawn.append(load_scenario(str(path)))
    assert drawn[0] != drawn[1] != drawn[2]


def test_each_set_adds_to_the_one_before() -> None:
    spreads = [load_scenario(name).spread for name in SETS[:4]]
    for fewer, more in itertools.pairwise(spreads):
        assert fewer.items() < more.items()
