"""Campaigns side by side: what the folders hold, confidence, modes compared run by run."""

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from autopilot.campaign.definition import define
from autopilot.campaign.results import Margin, RunResult
from autopilot.campaign.run_store import Shard, Store
from autopilot.campaign.run_table import median_interval, proportion
from autopilot.cli.main import cli
from autopilot.core.errors import ConfigError


@given(count=st.integers(1, 400), part=st.floats(0.0, 1.0))
def test_shares_at_the_ends_of_the_interval_are_just_not_ruled_out(count: int, part: float) -> None:
    """With the share at an end of the interval, so many hits or more (or fewer) have a chance of 2.5 %."""
    hits = round(part * count)
    found = proportion(hits, count)
    assert found.low <= hits / count <= found.high
    if hits > 0:
        assert binom.sf(hits - 1, count, found.low) == pytest.approx(0.025, rel=1e-6)
    if hits < count:
        assert binom.cdf(hits, count, found.high) == pytest.approx(0.025, rel=1e-6)


@given(values=st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=80, unique=True))
def test_interval_of_a_median_misses_it_once_in_twenty_times(values: list[float]) -> None:
    """It does if fewer than ``below`` or at least ``count - above`` values lie below the true median, each with 1/2."""
    found, count = median_interval(values), len(values)
    assert found.median is not None
    if found.low is None or found.high is None:
        assert count < 6, "the range of six values holds the median in 97 %"
        return
    below, above = sum(each < found.low for each in values), sum(each > found.high for each in values)
    assert binom.cdf(below, count, 0.5) + binom.sf(count - above - 1, count, 0.5) <= 0.05
    assert found.low <= found.median <= found.high


def flown(number: int, seed: int, energy_j: float, **more: Any) -> RunResult:
    """A run of three laps that kept everything."""
    margins = {
        "walls": Margin(margin=0.02 + 0.001 * number, at_s=1.0, tolerance=0.01),
        "heave": Margin(margin=0.001, at_s=1.0, tolerance=0.01),
    }
    told: dict[str, Any] = {
        "laps": 3, "laps_asked": 3, "completed": True, "energy_j": [energy_j] * 3, "lap_s": [25.0, 26.0, 27.0],
        "steps": 1000, "margins": margins, **more,
    }  # fmt: skip
    return RunResult(run=number, seed=seed, drawn={"x": float(number)}, **told)


def keep(out: Path, cost: float, results: list[RunResult], controller: str | None = None) -> Path:
    """A folder as a campaign leaves it."""
    store = Store(out, define("r1", params={"MPC_COST": cost}, controller=controller), Shard())
    for result in results:
        store.append(result)
    store.close()
    return out


def print_table(*arguments: str) -> str:
    return CliRunner().invoke(cli, ["campaign", "table", *arguments], catch_exceptions=False).output


@pytest.fixture
def both(tmp_path: Path) -> tuple[str, str]:
    """One set in both modes: ten runs each, in one mode with an alarm, a contact and a run that never began."""
    quadratic = keep(tmp_path / "r1-0", 0.0, [flown(k, 100 + k, 900.0 + k) for k in range(10)])
    least = [flown(k, 100 + k, 500.0 + k, pos_rms_m=0.002 * k, pos_max_m=0.01 * k) for k in range(7)]
    least.append(flown(7, 107, 500.0, events=["3.50 s Thruster port gives 62 % of its thrust"]))
    least.append(flown(8, 108, 500.0, laps=2, contacts=1, failsafes=["geofence"]))
    broken = define("r1").task(9)
    return str(quadratic), str(keep(tmp_path / "r1-1", 1.0, [*least, broken.failed("no thrust")]))


def test_rows_say_what_the_runs_did(both: tuple[str, str]) -> None:
    found = json.loads(print_table(*both, "--json"))
    first, second = found["rows"]
    assert [first["mode"], second["mode"]] == ["quadratic", "least energy"]
    assert (first["arrived"]["hits"], first["failed"]["hits"], first["alarmed"]["hits"]) == (10, 0, 0)
    assert first["least_m"] == 0.02, "speeds are no distances"
    assert first["lap_j"]["median"] == 904.5
    assert first["lap_s"]["median"] == 26.0
    assert (second["runs"], second["errors"], second["contacts"]) == (10, 1, 1)
    assert (second["arrived"]["hits"], second["failed"]["hits"]) == (8, 2)
    assert (second["alarmed"]["hits"], second["alarmed"]["count"]) == (1, 9)
    assert second["failsafes"] == ["geofence"]
    assert second["pos_mm"]["median"] == pytest.approx(4.0)
    assert second["worst_mm"] == pytest.approx(60.0)


def test_modes_are_compared_run_by_run(both: tuple[str, str], tmp_path: Path) -> None:
    (pair,) = json.loads(print_table(*both, "--json"))["pairs"]
    assert pair["cheaper"]["count"] == 8, "runs that arrived in both"
    assert pair["ratio"]["low"] <= pair["ratio"]["median"] <= pair["ratio"]["high"] < 0.57
    other = keep(tmp_path / "other", 1.0, [flown(k, 200 + k, 500.0) for k in range(10)])
    assert json.loads(print_table(both[0], str(other), "--json"))["pairs"] == [], "other seeds are other vehicles"


def test_another_controller_is_named_and_no_cost_of_ours(both: tuple[str, str], tmp_path: Path) -> None:
    other = keep(tmp_path / "other", 1.0, [flown(k, 100 + k, 500.0) for k in range(10)], "los-pid")
    found = json.loads(print_table(both[0], str(other), "--json"))
    assert [row["mode"] for row in found["rows"]] == ["quadratic", "own cost, los-pid"] and found["pairs"] == []


def test_markdown_has_a_row_per_folder_and_the_comparison(both: tuple[str, str]) -> None:
    text = print_table(*both, "--markdown")
    head, rule, *rows = [line for line in text.splitlines() if line.startswith("|")]
    assert len(rows) == 2
    assert len({line.count("|") for line in (head, rule, *rows)}) == 1
    assert "10 of 10 (69.2 to 100.0 %)" in rows[0]
    assert "r1: a lap of least energy takes 0.56" in text


def test_a_folder_without_a_campaign_is_named(tmp_path: Path) -> None:
    result = CliRunner().invoke(cli, ["campaign", "table", str(tmp_path)], standalone_mode=False)
    assert isinstance(result.exception, ConfigError)
    assert "holds no campaign" in str(result.exception)


def test_flying_needs_no_word(tmp_path: Path) -> None:
    """``campaign SCENARIO`` and ``campaign fly SCENARIO`` are one."""
    for words in (["campaign"], ["campaign", "fly"]):
        result = CliRunner().invoke(
            cli, [*words, "no-such-scenario", "--runs", "1", "--out", str(tmp_path)], standalone_mode=False
        )
        assert isinstance(result.exception, ConfigError)
        assert "no-such-scenario" in str(result.exception)
